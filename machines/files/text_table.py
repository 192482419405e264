"""A table of numbers with the headings that stand above it."""

from __future__ import annotations

import codecs
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import (
    BLANKS,
    COMMAS,
    GARBLED,
    HIDDEN_COMMA,
    MOST_BYTES,
    NUMBER,
    SAMPLE,
    SHOW,
    TEXT,
    Format,
    IndexArray,
    Layout,
    check_size,
    decoded_text,
    kind_of,
    layout_of,
    no_numbers,
)
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import COMPOUNDS, SYMBOLS


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of numbers as a text file holds it.

    Args:
        source: Name of the file.
        names: Header texts, stripped of units and quotes; 'column 1', ... by the place in the file
            where there is no header.
        units: Unit of each column as written ('A', 'mWb', 'ms'), '' where none is given.
        values: Shape (rows, columns), NaN where a cell is empty or says nan.
        lines: One-based line number of each row, shape (rows,).
        preamble: Lines of text before the header, and the texts that an oscilloscope writes beside
            the first rows.
        others: Names of columns that were not asked for.
        empty: Names of columns in which no row has anything.
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.intp]
    preamble: tuple[str, ...]
    others: tuple[str, ...] = ()
    empty: tuple[str, ...] = ()


# Names, units and settings that stand above or beside the rows of a text table.

_UNDERSCORE_UNITS = frozenset(
    {"A", "mA", "kA", "V", "mV", "kV", "s", "ms", "us", "ns", "rad", "deg", "rpm", "Hz"}
)
_UNDERSCORE_UNITS |= {"Wb", "mWb", "Vs", "mVs", "Nm", "W"}
_PHASES = ("ABC", "UVW")
_UNIT_WORDS = frozenset(
    {"volt", "volts", "ampere", "amperes", "amp", "amps", "second", "seconds", "sec", "weber"}
)
_UNIT_WORDS |= {
    "degree",
    "degrees",
    "radian",
    "radians",
    "newtonmeter",
    "watt",
    "watts",
    "hertz",
    "sequence",
    "u/min",
}
_OTHERWISE = ("U", "r", "tr", "F")
_UNIT_PARTS = re.compile(r"[\s/*·^().-]+|\d+")
_BRACKETED = re.compile(r"(.*?)(?:\[([^\[\]]*)\]|\(([^()]*)\))")
_SEPARATED = re.compile(r"(.+?)\s*(?:/|,|\sin\s)\s*(.+)")
_WRAPPED = re.compile(r"[\[(](.*)[\])]")
_OPENING = re.compile(r" (?=[\[(])")
_CHANNEL_UNIT = re.compile(r"\b[A-Za-z]+\d+:([^\s,;:]+)")
_SCOPE_UNITS = re.compile(r"(horizontal|vertical) units?\W*[,;:=\t ]\s*(.*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Header:
    """What stands above the rows about some of the file's columns."""

    columns: IndexArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]


def read_header(layout: Layout, start: int, kept: IndexArray) -> Header:
    """Names and units of columns from the lines above the rows.

    The other lines there are the preamble.
    """
    above = layout.said_above(start).tolist()
    row = _units_row(layout, above[-1], kept) if above else None
    found = _title_line(layout, above[:-1] if row else above, kept)
    if row and not found and not all(_WRAPPED.fullmatch(cell) for cell in row if cell):
        row, found = None, _title_line(layout, above, kept)
    place, titles = found or (None, [""] * kept.size)
    used = {place, above[-1] if row else None}
    settings = _settings_beside(
        layout, [line for line in (place, above[-1] if row else None) if line is not None], kept
    )
    parts = [_name_and_unit(title.translate(SHOW), titles) for title in titles]
    given = [_WRAPPED.sub(r"\1", cell).strip("-") for cell in row or [""] * kept.size]
    return Header(
        kept,
        tuple(
            name or f"column {column + 1}" for (name, _), column in zip(parts, kept, strict=True)
        ),
        tuple(unit or own for unit, (_, own) in zip(given, parts, strict=True)),
        (
            *(layout.lines[line].translate(SHOW).strip() for line in above if line not in used),
            *settings,
        ),
    )


def _settings_beside(layout: Layout, lines: Sequence[int], kept: IndexArray) -> list[str]:
    """What a title and perhaps a unit line hold beside the columns: 'Increment,2e-5' or 'tInc =
    2e-5'.
    """
    if layout.form.delimiter == " ":
        return []
    rows = [layout.form.split(layout.lines[line].lstrip("#% ")) for line in lines]
    others = sorted(set(range(max(map(len, rows), default=0))) - set(kept.tolist()))
    texts = [
        ",".join(row[column] for row in rows if column < len(row) and row[column])
        for column in others
    ]
    return [text.translate(SHOW) for text in texts if any(map(str.isdigit, text))]


def _title_line(
    layout: Layout, above: Sequence[int], kept: IndexArray
) -> tuple[int, list[str]] | None:
    """The nearest line of content or comment that has a title for each column, and the titles."""
    nearest = {layout.comment[line]: line for line in above}
    for loosely in (False, True):
        for line in sorted(nearest.values(), reverse=True):
            titles = titles_in(layout, line, kept, loosely=loosely)
            if titles:
                return line, titles
    return None


def titles_in(layout: Layout, line: int, kept: IndexArray, *, loosely: bool) -> list[str] | None:
    """Titles that a line has for columns, None if it has too few, too many or numbers among them.

    A header may be parted in another way than the rows; `loosely` tries that too.
    """
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    joined = _OPENING.sub("", BLANKS.sub(" ", text))
    splits = [layout.form.split(joined if layout.form.delimiter == " " else text)]
    if loosely and layout.width > 1:
        others = [
            [cell.strip() for cell in text.split(mark)] for mark in ("\t", ";", "|", ",", "  ")
        ]
        splits += [cells for cells in [*others, joined.split()] if len(cells) == layout.width]
    for cells in ([cell.rstrip(",;") for cell in split] for split in splits):
        # Some write settings behind the titles ('t0 = -1e-3').
        while cells and (not cells[-1] or (len(cells) > layout.width and "=" in cells[-1])):
            cells.pop()
        if not kept[-1] < len(cells) <= layout.width:
            continue
        titles = [cells[column] for column in kept]
        if any(titles) and all(layout.form.number(title) is None for title in titles if title):
            return titles
    return None


def _units_row(layout: Layout, line: int, kept: IndexArray) -> list[str] | None:
    """Cells of a line for columns if all are units, '-' or empty."""
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    cells = layout.form.split(text)
    if len(cells) <= kept[-1]:
        return None
    row = [cells[column].translate(SHOW) for column in kept]
    plain = [_WRAPPED.sub(r"\1", cell) for cell in row]
    units = [_is_unit(cell) for cell in plain if cell not in ("", "-")]
    return row if units and all(units) else None


def _is_unit(text: str) -> bool:
    """Whether a text is a unit, or a product or quotient of units; alone U is
    a phase, r a radius and F a force.
    """
    if text in _OTHERWISE:
        return False
    parts = [part for part in _UNIT_PARTS.split(text) if part]
    known = all(
        part in SYMBOLS or part in COMPOUNDS or part.lower() in _UNIT_WORDS for part in parts
    )
    return (bool(parts) and known) or text.lower() in _UNIT_WORDS


def _name_and_unit(title: str, titles: Sequence[str]) -> tuple[str, str]:
    """Part a title such as 'id [A]', 'psi_d (mVs)', 'Time, s', 't / s' or
    'id_A' into name and unit.

    In 'I_A' beside 'I_B' or 'U_V' beside 'U_W' the letter is a phase.
    """
    title = " ".join(title.strip(" \"'").split())
    bracketed = _BRACKETED.fullmatch(title)
    if bracketed and (bracketed[2] is not None or _is_unit(bracketed[3])):
        return bracketed[1].rstrip(" _,/"), (bracketed[2] or bracketed[3] or "").strip(" -")
    separated = _SEPARATED.fullmatch(title)
    if separated and _is_unit(separated[2]):
        return separated[1], separated[2]
    name, mark, unit = title.rpartition("_")
    phases = [
        f"{name}_{letter}"
        for group in _PHASES
        if unit in group
        for letter in group
        if letter != unit
    ]
    if name and mark and unit in _UNDERSCORE_UNITS and not set(phases) & set(titles):
        return name, unit
    return title, ""


def texts_beside(
    layout: Layout, rows: IndexArray, kinds: Cells, kept: IndexArray
) -> tuple[str, ...]:
    """Texts in the columns left out, where few rows have any: one line of text per row."""
    left_out = np.setdiff1d(np.arange(layout.width), kept)
    lines = rows[np.any(kinds[:, left_out] == TEXT, axis=1)]
    if lines.size > SAMPLE or 2 * lines.size > rows.size:
        return ()
    cells = [
        [layout.form.split(layout.lines[line])[column] for column in left_out] for line in lines
    ]
    return tuple(",".join(cell for cell in row if cell).translate(SHOW) for row in cells)


def scope_units(preamble: Sequence[str], count: int) -> tuple[str, ...]:
    """Units that an oscilloscope gives as 'Horizontal Units' and 'Vertical Units',
    '' where there are none.
    """
    found = {match[1].lower(): match[2] for match in map(_SCOPE_UNITS.match, preamble) if match}
    time = re.split(r"[,;\t]", found.get("horizontal", ""))[0].strip(" \"'")
    vertical = found.get("vertical", "")
    channels = _CHANNEL_UNIT.findall(vertical) or re.split(r"[,;\t]", vertical)
    channels = [unit for part in channels if (unit := part.strip(" \"'"))]
    if len(channels) == 1:
        channels *= count - 1
    return (time, *channels) if len(channels) == count - 1 else (time, *[""] * (count - 1))


# Tables of numbers in text files, as oscilloscopes, finite-element tools
# and spreadsheets write them.

_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+,\d+")


def read_table(
    content: bytes,
    source: str,
    progress: Progress | None = None,
    *,
    wanted: Wanted | None = None,
    most_bytes: int = MOST_BYTES,
) -> TextTable:
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
        wanted: Says of the name and the unit of a column whether it is kept; where it keeps none
            all are, for whoever names them.
        most_bytes: The largest size.

    Raises:
        InputError: The file is empty, too large (``most_bytes``, 40 million numbers kept) or no
            text, has fewer than two rows of numbers, a row with another number of columns, or text
            where numbers belong; thousands separators are refused.
    """
    if len(content) > LARGE:
        check_size(content, source, most_bytes)
        return read_in_blocks(content, source, _read_whole, progress, wanted)
    return _with_columns(_read_whole(content, source), wanted)


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
    bare = np.flatnonzero(np.isnan(values).all(axis=0) & (kinds == NUMBER).all(axis=0))
    return TextTable(
        source,
        header.names,
        units,
        np.ascontiguousarray(values[:, kept]),
        rows + 1,
        preamble,
        empty=read_header(layout, start, bare).names if bare.size else (),
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


# Large text tables, read some megabytes at a time, so that their memory is that of their numbers.
#
# The lines above the rows and the first rows tell the layout. Blocks of nothing but numbers are
# parsed by NumPy; any other is read behind those first lines as a small table of its own, with the
# same rules and the same refusals.

LARGE = 8_000_000  # Bytes from which on a table is read in blocks.
MOST_NUMBERS = 40_000_000  # Numbers that a table may hold: 320 MB.
_HEAD = 1 << 18
_BLOCK = 1 << 21
_FIRST_ROWS = 100
_PLAIN = re.compile(rb"[0-9+\-.eE,;\t \r\nnNaA]*")
_ENDS = re.compile(rb"[,;\t ]+(?=\r?\n|\r?$)")
_MARKS = np.frombuffer(b",;\t ", np.uint8)
Progress = Callable[[float], None]
Wanted = Callable[[str, str], bool]
_Whole = Callable[[bytes, str], "TextTable"]


@dataclass(frozen=True, slots=True)
class _Dialect:
    """How plain rows are written: the mark between cells (None for blanks) and the decimal sign."""

    mark: str | None
    decimal: bytes

    def parsed(
        self, block: bytes, columns: int, kept: IndexArray | None = None
    ) -> FloatArray | None:
        """Numbers of a block of whole lines, shape (rows, columns), or those of columns ``kept``.

        None where it is not as plain as that.
        """
        if not _PLAIN.fullmatch(block) or (self.decimal == b"," and b"." in block):
            return None
        text = block.replace(b",", b".") if self.decimal == b"," else block
        rows = text.count(b"\n") + (not text.endswith(b"\n"))
        try:
            data = np.frombuffer(text, np.uint8)
            ends = np.flatnonzero(data == ord("\n"))
            before = data[ends - 1 - (data[ends - 1] == ord("\r"))]
            # A mark at the end of a line parts nothing; rarely is there one.
            if rows > ends.size or np.isin(before, _MARKS).any():
                text = _ENDS.sub(b"", text)
            # Where columns are left out nobody counts the cells of a line.
            some = kept is not None and self.mark is not None and self._fits(text, columns)
            values = np.loadtxt(
                io.BytesIO(text),
                delimiter=self.mark,
                ndmin=2,
                comments=None,
                usecols=kept.tolist() if some and kept is not None else None,
            )
        except ValueError:
            return None
        # An empty line would shift the numbers of all lines below.
        if values.shape != (rows, kept.size if some and kept is not None else columns):
            return None
        found = values if some or kept is None else values[:, kept]
        return None if np.isinf(found).any() else found

    def _fits(self, text: bytes, columns: int) -> bool:
        """Whether each line has as many cells as there are columns."""
        data = np.frombuffer(text, np.uint8)
        marks = np.cumsum(data == ord(self.mark or " "), dtype=np.int32)
        ends = np.append(np.flatnonzero(data == ord("\n")), data.size - 1)
        ends = ends[:-1] if text.endswith(b"\n") else ends
        return bool(np.all(np.diff(marks[ends], prepend=0) == columns - 1))


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
        self, block: bytes, above: int, source: str, read_whole: _Whole, kept: IndexArray
    ) -> tuple[FloatArray, np.ndarray]:
        """Values of columns ``kept`` and line numbers of a block with ``above`` lines above it in
        the file.
        """
        table = self.table
        if self.dialect is not None:
            values = self.dialect.parsed(block, table.values.shape[1], kept)
            if values is not None:
                return values, np.arange(above + 1, above + 1 + len(values), dtype=np.intp)
        if not block.strip():
            return np.empty((0, kept.size)), np.empty(0, np.intp)
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
        return found.values[new][:, kept], found.lines[new] - self.lines + above


def read_in_blocks(
    content: bytes,
    source: str,
    read_whole: _Whole,
    progress: Progress | None = None,
    wanted: Wanted | None = None,
) -> TextTable:
    """Table of a large text, as `read_whole` would read it, in little more
    memory than its numbers take.

    Args:
        content: Bytes of the file.
        source: Its name, for messages.
        read_whole: What reads a small table.
        progress: Told the share that is done.
        wanted: As of `read_table`.

    Raises:
        InputError: As `read_whole`, with the line in the file; or the table holds more than
            `MOST_NUMBERS`.
    """
    content = _with_line_feeds(content, source)
    layout = _layout(content, source, read_whole)
    if layout is None:
        return _with_columns(read_whole(content, source), wanted)
    kept = _kept(layout.table, wanted)
    place, above, columns = len(layout.first), layout.lines, kept.size
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
    rows = layout.table.values[:, kept], layout.table.lines
    while True:
        values[count : count + rows[1].size], lines[count : count + rows[1].size] = rows
        count += rows[1].size
        if progress is not None:
            progress(place / len(content))
        if place >= len(content):
            break
        end = content.find(b"\n", place + _BLOCK) + 1 or len(content)
        block = content[place:end]
        rows = layout.rows(block, above, source, read_whole, kept)
        place, above = end, above + block.count(b"\n")
    return replace(_with_columns(layout.table, wanted), values=values[:count], lines=lines[:count])


def _kept(table: TextTable, wanted: Wanted | None) -> IndexArray:
    """Places of the wanted columns; of all where none is."""
    pairs = zip(table.names, table.units, strict=True)
    found = [place for place, pair in enumerate(pairs) if wanted is not None and wanted(*pair)]
    return np.array(found or range(len(table.names)), dtype=np.intp)


def _with_columns(table: TextTable, wanted: Wanted | None) -> TextTable:
    """A table with the wanted columns alone, the names of the others beside them."""
    kept = _kept(table, wanted).tolist()
    return replace(
        table,
        names=tuple(table.names[place] for place in kept),
        units=tuple(table.units[place] for place in kept),
        values=np.ascontiguousarray(table.values[:, kept]),
        others=tuple(name for place, name in enumerate(table.names) if place not in kept),
    )


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


# Numbers of the rows of a text table, parsed some ten thousand lines at a time.
#
# Cells are looked at one by one only in a block that holds something else than numbers.

Cells = NDArray[np.int8]


BLOCK = 20_000


_FORTRAN_EXPONENT = re.compile(r"(?<=[0-9.])[dD](?=[+-]?[0-9])")


def parsed_rows(layout: Layout, rows: IndexArray) -> tuple[FloatArray, Cells]:
    """Values of rows, NaN where no number stands, and what the cells are, both of shape (rows,
    width).
    """
    values = np.empty((rows.size, layout.width))
    kinds = np.zeros((rows.size, layout.width), np.int8)
    for begin in range(0, rows.size, BLOCK):
        part = slice(begin, begin + BLOCK)
        # A row may be given one empty cell more than the others: its delimiter at the end goes.
        texts = [
            layout.lines[row].rstrip(" ")[:-1] if layout.long[row] else layout.lines[row]
            for row in rows[part]
        ]
        block = _block(texts, layout.form, layout.width)
        if block is None:
            values[part], kinds[part] = _cell_by_cell(texts, layout.form, layout.width)
        else:
            values[part] = block
    return values, kinds


def _block(texts: Sequence[str], form: Format, width: int) -> FloatArray | None:
    """Values of lines that hold nothing but numbers and empty cells; None of others."""
    text = (
        "\n".join(BLANKS.sub(" ", line).strip(" ") for line in texts)
        if form.delimiter == " "
        else "\n".join(texts)
    )
    if form.decimal == ",":
        marks = HIDDEN_COMMA if form.delimiter == "," else f",{HIDDEN_COMMA}"
        if "." in text or re.search(rf"(?<![0-9])[{marks}]|[{marks}](?![0-9])", text):
            return None
        text = text.replace(HIDDEN_COMMA, ".")
        text = text if form.delimiter == "," else text.replace(",", ".")
    if "_" in text or not text.isascii():  # Python's numbers have both
        return None
    if "d" in text or "D" in text:
        text = _FORTRAN_EXPONENT.sub("e", text)
    mark = form.delimiter or "\n"
    text = mark + text.replace("\n", mark) + mark
    text = re.sub(rf"{re.escape(mark)} *(?={re.escape(mark)})", f"{mark}nan", text)
    cells = text[1:-1].split(mark)
    try:
        values = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
    return None if np.isinf(values).any() else values.reshape(-1, width)


def _cell_by_cell(texts: Sequence[str], form: Format, width: int) -> tuple[FloatArray, Cells]:
    """Values and kinds of cells of lines that hold texts, shapes (lines, width)."""
    cells = [cell for line in texts for cell in form.split(line)]
    found = [form.number(cell) for cell in cells]
    values = np.array([math.nan if number is None else number for number in found])
    kinds = [
        kind_of(cell) if number is None else NUMBER
        for cell, number in zip(cells, found, strict=True)
    ]
    return values.reshape(-1, width), np.array(kinds, np.int8).reshape(-1, width)


def numeric_columns(values: FloatArray, kinds: Cells) -> IndexArray:
    """Indices of the columns with numbers: in at least half of the rows where they have text
    too.
    """
    numbers = np.count_nonzero(np.isfinite(values), axis=0)
    texts = np.any(kinds != NUMBER, axis=0)
    kept = np.flatnonzero((numbers > 0) & (~texts | (2 * numbers >= len(values))))
    return kept if kept.size else np.flatnonzero(numbers > 0)
