"""Tables of numbers in text files, as oscilloscopes, finite-element tools
and spreadsheets write them.
"""

from __future__ import annotations

import math
import re

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.files.text_blocks import LARGE, Progress, read_in_blocks
from dqforge.machines.files.text_cells import Cells, numeric_columns, parsed_rows
from dqforge.machines.files.text_formats import (
    COMMAS,
    GARBLED,
    SHOW,
    TEXT,
    IndexArray,
    Layout,
    check_size,
    decoded_text,
    kind_of,
    layout_of,
    no_numbers,
)
from dqforge.machines.files.text_headers import (
    Header,
    read_header,
    scope_units,
    texts_beside,
    titles_in,
)
from dqforge.machines.files.text_table import TextTable

_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+,\d+")


def read_table(content: bytes, source: str, progress: Progress | None = None) -> TextTable:
    """Numbers, names and units of a text table.

    Delimiter, decimal sign, encoding and header are found out.

    Columns without a number, and those that hold text in most rows, are left out; blank lines,
    rulers and comments (# or %) among the rows are passed over. Where no line has more than one
    comma and there is no header, the comma parts two columns if every line has one and none looks
    like decimals.

    Args:
        content: Bytes of the file: UTF-8, UTF-16 with a byte order mark, or Latin-1.
        source: Name of the file, for messages.
        progress: Told the share of a large table that is read.

    Raises:
        InputError: The file is empty, too large (256 MB, 40 million numbers) or no text, has fewer
            than two rows of numbers, a row with another number of columns, or text where numbers
            belong; thousands separators are refused.
    """
    if len(content) > LARGE:
        check_size(content, source)
        return read_in_blocks(content, source, _read_whole, progress)
    return _read_whole(content, source)


def _read_whole(content: bytes, source: str) -> TextTable:
    """Table of a text that is classified and parsed in one piece."""
    lines = decoded_text(content, source).split("\n")
    layout = layout_of(lines, source)
    first = _first_row(layout, source)
    values, kinds = parsed_rows(layout, layout.rows_from(first))
    kept = numeric_columns(values, kinds)
    start = _start(layout, first, kept, kinds)
    rows = layout.rows_from(start)
    if start != first:
        values, kinds = parsed_rows(layout, rows)
    header = read_header(layout, start, kept)
    _refuse_text(layout, rows, kinds, header, source)
    _refuse_width(layout, start, rows, source)
    _refuse_decimal_commas(layout, start, kept, source)
    if rows.size < 2:
        raise InputError(
            "the table has a single row of numbers; it needs two",
            source=source,
            line=int(start) + 1,
        )
    preamble = header.preamble + texts_beside(layout, rows, kinds, kept)
    units = header.units if any(header.units) else scope_units(preamble, kept.size)
    return TextTable(
        source, header.names, units, np.ascontiguousarray(values[:, kept]), rows + 1, preamble
    )


def _first_row(layout: Layout, source: str) -> int:
    """The first line that is nothing but numbers, or has a number where none is."""
    candidates = np.flatnonzero(layout.plain & layout.fits).tolist()
    for line in candidates:
        if layout.form.numeric(layout.lines[line]):
            return int(line)
    for line in np.flatnonzero(layout.content & layout.fits).tolist():
        if any(number is not None and math.isfinite(number) for number in layout.numbers(line)):
            return int(line)
    for line in candidates:
        garbled = [
            column
            for column, cell in enumerate(layout.form.split(layout.lines[line]))
            if kind_of(cell) == GARBLED
        ]
        if garbled:
            raise _garbled(layout, line, garbled[0], f"column {garbled[0] + 1}", source)
    raise no_numbers(source)


def _start(layout: Layout, first: int, kept: IndexArray, kinds: Cells) -> int:
    """Line of the first row: before `first` where text stands beside numbers,
    behind it where text stands above.
    """
    clean = np.flatnonzero(~kinds[:, kept].any(axis=1))
    if clean.size and clean[0] > 0:
        return int(layout.rows_from(first)[clean[0]])
    for place in np.flatnonzero(layout.content[:first])[::-1]:
        if not _is_row(layout, int(place), kept):
            break
        first = int(place)
    return first


def _is_titled(layout: Layout, line: int, kept: IndexArray) -> bool:
    """Whether the line above another one is a header."""
    above = layout.said_above(line)
    return above.size > 0 and titles_in(layout, int(above[-1]), kept, loosely=True) is not None


def _is_row(layout: Layout, place: int, kept: IndexArray) -> bool:
    """Whether a line above the rows is one of them: with other texts beside,
    or with a fault that must be told.
    """
    if not layout.fits[place]:
        return layout.form.numeric(layout.lines[place]) and _is_titled(layout, place, kept)
    cells = [layout.form.split(layout.lines[place])[column] for column in kept]
    numbers = [layout.form.number(cell) for cell in cells]
    known = [
        kind_of(cell) == GARBLED if number is None else math.isfinite(number)
        for cell, number in zip(cells, numbers, strict=True)
    ]
    if None not in numbers or known[0]:
        return any(known)
    return kept.size > 2 and 2 * sum(known) >= kept.size and _is_titled(layout, place, kept)


def _refuse_text(
    layout: Layout, rows: IndexArray, kinds: Cells, header: Header, source: str
) -> None:
    """Raise the first text among numbers."""
    faults = kinds == GARBLED
    faults[:, header.columns] |= kinds[:, header.columns] == TEXT
    wrong = np.flatnonzero(faults.any(axis=1))
    if not wrong.size:
        return
    row, column = int(wrong[0]), int(np.flatnonzero(faults[wrong[0]])[0])
    line = int(rows[row])
    title = dict(zip(header.columns.tolist(), header.names, strict=True)).get(
        column, f"column {column + 1}"
    )
    if kinds[row, column] == GARBLED:
        raise _garbled(layout, line, column, title, source)
    message = f"{_shown(layout, line, column, title)} is not a number"
    raise InputError(
        f"{message}; write a number, nothing, or # before the line", source=source, line=line + 1
    )


def _garbled(layout: Layout, line: int, column: int, title: str, source: str) -> InputError:
    """What to say of a number with another decimal sign than the others or
    with thousands separators.
    """
    message = f"{_shown(layout, line, column, title)} is not a number here"
    advice = "write one kind of decimal sign and no thousands separators"
    return InputError(f"{message}; {advice}", source=source, line=line + 1)


def _shown(layout: Layout, line: int, column: int, title: str) -> str:
    """A cell and its place as they stand in a message."""
    cell = layout.form.split(layout.lines[line])[column].translate(SHOW)
    return f"{cell[:40]!r} in {title if title == f'column {column + 1}' else f'column {title!r}'}"


def _refuse_width(layout: Layout, start: int, rows: IndexArray, source: str) -> None:
    """Raise the first line below the rows: it has another number of columns."""
    body = start + np.flatnonzero(layout.content[start:])
    if body.size == rows.size:
        return
    wrong = int(body[rows.size])
    line = layout.lines[wrong].translate(SHOW)
    found = len(layout.form.split(layout.lines[wrong]))
    columns = "1 column" if found == 1 else f"{found} columns"
    message = f"this line has {columns}, the rows have {layout.width}: {line.strip()[:40]!r}"
    raise InputError(f"{message}; complete it or begin it with #", source=source, line=wrong + 1)


def _refuse_decimal_commas(layout: Layout, start: int, kept: IndexArray, source: str) -> None:
    """Raise a table whose commas both part the cells and stand before decimals,
    by a header with half the columns.
    """
    above = layout.said_above(start)
    if layout.form != COMMAS or not above.size:
        return
    titles = layout.form.split(layout.lines[above[-1]].lstrip("#% "))
    cells = layout.form.split(layout.lines[start])
    halved = 2 * len(titles) == kept.size and all(
        cell.isdigit() for cell in cells[1 : layout.width : 2]
    )
    if halved and (kept.size > 2 or _THOUSANDS.fullmatch(layout.lines[start].strip())):
        message = (
            f"{kept.size} cells below a header of {len(titles)}: commas seem to part cells and to "
            "stand before decimals"
        )
        raise InputError(f"{message}; part cells with semicolons", source=source, line=start + 1)
