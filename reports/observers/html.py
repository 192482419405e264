"""Observers in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.reports.observers.text import position_parts
from dqforge.reports.observers.tracker_text import tracker_part
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
    from dqforge.optimizer.estimators.solve import TunedTracker
    from dqforge.optimizer.observers.reduced_order import (
        ErrorsAtLoad,
        ObserverError,
        ReducedOrderObserver,
    )


def speed_tables(observer: ReducedOrderObserver, errors: Sequence[ErrorsAtLoad]) -> list[HtmlTable]:
    """Coefficients of the speed observer and its errors with and without load.

    ``errors`` are the steady errors of the speed: without load, and with half the largest torque.
    """
    return [_coefficients_table(observer), _speed_error_table(errors)]


def _coefficients_table(observer: ReducedOrderObserver) -> HtmlTable:
    coefficients = (
        ("A", f"{number(observer.a, 8)}", "pole in the z plane"),
        ("B_u", f"{number(observer.b_u, 8)}{NARROW}rad/(s V)", "factor of the voltage u_q"),
        ("B_i", f"{number(observer.b_i, 8)}{NARROW}rad/(s A)", "factor of the current i_q"),
        ("C", f"{number(observer.c, 8)}{NARROW}rad/(s A)", "current taken off the estimate"),
    )
    return HtmlTable(
        symbols(
            "Speed observer: \u03c9\u0302[k] = \u03b6[k] \u2212 C i_q[k], "
            "\u03b6[k+1] = A \u03b6[k] + B_u u_q[k] + B_i i_q[k]"
        ),
        ("", "", "value"),
        tuple(Row((symbols(name), symbols(text), value)) for name, value, text in coefficients),
        2,
    )


def _speed_error_table(errors: Sequence[ErrorsAtLoad]) -> HtmlTable:
    """Steady errors of the speed at half the base speed."""
    rows = []
    for label, found in zip(("no load", "half the largest torque"), errors, strict=True):
        cells = [_speed_error_text(error) for error in (found.exact, found.resistance)]
        rows.append(Row((label, quantity(found.torque_load, "N m"), *cells)))
    speed = quantity(errors[0].exact.omega_m, "rpm")
    caption = f"Steady speed error at {speed}, half the base speed, with an unknown load at i_d = 0"
    columns = (
        "",
        "load torque",
        "exact values",
        f"resistance {100.0 * errors[0].r_error:.0f} % too large",
    )
    return HtmlTable(symbols(caption), heading_cells(*columns), tuple(rows))


def estimator_tables(found: PositionObserver | TunedTracker) -> list[HtmlTable]:
    """Of an observer or a tracker of the position."""
    if isinstance(found, PositionObserver):
        return position_tables(found)
    title, columns, rows, notes = tracker_part(found)
    heading = symbols(f"{title}: {'; '.join(notes)}")
    return [HtmlTable(heading, heading_cells(*columns), tuple(Row(cells) for cells in rows))]


def position_tables(position: PositionObserver) -> list[HtmlTable]:
    """Errors of a position observer over its speeds, with what they include."""
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
