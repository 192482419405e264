"""Observers in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.observers.reduced_order import (
    ErrorsAtLoad,
    ObserverError,
)
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.reports.observers.text import position_parts
from dqforge.reports.pages.html_table import (
    HtmlTable,
    Row,
    coefficients_table,
    headings,
    speed_error_table,
)
from dqforge.reports.pages.html_text import (
    NARROW,
    quantity,
    share,
    symbols,
)
from dqforge.reports.pages.labels import (
    NEGLIGIBLE,
)

if TYPE_CHECKING:
    pass


def observer_tables(gains: GainSet, errors: Sequence[ErrorsAtLoad]) -> list[HtmlTable]:
    """Coefficients of the speed observer and its errors with and without load,
    or what is said of a position observer.

    ``errors`` are the steady errors of the speed: without load, and with half the largest torque.
    """
    if gains.observer is not None:
        return [coefficients_table(gains.observer), speed_error_table(errors)]
    return [] if gains.position is None else _position_tables(gains.position)


def _position_tables(position: PositionObserver) -> list[HtmlTable]:
    return [
        HtmlTable(
            symbols(f"{title}: {'; '.join(notes)}"),
            headings(*columns),
            tuple(Row(cells) for cells in rows),
        )
        for title, columns, rows, notes in position_parts(position)
    ]


def speed_error_text(error: ObserverError) -> str:
    if abs(error.relative) < NEGLIGIBLE:
        return f"0{NARROW}rpm"
    return f"{quantity(error.total, 'rpm', 3)} ({share(error.relative, 2)})"
