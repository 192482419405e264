"""The field-weakening reference: its C header with test vectors, plain data, tables, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.transforms import Reals, in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.curves.single_precision import SingleArray, SinglePolynomial
from dqforge.optimizer.field_weakening.fit import DomainBorders, SurfaceTrial, WeakeningFit
from dqforge.optimizer.field_weakening.form import SingleSurface, WeakeningReference
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, STEPS, DropReference
from dqforge.optimizer.solution import Solution
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    single_from,
    singles_from,
    title,
)
from dqforge.reports.c_code.numbers import comment_text, float_literal, rounded_up
from dqforge.reports.capability import Capability, Draw, Passage, Quantity, ReportPart, Rows
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import MAP_INK, MAP_MUTED, label_in_unit, new_figure, style
from dqforge.reports.pages.html_text import HtmlTable, Row, count, symbols
from dqforge.reports.pages.scaled import DrawnGrid, draw_filled
from dqforge.reports.pages.templating import AGAINST, plain_certificate, render
from dqforge.reports.pages.templating import WEAKENING as CHAPTER
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.counted_loops import place
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SEED = 20_260_611


_MOST_SEGMENTS, _MOST_TERMS = 8, 16


_NUMBERS = "flux_min", "flux_max", "torque_mid", "excess_mid"


_CURVES = "limit", "d", "q", "flux"


_SURFACES = "surface_d", "surface_q"


_DROPS = "torque_max", "per_torque", "square", "reserve"


_FAULT = InputError("weakening_header is not what dqforge writes; run the design again")


def plain_weakening(step: DropReference) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    reference = step.surface
    plain: PlainData = {name: shortest(getattr(reference, name)) for name in _NUMBERS}
    for name in _CURVES:
        curve: SinglePolynomial = getattr(reference, name)
        plain[name] = [
            {"start": shortest(start), "coefficients": [shortest(value) for value in row]}
            for start, row in zip(curve.starts, curve.coefficients, strict=True)
        ]
    for name in _SURFACES:
        surface: SingleSurface = getattr(reference, name)
        plain[name] = [[shortest(value) for value in row] for row in surface.rows]
    plain["drop"] = {
        **{name: shortest(getattr(step, name)) for name in _DROPS},
        "near": None if step.near is None else [shortest(value) for value in step.near],
        "passes": step.passes,
    }
    return plain


def weakening_from(plain: Mapping[str, Any]) -> DropReference:
    """Read an evaluator back.

    Raises:
        InputError: The data are not what `plain_weakening` makes.
    """
    try:
        found = WeakeningReference(
            flux_min=single_from(plain["flux_min"]),
            flux_max=single_from(plain["flux_max"]),
            limit=_curve(plain["limit"]),
            d=_curve(plain["d"]),
            q=_curve(plain["q"]),
            flux=_curve(plain["flux"]),
            torque_mid=single_from(plain["torque_mid"]),
            excess_mid=single_from(plain["excess_mid"]),
            surface_d=_surface(plain["surface_d"]),
            surface_q=_surface(plain["surface_q"]),
        )
        step = _drop(found, plain["drop"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    alike = all(np.array_equal(curve.starts, found.d.starts) for curve in (found.q, found.flux))
    if not alike or len(found.surface_d.rows) != len(found.surface_q.rows):
        raise _FAULT
    return step


def _drop(surface: WeakeningReference, plain: Any) -> DropReference:
    near, passes = plain["near"], plain["passes"]
    if isinstance(passes, bool) or passes not in (1, 2) or (near is not None and len(near) != 2):
        raise ValueError
    torque_max, per_torque, square, reserve = (single_from(plain[name]) for name in _DROPS)
    line = None if near is None else (single_from(near[0]), single_from(near[1]))
    return DropReference(surface, torque_max, per_torque, square, reserve, line, passes)


def _curve(rows: Any) -> SinglePolynomial:
    starts = singles_from([row["start"] for row in rows], _MOST_TERMS)
    coefficients = np.stack([singles_from(row["coefficients"], _MOST_TERMS) for row in rows])
    ascending = (
        starts[0] == 0.0 and bool(np.all(np.diff(starts) > 0.0)) and starts.size <= _MOST_SEGMENTS
    )
    if coefficients.shape[1] < 2 or not ascending:
        raise ValueError
    return SinglePolynomial(starts, coefficients)


def _surface(rows: Any) -> SingleSurface:
    if not 1 <= len(rows) <= _MOST_TERMS:
        raise ValueError
    return SingleSurface(tuple(singles_from(row, _MOST_TERMS) for row in rows))


def weakening_inputs(step: DropReference, count: int, seed: int, patterns: int = 0) -> SingleArray:
    """Inputs of the evaluator, shape (count + patterns + 1000, 3): torque in N m, voltage in V,
    speed in rad/s.

    All over the domain and beyond it, ``patterns`` of any bits, and every
    triple of ten special values.
    """
    generator = np.random.default_rng(seed)
    reference, most = step.surface, float(step.torque_max)
    low, high = float(reference.flux_min), float(reference.flux_max)
    volts = max(4.0 * float(np.sqrt(step.reserve)), 1.0) * generator.uniform(0.5, 4.0, count)
    whole = generator.uniform(
        0.9 * low, high + 1.5 * np.sqrt(float(step.reserve)) * low / np.min(volts), count
    )
    omega = volts / whole * generator.choice([-1.0, 1.0], count)
    torque = generator.uniform(-1.1, 1.1, count) * most
    inside = np.stack([torque, volts, omega], axis=1).astype(np.float32)
    edges = [
        np.float32(value)
        for value in (0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, 1e30, most, -most, 1e3)
    ]
    special = np.stack(np.meshgrid(edges, edges, edges), axis=-1).reshape(-1, 3).astype(np.float32)
    bits = generator.integers(0, 2**32, (patterns, 3), dtype=np.uint32).view(np.float32)
    return np.ascontiguousarray(np.concatenate([inside, special, bits]))


def weakening_currents(step: DropReference, inputs: SingleArray) -> SingleArray:
    """What the compiled evaluator must return for inputs, shape (M, 2)."""
    return np.stack(step.currents(*(inputs[:, column].copy() for column in range(3))), axis=1)


def _comment(fit: WeakeningFit) -> list[str]:
    domain = fit.domain
    return [
        (
            "torque_Nm: torque in N m, either sign, held to what voltage, speed and current limit "
            "allow."
        ),
        (
            "v_max_V: largest phase-voltage amplitude in V, as the dc link gives it now; negative "
            "counts as 0."
        ),
        (
            "omega_e_rad_per_s: electrical speed in rad/s, either sign; motoring where its sign is "
            "that of the torque."
        ),
        (
            f"Made for {domain.v_max:.6g} V up to {domain.omega_e:.6g} rad/s, and from "
            f"{domain.voltages[0]:.6g} V up for speeds up to the largest"
        ),
        (
            "in proportion to the voltage; below that the resistance takes more of it, and the "
            "largest speed falls faster."
        ),
        (
            "Beyond it torque is given up first; then the field is weakened to FLUX_MIN and no "
            "further, which may break"
        ),
        "the voltage limit.",
        (
            "i_d_A, i_q_A: current references in A (peak). Not-a-number as torque gives no torque; "
            "as voltage or speed"
        ),
        "no torque at FLUX_MIN, which keeps the voltage limit up to the largest speed.",
        (
            f"The phase resistance is {domain.machine.r_s:.6g} Ohm in what follows: take its "
            "largest value, warm."
        ),
        "",
        *error_lines(fit),
        (
            f"{fit.step.coefficients} constants; on a Cortex-M4F below {fit.step.flash} bytes "
            "(estimate)."
        ),
    ]


def _preamble(design: Design, fit: WeakeningFit) -> list[str]:
    rpm = in_rpm(fit.settings.omega_m)
    return [
        (
            f"{design.machine.pole_pairs} pole pairs, {design.i_max:.6g} A (peak), up to "
            f"{rpm:.6g} rpm."
        ),
        (
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
            "errors hold either way."
        ),
    ]


_SAID = (
    "Current references for a torque within a voltage at a speed, the drop over the phase "
    "resistance included."
)


def weakening_text(reference: DropReference, lines: Sequence[str], prefix: str) -> str:
    """Constants and functions of the header.

    Args:
        reference: What is evaluated.
        lines: What is said of it behind its first sentence.
        prefix: Before the names of functions, in capitals before those of constants.
    """
    macro, surface = f"{prefix.upper()}_WEAKENING", reference.surface
    ends: dict[str, Any] = {
        "flux_min": Expression(f"{macro}_FLUX_MIN_WB"),
        "flux_max": Expression(f"{macro}_FLUX_MAX_WB"),
    }
    named, trials = replace(reference, surface=replace(surface, **ends)), place(f"{macro}_TRIALS")
    functions = Functions()
    reader, number = StepReader(prefix, functions, Block("", set())), Expression("number")

    def weakening_reference(o: Arithmetic, torque: Reals, v_max: Reals, omega_e: Reals) -> Dq:
        return named.step(o, torque, v_max, omega_e, trials)

    reader.write("weakening_limit", named.weakening_limit, [number], names=["flux_Wb"])
    reader.write("weakening_flux", named.weakening_flux, [number, number])
    reader.write("weakening_least_flux", named.weakening_least_flux, [number, number])
    reader.write(
        "weakening_reference",
        weakening_reference,
        [number] * 3,
        into=["i_d_A", "i_q_A"],
        names=["torque_Nm", "v_max_V", "omega_e_rad_per_s"],
    )
    *inner, last = functions.texts.values()
    said = [f"/* {_SAID}", " *", *(f" * {comment_text(line)}".rstrip() for line in lines), " */"]
    least, most = map(float_literal, map(float, (surface.flux_min, surface.flux_max)))
    constants = [
        f"#define {macro}_FLUX_MIN_WB ({least}) /* least available flux linkage, Wb */",
        f"#define {macro}_FLUX_MAX_WB ({most}) /* from here upwards it limits nothing, Wb */",
        f"#define {macro}_TRIALS ({STEPS}U) /* of the torque, where not all of it can be had */",
    ]
    return "\n\n".join(["\n".join(constants), *inner, "\n".join([*said, last])])


WEAKENING_HARNESS = Harness(
    "weakening",
    "torque in N m, phase-voltage amplitude in V, electrical speed in rad/s; i_d and i_q in A",
    (3, 2),
    ("@_weakening_reference(in[0], in[1], in[2], &out[0], &out[1]);",),
)


def weakening_files(design: Design, fit: WeakeningFit) -> dict[str, bytes]:
    """Names and bytes of the header of field-weakening references and of its test vectors."""
    context, prefix = title(design), design.export.prefix
    body = weakening_text(fit.step, _comment(fit), prefix)
    header = {"part": "weakening", "subject": "current references with field weakening"}
    includes = ["<math.h> /* sqrtf */"]
    inputs = weakening_inputs(fit.step, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, weakening_currents(fit.step, inputs)], axis=1)
    text = render(
        "c_code/header.h.j2",
        context
        | header
        | {"preamble": _preamble(design, fit), "includes": includes}
        | {"body": body, "vectors": True},
    )
    return WEAKENING_HARNESS.files(design, text, vectors)


def weakening_programme(reference: DropReference) -> Programme:
    """The harness of a field-weakening header, with what its model answers."""
    half = SWEEP_POINTS // 2
    inputs = weakening_inputs(reference, half, SWEEP_SEED, patterns=half)
    results = weakening_currents(reference, inputs)
    return Programme(WEAKENING_HARNESS, inputs, results, "current reference with field weakening")


# Two-dimensional references in words, alike on the terminal and in the report.


def percent(value: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(value, 0.0))} %"


def domain_text(fit: WeakeningFit) -> str:
    """Speed, voltage, range of the flux linkage, and size in one line."""
    region, domain = fit.region, fit.domain
    return (
        f"up to {format_quantity(fit.settings.omega_m, 'rpm', 4)} at "
        f"{format_quantity(domain.v_max, 'V', 4)}, of which the resistance takes up to "
        f"{format_quantity(domain.largest_drop, 'V', 3)}; "
        f"{format_quantity(region.flux_min, 'Wb', 4)} to "
        f"{format_quantity(region.flux_max, 'Wb', 4)}; {fit.step.coefficients} constants, below "
        f"{fit.step.flash} B on a Cortex-M4F (estimate)"
    )


def least_voltage_text(fit: WeakeningFit) -> str:
    """The least voltage for which errors are stated."""
    return f"{100.0 * LEAST_VOLTAGE:g} % of {format_quantity(fit.domain.v_max, 'V', 4)}"


def errors_text(fit: WeakeningFit) -> str:
    """The largest errors in one line."""
    return (
        f"torque {percent(_torque(fit))}, voltage +{percent(fit.voltage.voltage_excess)},"
        f" current +{percent(fit.largest_current_excess)}, copper loss "
        f"+{percent(fit.voltage.loss_relative)}, from {least_voltage_text(fit)} up"
    )


def nominal_text(fit: WeakeningFit) -> str:
    """What of the errors falls on the design's voltage itself, and what beyond reach is missed."""
    voltage = fit.voltage
    return (
        f"beyond reach at most {percent(voltage.missed)} of what is available is missed; at "
        f"{format_quantity(fit.domain.v_max, 'V', 4)} itself torque "
        f"{percent(voltage.torque_nominal / fit.region.torque_max)}, copper loss "
        f"+{percent(voltage.loss_nominal)}"
    )


def _torque(fit: WeakeningFit) -> float:
    """Largest sampled error of the torque over the largest torque."""
    return fit.largest_torque_error / fit.region.torque_max


def proof_text(fit: WeakeningFit) -> str | None:
    """The proven bounds in one line; None where nothing is proven."""
    proof = fit.certificate
    if proof is None:
        return None
    volts = (
        "voltage not bounded"
        if proof.voltage_excess is None
        else f"voltage +{percent(proof.voltage_excess)}"
    )
    return (
        f"torque {percent(proof.torque_relative)} of what is granted, {volts},"
        f" current +{percent(proof.current_excess)}, from {least_voltage_text(fit)} up, against "
        f"{AGAINST[proof.model]}"
    )


def _sampled_lines(fit: WeakeningFit) -> list[str]:
    """What no bound covers."""
    voltage, volts = fit.voltage, f"{fit.domain.v_max:.6g} V"
    shares = [f"{part / fit.domain.v_max:.3g}" for part in fit.domain.voltages]
    nominal = percent(voltage.torque_nominal / fit.region.torque_max)
    return [
        (
            f"torque beyond reach is granted to within {percent(_torque(fit))} of the largest one, "
            f"and to within {percent(voltage.missed)}"
        ),
        f"of what voltage, speed and current leave of it ({nominal} of the largest at {volts}),",
        (
            f"copper loss is up to {percent(voltage.loss_relative)} above the least "
            f"({percent(voltage.loss_nominal)} at {volts}), from 5 % of the largest torque"
        ),
        (
            f"up: {fit.errors.samples + voltage.samples} evaluations, with and without fused "
            "multiply-add, at"
        ),
        f"{', '.join(shares[:-1])} and {shares[-1]} times {volts}, motoring and generating.",
    ]


def error_lines(fit: WeakeningFit) -> list[str]:
    """Proven bounds and sampled errors as lines of at most 110 characters for the
    comment of the evaluator.
    """
    errors, proof, most = fit.errors, fit.certificate, f"{fit.region.torque_max:.6g} N m"
    volts, current = percent(fit.voltage.voltage_excess), percent(fit.largest_current_excess)
    reach = f"voltages from {least_voltage_text(fit)} up, motoring and generating"
    if proof is None:
        return [
            f"Sampled, not proven, for {reach}:",
            f"the torque errs by at most {percent(_torque(fit))} of the largest one, {most};",
            f"the phase voltage, resistance drop included, exceeds its limit by {volts},",
            f"the current its limit by {current};",
            *_sampled_lines(fit),
        ]
    torque = (
        f"{percent(proof.torque_relative)} of the largest one, {most} "
        f"({percent(errors.torque_relative)})"
    )
    bound = "no proven bound" if proof.voltage_excess is None else percent(proof.voltage_excess)
    return [
        (
            "Bounds of the errors, proven for every torque and speed up to the largest, against "
            f"{AGAINST[proof.model]},"
        ),
        f"for {reach};",
        (
            "rounding included, with and without fused multiply-add; in brackets what was found by "
            "sampling:"
        ),
        f"the phase voltage, resistance drop included, exceeds its limit by {bound} ({volts}),",
        f"the current its limit by {percent(proof.current_excess)} ({current}),",
        f"the torque that is granted errs by at most {rounded_up(proof.torque)} N m, {torque}.",
        "Sampled, not proven:",
        *_sampled_lines(fit),
    ]


# Figure of a two-dimensional reference: its errors over the available
# flux linkage and the torque.

_STEPS = 10


def _mark_borders(axes: Axes, borders: DomainBorders) -> None:
    """The MTPA locus, above which the field is weakened, the largest torque,
    and where MTPV begins.
    """
    axes.plot(borders.mtpa_flux, borders.mtpa_torque, color=MAP_INK, linewidth=1.1, label="_MTPA")
    flux, torque = borders.flux, borders.largest_torque
    axes.plot(flux, torque, color=MAP_INK, linewidth=1.1, label="_largest torque")
    touching = np.flatnonzero(borders.mtpv)
    if touching.size:
        last = touching[-1]
        axes.plot(flux[: last + 1], torque[: last + 1], color=MAP_INK, linewidth=2.4, label="_MTPV")
        axes.annotate(
            "MTPV",
            (float(flux[last]), float(torque[last])),
            (-4, 6),
            textcoords="offset points",
            ha="right",
            color=MAP_MUTED,
            fontsize=7.5,
        )
    middle = int(0.55 * borders.mtpa_flux.size)
    axes.annotate(
        "MTPA",
        (float(borders.mtpa_flux[middle]), float(borders.mtpa_torque[middle])),
        (5, -3),
        textcoords="offset points",
        color=MAP_MUTED,
        fontsize=7.5,
        va="top",
    )


def _draw(
    axes: Axes,
    grid: tuple[FloatArray, FloatArray],
    percent: FloatArray,
    permitted: float,
    title: str,
) -> None:
    """Filled steps of an error in percent from minus to plus the permitted one."""
    levels = np.linspace(-permitted, permitted, 2 * (_STEPS // 2) + 1)
    filled = draw_filled(
        axes,
        DrawnGrid(*grid, percent, title),
        np.clip(percent, -permitted, permitted),
        levels=levels,
        cmap="PuOr_r",
    )
    bar = axes.figure.colorbar(filled, ax=axes, pad=0.02, aspect=28, ticks=levels[::5])
    bar.ax.tick_params(labelsize=7)
    axes.set_title(title)


def plot_weakening(fit: WeakeningFit) -> Figure:
    """Torque error and voltage excess over available flux linkage and torque,
    with the borders of the regions.
    """
    chart, settings, region = fit.chart, fit.settings, fit.region
    grid = chart.flux, chart.torque
    with style():
        figure = new_figure(
            "weakening", 3.1, "Errors of torque and voltage over flux linkage and torque"
        )
        left, right = figure.subplots(1, 2, sharey=True)
        figure.subplots_adjust(left=0.09, right=0.97, top=0.9, bottom=0.16, wspace=0.08)
        error, excess = 100.0 * chart.torque_error, 100.0 * chart.voltage_error
        _draw(left, grid, error, 100.0 * settings.torque_error, "Torque error in % of the largest")
        _draw(
            right,
            grid,
            excess,
            100.0 * settings.voltage_excess,
            "Voltage error in % of the optimum's",
        )
        for axes in (left, right):
            _mark_borders(axes, chart.borders)
            axes.margins(0.0)
            label_in_unit(axes.xaxis, "Available flux linkage in {}", region.flux_max, "Wb")
        label_in_unit(left.yaxis, "Torque in {}", region.torque_max, "N m")
    return figure


# Two-dimensional references on the terminal and in the report.

_COLUMNS = (
    "degree in torque",
    "in excess flux linkage",
    "constants",
    "code and constants",
    "error over budget",
    "torque error",
    "voltage excess",
    "current excess",
    "extra loss",
)


def _cells(trial: SurfaceTrial) -> tuple[str, ...]:
    errors = trial.errors
    shown: tuple[str, ...] = ("",) * 4
    if errors is not None and trial.voltage is not None:
        voltage = trial.voltage
        values = (
            errors.torque_relative,
            voltage.voltage_excess,
            errors.current_excess,
            voltage.loss_relative,
        )
        shown = tuple(percent(value) for value in values)
    size = (
        f"{trial.degrees[0]}",
        f"{trial.degrees[1]}",
        f"{trial.coefficients}",
        f"{trial.flash} B",
    )
    return (*size, f"{trial.grid_error:.2f}", *shown)


def weakening_tables(fit: WeakeningFit | None) -> list[Table]:
    """What was tried, in order of size, for the terminal.

    Nothing where no such reference is asked for.
    """
    if fit is None:
        return []
    note = (
        "error over budget on the grid of the fit; measured in float32 where that is below 0.95; "
        "the last is emitted"
    )
    rows = tuple(_cells(trial) for trial in fit.trials)
    proven = proof_text(fit)
    bounds = "no bounds are proven" if proven is None else f"proven bounds: {proven}"
    largest = f"largest errors: {errors_text(fit)}"
    notes = (domain_text(fit), largest, nominal_text(fit), bounds, note)
    return [Table("Field weakening: surfaces tried for the budget", _COLUMNS, rows, notes)]


def weakening_html(fit: WeakeningFit) -> HtmlTable:
    """What was tried, in order of size, for the report."""
    rows = tuple(Row(_cells(trial), "chosen" if trial.chosen else "") for trial in fit.trials)
    return HtmlTable(
        "Surfaces tried for the budget, by size", tuple(symbols(text) for text in _COLUMNS), rows
    )


def weakening_passage(fit: WeakeningFit, prefix: str) -> Passage:
    """The part of the report on field weakening."""
    proven, samples = proof_text(fit), count(fit.errors.samples + fit.voltage.samples)
    bounds = "They are sampled, not proven."
    if proven:
        bounds = (
            "Proven for every torque, motoring and generating, voltages from "
            f"{least_voltage_text(fit)} up and speeds up to the largest, rounding included: "
            f"{proven}; what is granted of a torque beyond reach, and the copper loss, are sampled."
        )
    text = (
        "Currents over torque, voltage and speed, the resistance drop included, "
        f"{domain_text(fit)}. Largest errors: {errors_text(fit)}; {nominal_text(fit)}; found in "
        f"{samples} evaluations with and without fused multiply-add. {bounds}"
    )
    caption = (
        "Errors of the emitted single-precision currents over torque and the flux linkage that "
        "voltage, speed and resistance drop leave. Lines: flux linkage of the MTPA currents, to "
        "the left of which the field is weakened, and the largest torque; thick where MTPV limits "
        "it."
    )
    return Passage(
        text=[text],
        drawings=[("weakening", caption)],
        tables=[weakening_html(fit)],
        declaration=(
            f"void {prefix}_weakening_reference(float torque_Nm, float v_max_V, "
            "float omega_e_rad_per_s, float *i_d_A, float *i_q_A);"
        ),
    )


# The current reference with field weakening, as one record.


def _summary(_: Solution, fit: WeakeningFit) -> Rows:
    rows = [
        ("field weakening", domain_text(fit)),
        ("  largest errors", errors_text(fit)),
        ("  over the dc link", nominal_text(fit)),
    ]
    proven = proof_text(fit)
    return rows if proven is None else [*rows, ("  proven bounds", proven)]


def _figures(_: Solution, fit: WeakeningFit) -> Mapping[str, Draw]:

    return {"weakening": lambda: plot_weakening(fit)}


def _parts(solution: Solution, fit: WeakeningFit) -> list[ReportPart]:
    return [weakening_passage(fit, solution.design.export.prefix).of(CHAPTER)]


WEAKENING = Capability(
    name="weakening",
    title="field weakening",
    of=lambda outcome: outcome.solution.weakening,
    plain=lambda _, fit: plain_weakening_fit(fit),
    summary=_summary,
    tables=lambda _, fit: weakening_tables(fit),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="weakening",
            files=lambda solution, fit: weakening_files(solution.design, fit),
            plain=lambda _, fit: plain_weakening(fit.step),
            read=lambda own, _: weakening_from(own),
            programme=weakening_programme,
        ),
    ),
    quantities=(
        Quantity("current reference", "bytes of the surface", "", ("weakening", "flash_B")),
        Quantity("current reference", "surface up to", "rpm", ("weakening", "omega_m_rad_per_s")),
    ),
)


# The field-weakening reference as plain data.


def plain_weakening_fit(fit: WeakeningFit | None) -> PlainData | None:
    """Domain, errors and trials of the two-dimensional reference."""
    if fit is None:
        return None
    region = fit.region
    return {
        "omega_m_rad_per_s": fit.settings.omega_m,
        "flux_min_Wb": region.flux_min,
        "flux_max_Wb": region.flux_max,
        "torque_max_Nm": region.torque_max,
        "v_max_V": fit.domain.v_max,
        "omega_e_rad_per_s": fit.domain.omega_e,
        "v_least_V": fit.domain.voltages[0],
        "voltages_V": list(fit.domain.voltages),
        "voltage_drop_V": fit.domain.largest_drop,
        "torque_error_Nm": fit.largest_torque_error,
        "r_s_Ohm": fit.domain.machine.r_s,
        "coefficients": fit.step.coefficients,
        "flash_B": fit.step.flash,
        "errors": asdict(fit.errors),
        "voltage_errors": asdict(fit.voltage),
        "certificate": plain_certificate(fit.certificate),
        "trials": [asdict(trial) for trial in fit.trials],
    }
