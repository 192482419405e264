"""Paper 002 in tables: printed beside found, and what rests on inferred data."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper002_bench_currents import (
    BENCH_TORQUE,
    DESIGN_NAME,
    HIGHEST_ORDER,
    BenchCurves,
    CurveFigure,
    SpokenHarmonics,
    bench_curves,
    bench_machine,
    curve_figures,
    plot_currents,
    plot_frames,
    plot_machine,
    spoken_harmonics,
    telling_orders,
)
from dqforge.reports.papers.paper002_closed_loops import (
    BENCH_SPEED,
    SHIPPED,
    ClosedLoops,
    DiodePath,
    LedRun,
    LoopRatio,
    LoopRun,
    diode_path,
    left_out_table,
    loop_ratios,
    loop_tables,
    run_loops,
)
from dqforge.reports.papers.paper002_compensation import (
    COMPONENTS,
    TRAPEZOID_FLUX,
    Compensation,
    ComponentRow,
    Misprint,
    ModelCheck,
    check_model,
    compensation,
    frame_curves,
    plot_structures,
    plot_terms,
    shipped_machine,
    table_3_1,
    trapezoid_machine,
)
from dqforge.reports.papers.transients import RPM
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ORDERS = (1, 3, 5, 7, 9)  # Of the harmonics that are shown.

INFERRED_NOTE = (
    "The thesis prints a name plate and no other data of its machine: amperes, volts and rpm rest "
    "on inferred data."
)

# Quantity: label, unit, decimals.
_RANGES = {
    "a_x": ("a_x", "", 3),
    "a_y": ("a_y", "", 3),
    "theta_x": ("theta_x", "deg", 1),
    "theta_y": ("theta_y", "deg", 1),
    "turn": ("1 + theta_x'", "", 2),
    "theta_y_rate": ("theta_y'", "", 2),
    "growth": ("a_y'/a_y", "", 2),
    "emf": ("(4.17): omega phi_m F_qy", "V", 0),
    "coupling_d": ("(4.10): A omega i_qy", "V", 1),
    "coupling_q": ("(4.17): H omega i_qy", "V", 1),
    "coupling_0": ("(4.15): F omega i_qy", "V", 1),
}


def _components(rows: tuple[ComponentRow, ...]) -> Table:
    return Table(
        "Paper 002, Table 3.1: r.m.s. of the components of the back-EMF of unit amplitude",
        ("", *(f"{name} printed / found" for name in COMPONENTS), "copper loss dqx over dqy"),
        tuple(
            (
                row.shape,
                *(f"{row.printed[name]:.2f} / {row.found[name]:.3f}" for name in COMPONENTS),
                f"{row.loss_ratio:.3f}",
            )
            for row in rows
        ),
        (
            "The trapezoid's 1.83 and 1.92 are r.m.s.(|F|^2)/sqrt(3/2), another quantity.",
            "The trapezoid's printed d is not that of a flat top of 120 degrees.",
            (
                "Copper losses at the same constant torque; power-invariant components, as in the "
                "thesis."
            ),
        ),
    )


def _figures() -> Table:
    return Table(
        "Paper 002, Figures 4.1 to 4.3 and 6.1 to 6.18: what they show, and what is recomputed",
        ("figure", "shows", "recomputed from", "cannot be had"),
        tuple(
            (entry.numbers, entry.shows, entry.rests_on, entry.lacks or "-") for entry in FIGURES
        ),
        ("Measured curves are pictures, without a scale in the text.", INFERRED_NOTE),
    )


def _conditions(rows: tuple[Condition, ...]) -> Table:
    return Table(
        "Paper 002, chapter 6: everything that it states in numbers",
        ("", "where", "printed", "here"),
        tuple(
            (row.name, row.place, f"{row.printed:g} {row.unit}", f"{row.used:.4g} {row.unit}")
            for row in rows
        ),
    )


def _size(value: float | None, factor: float, text: str) -> str:
    return "-" if value is None else f"{factor * value:{text}}"


def _misprint(row: Misprint) -> tuple[str, ...]:
    return (
        row.equation,
        row.printed,
        row.holds,
        _size(row.share, 100.0, ".1f"),
        _size(row.volts, 1.0, ".2f"),
    )


def _model(model: ModelCheck) -> Table:
    verdict = "below" if model.agreement < 1e-12 else "ABOVE"
    over, ripple = 100.0 * model.emf_error, 100.0 * model.reference_ripple
    return Table(
        "Paper 002, chapter 4: the terms (4.10) to (4.18) against the machine in alpha, beta and 0",
        ("equation", "printed", "holds", "error %", "error V"),
        tuple(_misprint(row) for row in model.misprints),
        (
            f"With what holds, blocks A to I make its voltages, {verdict} 1e-12 apart.",
            f"With what holds, A to I make the voltages of the machine, {verdict} 1e-12 apart.",
            f"error V: of the shipped drive at {TERMS_TORQUE:g} N m, {TERMS_SPEED:.0f} rpm.",
            "-: no voltage as printed. The order of (4.8) is right.",
            f"(4.3) after (4.2) divides by a_x and a_y, (3.2) by a_y: up to {over:.0f} % more.",
            f"(4.4) as printed lets i_qy follow 1/a_y^4, {ripple:.0f} % p-p; it is constant.",
            "Compensation of the back-EMF by (4.16) to (4.18) as printed compensates none.",
        ),
    )


def _terms(machines: tuple[Compensation, ...]) -> Table:
    found = [machine.ranges for machine in machines]
    rows = tuple(
        (
            label,
            unit,
            *(f"{part[name][0]:.{digits}f} to {part[name][1]:.{digits}f}" for part in found),
        )
        for name, (label, unit, digits) in _RANGES.items()
    )
    return Table(
        "Paper 002, Figures 4.2 and 4.3: frames and compensation over the angle at "
        f"{TERMS_TORQUE:g} N m, {TERMS_SPEED:.0f} rpm",
        ("", "unit", *(machine.name for machine in machines)),
        rows,
        (
            "Constant references i_qy = "
            + " and ".join(f"{machine.i_qy:.4g} A" for machine in machines)
            + ", i_dy = i_0y = 0; the voltages that they need are not constant.",
        ),
    )


def _harmonics(found: Reproduction) -> Table:
    lines = found.curves.harmonics
    orders = ", ".join(str(order) for order in found.telling)
    return Table(
        "Paper 002, Figures 6.3 and 6.7 for the shipped drive at 1 N m: harmonics of phase a",
        ("order", "back-EMF mV s/rad (peak)", "dqx mA (peak)", "dqy mA (peak)"),
        tuple(
            (
                f"{order}",
                f"{1e3 * found.curves.flux_harmonics[order]:.2f}",
                *(f"{1e3 * lines[k, order]:.2f}" for k in range(2)),
            )
            for order in ORDERS
        ),
        (
            (
                f"i_qy is constant, {found.curves.i_qy:.4g} A = T / (p phi_m sqrt(3/2)), "
                "power-invariant; (4.4) errs."
            ),
            f"The thesis: dqx and dqy differ most in orders 1, 3, 7; here, largest first {orders}.",
            f"Copper loss of dqx over dqy here: {found.curves.loss_ratio:.4f}.",
            "The drive's harmonics are assumed: the thesis shows its back-EMF as a figure only.",
            *_spoken(found.spoken),
        ),
    )


def _spoken(spoken: SpokenHarmonics) -> tuple[str, ...]:
    """What the words on the orders 1, 3 and 7 leave of the harmonics."""
    rule = (
        "in all of them the shares of 5 and 7 add up to less than zero (against the fundamental)"
        if spoken.opposed
        else "no rule for the signs of 5 and 7 holds in all of them"
    )
    own, other = (
        "is one of them" if agrees else "is none of them"
        for agrees in (spoken.shipped_agrees, spoken.turned_agrees)
    )
    shares = ", ".join(f"{100.0 * share:+.3g} %" for share in spoken.shipped)
    text = (
        "Scanned: shares of the orders 3 (2 to 30 %), 5 (within 8 %) and 7 (within 6 %) of either "
        f"sign. {spoken.agreeing} of {spoken.sets} sets give 1, 3 and 7; {rule}; copper loss of "
        f"dqx over dqy from {spoken.loss_least:.3f} to {spoken.loss_largest:.3f}. The shipped set "
        f"({shares}) {own}; with order 5 in opposite phase it {other}."
    )
    return tuple(textwrap.wrap(text, 110))


def _row(figure: CurveFigure) -> tuple[str, ...]:
    expected = "" if figure.expected is None else f"{abs(figure.expected):.4f} {figure.identity}"
    return (figure.figure, figure.quantity, f"{abs(figure.found):.4f}", expected)


def _curves(rows: tuple[CurveFigure, ...]) -> Table:
    return Table(
        "Paper 002, Figures 6.9 to 6.16 from the definitions: dqy at 1 N m, power-invariant",
        ("figure", "quantity", "found A", "by an identity of the frames, A"),
        tuple(_row(row) for row in rows),
        ("The text prints no number of these curves. " + INFERRED_NOTE,),
    )


def _loops(found: Reproduction) -> list[Table]:
    if found.loops is None:
        return [left_out_table(found.loops_left_out)]
    closed = {row.shape: row.loss_ratio for row in found.rows}
    closed[SHIPPED] = found.curves.loss_ratio
    return loop_tables(found.loops, found.path, found.ratios, closed)


def reproduction_tables(found: Reproduction) -> list[Table]:
    """Printed and recomputed values side by side."""
    return [
        _figures(),
        _components(found.rows),
        _model(found.model),
        _terms(found.terms),
        _conditions(found.conditions),
        _harmonics(found),
        _curves(found.curve_figures),
        *_loops(found),
    ]


# Everything that is recomputed of paper 002: printed beside found.

TERMS_TORQUE = 3.5  # N m, at which the terms of Figure 4.3 are shown; chosen near the rated torque.
TERMS_SPEED = 1800.0  # rpm, the rated speed.


@dataclass(frozen=True, slots=True)
class Condition:
    """A number that chapter 6 states, and what the shipped design has; in ``unit``."""

    name: str
    printed: float
    unit: str
    place: str
    used: float


def _used(design: Design) -> dict[str, float]:
    machine, waveform, rpm = design.machine, design.waveform, np.pi / 30.0
    speed = machine.omega_m_max
    assert speed is not None
    assert waveform.torque is not None
    assert waveform.omega_m is not None
    return {
        "poles": 2.0 * machine.pole_pairs,
        "rated power": machine.torque_per_ampere * design.i_max * speed,
        "dc link": design.inverter.v_dc,
        "rated current": design.i_max / 2.0**0.5,
        "rated speed": speed / rpm,
        "speed": waveform.omega_m / rpm,
        "torque": waveform.torque,
        "sampling period": 1e6 * design.control.t_s,
        "switching frequency": 1e-3 * design.inverter.f_sw,
    }


def conditions() -> tuple[Condition, ...]:
    """The stated numbers beside those of the shipped design."""
    used = _used(catalogue.load(DESIGN_NAME))
    return tuple(
        Condition(name, value, unit, place, used[name])
        for name, (value, unit, place) in PRINTED_CONDITIONS.items()
    )


# What the figures of chapters 4 and 6 of paper 002 show, and what of them can be recomputed.
#
# The thesis prints its curves without a scale in the text; its machine has a name plate (Table 6.1)
# and no other data. So identities of the frames hold whatever the machine, and everything in
# amperes, volts or revolutions here rests on the inferred data of the shipped drive.

# Everything in numbers that chapter 6 states: value, unit, place.
PRINTED_CONDITIONS = {
    "poles": (4.0, "", "Table 6.1"),
    "rated power": (750.0, "W", "Table 6.1"),
    "dc link": (220.0, "V", "Table 6.1"),
    "rated current": (4.2, "A", "Table 6.1"),
    "rated speed": (1800.0, "rpm", "Table 6.1"),
    "speed": (750.0, "rpm", "section 6.2"),
    "torque": (1.0, "N m", "section 6.2"),
    "sampling period": (100.0, "us", "section 6.2"),
    "switching frequency": (10.0, "kHz", "section 6.2"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """Table 3.1, the conditions of chapter 6, chapter 4 judged, its terms over the angle, and the
    curves of chapter 6 from the definitions with the numbers read off them.

    ``telling`` are the orders by which the currents of dqx and dqy differ, the largest first.
    ``loops`` and ``ratios`` are those of the emitted C, None and empty where ``loops_left_out``
    says why.
    """

    rows: tuple[ComponentRow, ...]
    conditions: tuple[Condition, ...]
    model: ModelCheck
    terms: tuple[Compensation, ...]
    curves: BenchCurves
    curve_figures: tuple[CurveFigure, ...]
    telling: tuple[int, ...]
    spoken: SpokenHarmonics
    path: DiodePath
    loops: ClosedLoops | None
    ratios: tuple[LoopRatio, ...]
    loops_left_out: str


def _closed_loops() -> tuple[ClosedLoops | None, tuple[LoopRatio, ...], str]:
    """What runs in the loop, or why nothing does."""
    try:
        require_compiler()
    except VerificationError as error:
        return None, (), str(error)
    return run_loops(), loop_ratios(), ""


def reproduce_paper() -> Reproduction:
    """Recompute everything; without a C compiler all but the closed loops."""
    machine, omega_e = bench_machine(), TERMS_SPEED * np.pi / 30.0
    omega_e *= machine.pole_pairs
    shipped = shipped_machine(machine)
    curves = bench_curves()
    loops, ratios, left_out = _closed_loops()
    point = (machine.pole_pairs, TERMS_TORQUE, omega_e)
    return Reproduction(
        rows=table_3_1(),
        conditions=conditions(),
        model=check_model(shipped, *point),
        terms=(
            compensation("shipped drive (inferred)", shipped, *point),
            compensation(
                f"trapezoid, {TRAPEZOID_FLUX:g} Wb (chosen)", trapezoid_machine(machine), *point
            ),
        ),
        curves=curves,
        curve_figures=curve_figures(curves),
        telling=telling_orders(curves),
        spoken=spoken_harmonics(curves),
        path=diode_path(machine, BENCH_TORQUE, BENCH_SPEED),
        loops=loops,
        ratios=ratios,
        loops_left_out=left_out,
    )


# Paper 002 as plain data.


def _component_row(row: ComponentRow) -> PlainData:
    return {
        "shape": row.shape,
        "printed": row.printed,
        "found": row.found,
        "loss_ratio_dqx_over_dqy": row.loss_ratio,
    }


def _drive(curves: BenchCurves) -> PlainData:
    lines = slice(0, HIGHEST_ORDER + 1)
    return {
        "theta_rad": curves.theta,
        "emf_over_omega_Wb": curves.flux,
        "harmonics_emf_Wb": curves.flux_harmonics[lines],
        "theta_x_rad": curves.angles.theta_x,
        "theta_y_rad": curves.angles.theta_y,
        "a_x": curves.angles.a_x,
        "a_y": curves.angles.a_y,
        "current_a_dqx_A": curves.currents[0],
        "current_a_dqy_A": curves.currents[1],
        "harmonics_a_dqx_A": curves.harmonics[0, lines],
        "harmonics_a_dqy_A": curves.harmonics[1, lines],
        "i_qy_A": curves.i_qy,
        "i_qx_A": curves.dqx[1],
        "i_alphabeta0_A": curves.stationary,
        "loss_ratio_dqx_over_dqy": curves.loss_ratio,
    }


def _model_data(model: ModelCheck) -> PlainData:
    return {
        "agreement": model.agreement,
        "misprints": [asdict(row) for row in model.misprints],
        "reference_ripple": model.reference_ripple,
        "emf_error": model.emf_error,
    }


def _terms_data(found: Compensation) -> PlainData:
    return {"machine": found.name, "i_qy_A": found.i_qy, "ranges": found.ranges}


def _loop(run: LoopRun) -> PlainData:
    mean, least, largest = run.i_qy
    early, late = run.asked
    case, curves = run.case, run.curves
    return {
        "circuit": case.plant,
        "header_for": case.firmware,
        "frame": case.frame,
        "feedforward": case.feedforward,
        "harmonic_integrators": case.harmonics,
        "in_the_thesis": case.shown or None,
        "torque_Nm": run.torque,
        "ripple_averaged_Nm": run.ripple_averaged,
        "ripple_of_means_Nm": run.ripple_means,
        "ripple_Nm": run.ripple,
        "neutral_rms_A": run.neutral_rms,
        "i_0_rms_A": run.zero_rms,
        "i_0_order_3_A": run.zero_third,
        "i_qy_A": {"mean": mean, "least": least, "largest": largest},
        "phase_rms_A": run.phase_rms,
        "copper_W": run.copper,
        "v_0_asked_V": None if math.isnan(early) else [early, late],
        "dip_rad_per_s": run.dip,
        "dip_after_s": run.dip_after,
        "theta_rad": curves.theta,
        "i_alphabeta0_A": curves.stationary,
        "i_dqy_A": curves.dqy,
        "step_time_s": curves.time,
        "step_torque_Nm": curves.torque,
        "step_speed_rad_per_s": curves.speed,
    }


def _led(run: LedRun) -> PlainData:
    return {
        "angle_from": run.led_by,
        "torque_Nm": run.mean,
        "ripple_of_means_Nm": run.ripple,
        "angle_error_rad": {"mean": run.bias, "peak_to_peak": run.swing},
        "dip_rad_per_s": run.dip,
    }


def plain_reproduction(found: Reproduction) -> PlainData:
    """Tables and curves as plain data."""
    return {
        "figures": [asdict(figure) for figure in FIGURES],
        "table_3_1": [_component_row(row) for row in found.rows],
        "chapter_4": _model_data(found.model),
        "figure_4_3": [_terms_data(machine) for machine in found.terms],
        "conditions": [asdict(row) for row in found.conditions],
        "drive": _drive(found.curves),
        "figures_6_9_to_6_16": [asdict(row) for row in found.curve_figures],
        "telling_orders": list(found.telling),
        "spoken_harmonics": asdict(found.spoken),
        "diode_path": asdict(found.path),
        "closed_loops": None if found.loops is None else [_loop(run) for run in found.loops.runs],
        "without_encoder": None if found.loops is None else [_led(run) for run in found.loops.led],
        "closed_loops_left_out": found.loops_left_out or None,
        "closed_loop_loss_ratios": [asdict(row) for row in found.ratios],
    }


DEFINED = "from the definitions"
INFERRED = "inferred data"
LOOP = "inferred data, emitted C in the loop"
PHOTOGRAPH = "not recomputed"


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """A figure of the thesis: its numbers, what it shows, on what the recomputed one rests, and
    what cannot be recomputed of it (empty: nothing).
    """

    numbers: str
    shows: str
    rests_on: str
    lacks: str = ""


_CURVES = "the measured curve"

FIGURES = (
    ThesisFigure(
        "4.1", "control in three parts: transforms, current controller, inverter", DEFINED
    ),
    ThesisFigure("4.2", "dqy control: references (4.4)-(4.6), PI controllers in dqy", DEFINED),
    ThesisFigure("4.3", "the same with decoupling (4.10)-(4.15) and (4.16)-(4.18)", DEFINED),
    ThesisFigure("6.1", "machine and load on the bench", PHOTOGRAPH, "a photograph"),
    ThesisFigure("6.2", "back-EMF over speed, three phases, measured", INFERRED, _CURVES),
    ThesisFigure("6.3", "harmonics of the back-EMF of phase a", INFERRED, "its numbers"),
    ThesisFigure("6.4", "theta_r, theta_r + theta_x and theta_y over the angle", INFERRED),
    ThesisFigure("6.5", "a_x and a_y over the angle", INFERRED),
    ThesisFigure("6.6", "current of phase a by dqx and dqy, simulated", INFERRED),
    ThesisFigure("6.7", "harmonics of that current", INFERRED),
    ThesisFigure("6.8", "the two diodes 1N5408 at the neutral", PHOTOGRAPH, "a photograph"),
    ThesisFigure("6.9", "i_qy, simulated and measured", LOOP, _CURVES),
    ThesisFigure("6.10", "i_qx of the same", LOOP, _CURVES),
    ThesisFigure("6.11, 6.12", "i_alpha, i_beta of the same", LOOP, _CURVES),
    ThesisFigure("6.13", "i_0 of the same", LOOP, _CURVES),
    ThesisFigure("6.14, 6.15", "path of the current in alpha-beta and alpha-beta-0", LOOP, _CURVES),
    ThesisFigure("6.16", "current of phase a", LOOP, _CURVES),
    ThesisFigure("6.17", "torque at a load step of 1 N m, 750 rpm", LOOP, _CURVES),
    ThesisFigure(
        "6.18", "speed at that step", LOOP, "the measured curve; inertia, speed controller"
    ),
)


# The figures of paper 002 by the names of their files.


def figures_of(found: Reproduction) -> dict[str, Callable[[], Figure]]:
    """Figures by file name, drawn when called; those of the loops where they were run."""
    frames, loops = frame_curves(), found.loops
    drawn: dict[str, Callable[[], Figure]] = {
        "figures-2.3-to-3.2.svg": lambda: plot_frames(frames),
        "figures-4.1-to-4.3.svg": plot_structures,
        "figure-4.3-terms.svg": lambda: plot_terms(found.terms),
        "figures-6.2-to-6.7.svg": lambda: plot_machine(found.curves),
        "figures-6.9-to-6.16.svg": lambda: plot_currents(found.curves),
    }
    if loops is not None:
        drawn["figures-6.9-to-6.16-loops.svg"] = lambda: plot_loops(loops.runs, found.curves)
        drawn["figures-6.17-to-6.18.svg"] = lambda: plot_step(loops.runs)
        drawn["dqy-without-encoder.svg"] = lambda: plot_led(loops.led)
    return drawn


# Figures 6.9 to 6.18 of paper 002 with the emitted C in the loop, circuits side by side.

_BESIDE = ("diodes_pi", "legs_pi", "legs_table")


_STEPS = ("diodes_pi", "legs_pi", "legs_table", "star_table")


_SHORT = {
    "diodes_pi": "Diodes, dqy with PI (the bench)",
    "legs_pi": "Four legs, dqy with PI",
    "legs_table": "Four legs, table",
    "star_table": "Star, dqx table",
}


def _definition(axes: Axes, degrees: FloatArray, values: FloatArray) -> None:
    axes.plot(
        degrees, values, color=MUTED, linewidth=0.8, linestyle=(0, (4.0, 2.0)), label="definition"
    )


def _rows(column: tuple[Axes, ...], run: LoopRun, curves: BenchCurves) -> None:
    q, plane, zero, phase = column
    found, degrees, wanted = run.curves, np.degrees(run.curves.theta), np.degrees(curves.theta)
    q.plot(degrees, found.dqy[1], color=BLUE, label="i_qy (6.9)")
    q.plot(degrees, found.dqx[1], color=ORANGE, linewidth=0.9, label="i_qx (6.10)")
    q.set_title(_SHORT[run.case.name], fontsize=7.5)
    q.set(ylim=(1.7, 2.5))
    plane.plot(degrees, found.stationary[0], color=BLUE, label="i_\u03b1 (6.11)")
    plane.plot(degrees, found.stationary[1], color=ORANGE, label="i_\u03b2 (6.12)")
    plane.set(ylim=(-2.2, 3.4))
    zero.plot(degrees, found.stationary[2], color=TEAL, label="i_0 (6.13)")
    _definition(zero, wanted, curves.stationary[2])
    zero.set(ylim=(-0.36, 0.55))
    phase.plot(degrees, found.phase_a, color=BLUE, label="i_a (6.16)")
    _definition(phase, wanted, curves.currents[1])
    phase.set(ylim=(-1.7, 2.5), xlabel="Electrical angle in deg")
    for axes in column:
        axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 120))
        axes.legend(frameon=False, loc="upper right", ncols=2, fontsize=6.0, handlelength=1.2)


def _paths(plane: Axes, space: Axes, run: LoopRun) -> None:
    alpha, beta, zero = run.curves.stationary
    plane.plot(alpha, beta, color=BLUE, linewidth=0.9)
    plane.set(xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal", xlabel="i_\u03b1 in A")
    space.plot(beta, zero, color=TEAL, linewidth=0.9)
    space.set(xlim=(-2.2, 2.2), ylim=(-0.36, 0.36), xlabel="i_\u03b2 in A")


def plot_loops(runs: tuple[LoopRun, ...], curves: BenchCurves) -> Figure:
    """Currents at 750 rpm and 1 N m: the circuit of the thesis beside four legs."""
    by_name = {run.case.name: run for run in runs}
    with style():
        figure = new_figure(
            "paper-002-loops", 10.2, "Currents in the loop: diodes beside four legs, 750 rpm, 1 N m"
        )
        for place, name in enumerate(_BESIDE):
            across, run = 0.085 + 0.313 * place, by_name[name]
            column = tuple(
                figure.add_axes((across, 0.855 - 0.148 * row, 0.255, 0.112)) for row in range(4)
            )
            _rows(column, run, curves)
            plane = figure.add_axes((across + 0.03, 0.2, 0.205, 0.141))
            space = figure.add_axes((across, 0.045, 0.255, 0.09))
            _paths(plane, space, run)
            plane.set_title("Figure 6.14", fontsize=7.0)
            space.set_title("Figure 6.15, seen along \u03b1", fontsize=7.0)
            if place == 0:
                for axes in (*column, space):
                    axes.set_ylabel("A")
                plane.set_ylabel("i_\u03b2 in A")
                space.set_ylabel("i_0 in A")
    return figure


def plot_step(runs: tuple[LoopRun, ...]) -> Figure:
    """Torque and speed at a load step: Figures 6.17 and 6.18."""
    by_name = {run.case.name: run for run in runs}
    with style():
        figure = new_figure(
            "paper-002-step", 4.6, "Torque and speed at a load step of 1 N m, 750 rpm"
        )
        for place, name in enumerate(_STEPS):
            run, row, column = by_name[name], place // 2, place % 2
            axes = figure.add_axes((0.08 + 0.305 * column, 0.58 - 0.48 * row, 0.235, 0.33))
            axes.plot(1e3 * run.curves.time, run.curves.torque, color=BLUE, linewidth=0.7)
            axes.set(xlim=(-10.0, 300.0), ylim=(-0.1, 1.6), xlabel="Time in ms")
            axes.set_title(_SHORT[name], fontsize=7.0)
            if column == 0:
                axes.set_ylabel("6.17: torque in N m")
        speed = figure.add_axes((0.735, 0.1, 0.24, 0.81))
        for name, colour, dashes in zip(
            _STEPS, (ORANGE, BLUE, TEAL, MUTED), ("-", "-", "--", ":"), strict=True
        ):
            curves = by_name[name].curves
            speed.plot(
                1e3 * curves.time,
                curves.speed / RPM,
                color=colour,
                linestyle=dashes,
                linewidth=1.0,
                label=_SHORT[name],
            )
        speed.set(title="Figure 6.18, all alike", ylabel="Speed in rpm", xlabel="Time in ms")
        speed.set(xlim=(-10.0, 300.0), ylim=(640.0, 790.0))
        speed.legend(frameon=False, loc="upper right", fontsize=6.0)
    return figure


def plot_led(led: tuple[LedRun, ...]) -> Figure:
    """Torque, speed and angle error at a load step: dqy by an encoder and by an observer."""
    with style():
        figure = new_figure("paper-002-led", 3.0, "dqy led by an encoder and by an observer, 1 N m")
        for place, (label, limits) in enumerate(
            (("Torque in N m", (-0.1, 1.6)), ("Speed in rpm", (610.0, 790.0)))
        ):
            axes = figure.add_axes((0.075 + 0.32 * place, 0.15, 0.245, 0.68))
            for run, colour in zip(led, (MUTED, BLUE), strict=True):
                values = run.torque if place == 0 else run.speed / RPM
                axes.plot(1e3 * run.time, values, color=colour, linewidth=0.8, label=run.led_by)
            axes.set(xlim=(-10.0, 300.0), ylim=limits, xlabel="Time in ms", ylabel=label)
            axes.legend(frameon=False, loc="lower right", fontsize=6.5)
        axes = figure.add_axes((0.72, 0.15, 0.25, 0.68))
        axes.plot(1e3 * led[1].time, np.degrees(led[1].angle_error), color=ORANGE, linewidth=0.8)
        axes.set(xlim=(-10.0, 300.0), xlabel="Time in ms", ylabel="Error of the angle in deg")
    return figure
