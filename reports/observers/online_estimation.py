"""The emitted on-line estimation: header, model, tables, JSON and words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.online_estimation import (
    CONSTANTS,
    FLUX,
    FLUX_WRONG,
    INDUCTANCE_WRONG,
    RESISTANCE,
    RESISTANCE_WRONG,
    SENSOR_WRONG,
    OnlineEstimationFit,
    OnlineEstimationGains,
    Sought,
    advancing,
    at_rest,
    start,
)
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, cast
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.capability import Capability, Passage, ReportPart
from dqforge.reports.observers.float32_model import gains_from, plain_gains_of
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.control_types import control_types
from dqforge.reports.steps.record_text import record_structs, record_values
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.steps.word_reader import WordReader

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData

TITLE = "On-line estimation of resistance and magnet flux"
_NAME = "online_estimation"
_LENGTH = 100  # Samples of a sequence.
# Both estimates at its start over the data: as they are, and near the ends of their ranges.
_FIRST = (1.0, 1.0, 0.7642, 0.6801, 1.1199, 1.6287)
_COLUMNS_IN, _COLUMNS_OUT = 7, 3

_SEEN = {0: "neither", RESISTANCE: "resistance", FLUX: "flux", RESISTANCE | FLUX: "both"}

_CAUSES = {
    "dead_time": "dead time",
    "l_d": "L_d",
    "l_q": "L_q",
    "sensor": "sensors",
    "r_s": "R wrong",
    "psi_pm": "psi wrong",
}


# What is said of it.


def estimation_rows(found: OnlineEstimationFit) -> list[tuple[str, str]]:
    """Label and text of what holds at every point."""
    sought, most = found.sought, found.largest_current
    names = [name for name, on in (("flux", sought.flux), ("resistance", sought.resistance)) if on]
    rows = [("estimated on line", f"{' and '.join(names)}, within {found.time_constant:.4g} s")]
    if sought.resistance:
        if found.least_current > most:
            rows.append(("resistance", f"never seen: dead time hides it up to {_ampere(most)}"))
        else:
            top = format_quantity(found.fastest_for_resistance(most), "rpm", 3)
            rows.append(
                (
                    "resistance",
                    f"from {_ampere(found.least_current)}, and up to {top} at {_ampere(most)}",
                )
            )
    if sought.flux:
        none, full = (format_quantity(found.slowest_for_flux(i), "rpm", 3) for i in (0.0, most))
        rows.append(("flux", f"from {none} without current to {full} at {_ampere(most)}"))
    return rows


def _ampere(current: float) -> str:
    return format_quantity(current, "A", 3)


def _notes(found: OnlineEstimationFit) -> tuple[str, ...]:
    left = format_quantity(found.dead_time_left, "V", 3)
    return (
        *(f"{label}: {text}" for label, text in estimation_rows(found)),
        (
            f"errors in % of what is seen, by {left} of a dead time, L_d and L_q "
            f"{100.0 * INDUCTANCE_WRONG:.3g} % and sensors {100.0 * SENSOR_WRONG:.3g} % above what "
            f"is known, R {100.0 * RESISTANCE_WRONG:.3g} % and psi {100.0 * FLUX_WRONG:.3g} %"
        ),
    )


_HEADS = (
    "torque", "speed", "current A", "seen", "time constant s",
    *(f"{said} %" for said in _CAUSES.values()),
)  # fmt: skip


def point_rows(found: OnlineEstimationFit) -> list[tuple[str, ...]]:
    """A row per operating point."""
    seen, at = found.seen, found.points
    rows = []
    for n, torque in enumerate(found.torque.tolist()):
        settling = float(seen.settling[n])
        rows.append(
            (
                format_quantity(torque, "N m", 3),
                format_quantity(float(at.omega_e[n]) / found.pole_pairs, "rpm", 4),
                f"{math.hypot(float(at.i_d[n]), float(at.i_q[n])):.3g}",
                _SEEN[int(seen.status[n])],
                f"{settling:.3g}" if math.isfinite(settling) else "-",
                *(_errors(seen.shifts[cause][n]) for cause in _CAUSES),
            )
        )
    return rows


def _errors(shift: Any) -> str:
    """In %, of resistance and flux linkage where both are seen."""
    seen = [round(100.0 * x, 2) + 0.0 for x in shift.tolist() if not math.isnan(x)]
    return " / ".join(f"{x:.2g}" for x in seen) or "-"


def estimation_tables(found: OnlineEstimationFit) -> list[Table]:
    """For the terminal."""
    return [Table(TITLE, _HEADS, tuple(point_rows(found)), _notes(found))]


def _parts(_: Solution, found: OnlineEstimationFit) -> list[ReportPart]:
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in point_rows(found))
    notes = tuple(symbols(note) for note in _notes(found))
    heads = tuple(symbols(head) for head in _HEADS)
    return [Passage(tables=[HtmlTable(TITLE, heads, rows, notes=notes)], kind="loops").of(LOOPS)]


def plain_estimation(found: OnlineEstimationFit) -> PlainData:
    """As plain data, in SI units; shifts are relative, of resistance and flux linkage."""
    seen, at = found.seen, found.points
    finite = np.isfinite(seen.settling)
    return {
        "flux": found.sought.flux,
        "resistance": found.sought.resistance,
        "time_constant_s": found.time_constant,
        "dead_time_left_V": found.dead_time_left,
        "least_current_A": found.least_current,
        "resistance_below_rad_per_s": found.fastest_for_resistance(found.largest_current),
        "flux_from_rad_per_s": found.slowest_for_flux(0.0),
        "range": {
            "r_s_Ohm": [found.gains.r_least, found.gains.r_most],
            "psi_pm_Wb": [found.gains.psi_least, found.gains.psi_most],
        },
        "torque_Nm": found.torque,
        "omega_m_rad_per_s": at.omega_e / found.pole_pairs,
        "i_d_A": at.i_d,
        "i_q_A": at.i_q,
        "status": seen.status,
        "poles_per_s": seen.poles,
        "time_constants_s": [
            float(value) if known else None
            for value, known in zip(seen.settling, finite, strict=True)
        ],
        "shifts": {
            name: [[None if math.isnan(x) else x for x in pair] for pair in shift.tolist()]
            for name, shift in seen.shifts.items()
        },
    }


# The model of the header: the step in single precision.


@dataclass(frozen=True, slots=True)
class EstimationModel:
    """What verification needs: what is estimated, and the gains as float32 values."""

    sought: Sought
    gains: OnlineEstimationGains


def plain_model(found: OnlineEstimationFit) -> PlainData:
    """As plain data; every number is a float32 value."""
    return {
        "flux": found.sought.flux,
        "resistance": found.sought.resistance,
        "dead_time": found.sought.dead_time,
        "gains": plain_gains_of(found.gains),
    }


def model_from(plain: Mapping[str, Any]) -> EstimationModel:
    """Read a model back.

    Raises:
        InputError: The data are not what `plain_model` makes.
    """
    fault = InputError("online_estimation_header is not what dqforge writes; run the design again")
    flags = [plain.get(name) for name in ("flux", "resistance", "dead_time")]
    if not all(isinstance(flag, bool) for flag in flags) or not any(flags[:2]):
        raise fault
    if not isinstance(plain.get("gains"), dict):
        raise fault
    try:
        gains = gains_from(OnlineEstimationGains, plain["gains"])
    except InputError as error:
        raise fault from error
    return EstimationModel(Sought(*map(bool, flags)), gains)


def estimation_inputs(gains: OnlineEstimationGains, count: int, seed: int) -> SingleArray:
    """Rows (first estimates over the data, or 0, v_alpha, v_beta, i_alpha, i_beta, theta_e,
    omega_e), shape (rows, 7), in sequences of 100 samples: currents and speeds on both sides of
    what either parameter needs, voltages that fit the machine and wild ones, and what is no number.
    """
    generator = np.random.default_rng(seed)
    sequences = max(1, count // _LENGTH)
    shape = (sequences, _LENGTH)
    size = math.sqrt(gains.square_least) * 10.0 ** generator.uniform(-1.5, 1.0, (sequences, 1))
    most = gains.omega_least + gains.turning * size
    speed = most * generator.choice([0.0, 0.02, 0.2, 0.9, 1.1, 3.0, -1.5], (sequences, 1))
    speed = np.clip(speed, -0.4 * gains.rate, 0.4 * gains.rate)
    theta = generator.uniform(-np.pi, np.pi, (sequences, 1))
    theta = theta + speed * (2.0 / gains.rate) * np.arange(_LENGTH)
    lead = generator.uniform(0.0, np.pi, (sequences, 1))
    current = size * np.exp(1j * (theta + lead)) * generator.uniform(0.9, 1.1, shape)
    wild = 10.0 ** generator.choice([0.0, 0.0, 2.0, 4.0], (sequences, 1))
    wild = wild * np.where(wild > 1.0, generator.choice([1.0, -1.0], (sequences, 1)), 1.0)
    voltage = gains.r_s * current + 1j * speed * gains.psi_pm * np.exp(1j * theta)
    voltage = voltage * wild * generator.uniform(0.5, 1.5, shape)
    rows = np.zeros((*shape, _COLUMNS_IN))
    rows[:, 0, 0] = generator.choice(_FIRST, sequences)
    rows[:, :, 1], rows[:, :, 2] = voltage.real, voltage.imag
    rows[:, :, 3], rows[:, :, 4] = current.real, current.imag
    rows[:, :, 5] = (theta + np.pi) % (2.0 * np.pi) - np.pi
    rows[:, :, 6] = speed
    special = [np.nan, np.inf, -np.inf, -0.0, 0.0, 1e-40, 3e38]
    place = generator.integers(1, _LENGTH, sequences)
    column = generator.integers(1, _COLUMNS_IN, sequences)
    chosen = np.arange(sequences) % 4 == 1
    rows[chosen, place[chosen], column[chosen]] = generator.choice(special, np.sum(chosen))
    return np.ascontiguousarray(rows.reshape(-1, _COLUMNS_IN).astype(np.float32))


def estimation_outputs(model: EstimationModel, inputs: SingleArray) -> SingleArray:
    """What the compiled functions must return: both estimates and the status, shape (rows, 3)."""
    gains, advance = cast(model.gains, SINGLE), advancing(model.sought)
    rows = inputs.reshape(-1, _LENGTH, _COLUMNS_IN)
    found = np.empty((*rows.shape[:2], _COLUMNS_OUT), dtype=np.float32)
    state = at_rest()
    with np.errstate(all="ignore"):  # as C has it, beyond the range of single precision
        start(SINGLE, gains, state)
        state.r_s, state.psi_pm = state.r_s * rows[:, 0, 0], state.psi_pm * rows[:, 0, 0]
        for k in range(_LENGTH):
            v_alpha, v_beta, i_alpha, i_beta, theta, omega = (
                rows[:, k, column].copy() for column in range(1, _COLUMNS_IN)
            )
            v, i = AlphaBeta(v_alpha, v_beta), AlphaBeta(i_alpha, i_beta)
            advance(SINGLE, gains, state, v, i, theta, omega)
            for column, value in enumerate((state.r_s, state.psi_pm, state.status)):
                found[:, k, column] = value
    return found.reshape(-1, _COLUMNS_OUT)


# The C header, and its harness.


def estimation_files(design: Design, found: OnlineEstimationFit) -> dict[str, bytes]:
    """Name and bytes of the header."""
    prefix = design.export.prefix
    call = (
        f"Call {prefix}_{_NAME}_start() once and {prefix}_{_NAME}_step() at every sample with the "
        "voltage reference that acted over the period that ends there. No control function uses "
        "the estimates. Compile with -ffp-contract=off to equal the model bit for bit."
    )
    lines = [
        line
        for label, text in estimation_rows(found)
        for line in wrap(f"{label[0].upper()}{label[1:]}: {text}.", 110)
    ]
    dead = "The step takes the dead time from the voltage: compensate it nowhere else, or set dead"
    context: PlainData = {
        **title(design),
        "part": _NAME,
        "subject": "resistance and magnet flux linkage on line",
        "preamble": [
            *lines,
            *([f"{dead} to 0."] if found.sought.dead_time else []),
            "",
            *wrap(call, 110),
        ],
        "includes": ["<math.h>", "<stdbool.h>", "<stdint.h>"],
        "vectors": False,
        "body": estimation_text(found.sought, found.gains, prefix),
    }
    text = render("c_code/header.h.j2", context)
    return {f"{prefix}_{_NAME}.h": text.encode("ascii")}


def estimation_text(sought: Sought, gains: OnlineEstimationGains, prefix: str) -> str:
    """Types, numbers and functions of the header.

    Args:
        sought: What is estimated.
        gains: Numbers of the step.
        prefix: Before all names.
    """
    macro, functions, state = prefix.upper(), Functions(), at_rest()
    reader = WordReader(prefix, functions, Block("", set()))
    number, pair = Expression("number"), vector(AlphaBeta, "x")
    reader.write(f"{_NAME}_start", start, [gains, state])
    said = (
        "One sample: v in V is the voltage reference that acted over the period that ends at the "
        "sampling instant of i in A and of the electrical angle theta_e in rad; omega_e in rad/s "
        "(electrical) says where what is seen. Frozen estimates stay."
    )
    reader.write(
        f"{_NAME}_step", advancing(sought), [gains, state, pair, pair, number, number], said
    )
    parts = [
        [control_types(prefix, macro)],
        [
            f"#define {macro}_{name} ({value}U) /* bit of the status: this sample moved it */"
            for name, value in CONSTANTS.items()
        ],
        *record_structs(gains, prefix, functions.members),
        *record_structs(state, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {prefix}_{_NAME}_gains_t {macro}_{_NAME.upper()}_GAINS = {{",
            *record_values(gains, functions.members),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def estimation_programme(model: EstimationModel) -> Programme:
    """The harness of the header, with what its model answers."""
    inputs = estimation_inputs(model.gains, SWEEP_POINTS, SWEEP_SEED)
    return Programme(_HARNESS, inputs, estimation_outputs(model, inputs), "on-line estimation")


_HARNESS = Harness(
    _NAME,
    "a start by so much of the data, or 0, v, i, angle and speed; resistance, flux linkage, status",
    (_COLUMNS_IN, _COLUMNS_OUT),
    (
        "const @_alphabeta_t v = { in[1], in[2] };",
        "const @_alphabeta_t i = { in[3], in[4] };",
        "",
        "if (in[0] > 0.0F) {",
        f"    @_{_NAME}_start(&@@_{_NAME.upper()}_GAINS, &state);",
        "    state.r_s *= in[0];",
        "    state.psi_pm *= in[0];",
        "}",
        f"@_{_NAME}_step(&@@_{_NAME.upper()}_GAINS, &state, v, i, in[5], in[6]);",
        "out[0] = state.r_s;",
        "out[1] = state.psi_pm;",
        "out[2] = (float)state.status;",
    ),
    vectors=False,
    states=(f"@_{_NAME}_t state;",),
    starts=(f"@_{_NAME}_start(&@@_{_NAME.upper()}_GAINS, &state);",),
)


# The on-line estimation, as a record.

_HEADER: HeaderKind[OnlineEstimationFit, EstimationModel] = HeaderKind(
    name=_NAME,
    files=lambda solution, found: estimation_files(solution.design, found),
    plain=lambda _, found: plain_model(found),
    read=lambda own, _: model_from(own),
    programme=estimation_programme,
    vectors=False,
)

ONLINE_ESTIMATION = Capability(
    name=_NAME,
    title="resistance and magnet flux on line",
    of=lambda outcome: outcome.solution.online_estimation,
    plain=lambda _, found: plain_estimation(found),
    always=False,
    summary=lambda _, found: estimation_rows(found),
    tables=lambda _, found: estimation_tables(found),
    parts=_parts,
    headers=(_HEADER,),
)
