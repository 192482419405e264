"""Observers in the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.observers.reduced_order import ObserverError, steady_state_error
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.reports.observers.text import position_parts
from dqforge.reports.pages.html_table import HtmlTable, Row, heading_cells
from dqforge.reports.pages.html_text import (
    NARROW,
    number,
    quantity,
    share,
    symbols,
)
from dqforge.reports.pages.labels import (
    NEGLIGIBLE,
)

if TYPE_CHECKING:
    pass


R_ERROR = 0.3

"""Relative error of the resistance for which the observer's speed error is stated."""


def observer_tables(design: Design, gains: GainSet, torque_max: float) -> list[HtmlTable]:
    """Coefficients of the speed observer.

    Its steady speed error with and without load and error of the resistance.
    """
    observer, machine = gains.observer, design.machine
    if observer is None:
        return [] if gains.position is None else _position_tables(gains.position)
    coefficients = (
        ("A", f"{number(observer.a, 8)}", "pole in the z plane"),
        ("B_u", f"{number(observer.b_u, 8)}{NARROW}rad/(s V)", "factor of the voltage u_q"),
        ("B_i", f"{number(observer.b_i, 8)}{NARROW}rad/(s A)", "factor of the current i_q"),
        ("C", f"{number(observer.c, 8)}{NARROW}rad/(s A)", "current taken off the estimate"),
    )
    first = HtmlTable(
        symbols(
            "Speed observer: \u03c9\u0302[k] = \u03b6[k] \u2212 C i_q[k], "
            "\u03b6[k+1] = A \u03b6[k] + B_u u_q[k] + B_i i_q[k]"
        ),
        ("", "", "value"),
        tuple(Row((symbols(name), symbols(text), value)) for name, value, text in coefficients),
        2,
    )
    speed = 0.5 * design.control.bases.speed
    rows = []
    for label, load in (("no load", 0.0), ("half the largest torque", 0.5 * torque_max)):
        errors = [
            steady_state_error(
                machine, observer.g, observer.t_s, speed, torque_load=load, r_error=r_error
            )
            for r_error in (0.0, R_ERROR)
        ]
        cells = [_speed_error_text(error) for error in errors]
        rows.append(Row((label, quantity(load, "N m"), *cells)))
    caption = (
        f"Steady speed error at {quantity(speed, 'rpm')}, half the base speed, with an unknown "
        "load at i_d = 0"
    )
    columns = ("", "load torque", "exact values", f"resistance {100.0 * R_ERROR:.0f} % too large")
    return [first, HtmlTable(symbols(caption), heading_cells(*columns), tuple(rows))]


def _position_tables(position: PositionObserver) -> list[HtmlTable]:
    return [
        HtmlTable(
            symbols(f"{title}: {'; '.join(notes)}"),
            heading_cells(*columns),
            tuple(Row(cells) for cells in rows),
        )
        for title, columns, rows, notes in position_parts(position)
    ]


def _speed_error_text(error: ObserverError) -> str:
    if abs(error.relative) < NEGLIGIBLE:
        return f"0{NARROW}rpm"
    return f"{quantity(error.total, 'rpm', 3)} ({share(error.relative, 2)})"
