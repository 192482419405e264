"""Paper 002 in tables: printed beside found, and what rests on inferred data."""

from __future__ import annotations

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper002.figure_list import FIGURES
from dqforge.reports.papers.paper002.recomputed import (
    TERMS_SPEED,
    TERMS_TORQUE,
    Condition,
    Reproduction,
)
from dqforge.reports.papers.paper002_definitions.back_emf_components import COMPONENTS, ComponentRow
from dqforge.reports.papers.paper002_definitions.bench_currents import CurveFigure
from dqforge.reports.papers.paper002_definitions.compensation import Compensation
from dqforge.reports.papers.paper002_definitions.misprints import Misprint, ModelCheck
from dqforge.reports.papers.paper002_loops.loop_tables import left_out_table, loop_tables
from dqforge.reports.papers.paper002_loops.loss_ratios import SHIPPED

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
        ),
    )


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
    return loop_tables(found.loops.runs, found.path, found.ratios, closed)


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
