"""Tables for the terminal: results become rows of text here, and nowhere are they computed."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import field, replace

from dqforge.machines.records import dataclass

# What stands between two columns, and beside the first and the last, in characters.
_BETWEEN, _EDGES = 3, 2
# A longer cell is a sentence, which may take several lines.
_SHORT = 24
# A table with no more rows than this is turned rather than parted where it is too wide.
_FEW_ROWS = 4
_LEAST_SENTENCE = 20
_GLUE = "\x1f"
NUMBER_AND_UNIT = re.compile(r"(?<=\d) (?=[^\W\d_]|[%°Ω/])")


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table of text: ``columns`` are the headings with units, ``rows`` the cells,
    ``notes`` lines below.
    """

    title: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)


def fitted(table: Table, room: int) -> list[Table]:
    """The table for a terminal of ``room`` characters: no number is parted from itself or its unit.

    Headings and sentences take several lines first; where that is not enough, a table of few rows
    is turned, so that a row becomes a column, and any other is parted, with its first column
    repeated. A single cell wider than the terminal stays whole.
    """
    notes = [line for note in table.notes for line in _paragraph(note, room)]
    table = replace(table, title="\n".join(_paragraph(table.title, room)), notes=tuple(notes))
    if not table.columns:
        return [table]
    widths = _widths(table, room)
    if widths is not None:
        return [_wrapped(table, widths)]
    turned = _turned(table)
    if len(table.rows) <= _FEW_ROWS and _widths(turned, room) is not None:
        return fitted(turned, room)
    return _parted(table, room)


def _cells(table: Table) -> list[list[str]]:
    """Headings and cells by column."""
    return [[table.columns[k], *(row[k] for row in table.rows)] for k in range(len(table.columns))]


def _sentence(cell: str) -> bool:
    return len(cell) > _SHORT and " " in cell


def _lines(text: str, width: int) -> list[str]:
    """A text in lines of a width, broken at spaces, but not between a number and its unit."""
    glued = NUMBER_AND_UNIT.sub(_GLUE, text)
    lines = textwrap.wrap(glued, max(width, 1), break_long_words=False, break_on_hyphens=False)
    return [line.replace(_GLUE, " ") for line in lines] or [""]


def _paragraph(text: str, width: int) -> list[str]:
    """Lines of a text that may have lines of its own, those that fit as they are."""
    lines = text.split("\n")
    return [
        part for line in lines for part in ([line] if len(line) <= width else _lines(line, width))
    ]


def _longest(lines: Sequence[str]) -> int:
    return max(len(line) for line in lines)


def _least(title: str, cells: Sequence[str]) -> int:
    """The least width of a column: short cells whole, words of headings and sentences."""
    whole = [len(cell) for cell in cells if not _sentence(cell)]
    words = [_longest(_lines(text, 1)) for text in [title, *filter(_sentence, cells)]]
    room = [min(len(cell), _LEAST_SENTENCE) for cell in cells if _sentence(cell)]
    return max([*whole, *words, *room])


def _widths(table: Table, room: int) -> list[int] | None:
    """Widths of the columns within a terminal; None where they do not fit beside each other."""
    columns = _cells(table)
    natural = [_longest(column) for column in columns]
    left = room - _EDGES - _BETWEEN * (len(columns) - 1)
    if sum(natural) <= left:
        return natural
    least = [_least(column[0], column[1:]) for column in columns]
    left -= sum(least)
    if left < 0:
        return None
    wanted = [most - few for most, few in zip(natural, least, strict=True)]
    return [few + left * want // sum(wanted) for few, want in zip(least, wanted, strict=True)]


def _wrapped(table: Table, widths: Sequence[int]) -> Table:
    """Headings and sentences in lines of these widths."""

    def cell(text: str, width: int) -> str:
        return "\n".join(_lines(text, width)) if len(text) > width else text

    rows = [tuple(map(cell, row, widths)) for row in table.rows]
    return replace(table, columns=tuple(map(cell, table.columns, widths)), rows=tuple(rows))


def _turned(table: Table) -> Table:
    """Rows as columns, headed by their first cell."""
    heading, *others = _cells(table)
    return replace(table, columns=tuple(heading), rows=tuple(map(tuple, others)))


def _parted(table: Table, room: int) -> list[Table]:
    """Several tables of as many columns as fit, each behind the first column."""
    parts: list[Table] = []
    taken: list[int] = []
    for k in range(1, len(table.columns)):
        if taken and _widths(_chosen(table, [0, *taken, k]), room) is None:
            parts.append(_chosen(table, [0, *taken]))
            taken = []
        taken.append(k)
    parts.append(_chosen(table, [0, *taken]))
    shown = []
    for place, part in enumerate(parts):
        title = table.title if place == 0 else ""
        notes = table.notes if place == len(parts) - 1 else ()
        widths = _widths(part, room) or [_least(c[0], c[1:]) for c in _cells(part)]
        shown.append(_wrapped(replace(part, title=title, notes=notes), widths))
    return shown


def _chosen(table: Table, kept: Sequence[int]) -> Table:
    """A table of some of its columns."""
    rows = tuple(tuple(row[k] for k in kept) for row in table.rows)
    return replace(table, columns=tuple(table.columns[k] for k in kept), rows=rows)
