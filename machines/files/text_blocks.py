"""Large text tables, read some megabytes at a time, so that their memory is that of their numbers.

The lines above the rows and the first rows tell the layout. Blocks of nothing but numbers are
parsed by NumPy; any other is read behind those first lines as a small table of its own, with the
same rules and the same refusals.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.files.text_table import TextTable


LARGE = 8_000_000  # Bytes from which on a table is read in blocks.
MOST_NUMBERS = 40_000_000  # Numbers that a table may hold: 320 MB.
_HEAD = 1 << 18
_BLOCK = 1 << 21
_FIRST_ROWS = 100
_PLAIN = re.compile(rb"[0-9+\-.eE,;\t \r\nnNaA]*")
_ENDS = re.compile(rb"[,;\t ]+(?=\r?\n|\r?$)")
Progress = Callable[[float], None]
_Whole = Callable[[bytes, str], "TextTable"]


@dataclass(frozen=True, slots=True)
class _Dialect:
    """How plain rows are written: the mark between cells (None for blanks) and the decimal sign."""

    mark: str | None
    decimal: bytes

    def parsed(self, block: bytes, columns: int) -> FloatArray | None:
        """Numbers of a block of whole lines, shape (rows, columns).

        None where it is not as plain as that.
        """
        if not _PLAIN.fullmatch(block) or (self.decimal == b"," and b"." in block):
            return None
        text = block.replace(b",", b".") if self.decimal == b"," else block
        rows = text.count(b"\n") + (not text.endswith(b"\n"))
        try:
            values = np.loadtxt(
                io.BytesIO(_ENDS.sub(b"", text)), delimiter=self.mark, ndmin=2, comments=None
            )
        except ValueError:
            return None
        # An empty line would shift the numbers of all lines below.
        return values if values.shape == (rows, columns) and not np.isinf(values).any() else None


_DIALECTS = tuple(
    _Dialect(mark, decimal)
    for mark, decimal in ((",", b"."), (";", b"."), ("\t", b"."), (None, b"."))
)


_DIALECTS += tuple(_Dialect(mark, b",") for mark in (";", "\t", None))


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the first lines tell: the table of their rows, their bytes and number,
    and a dialect if rows are plain.
    """

    table: TextTable
    first: bytes
    lines: int
    dialect: _Dialect | None

    def rows(
        self, block: bytes, above: int, source: str, read_whole: _Whole
    ) -> tuple[FloatArray, np.ndarray]:
        """Values and line numbers of a block with ``above`` lines above it in the file."""
        table = self.table
        if self.dialect is not None:
            values = self.dialect.parsed(block, table.values.shape[1])
            if values is not None:
                return values, np.arange(above + 1, above + 1 + len(values), dtype=np.intp)
        if not block.strip():
            return np.empty((0, table.values.shape[1])), np.empty(0, np.intp)
        try:
            found = read_whole(self.first + block, source)
        except InputError as error:
            if error.line is None or error.line <= self.lines:
                raise
            line = error.line - self.lines + above
            raise InputError(error.message, source=source, line=line, column=error.column) from None
        if (found.names, found.units) != (table.names, table.units):
            message = (
                "the columns of the table change from about this line on; save its parts in a file "
                "each"
            )
            raise InputError(message, source=source, line=above + 1)
        new = found.lines > self.lines
        return found.values[new], found.lines[new] - self.lines + above


def read_in_blocks(
    content: bytes, source: str, read_whole: _Whole, progress: Progress | None = None
) -> TextTable:
    """Table of a large text, as `read_whole` would read it, in little more
    memory than its numbers take.

    Args:
        content: Bytes of the file.
        source: Its name, for messages.
        read_whole: What reads a small table.
        progress: Told the share that is done.

    Raises:
        InputError: As `read_whole`, with the line in the file; or the table holds more than
            `MOST_NUMBERS`.
    """
    content = _with_line_feeds(content, source)
    layout = _layout(content, source, read_whole)
    if layout is None:
        return read_whole(content, source)
    place, above, columns = len(layout.first), layout.lines, layout.table.values.shape[1]
    most = layout.table.lines.size + content.count(b"\n", place) + 1
    if most * columns > MOST_NUMBERS:
        message = f"the table has some {most / 1e6:.3g} million rows of {columns} columns"
        advice = (
            f"at most {MOST_NUMBERS / 1e6:g} million numbers can be read; save fewer columns or "
            "rows"
        )
        raise InputError(f"{message}, {advice}", source=source)
    values, lines = np.empty((most, columns)), np.empty(most, np.intp)
    count = 0
    rows = layout.table.values, layout.table.lines
    while True:
        values[count : count + rows[1].size], lines[count : count + rows[1].size] = rows
        count += rows[1].size
        if progress is not None:
            progress(place / len(content))
        if place >= len(content):
            break
        end = content.find(b"\n", place + _BLOCK) + 1 or len(content)
        block = content[place:end]
        rows = layout.rows(block, above, source, read_whole)
        place, above = end, above + block.count(b"\n")
    return replace(layout.table, values=values[:count], lines=lines[:count])


def _with_line_feeds(content: bytes, source: str) -> bytes:
    """Text whose lines can be found by their line feeds: UTF-16 as UTF-8,
    lone carriage returns replaced.
    """
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        decoder = codecs.getincrementaldecoder("utf-16")()
        parts = []
        try:
            for start in range(0, len(content), _BLOCK):
                final = start + _BLOCK >= len(content)
                parts.append(decoder.decode(content[start : start + _BLOCK], final).encode())
        except UnicodeError as error:
            raise InputError(
                "the UTF-16 text is damaged; save the table again", source=source
            ) from error
        content = b"".join(parts)
    return content if b"\n" in content[:_HEAD] else content.replace(b"\r", b"\n")


def _layout(content: bytes, source: str, read_whole: _Whole) -> _Layout | None:
    """Layout by the first lines; None where the file has a line of enormous length."""
    end = content.rfind(b"\n", 0, _HEAD) + 1
    if end == 0:
        return None
    head = read_whole(content[:end], source)
    lines = int(head.lines[min(_FIRST_ROWS, head.lines.size) - 1])
    place = 0
    for _ in range(lines):
        place = content.index(b"\n", place) + 1
    first = content[:place]
    table = read_whole(first, source) if lines > head.lines[0] else head
    if (table.names, table.units) != (head.names, head.units):  # a column that begins later
        lines, first, table = int(head.lines[-1]), content[:end], head
    sample = content[place:end]
    for dialect in _DIALECTS if sample else ():
        values = dialect.parsed(sample, head.values.shape[1])
        rows = head.values[head.lines > lines]
        if values is not None and np.array_equal(values, rows, equal_nan=True):
            return _Layout(table, first, lines, dialect)
    return _Layout(table, first, lines, None)
