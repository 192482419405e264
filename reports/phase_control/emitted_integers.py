"""The emitted control in integers of a design: of its phases where it has them, else that of
rotor coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.fixed_control.transforms import FixedControl
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit
from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl
from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
from dqforge.reports.c_code.harness import (
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    control_harness,
    integer_kinds,
    title,
)
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart
from dqforge.reports.control.fixed_header import (
    IntegerRows,
    control_fixed_files,
    control_fixed_html,
    control_fixed_programme,
    control_fixed_tables,
    error_words,
    plain_fixed_control,
    plain_fixed_evidence,
    sweep_rows,
    wide_programme,
)
from dqforge.reports.control.fixed_model import fixed_control_from
from dqforge.reports.control.fixed_text import pi_text
from dqforge.reports.control.header import (
    ControlModel,
    control_files,
    control_from,
    control_programme,
    plain_control,
)
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.phase_control.fixed_phase_model import (
    phase_inputs,
    phase_integers_from,
    phase_outputs,
    phase_results,
    phase_rows,
)
from dqforge.reports.phase_control.fixed_phase_text import phase_text, phase_types
from dqforge.reports.phase_control.float32_model import PhaseControlModel, opened
from dqforge.reports.phase_control.header import (
    phase_control_files,
    phase_control_from,
    plain_solution_control,
)
from dqforge.reports.single_headers.fixed_mesh_reading import mesh_from
from dqforge.reports.steps.code_text import code_basics, code_types

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.phase_control.phase_controller import PhaseControl
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


IntegerModel = FixedControl | FixedPhaseControl


def integer_files(design: Design, fit: IntegerFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    if isinstance(fit, FixedPhaseFit):
        return phase_fixed_files(design, fit)
    return control_fixed_files(design, fit)


def plain_integers(fit: IntegerFit) -> PlainData:
    """The integers as plain data."""
    if isinstance(fit, FixedPhaseFit):
        return plain_phase_integers(fit.control)
    return plain_fixed_control(fit.control)


def plain_integer_evidence(fit: IntegerFit) -> PlainData:
    """What is proven of the integers, as plain data."""
    return (
        plain_phase_evidence(fit) if isinstance(fit, FixedPhaseFit) else plain_fixed_evidence(fit)
    )


def integers_from(plain: Mapping[str, Any], width: int, result: Mapping[str, Any]) -> IntegerModel:
    """Read the control in words of ``width`` bits back, with the references of the ``result`` that
    it is part of.

    Raises:
        InputError: The data are not what `plain_integers` makes.
    """
    if "shape" in plain:
        return phase_integers_from(plain, width)
    if not plain.get("reference", False):
        return fixed_control_from(plain, width)
    described = result.get(f"reference_q{width - 1}_header")
    return fixed_control_from(plain, width, mesh_from(described or {}, width))


def integer_programme(model: IntegerModel) -> Programme:
    """The harness of the control in integers."""
    if isinstance(model, FixedPhaseControl):
        return phase_fixed_programme(model)
    return control_fixed_programme(model)


def integer_tables(fits: Sequence[IntegerFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    phases = [fit for fit in fits if isinstance(fit, FixedPhaseFit)]
    others = [fit for fit in fits if not isinstance(fit, FixedPhaseFit)]
    return control_fixed_tables(others) + phase_fixed_tables(phases)


def integer_html(fits: Sequence[IntegerFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    phases = [fit for fit in fits if isinstance(fit, FixedPhaseFit)]
    others = [fit for fit in fits if not isinstance(fit, FixedPhaseFit)]
    return control_fixed_html(others) + phase_fixed_html(phases)


# The control of a phase machine in fixed point as C: plain data, header, test vectors.

_SEED = 20_261_122


_BASES = (
    ("BASE_CURRENT_A", "A (peak)"),
    ("BASE_VOLTAGE_V", "V (peak of phase)"),
    ("BASE_SPEED_RAD_PER_S", "mechanical speed, rad/s"),
    ("BASE_TORQUE_NM", "N m"),
    ("BASE_FLUX_WB", "back-EMF over electrical speed, V s/rad"),
)


def plain_phase_integers(control: FixedPhaseControl) -> PlainData:
    """The integers as plain data."""
    return asdict(control)


def plain_phase_evidence(fit: FixedPhaseFit) -> PlainData:
    """Proven range of every product and sum, and the error of the shape, as plain data."""
    return {
        "ranges": [
            {
                "name": reach.name,
                "low": reach.range.low,
                "high": reach.range.high,
                "bits": reach.bits,
            }
            for reach in fit.reaches
        ],
        "fullest": {"name": fit.fullest.name, "share": fit.fullest.share},
        "shape_error": fit.shape_error,
        "sine_error_codes": fit.sine_error,
    }


def _preamble(fit: FixedPhaseFit, design: Design) -> list[str]:
    control, bits, fullest = fit.control, fit.control.width, fit.fullest
    return [
        (
            f"Frame {control.frame}, {control.topology}; sampled every "
            f"{1e6 * design.control.t_s:.6g} us."
        ),
        (
            f"Codes are int{bits}_t, 2^{bits - 1} of them full scale; the angle is uint{bits}_t, "
            f"2^{bits} the shape's period."
        ),
        "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign.",
        (
            f"No overflow for any inputs and any past: {len(fit.reaches)} products and sums proven "
            "by interval analysis;"
        ),
        f"the fullest, '{fullest.name}', reaches {fullest.share:.4%} of int{2 * bits}_t.",
        "Currents beyond full scale must be saturated where they are measured.",
    ]


def _speed_comment(control: FixedPhaseControl) -> list[str]:
    if control.speed is None:
        return ["There is no speed loop."]
    return [f"The speed loop runs every {control.ratio} current samples."]


def phase_fixed_context(design: Design, fit: FixedPhaseFit) -> PlainData:
    """Everything that the header prints, as plain data."""
    control = fit.control
    scales = [
        {"name": name, "value": value, "comment": text}
        for (name, text), value in zip(_BASES, control.bases, strict=True)
    ]
    link = control.bases[1] * 2.0**control.dc_scale
    scales.append({"name": "BASE_DC_VOLTAGE_V", "value": link, "comment": "V, of the dc link"})
    prefix, macro = design.export.prefix, title(design)["macro"]
    error = error_words(control.width, fit.sine_error)
    return {
        **title(design),
        "subject": "current control of any back-EMF",
        "format": control.format,
        "width": control.width,
        "preamble": _preamble(fit, design),
        "scales": scales,
        "reference": False,
        "parts": [
            code_types(prefix, macro, control.width),
            phase_types(control, prefix),
            code_basics(prefix, macro, control.width, error),
            pi_text(prefix, macro, control.width, {}, _speed_comment(control)),
            phase_text(control, prefix, macro),
        ],
    }


def phase_fixed_files(design: Design, fit: FixedPhaseFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    context, control = phase_fixed_context(design, fit), fit.control
    inputs = phase_rows(control, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, phase_results(control, inputs)], axis=1)
    text = render("control/fixed.h.j2", context)
    return _harness(control).files(design, text, vectors)


def _harness(control: FixedPhaseControl) -> Harness:
    """One step from the state and the samples of a row."""
    rows = IntegerRows(control.width, phase_inputs(control), phase_outputs(control))
    f, gains = control.format, f"&@@_CONTROL_GAINS_{control.format.upper()}"
    arg, taken, put = rows.arg, rows.taken, rows.put
    parts = {f"integral_{x}": f"integral[{k}]" for k, x in enumerate("dq0")}
    for n in range(len(control.harmonics)):
        parts |= {f"harmonic_{n}{x}": f"harmonic[{n}][{k}]" for k, x in enumerate("xy")}
    axes = {"alpha": "alpha", "beta": "beta", "0": "zero"}
    measured = ["i.a", "i.b", "i.c", "theta", "omega_m", "v_dc"]
    names = ["i_a", "i_b", "i_c", "theta", "omega", "v_dc"]
    if control.midpoint:
        measured, names = [*measured, "v_m"], [*names, "v_m"]
    codes = [f"(u{rows.number}){arg(x)}" if x == "theta" else taken(x) for x in names]
    speed = f"{gains}, &control, measured.omega_m, {taken('speed_reference')}"
    sinusoids = f"@_sinusoids_{f}({gains}, @_speed_loop_{f}({speed})).q"
    opened = f"@_open_phase_{f}(&control, (uint8_t){arg('open')});" if control.zero else ""
    shaped = f"{gains}, &control, &measured, {taken('torque')}, constant"
    return rows.made(
        [
            f"const @_dq_{f}_t constant = {{ {taken('d')}, {taken('q')} }};",
            f"@_measured_{f}_t measured;",
            f"@_control_{f}_t control;",
            f"@_duties_{f}_t duty;",
            "",
            *(f"measured.{name} = {code};" for name, code in zip(measured, codes, strict=True)),
            f"@_control_start_{f}(&control);",
            *([opened] if opened else []),
            *(f"control.{place} = {arg(name)};" for name, place in parts.items()),
            f"duty = @_shaped_control_{f}({shaped});",
            *(
                put(f"duty_{leg}", f"({rows.wide})duty.{leg}")
                for leg in TOPOLOGIES[control.topology].legs
            ),
            *(put(name, f"control.{place}") for name, place in parts.items()),
            *(put(f"v_{name}", f"control.v.{axis}") for name, axis in axes.items()),
            *(put(f"reference_{name}", f"control.reference.{axis}") for name, axis in axes.items()),
            f"control.filtered = {arg('speed_filtered')};",
            f"control.speed.integral = {arg('speed_integral')};",
            f"control.torque = {taken('speed_torque')};",
            f"control.count = (uint32_t){arg('speed_count')};",
            put("sinusoid_q", sinusoids),
            put("speed_filtered", "control.filtered"),
            put("speed_integral", "control.speed.integral"),
            put("speed_torque", "control.torque"),
            put("speed_count", f"({rows.wide})control.count"),
            put("speed_omega", "control.omega_m"),
        ]
    )


def phase_fixed_programme(control: FixedPhaseControl) -> Programme:
    """In 16 bits as many rows as there are angles, so that each comes once."""
    inputs = phase_rows(control, sweep_rows(control.width), SWEEP_SEED)
    results = phase_results(control, inputs)
    name = "fixed-point control of the phases"
    return wide_programme(_harness(control), inputs, results, name)


# The run that proves the control of phase machines: sequences that visit every mode.

_DRIVES, _STEPS = 48, 160


_COLUMNS = 11


def phase_control_inputs(model: PhaseControlModel) -> SingleArray:
    """Sequences for the harness, shape (steps * drives, 11).

    Drives with currents near their references and far off, at rest, at speeds from few to many
    samples per period and beyond all harmonics, with links that bind and that do not, phases that
    open and close, and samples that are no numbers.
    """
    gains, made = model.gains, model.structure
    generator = np.random.default_rng(_SEED)
    shape = (_STEPS, _DRIVES)
    torque_max, t_s = float(gains["torque_max"]), float(gains["t_s"])
    per_ampere = torque_per_ampere(float(gains["pole_pairs"]), float(gains["psi_pm"]))
    ampere = torque_max / per_ampere
    spread = generator.choice([0.02, 1.0, 30.0], size=_DRIVES)
    # samples per electrical period from 3 to 3000, both directions; two drives at rest
    samples = 3.0 * 1000.0 ** generator.uniform(0.0, 1.0, _DRIVES)
    omega_e = 2.0 * np.pi / (samples * t_s) * generator.choice([-1.0, 1.0], size=_DRIVES)
    omega_e[:2] = 0.0
    emf = np.abs(omega_e) * float(gains["psi_pm"])
    v_dc = (emf + 10.0) * generator.choice([0.5, 1.5, 3.0, 20.0], size=_DRIVES)
    rows = np.zeros((*shape, _COLUMNS))
    rows[..., 0] = np.arange(_DRIVES) % 3
    rows[..., 1:4] = generator.normal(size=(*shape, 3)) * (spread * ampere)[:, None]
    rows[..., 4] = np.arange(_STEPS)[:, None] * omega_e * t_s + generator.uniform(-9, 9, _DRIVES)
    rows[..., 5] = (
        omega_e / float(gains["pole_pairs"]) * (1.0 + 0.01 * generator.normal(size=shape))
    )
    rows[..., 6] = v_dc * generator.uniform(0.9, 1.1, shape)
    rows[..., 7] = rows[..., 6] * generator.uniform(0.4, 0.6, shape)
    rows[..., 8:10] = (
        generator.normal(size=(*shape, 2)) * (np.minimum(spread, 1.0) * ampere)[:, None]
    )
    torque = generator.uniform(-1.2, 1.2, shape) * torque_max
    rows[..., 8] = np.where(rows[..., 0] == 1, torque, rows[..., 8])
    speeds = rows[..., 5] * generator.uniform(0.0, 2.0, shape)
    rows[..., 8] = np.where(rows[..., 0] == 2, speeds, rows[..., 8])
    rows[..., 10] = -1.0
    if made.neutral:
        rows[60, :, 10] = np.arange(_DRIVES) % 5  # one drive in five has all phases, one bad number
        rows[130, :, 10] = 0.0
    _spoil(rows)
    return np.ascontiguousarray(rows.reshape(-1, _COLUMNS), dtype=np.float32)


def _spoil(rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    """Samples that are exactly equal, zero, or no numbers, one column at a time."""
    rows[:3, :, 1:4] = 0.0
    rows[2, :, 8:10] = 0.0
    rows[5, :, 6:8] = 0.0  # no DC-link voltage
    rows[7, :, 4] = 70_000.0  # an angle beyond all sense
    for bad, start in ((np.nan, 10), (np.inf, 22), (-np.inf, 34)):
        for place, column in enumerate(range(1, 10)):
            rows[start + place, :, column] = bad


def phase_control_results(model: PhaseControlModel, inputs: SingleArray) -> SingleArray:
    """What the harness must return for `phase_control_inputs`, shape (N, legs + 6)."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore", under="ignore"):
        return _results(model, inputs)


def _results(model: PhaseControlModel, inputs: SingleArray) -> SingleArray:
    made = model.structure
    rows = inputs.reshape(-1, _DRIVES, _COLUMNS)
    width = len(TOPOLOGIES[made.topology].legs) + 6
    results = np.empty((rows.shape[0], _DRIVES, width), dtype=np.float32)
    # Three modes side by side: one step of the control for all drives.
    by_current, by_speed = np.arange(_DRIVES) % 3 == 0, slice(2, _DRIVES, 3)
    state = made.at_rest(_DRIVES)
    loop = made.at_rest(_DRIVES // 3)
    for step, row in enumerate(rows):
        first, second = (np.ascontiguousarray(row[:, column]) for column in (8, 9))
        measured = np.ascontiguousarray(row[:, 1:8] if made.midpoint else row[:, 1:7])
        if made.neutral:
            command = row[:, 10]
            opened(state, np.maximum(command, 0.0).astype(np.uint32), command >= 0.0)
        torque = first.copy()
        torque[by_speed] = model.speed_loop(loop, measured[by_speed], first[by_speed])
        state.torque = np.where(by_current, np.float32(0.0), torque)
        given, limit = model.of_currents(measured, (first, second))
        made_of, limited = model.of_torque(state, measured, torque)
        reference = tuple(np.where(by_current, *both) for both in zip(given, made_of, strict=True))
        duty = model.control_step(state, measured, reference, np.where(by_current, limit, limited))
        results[step] = np.stack(
            [*duty, *state.v, state.v_0, *state.reference, state.torque], axis=1
        )
    return results.reshape(-1, width)


def phase_control_programme(model: PhaseControlModel) -> Programme:
    """The harness of the control functions."""
    inputs = phase_control_inputs(model)
    made = model.structure
    opens = ("if (in[10] >= 0.0F) {", "    @_open_phase(state, (uint32_t)in[10]);", "}")
    further = (
        *(["measured.v_m = in[7];"] if made.midpoint else []),
        *(opens if made.neutral else []),
    )
    told = "v_m, reference d (or the only one) and q, phase that opens (-1: none)"
    results = (
        *(f"duty.{leg}" for leg in made.legs),
        "state->v.alpha",
        "state->v.beta",
        "state->v_0",
    )
    rows = control_harness(_DRIVES, told, 8, 11, further, "duties", results)
    return Programme(rows, inputs, phase_control_results(model, inputs), "control functions")


# The control of a phase machine in fixed point on the terminal and in the report.

_FIXED_PHASE_TABLES_COLUMNS = (
    "axis",
    "kp",
    "error of kp",
    "ki t_s",
    "error of ki t_s",
    "further bits of the integral",
)


def _rows(fit: FixedPhaseFit) -> list[tuple[str, ...]]:
    axes = {"d": fit.control.d, "q": fit.control.q, "0": fit.control.zero}
    return [
        (
            name,
            axis.kp.text(),
            f"{axis.kp.error:+.1e}",
            axis.ki.text(),
            f"{axis.ki.error:+.1e}",
            f"{axis.fraction}",
        )
        for name, axis in axes.items()
        if axis is not None
    ]


def _title(fit: FixedPhaseFit) -> str:
    control = fit.control
    return f"Control in fixed point, {control.format}: {control.frame}, {control.topology}"


def _notes(fit: FixedPhaseFit) -> tuple[str, ...]:
    orders = ", ".join(
        f"{part.order}{' of 0' if part.zero else ''}" for part in fit.control.harmonics
    )
    return (
        (
            f"{len(fit.reaches)} products and sums proven not to overflow; '{fit.fullest.name}' "
            f"reaches {fit.fullest.share:.3%}"
        ),
        (
            f"table of the back-EMF: {fit.control.nodes} nodes, {len(fit.control.shape)} row(s), "
            f"rounded by at most {100.0 * fit.shape_error:.2g} % of its largest value"
        ),
        f"integrators of the harmonics {orders or 'none'}",
    )


def phase_fixed_tables(fits: Sequence[FixedPhaseFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    return [
        Table(_title(fit), _FIXED_PHASE_TABLES_COLUMNS, tuple(_rows(fit)), _notes(fit))
        for fit in fits
    ]


def phase_fixed_html(fits: Sequence[FixedPhaseFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    headings = tuple(symbols(text) for text in _FIXED_PHASE_TABLES_COLUMNS)
    return [
        HtmlTable(_title(fit), headings, tuple(Row(row, "") for row in _rows(fit))) for fit in fits
    ]


# The emitted float32 control of a design: that of phase machines where the design has one, else
# that of rotor coordinates.

EmittedModel = ControlModel | PhaseControlModel


def phase_control_of(solution: Solution) -> PhaseControl | None:
    """The current control over the angle, None for machines with a sinusoidal back-EMF."""
    loops = solution.gains.phases
    return None if loops is None else loops.control


def emitted_control_files(solution: Solution) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_control.h``; raises as `emitted_control_plain`."""
    control = phase_control_of(solution)
    return control_files(solution) if control is None else phase_control_files(solution, control)


def emitted_control_plain(solution: Solution) -> PlainData:
    """What ``result.json`` says of the emitted control.

    Raises:
        InputError: It cannot be emitted; the message says what is instead.
    """
    control = phase_control_of(solution)
    if control is None:
        return plain_control(solution)
    return plain_solution_control(solution, control)


def emitted_control_from(described: Mapping[str, Any], whole: Mapping[str, Any]) -> EmittedModel:
    """Read the control functions back from a result and its part that describes them.

    Raises:
        InputError: The data are not what `emitted_control_plain` makes.
    """
    read = phase_control_from if "frame" in described else control_from
    return read(described, whole)


def emitted_control_programme(model: EmittedModel) -> Programme:
    """The harness of the control functions."""
    if isinstance(model, PhaseControlModel):
        return phase_control_programme(model)
    return control_programme(model)


# Control functions in single precision and in fixed point, as records.


def _float32(outcome: Outcome) -> Solution | None:
    """What the control functions are of: over a regulator that switches the bridge itself, the
    speed loop and the references.
    """
    if "float32" not in outcome.design.export.control:
        return None
    solution = outcome.solution
    if solution.current_feedback is None:
        return solution
    return replace(solution, loops=solution.current_feedback.gains)


FLOAT32_CONTROL = Capability(
    name="control",
    title="control functions in single precision",
    of=_float32,
    headers=(
        HeaderKind(
            name="control",
            files=lambda _, solution: emitted_control_files(solution),
            plain=lambda _, solution: emitted_control_plain(solution),
            read=emitted_control_from,
            programme=emitted_control_programme,
            vectors=False,
        ),
    ),
)


Fits = tuple[IntegerFit, ...]


_KINDS = integer_kinds(
    "control",
    width_of=lambda fit: fit.control.width,
    files=lambda solution, fit: integer_files(solution.design, fit),
    plain=plain_integers,
    read=integers_from,
    programme=integer_programme,
)


def _parts(_: Solution, fits: Fits) -> list[ReportPart]:
    return [Passage(tables=integer_html(fits), kind="loops").of(LOOPS)]


FIXED_CONTROL = Capability(
    name="control_fixed",
    title="control functions in fixed point",
    of=lambda outcome: outcome.solution.fixed or None,
    plain=lambda _, fits: {fit.control.format: plain_integer_evidence(fit) for fit in fits},
    always=False,
    tables=lambda _, fits: integer_tables(fits),
    parts=_parts,
    headers=_KINDS,
)
