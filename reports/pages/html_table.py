"""Tables of the HTML report: results become cells of text here; the template only lays them out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.reports.pages.html_text import (
    ceiling,
    quantity,
    share,
    symbols,
)

if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True, slots=True)
class Row:
    """Cells of one row; ``mark`` is ``best``, ``chosen`` or ``muted``, or empty."""

    cells: tuple[str | Markup, ...]
    mark: str = ""


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """A table with a caption.

    The first ``text_columns`` columns are text, the others are set as numbers; ``notes`` stand
    below it, one line each.
    """

    caption: str | Markup
    columns: tuple[str | Markup, ...]
    rows: tuple[Row, ...]
    text_columns: int = 1
    notes: tuple[str | Markup, ...] = ()


def heading_cells(*texts: str) -> tuple[Markup, ...]:
    """Headings of a table, with their symbols set."""
    return tuple(symbols(text) for text in texts)


def error_cells(errors: ReferenceErrors) -> tuple[str, ...]:
    """Errors of a current reference as cells."""
    return (
        quantity(ceiling(errors.torque), "N m", 3),
        share(ceiling(errors.torque_relative), 3),
        quantity(ceiling(errors.i_d), "A", 3),
        quantity(ceiling(errors.i_q), "A", 3),
        quantity(ceiling(errors.loss), "W", 3),
        share(ceiling(errors.loss_relative), 3),
        quantity(ceiling(errors.step_at_zero), "A", 3),
    )
