"""The C header of a six-step drive, as plain data and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.names import SIX_STEP_METHODS
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.six_step.control import SixStepGains
from dqforge.optimizer.six_step.sector_step import BlockGains
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.capability import Capability, Draw, Outcome, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import Chapter, render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.six_step.float32_model import six_step_inputs, six_step_outputs
from dqforge.reports.six_step.six_step_text import control_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.optimizer.solution import Solution


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
        if field.name != "observer":
            gains[field.name] = value if field.name in _WHOLE else _single(value)
    return {"method": design.method, "gains": gains}


def _read(kind: type[Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for field in fields(kind):
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
    what = (
        "the integral of its back-EMF" if found.by_integral else "the zero crossing of its back-EMF"
    )
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
            "of the terminals and the currents sampled in the middle of the on-time; the legs it "
            "returns act from the next period on.",
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
    return Programme(_HARNESS, inputs, outputs, "six-step control")


_GAINS = "&@@_SIX_STEP_GAINS, &drive"
_HARNESS = Harness(
    "six_step",
    "reset, torque mode, voltages, currents, link, reference; stage, fault, sector, legs, duty "
    "cycle, angle, speed, torque, chopped leg",
    (10, 10),
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
    data = {"tables": block_html(found)}
    return [ReportPart(CHAPTER, "six_step/report.html.j2", data, range_words(found))]


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
