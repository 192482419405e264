"""Tables of the HTML report: results become cells of text here; the template only lays them out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.reports.pages.html_text import (
    ceiling,
    count,
    quantity,
    share,
    symbols,
)

if TYPE_CHECKING:
    from markupsafe import Markup


MOST_OPEN_ROWS = 24  # A table with more rows is folded, so that the page stays readable.


@dataclass(frozen=True, slots=True)
class Row:
    """Cells of one row; ``mark`` is ``best``, ``chosen`` or ``muted``, or empty."""

    cells: tuple[str | Markup, ...]
    mark: str = ""


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """A table with a caption.

    The first ``text_columns`` columns are text, the others are set as numbers; ``notes`` stand
    below it, one line each. A table that is ``folded``, or has more than `MOST_OPEN_ROWS` rows, is
    closed at first; its summary line then has the number of rows, and ``key``, its key number.
    """

    caption: str | Markup
    columns: tuple[str | Markup, ...]
    rows: tuple[Row, ...]
    text_columns: int = 1
    notes: tuple[str | Markup, ...] = ()
    folded: bool = False
    key: str | Markup = ""

    @property
    def folds(self) -> bool:
        """Whether it is closed at first."""
        return bool(self.rows) and (self.folded or len(self.rows) > MOST_OPEN_ROWS)

    @property
    def told(self) -> str | Markup:
        """What the summary line says besides the caption."""
        return counted(len(self.rows), "row") + (self.key and "; " + self.key)


def counted(many: int, what: str) -> str:
    """How many there are of something, in words that agree."""
    return f"{count(many)} {what}{'' if many == 1 else 's'}"


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
