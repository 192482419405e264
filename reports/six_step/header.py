"""The C header of a six-step drive, as plain data and as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.names import SIX_STEP_METHODS
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.six_step import control, sector_step
from dqforge.optimizer.six_step.control import (
    FAULTS,
    STAGES,
    SixStep,
    SixStepGains,
    SixStepLegs,
    blank,
    six_step_diode_step,
    six_step_reset,
    six_step_speed_control,
    six_step_step,
    six_step_torque_control,
)
from dqforge.optimizer.six_step.sector_step import BlockGains, BlockState, SixStepSeen
from dqforge.optimizer.steps.step_arithmetic import Abc, cast
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.capability import Capability, Draw, Outcome, Passage, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import Chapter, render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import record_structs, record_values, vector_struct
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.optimizer.solution import Solution


# Float32 model of the emitted six-step control: the steps of `dqforge.optimizer.six_step.control`
# on numpy's single precision, and sequences that lead through all its stages.

_LENGTH = 250  # rows of a short sequence
_LONGEST = 12_000  # rows of the sequence that goes through alignment and ramp
_FACTOR = 1.6539866862653762  # of a sine: emf over the amplitude of the flux

# Columns of the inputs: reset, torque mode, v_a, v_b, v_c, i_a, i_b, i_c, v_dc, reference, whether
# the diodes of a, b and c conduct.
COLUMNS = 13

# Columns of the results: stage, fault, sector, high, low, duty, angle, speed, torque, chopped leg.
RESULTS = 10


def _sequence(
    gains: SixStepGains, generator: np.random.Generator, rows: int, omega: float, torque: bool
) -> np.ndarray:
    """A rotor that turns at a speed in rad/s (electrical), slowly faster, with noise."""
    t_s, flux = gains.observer.t_s, gains.emf / _FACTOR
    speeds = omega * (1.0 + 0.3 * np.linspace(0.0, 1.0, rows))
    theta = generator.uniform(-np.pi, np.pi) + np.cumsum(speeds) * t_s
    size = np.abs(speeds) * flux
    link = 20.0 * gains.emf * gains.omega_caught
    found = np.zeros((rows, COLUMNS))
    found[0, 0] = 1.0
    found[:, 1] = float(torque)
    for phase in range(3):
        lag = theta - 2.0 * np.pi / 3.0 * phase
        noise = 0.01 * (size + 0.1) * generator.standard_normal(rows)
        found[:, 2 + phase] = 0.5 * link - np.sign(omega) * size * np.sin(lag) + noise
        found[:, 5 + phase] = gains.i_max * generator.normal(0.0, 0.5, rows)
        found[:, 10 + phase] = np.sign(omega) * np.sin(2.0 * lag) > 0.0
    found[:, 8] = link
    way = 1.0 if omega >= 0.0 else -1.0
    asked = gains.torque * gains.i_max if torque else 1.3 * abs(omega) / gains.pole_pairs
    found[:, 9] = way * max(asked, 1.5 * gains.omega_least if not torque else asked)
    if rows > 200 and generator.random() < 0.3:
        found[rows // 2 :, 9] *= generator.choice([0.0, -1.0])
    unknown = generator.random((rows, 6)) < 0.002
    found[:, 2:8][unknown] = np.nan
    return found


def six_step_inputs(gains: SixStepGains, count: int, seed: int) -> SingleArray:
    """Rows for the harness, shape (rows, `COLUMNS`): many short sequences at all speeds of both
    directions, and one through alignment and ramp.

    Args:
        gains: Of the control.
        count: Rows of the short sequences, about.
        seed: Of the draws.
    """
    generator = np.random.default_rng(seed)
    whole = 2 * gains.align + round(gains.rate / gains.rise) + 6 * (gains.settle + gains.gap)
    parts = [_sequence(gains, generator, min(whole, _LONGEST), 0.0, torque=False)]
    for place in range(max(1, count // _LENGTH)):
        speed = gains.omega_caught * 10.0 ** generator.uniform(-0.5, 1.0)
        rows = max(_LENGTH, 3 * (gains.settle + gains.gap))
        way = 1.0 if place % 2 == 0 else -1.0
        parts.append(_sequence(gains, generator, rows, way * speed, torque=place % 3 == 0))
    return np.ascontiguousarray(np.concatenate(parts).astype(np.float32))


def _row(drive: SixStep, gains: SixStepGains, given: SingleArray) -> list[float]:
    if given[1] > 0.0:
        asked = six_step_torque_control(SINGLE, drive, given[9])
    else:
        asked = six_step_speed_control(SINGLE, gains, drive, given[9])
    v, i, diodes = Abc(*given[2:5]), Abc(*given[5:8]), Abc(*given[10:13])
    if gains.observer.late is None:
        legs = six_step_step(SINGLE, gains, drive, v, i, given[8])
    else:
        legs = six_step_diode_step(SINGLE, gains, drive, v, diodes, i, given[8])
    seen = drive.observer
    found = (
        drive.stage,
        drive.fault,
        drive.sector,
        legs.high,
        legs.low,
        legs.duty,
        seen.theta_e,
        seen.omega_e,
        asked,
        legs.chopped,
    )
    return [float(number) for number in found]


def six_step_outputs(gains: SixStepGains, inputs: SingleArray) -> SingleArray:
    """What the compiled control must return for rows of inputs, shape (rows, `RESULTS`).

    Args:
        gains: Of the control, float32 values.
        inputs: Of `six_step_inputs`.
    """
    found, own = np.empty((len(inputs), RESULTS), dtype=np.float32), cast(gains, SINGLE)
    drive = blank()
    six_step_reset(SINGLE, own, drive)
    with np.errstate(all="ignore"):
        for place, given in enumerate(inputs):
            if given[0] > 0.0:
                six_step_reset(SINGLE, own, drive)
            found[place] = _row(drive, own, given)
    return found


# The six-step control in C, written from its steps.


@dataclass(frozen=True, slots=True)
class ZeroCrossingGains(BlockGains):
    """Numbers of the estimator; those with two entries hold forwards and backwards."""


@dataclass(slots=True)
class ZeroCrossing(BlockState):
    """What the estimator keeps from sample to sample."""


@dataclass(frozen=True, slots=True)
class EmfIntegrationGains(BlockGains):
    """Numbers of the estimator; those with two entries hold forwards and backwards."""


@dataclass(slots=True)
class EmfIntegration(BlockState):
    """What the estimator keeps from sample to sample."""


@dataclass(frozen=True, slots=True)
class DiodeConductionGains(BlockGains):
    """Numbers of the estimator; those with two entries hold forwards and backwards."""


@dataclass(slots=True)
class DiodeConduction(BlockState):
    """What the estimator keeps from sample to sample."""


# What the records of the estimator are called in C, by its name there.
_KINDS: dict[str, tuple[type[BlockGains], type[BlockState]]] = {
    "zero_crossing": (ZeroCrossingGains, ZeroCrossing),
    "emf_integration": (EmfIntegrationGains, EmfIntegration),
    "diode_conduction": (DiodeConductionGains, DiodeConduction),
}


def _named(kind: type[Any], record: Any) -> Any:
    """A record as one of another name."""
    return kind(*(getattr(record, field.name) for field in fields(record)))


def control_text(code: str, gains: SixStepGains, prefix: str, macro: str) -> str:
    """What stands in the header behind the types that all headers share.

    Args:
        code: Name of the estimator in C.
        gains: Of the control.
        prefix, macro: Before the names of functions and types, and before those of macros.
    """
    own, kept = _KINDS[code]
    gains = replace(gains, observer=_named(own, gains.observer))
    blank = control.blank()
    state = replace(blank, observer=_named(kept, blank.observer))
    functions = _functions(code, gains, state, prefix)
    known = set[str]()
    parts = [
        *_enumerations(macro),
        *_tables(macro),
        *record_structs(gains, prefix, known=known),
        *record_structs(state, prefix, known=known),
        vector_struct(SixStepLegs, prefix),
        vector_struct(SixStepSeen, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {prefix}_six_step_gains_t {macro}_SIX_STEP_GAINS = {{",
            *record_values(gains, None),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def _functions(code: str, gains: SixStepGains, state: SixStep, prefix: str) -> Functions:
    names = {name: f"{code}_{name}" for name in ("crossing", "see", "due")}
    names |= {f"block_{name}": f"{code}_{name}" for name in ("start", "step")}
    names["diode_step"] = f"{code}_step"
    functions = Functions(names=names)
    reader = StepReader(prefix, functions, Block("", set()))
    number, v, i = Expression("number"), vector(Abc, "v"), vector(Abc, "i")
    start = [gains.observer, state.observer, 0, 1, number, number]
    reader.write(f"{code}_start", sector_step.block_start, start)
    diodes = vector(Abc, "diodes")
    seen = [gains.observer, state.observer]
    if gains.observer.late is None:
        reader.write(f"{code}_step", sector_step.block_step, [*seen, v])
    else:
        reader.write(f"{code}_step", sector_step.diode_step, [*seen, diodes])
    reader.write("six_step_reset", control.six_step_reset, [gains, state])
    speed, torque = control.six_step_speed_control, control.six_step_torque_control
    reader.write("six_step_speed_control", speed, [gains, state, number])
    reader.write("six_step_torque_control", torque, [state, number])
    if gains.observer.late is None:
        reader.write("six_step_step", control.six_step_step, [gains, state, v, i, number])
    else:
        own = [gains, state, v, diodes, i, number]
        reader.write("six_step_step", control.six_step_diode_step, own)
    return functions


def _enumerations(macro: str) -> Iterator[list[str]]:
    for begin, names in (("", STAGES), ("FAULT_", FAULTS)):
        values = [
            f"    {macro}_SIX_STEP_{begin}{name.upper().replace(' ', '_')} = {n}"
            for n, name in enumerate(names)
        ]
        yield [
            "/* Faults. */" if begin else "/* Stages. */",
            "enum {",
            *",\n".join(values).split("\n"),
            "};",
        ]


def _tables(macro: str) -> Iterator[list[str]]:
    """Phases by sector."""
    yield ["/* Phases by sector: fed, returning, floating. */"] + [
        f"static const int32_t {macro}_{name}[6] = {{ {', '.join(map(str, table))} }};"
        for name, table in sector_step.TABLES.items()
    ]


# The C header of a six-step drive, as plain data and as text.

_WHOLE = ("by_integral", "ratio", "align", "settle", "gap")


@dataclass(frozen=True, slots=True)
class EmittedSixStep:
    """What verification needs: the method and its gains, float32 values."""

    method: str
    gains: SixStepGains


def code_of(method: str) -> str:
    """Part of C names of a method.

    Args:
        method: As in the design file.
    """
    return method.replace("-", "_")


def _single(value: Any) -> Any:
    if isinstance(value, tuple):
        return [shortest(np.float32(item)) for item in value]
    return shortest(np.float32(value))


def plain_six_step(design: SixStepDesign) -> PlainData:
    """Method and gains as plain data; every number but the whole ones is a float32 value.

    Args:
        design: The six-step drive.
    """
    gains: dict[str, Any] = {
        "observer": {
            field.name: value if field.name in _WHOLE else _single(value)
            for field in fields(BlockGains)
            if (value := getattr(design.gains.observer, field.name)) is not None
        }
    }
    for field in fields(SixStepGains):
        value = getattr(design.gains, field.name)
        if field.name != "observer" and value is not None:
            gains[field.name] = value if field.name in _WHOLE else _single(value)
    return {"method": design.method, "gains": gains}


def _read(kind: type[Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for field in fields(kind):
        if field.default is None and field.name not in plain:
            continue
        value = plain[field.name]
        if field.name == "observer":
            values[field.name] = BlockGains(**_read(BlockGains, value))
        elif field.name in _WHOLE:
            values[field.name] = int(value)
        elif isinstance(value, list):
            values[field.name] = tuple(_finite(item) for item in value)
        else:
            values[field.name] = _finite(value)
    return values


def _finite(value: Any) -> float:
    number = float(np.float32(value))
    if not math.isfinite(number):
        raise ValueError(value)
    return number


def six_step_from(plain: Mapping[str, Any]) -> EmittedSixStep:
    """Read a header back.

    Args:
        plain: What `plain_six_step` makes.

    Raises:
        InputError: It is something else.
    """
    foreign = "six_step_header is not what dqforge writes; run the design again"
    try:
        gains = SixStepGains(**_read(SixStepGains, plain["gains"]))
        method = str(plain["method"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(foreign) from error
    whole = min(gains.align, gains.settle, gains.gap, gains.ratio)
    if method not in SIX_STEP_METHODS or len(gains.observer.crossings) != 6 or whole < 1:
        raise InputError(foreign)
    return EmittedSixStep(method, gains)


def range_text(found: SixStepDesign) -> str:
    """The speeds at which it holds, in words.

    Args:
        found: The six-step drive.
    """
    low, high = found.limits.low, found.limits.high
    return (
        f"from {low / (2.0 * math.pi):.3g} to {high / (2.0 * math.pi):.3g} Hz (electrical), where "
        "a commutation errs by at most 10 deg"
    )


def _preamble(design: Design, found: SixStepDesign) -> list[str]:
    prefix, start = design.export.prefix, found.start
    what = {
        "zero-crossing": "the zero crossing of its back-EMF",
        "emf-integration": "the integral of its back-EMF",
        "diode-conduction": "the diode of the phase that rests",
    }[found.method]
    diodes = ", whether a diode conducted in the off-time before" * found.disturbed.by_diode
    period = found.gains.observer.t_s * 1e6
    return [
        f"Blocks of 120 degrees, commutated by {what}, every {period:.6g} us.",
        *wrap(f"Range: {range_text(found)}.", 110),
        *wrap(
            f"Start: {start.align_time:.3g} s of alignment and {start.ramp_time:.3g} s of ramp "
            f"with {start.current:.4g} A, against at most {start.load:.4g} N m.",
            110,
        ),
        "",
        *wrap(
            f"{prefix}_six_step_reset() once; in every period {prefix}_six_step_speed_control() or "
            f"{prefix}_six_step_torque_control(), then {prefix}_six_step_step() with the voltages "
            f"of the terminals{diodes} and the currents sampled in the middle of the on-time; the "
            "legs it returns act from the next period on.",
            110,
        ),
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def six_step_files(design: Design, found: SixStepDesign) -> dict[str, bytes]:
    """Name and bytes of the header.

    Args:
        design: What it is of.
        found: Its six-step drive.
    """
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "preamble": _preamble(design, found),
        "body": control_text(code_of(found.method), found.gains, prefix, prefix.upper()),
    }
    text = render("six_step/six_step.h.j2", context)
    return {f"{prefix}_six_step.h": text.encode("ascii")}


def six_step_programme(emitted: EmittedSixStep) -> Programme:
    """The harness of a six-step drive, with what its model answers.

    Args:
        emitted: Its method and gains.
    """
    inputs = six_step_inputs(emitted.gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = six_step_outputs(emitted.gains, inputs)
    harness = _HARNESS if emitted.gains.observer.late is None else _DIODE_HARNESS
    return Programme(harness, inputs, outputs, "six-step control")


_GAINS = "&@@_SIX_STEP_GAINS, &drive"
_HARNESS = Harness(
    "six_step",
    "reset, torque mode, voltages, currents, link, reference, diodes; stage, fault, sector, legs, "
    "duty cycle, angle, speed, torque, chopped leg",
    (COLUMNS, RESULTS),
    (
        "const @_abc_t v = { in[2], in[3], in[4] };",
        "const @_abc_t i = { in[5], in[6], in[7] };",
        "@_six_step_legs_t legs;",
        "",
        "if (in[0] > 0.0F) {",
        f"    @_six_step_reset({_GAINS});",
        "}",
        "if (in[1] > 0.0F) {",
        "    out[8] = @_six_step_torque_control(&drive, in[9]);",
        "} else {",
        f"    out[8] = @_six_step_speed_control({_GAINS}, in[9]);",
        "}",
        f"legs = @_six_step_step({_GAINS}, v, i, in[8]);",
        "out[0] = (float)drive.stage;",
        "out[1] = (float)drive.fault;",
        "out[2] = (float)drive.sector;",
        "out[3] = (float)legs.high;",
        "out[4] = (float)legs.low;",
        "out[5] = legs.duty;",
        "out[6] = drive.observer.theta_e;",
        "out[7] = drive.observer.omega_e;",
        "out[9] = (float)legs.chopped;",
    ),
    vectors=False,
    states=("@_six_step_t drive;",),
    starts=(f"@_six_step_reset({_GAINS});",),
)


_DIODE_HARNESS = replace(
    _HARNESS,
    body=(
        "const @_abc_t diodes = { in[10], in[11], in[12] };",
        *(line.replace("v, i, in", "v, diodes, i, in") for line in _HARNESS.body),
    ),
)


# A six-step drive as tables, as plain data, and in the report.

_ERROR_COLUMNS = ("speed", "offset", "noise, 3 sigma", "grid", "saliency", "together")


_ERRORS = "Error of a commutation, electrical"


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.3g} deg"


def _hertz(omega: float) -> str:
    return format_quantity(omega / (2.0 * math.pi), "Hz", 4)


def range_words(found: SixStepDesign) -> str:
    """Electrical frequencies between which the drive is handed on by its voltages."""
    return f"{_hertz(found.limits.low)} to {_hertz(found.limits.high)}"


def block_rows(found: SixStepDesign) -> list[tuple[str, str]]:
    """Label and text of what was designed.

    Args:
        found: The six-step drive.
    """
    shape, limits, start = found.shape, found.limits, found.start
    rows = [
        ("commutation", found.method),
        ("from crossing to commutation", _degrees(shape.delay)),
        ("integral in between", f"{shape.threshold:.5g} V s"),
        ("torque over current", f"{shape.torque:.5g} N m/A"),
        ("torque ripple of ideal blocks, peak to peak", f"{100.0 * shape.ripple:.3g} %"),
        ("range (electrical)", range_words(found)),
        ("least speed by the error", _hertz(limits.by_error[0])),
        ("least speed by the duty cycle", _hertz(limits.by_duty)),
        ("largest speed by freewheeling", _hertz(limits.by_freewheeling)),
        ("freewheeling at the current limit", _degrees(limits.freewheeling)),
        (
            "current, two phases in series",
            f"kp {found.gains.kp:.4g} V/A, ki t_s {found.gains.ki_ts:.4g} V/A",
        ),
        (
            "start",
            (
                f"{start.current:.4g} A, aligned in {start.align_time:.3g} s, "
                f"ramp of {start.ramp_time:.3g} s"
            ),
        ),
        ("hand-over (electrical)", _hertz(start.omega)),
        ("largest load at the start", format_quantity(start.load, "N m", 4)),
    ]
    if found.speed is not None:
        rows.append(
            (
                "speed at the least speed",
                (
                    f"{1e3 * found.speed.delay:.3g} ms late, {_degrees(found.speed.margin)} of "
                    f"margin at {found.speed.crossover:.4g} rad/s"
                ),
            )
        )
    return rows


def _error_lines(found: SixStepDesign) -> list[tuple[str, ...]]:
    errors = found.errors
    columns = (errors.offset, 3.0 * errors.noise, errors.grid, errors.saliency, errors.largest)
    return [
        (_hertz(float(omega)), *(_degrees(float(column[k])) for column in columns))
        for k, omega in enumerate(errors.omega)
    ]


def block_tables(found: SixStepDesign) -> list[Table]:
    """Tables for the terminal.

    Args:
        found: The six-step drive.
    """
    return [
        Table("Six-step drive", ("", ""), tuple(block_rows(found))),
        Table(_ERRORS, _ERROR_COLUMNS, tuple(_error_lines(found))),
    ]


def block_html(found: SixStepDesign) -> list[HtmlTable]:
    """The same for the report.

    Args:
        found: The six-step drive.
    """
    rows = tuple(Row((symbols(name), symbols(text))) for name, text in block_rows(found))
    lines = tuple(Row(line) for line in _error_lines(found))
    return [
        HtmlTable("Six-step drive", ("", ""), rows, 2),
        HtmlTable(_ERRORS, _ERROR_COLUMNS, lines, 0),
    ]


def block_summary(found: SixStepDesign) -> list[tuple[str, str]]:
    """Rows of the summary of a run.

    Args:
        found: The six-step drive.
    """
    limits = found.limits
    return [
        (
            "six-step drive",
            f"{found.method}, {_hertz(limits.low)} to {_hertz(limits.high)} (electrical)",
        )
    ]


def plain_blocks(found: SixStepDesign) -> PlainData:
    """As plain data, in SI units.

    Args:
        found: The six-step drive.
    """
    shape, limits, start, errors = found.shape, found.limits, found.start, found.errors
    return {
        "method": found.method,
        "delay_rad": shape.delay,
        "spread_rad": shape.spread,
        "threshold_Vs": shape.threshold,
        "torque_Nm_per_A": shape.torque,
        "ripple": shape.ripple,
        "omega_low_rad_per_s": limits.low,
        "omega_high_rad_per_s": limits.high,
        "limits": {
            "error_rad_per_s": list(limits.by_error),
            "duty_rad_per_s": limits.by_duty,
            "freewheeling_rad_per_s": limits.by_freewheeling,
            "freewheeling_rad": limits.freewheeling,
        },
        "errors": {
            "omega_rad_per_s": errors.omega.tolist(),
            "offset_rad": errors.offset.tolist(),
            "noise_rms_rad": errors.noise.tolist(),
            "grid_rad": errors.grid.tolist(),
            "saliency_rad": errors.saliency.tolist(),
            "largest_rad": errors.largest.tolist(),
        },
        "start": {
            "current_A": start.current,
            "align_s": start.align_time,
            "ramp_s": start.ramp_time,
            "hand_over_rad_per_s": start.omega,
            "load_Nm": start.load,
        },
        "speed_loop": None
        if found.speed is None
        else {
            "kp": found.speed.kp,
            "ki": found.speed.ki,
            "delay_s": found.speed.delay,
            "crossover_rad_per_s": found.speed.crossover,
            "margin_rad": found.speed.margin,
        },
    }


# Six-step drives, as a record.

CHAPTER = Chapter("six_step", "Six-step drive")


def _of(outcome: Outcome) -> SixStepDesign | None:
    return outcome.solution.six_step


def _figures(_: Solution, found: SixStepDesign) -> Mapping[str, Draw]:
    from dqforge.reports.six_step.figures import plot_blocks

    return {"six_step": partial(plot_blocks, found)}


def _parts(_: Solution, found: SixStepDesign) -> list[ReportPart]:
    text = (
        "Blocks of 120 degrees: one leg is chopped, one stays at its rail, the third rests, and "
        "the voltage of its phase determines the instant of commutation."
    )
    caption = "Error of a commutation over the speed; dotted: the range."
    shown = Passage(text=[text], drawings=[("six_step", caption)], tables=block_html(found))
    return [shown.of(CHAPTER, range_words(found))]


SIX_STEP = Capability(
    name="six_step",
    title="six-step drive",
    of=_of,
    plain=lambda _, found: plain_blocks(found),
    always=False,
    summary=lambda _, found: block_summary(found),
    tables=lambda _, found: block_tables(found),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="six_step",
            files=lambda solution, found: six_step_files(solution.design, found),
            plain=lambda _, found: plain_six_step(found),
            read=lambda own, _: six_step_from(own),
            programme=six_step_programme,
            vectors=False,
        ),
    ),
)
