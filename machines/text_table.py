"""Tables of numbers in text files, as oscilloscopes, finite-element tools and spreadsheets write them.

Lines are classified and counted as arrays of bytes, and numbers are parsed some ten thousand lines at a time; cells
are looked at one by one only in a block that holds something else than numbers.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.synchronous import FloatArray
from dqforge.machines.units import COMPOUNDS, SYMBOLS

_BoolArray = NDArray[np.bool_]
_IndexArray = NDArray[np.intp]
_Cells = NDArray[np.int8]

_MOST_BYTES = 200_000_000
_BLOCK = 20_000
_SAMPLE = 300
_NUMBER, _TEXT, _GARBLED = 0, 1, 2

# Delimiters inside quotes are no delimiters; they are kept as characters that no file uses until the cells are split.
_QUOTED = re.compile(r'"([^"\n]*)"')
_HIDDEN_COMMA = "\ue000"
_HIDE = str.maketrans(",;\t| ", "\ue000\ue001\ue002\ue003\ue004")
_SHOW = str.maketrans("\ue000\ue001\ue002\ue003\ue004", ",;\t| ")
_BLANKS = re.compile(r"[ \t]+")

_POINT_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?", re.ASCII)
_COMMA_NUMBER = re.compile(rf"[+-]?\d+(?:[,{_HIDDEN_COMMA}]\d+)?(?:[eEdD][+-]?\d+)?", re.ASCII)
# What follows a decimal comma, but no comma that parts cells: zeros before other digits, an exponent after many.
_LIKE_DECIMALS = re.compile(r"-0,|,0\d|,\d\d+[eEdD]")
_NAN = re.compile(r"[+-]?nan", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+,\d+")
_GARBLED_NUMBER = re.compile(r"(?=\D*\d)[+-]?[\d.,;'|\s]+(?:[eEdD][+-]?\d+)?")
_DATE = re.compile(r"\d{1,4}\.\d{1,2}\.\d{1,4}\.?(?:\s.*)?")
_FORTRAN_EXPONENT = re.compile(r"(?<=[0-9.])[dD](?=[+-]?[0-9])")

_UNDERSCORE_UNITS = frozenset({"A", "mA", "kA", "V", "mV", "kV", "s", "ms", "us", "ns", "rad", "deg", "rpm", "Hz"})
_UNDERSCORE_UNITS |= {"Wb", "mWb", "Vs", "mVs", "Nm", "W"}
_PHASES = ("ABC", "UVW")
_UNIT_WORDS = frozenset({"volt", "volts", "ampere", "amperes", "amp", "amps", "second", "seconds", "sec", "weber"})
_UNIT_WORDS |= {"degree", "degrees", "radian", "radians", "newtonmeter", "watt", "watts", "hertz", "sequence", "u/min"}
_TURNS = ("U", "r", "tr")
_UNIT_PARTS = re.compile(r"[\s/*·^().-]+|\d+")
_BRACKETED = re.compile(r"(.*?)(?:\[([^\[\]]*)\]|\(([^()]*)\))")
_SEPARATED = re.compile(r"(.+?)\s*(?:/|,|\sin\s)\s*(.+)")
_WRAPPED = re.compile(r"[\[(](.*)[\])]")
_OPENING = re.compile(r" (?=[\[(])")
_SCOPE_UNITS = re.compile(r"(horizontal|vertical) units?\W*[,;:=\t ]\s*(.*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of numbers as a text file holds it.

    Parameters
    ----------
    source:
        Name of the file.
    names:
        Header texts, stripped of units and quotes; 'column 1', ... by the place in the file where there is no header.
    units:
        Unit of each column as written ('A', 'mWb', 'ms'), '' where none is given.
    values:
        Shape (rows, columns), NaN where a cell is empty or says nan.
    lines:
        One-based line number of each row, shape (rows,).
    preamble:
        Lines of text before the header, and the texts that an oscilloscope writes beside the first rows.
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.intp]
    preamble: tuple[str, ...]


def read_table(content: bytes, source: str) -> TextTable:
    """Numbers, names and units of a text table; delimiter, decimal sign, encoding and header are found out.

    Columns without a number, and those that hold text in most rows, are left out; blank lines, rulers and comments
    (# or %) among the rows are passed over. Where no line has more than one comma and there is no header, the comma
    parts two columns if every line has one and none looks like decimals.

    Parameters
    ----------
    content:
        Bytes of the file: UTF-8, UTF-16 with a byte order mark, or Latin-1.
    source:
        Name of the file, for messages.

    Raises
    ------
    InputError
        The file is empty, too large or no text, has fewer than two rows of numbers, a row with another number of
        columns, or text where numbers belong; thousands separators are refused.
    """
    lines = decoded_text(content, source).split("\n")
    layout = _layout(lines, source)
    first = _first_row(layout, source)
    values, kinds = _parsed(layout, layout.rows_from(first))
    kept = _numeric_columns(values, kinds)
    start = _start(layout, first, kept, kinds)
    rows = layout.rows_from(start)
    if start != first:
        values, kinds = _parsed(layout, rows)
    header = _read_header(layout, start, kept)
    _refuse_text(layout, rows, kinds, header, source)
    _refuse_width(layout, start, rows, source)
    _refuse_decimal_commas(layout, start, kept, source)
    if rows.size < 2:
        raise InputError("the table has a single row of numbers; it needs two", source=source, line=int(start) + 1)
    preamble = header.preamble + _texts_beside(layout, rows, kinds, kept)
    units = header.units if any(header.units) else _scope_units(preamble, kept.size)
    return TextTable(source, header.names, units, np.ascontiguousarray(values[:, kept]), rows + 1, preamble)


@dataclass(frozen=True, slots=True)
class _Format:
    """How cells are parted and numbers written: '' parts nothing, ' ' is any run of blanks."""

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Cells of a line, stripped of blanks."""
        if self.delimiter == " ":
            return _BLANKS.split(line.strip(" \t"))
        return [cell.strip() for cell in (line.split(self.delimiter) if self.delimiter else [line])]

    def number(self, cell: str) -> float | None:
        """Value of a cell, NaN of an empty one, None of text."""
        if not cell or _NAN.fullmatch(cell):
            return math.nan
        if not (_POINT_NUMBER if self.decimal == "." else _COMMA_NUMBER).fullmatch(cell):
            return None
        value = float(re.sub("[dD]", "e", cell.replace(",", ".").replace(_HIDDEN_COMMA, ".")))
        return value if math.isfinite(value) else None

    def numeric(self, line: str) -> bool:
        """Whether all cells of a line are numbers or empty, with one number at least."""
        numbers = [self.number(cell) for cell in self.split(line)]
        return None not in numbers and any(number == number for number in numbers)  # noqa: PLR0124 - not NaN


@dataclass(frozen=True, slots=True)
class _Header:
    """What stands above the rows about some of the file's columns."""

    columns: _IndexArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]


# Of formats that explain the lines equally well, the first is taken.
_FORMATS = tuple(_Format(delimiter, decimal) for delimiter in ("", ";", "\t", "|", ",", " ") for decimal in ".,")
_COMMAS = _Format(",", ".")
_ONE_COLUMN = _Format("", ",")


@dataclass(frozen=True, slots=True)
class _Layout:
    """Lines of a file with what they are.

    `content` marks lines with more than blanks, rulers and comments, `plain` those among them that hold nothing but
    characters of numbers, `fits` those with as many cells as the rows, `width`; `long` have one more, empty, at the
    end.
    """

    lines: list[str]
    form: _Format
    width: int
    content: _BoolArray
    comment: _BoolArray
    plain: _BoolArray
    fits: _BoolArray
    long: _BoolArray

    def rows_from(self, start: int) -> _IndexArray:
        """Indices of the rows from a line on, up to the first that does not fit."""
        body = start + np.flatnonzero(self.content[start:])
        wrong = np.flatnonzero(~self.fits[body])
        return body[: wrong[0]] if wrong.size else body

    def said_above(self, line: int) -> _IndexArray:
        """Indices of the comments and lines of content above a line."""
        return np.flatnonzero(self.content[:line] | self.comment[:line])

    def numbers(self, line: int) -> list[float | None]:
        """Values of the cells of a line; None where text stands."""
        return [self.form.number(cell) for cell in self.form.split(self.lines[line])]


def decoded_text(content: bytes, source: str) -> str:
    """Text of a file with line feeds at the ends of lines, without quotes."""
    if len(content) > _MOST_BYTES:
        message = f"the file has {len(content) / 1e6:.0f} MB, at most {_MOST_BYTES / 1e6:.0f} MB can be read"
        raise InputError(f"{message}; save fewer columns or samples", source=source)
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if wide:
            raise InputError("the UTF-16 text is damaged; save the table again", source=source) from error
        text = content.decode("latin-1")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError("this is binary data, not text; export the table as CSV", source=source, line=line)
    if not text.strip():
        raise InputError("the file is empty; give a table with two rows of numbers at least", source=source, line=1)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if re.match(r"sep=.\n", text, re.IGNORECASE):  # an order to the spreadsheet
        text = text[text.index("\n") :]
    return _QUOTED.sub(lambda quoted: quoted[1].strip().translate(_HIDE), text) if '"' in text else text


def _holds(data: NDArray[np.uint8], starts: _IndexArray, characters: bytes, *, others: bool = False) -> _BoolArray:
    """Whether each line holds one of some characters, or one of all others but the end of the line."""
    wanted = np.full(256, others)
    wanted[list(characters)] = not others
    wanted[10] = False
    return np.logical_or.reduceat(wanted[data], starts)


def _layout(lines: list[str], source: str) -> _Layout:
    """Classify the lines, find out the format and the number of columns."""
    data, starts = _bytes(lines)
    comment = (data[starts] == ord("#")) | (data[starts] == ord("%"))
    content = ~comment & _holds(data, starts, b" \t,;|-=+:_*~", others=True)
    digits = content & _holds(data, starts, b"0123456789")
    plain = digits & ~_holds(data, starts, b"0123456789+-.,;|\t eEdDnNaA?", others=True)
    typical = np.flatnonzero(plain if plain.any() else digits)
    if not typical.size:
        raise _no_numbers(source)
    form = _format(lines, typical, (content, comment))
    # Lines are counted by single delimiters; the text of comments and titles keeps its blanks.
    blanks = form.delimiter == " "
    cells = [_BLANKS.sub(" ", line).strip(" ") for line in lines] if blanks else [line.rstrip(" ") for line in lines]
    counts, ends = _counts(cells, form.delimiter)
    widths = [int(np.bincount(number[typical]).argmax()) for number in (counts, counts - ends)]
    fitting = [(counts == width) | (counts - ends == width) for width in widths]
    best = int(np.argmax([np.count_nonzero(fit[typical]) for fit in fitting]))
    return _Layout(lines, form, widths[best], content, comment, plain, fitting[best], counts > widths[best])


def _bytes(lines: Sequence[str]) -> tuple[NDArray[np.uint8], _IndexArray]:
    """Characters as bytes ('?' for those beyond ASCII), and where each line starts."""
    data = np.frombuffer(("\n".join(lines) + "\n").encode("ascii", "replace"), np.uint8)
    return data, np.concatenate([[0], np.flatnonzero(data == 10)[:-1] + 1])


def _counts(lines: Sequence[str], delimiter: str) -> tuple[_IndexArray, _IndexArray]:
    """Number of cells of each line, and 1 for each that ends in a delimiter."""
    if not delimiter:
        return np.ones(len(lines), np.intp), np.zeros(len(lines), np.intp)
    data, starts = _bytes(lines)
    marks = data == ord(delimiter)
    last = np.append(starts[1:], data.size) - 2
    return np.add.reduceat(marks, starts, dtype=np.intp) + 1, (marks[last] & (last >= starts)).astype(np.intp)


def _format(lines: list[str], typical: _IndexArray, headers: Sequence[_BoolArray]) -> _Format:
    """The format that makes most numbers and least text of the typical lines.

    Parameters
    ----------
    lines:
        All lines of the file.
    typical:
        Indices of lines that seem to hold numbers.
    headers:
        Marks of two kinds of lines, either of which may hold the header.
    """
    places = np.unique(np.linspace(0, typical.size - 1, _SAMPLE).astype(np.intp))
    sample = [lines[place] for place in typical[places]]
    best = max(_FORMATS, key=lambda form: _score(form, sample))
    if best != _COMMAS:
        return best
    if not all(_COMMA_NUMBER.fullmatch(lines[place].strip()) for place in typical):
        return best
    above = [lines[place] for kind in headers for place in np.flatnonzero(kind[: typical[0]])[-1:]]
    if above:
        return best if any("," in line for line in above) else _ONE_COLUMN
    decimals = any("," not in lines[place] or _LIKE_DECIMALS.search(lines[place]) for place in typical)
    return _ONE_COLUMN if decimals else best


def _score(form: _Format, sample: Sequence[str]) -> int:
    """Numbers less texts in the lines with the usual number of cells, less the other lines.

    Digits around a semicolon, tab or bar tell that it parts cells; around a comma they may be decimals.
    """
    rows = [form.split(line) for line in sample]
    usual = int(np.bincount([len(row) for row in rows]).argmax())
    cells = [cell for row in rows if len(row) == usual for cell in row if cell]
    texts = [cell for cell in cells if form.number(cell) is None]
    unparted = sum(bool(re.search(r"[;|\t]", cell)) and _kind(cell) == _GARBLED for cell in texts)
    nans = sum(bool(_NAN.fullmatch(cell)) for cell in cells)
    return len(cells) - nans - 2 * len(texts) - 10 * unparted - sum(len(row) != usual for row in rows)


def _no_numbers(source: str) -> InputError:
    return InputError(
        "no line holds a row of numbers; write one row per line, cells parted by commas, semicolons, tabs or blanks",
        source=source,
        line=1,
    )


def _first_row(layout: _Layout, source: str) -> int:
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
            column for column, cell in enumerate(layout.form.split(layout.lines[line])) if _kind(cell) == _GARBLED
        ]
        if garbled:
            raise _garbled(layout, line, garbled[0], f"column {garbled[0] + 1}", source)
    raise _no_numbers(source)


def _parsed(layout: _Layout, rows: _IndexArray) -> tuple[FloatArray, _Cells]:
    """Values of rows, NaN where no number stands, and what the cells are, both of shape (rows, width)."""
    values = np.empty((rows.size, layout.width))
    kinds = np.zeros((rows.size, layout.width), np.int8)
    for begin in range(0, rows.size, _BLOCK):
        part = slice(begin, begin + _BLOCK)
        # A row may be given one empty cell more than the others: its delimiter at the end goes.
        texts = [layout.lines[row].rstrip(" ")[:-1] if layout.long[row] else layout.lines[row] for row in rows[part]]
        block = _block(texts, layout.form, layout.width)
        if block is None:
            values[part], kinds[part] = _cell_by_cell(texts, layout.form, layout.width)
        else:
            values[part] = block
    return values, kinds


def _block(texts: Sequence[str], form: _Format, width: int) -> FloatArray | None:
    """Values of lines that hold nothing but numbers and empty cells; None of others."""
    text = "\n".join(_BLANKS.sub(" ", line).strip(" ") for line in texts) if form.delimiter == " " else "\n".join(texts)
    if form.decimal == ",":
        marks = _HIDDEN_COMMA if form.delimiter == "," else f",{_HIDDEN_COMMA}"
        if "." in text or re.search(rf"(?<![0-9])[{marks}]|[{marks}](?![0-9])", text):
            return None
        text = text.replace(_HIDDEN_COMMA, ".")
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


def _cell_by_cell(texts: Sequence[str], form: _Format, width: int) -> tuple[FloatArray, _Cells]:
    """Values and kinds of cells of lines that hold texts, shapes (lines, width)."""
    cells = [cell for line in texts for cell in form.split(line)]
    found = [form.number(cell) for cell in cells]
    values = np.array([math.nan if number is None else number for number in found])
    kinds = [_kind(cell) if number is None else _NUMBER for cell, number in zip(cells, found, strict=True)]
    return values.reshape(-1, width), np.array(kinds, np.int8).reshape(-1, width)


def _kind(cell: str) -> int:
    """Whether a cell that is no number is text, or a number written in another way."""
    shown = cell.translate(_SHOW)
    return _GARBLED if _GARBLED_NUMBER.fullmatch(shown) and not _DATE.fullmatch(shown) else _TEXT


def _numeric_columns(values: FloatArray, kinds: _Cells) -> _IndexArray:
    """Indices of the columns with numbers: in at least half of the rows where they have text too."""
    numbers = np.count_nonzero(np.isfinite(values), axis=0)
    texts = np.any(kinds != _NUMBER, axis=0)
    kept = np.flatnonzero((numbers > 0) & (~texts | (2 * numbers >= len(values))))
    return kept if kept.size else np.flatnonzero(numbers > 0)


def _start(layout: _Layout, first: int, kept: _IndexArray, kinds: _Cells) -> int:
    """Line of the first row: before `first` where text stands beside numbers, behind it where text stands above."""
    clean = np.flatnonzero(~kinds[:, kept].any(axis=1))
    if clean.size and clean[0] > 0:
        return int(layout.rows_from(first)[clean[0]])
    for place in np.flatnonzero(layout.content[:first])[::-1]:
        if not _is_row(layout, int(place), kept):
            break
        first = int(place)
    return first


def _is_titled(layout: _Layout, line: int, kept: _IndexArray) -> bool:
    """Whether the line above another one is a header."""
    above = layout.said_above(line)
    return above.size > 0 and _titles(layout, int(above[-1]), kept, loosely=True) is not None


def _is_row(layout: _Layout, place: int, kept: _IndexArray) -> bool:
    """Whether a line above the rows is one of them: with other texts beside, or with a fault that must be told."""
    if not layout.fits[place]:
        return layout.form.numeric(layout.lines[place]) and _is_titled(layout, place, kept)
    cells = [layout.form.split(layout.lines[place])[column] for column in kept]
    numbers = [layout.form.number(cell) for cell in cells]
    known = [
        _kind(cell) == _GARBLED if number is None else math.isfinite(number)
        for cell, number in zip(cells, numbers, strict=True)
    ]
    if None not in numbers or known[0]:
        return any(known)
    return kept.size > 2 and 2 * sum(known) >= kept.size and _is_titled(layout, place, kept)


def _refuse_text(layout: _Layout, rows: _IndexArray, kinds: _Cells, header: _Header, source: str) -> None:
    """Raise the first text among numbers."""
    faults = kinds == _GARBLED
    faults[:, header.columns] |= kinds[:, header.columns] == _TEXT
    wrong = np.flatnonzero(faults.any(axis=1))
    if not wrong.size:
        return
    row, column = int(wrong[0]), int(np.flatnonzero(faults[wrong[0]])[0])
    line = int(rows[row])
    title = dict(zip(header.columns.tolist(), header.names, strict=True)).get(column, f"column {column + 1}")
    if kinds[row, column] == _GARBLED:
        raise _garbled(layout, line, column, title, source)
    message = f"{_shown(layout, line, column, title)} is not a number"
    raise InputError(f"{message}; write a number, nothing, or # before the line", source=source, line=line + 1)


def _garbled(layout: _Layout, line: int, column: int, title: str, source: str) -> InputError:
    """What to say of a number with another decimal sign than the others or with thousands separators."""
    message = f"{_shown(layout, line, column, title)} is not a number here"
    advice = "write one kind of decimal sign and no thousands separators"
    return InputError(f"{message}; {advice}", source=source, line=line + 1)


def _shown(layout: _Layout, line: int, column: int, title: str) -> str:
    """A cell and its place as they stand in a message."""
    cell = layout.form.split(layout.lines[line])[column].translate(_SHOW)
    return f"{cell[:40]!r} in {title if title == f'column {column + 1}' else f'column {title!r}'}"


def _refuse_width(layout: _Layout, start: int, rows: _IndexArray, source: str) -> None:
    """Raise the first line below the rows: it has another number of columns."""
    body = start + np.flatnonzero(layout.content[start:])
    if body.size == rows.size:
        return
    wrong = int(body[rows.size])
    line = layout.lines[wrong].translate(_SHOW)
    found = len(layout.form.split(layout.lines[wrong]))
    columns = "1 column" if found == 1 else f"{found} columns"
    message = f"this line has {columns}, the rows have {layout.width}: {line.strip()[:40]!r}"
    raise InputError(f"{message}; complete it or begin it with #", source=source, line=wrong + 1)


def _refuse_decimal_commas(layout: _Layout, start: int, kept: _IndexArray, source: str) -> None:
    """Raise a table whose commas both part the cells and stand before decimals, by a header with half the columns."""
    above = layout.said_above(start)
    if layout.form != _COMMAS or not above.size:
        return
    titles = layout.form.split(layout.lines[above[-1]].lstrip("#% "))
    cells = layout.form.split(layout.lines[start])
    halved = 2 * len(titles) == kept.size and all(cell.isdigit() for cell in cells[1 : layout.width : 2])
    if halved and (kept.size > 2 or _THOUSANDS.fullmatch(layout.lines[start].strip())):
        message = (
            f"{kept.size} cells below a header of {len(titles)}: commas seem to part cells and to stand before decimals"
        )
        raise InputError(f"{message}; part cells with semicolons", source=source, line=start + 1)


def _read_header(layout: _Layout, start: int, kept: _IndexArray) -> _Header:
    """Names and units of columns from the lines above the rows; the other lines there are the preamble."""
    above = layout.said_above(start).tolist()
    row = _units_row(layout, above[-1], kept) if above else None
    found = _title_line(layout, above[:-1] if row else above, kept)
    if row and not found and not all(_WRAPPED.fullmatch(cell) for cell in row if cell):
        row, found = None, _title_line(layout, above, kept)
    place, titles = found or (None, [""] * kept.size)
    used = {place, above[-1] if row else None}
    parts = [_name_and_unit(title.translate(_SHOW), titles) for title in titles]
    given = [_WRAPPED.sub(r"\1", cell).strip("-") for cell in row or [""] * kept.size]
    return _Header(
        kept,
        tuple(name or f"column {column + 1}" for (name, _), column in zip(parts, kept, strict=True)),
        tuple(unit or own for unit, (_, own) in zip(given, parts, strict=True)),
        tuple(layout.lines[line].translate(_SHOW).strip() for line in above if line not in used),
    )


def _title_line(layout: _Layout, above: Sequence[int], kept: _IndexArray) -> tuple[int, list[str]] | None:
    """The nearest line of content or comment that has a title for each column, and the titles."""
    nearest = {layout.comment[line]: line for line in above}
    for loosely in (False, True):
        for line in sorted(nearest.values(), reverse=True):
            titles = _titles(layout, line, kept, loosely=loosely)
            if titles:
                return line, titles
    return None


def _titles(layout: _Layout, line: int, kept: _IndexArray, *, loosely: bool) -> list[str] | None:
    """Titles that a line has for columns, None if it has too few, too many or numbers among them.

    A header may be parted in another way than the rows; `loosely` tries that too.
    """
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    joined = _OPENING.sub("", _BLANKS.sub(" ", text))
    splits = [layout.form.split(joined if layout.form.delimiter == " " else text)]
    if loosely and layout.width > 1:
        others = [[cell.strip() for cell in text.split(mark)] for mark in ("\t", ";", "|", ",", "  ")]
        splits += [cells for cells in [*others, joined.split()] if len(cells) == layout.width]
    for cells in ([cell.rstrip(",;") for cell in split] for split in splits):
        while cells and not cells[-1]:
            cells.pop()
        if not kept[-1] < len(cells) <= layout.width:
            continue
        titles = [cells[column] for column in kept]
        if any(titles) and all(layout.form.number(title) is None for title in titles if title):
            return titles
    return None


def _units_row(layout: _Layout, line: int, kept: _IndexArray) -> list[str] | None:
    """Cells of a line for columns if all are units, '-' or empty."""
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    cells = layout.form.split(text)
    if len(cells) <= kept[-1]:
        return None
    row = [cells[column].translate(_SHOW) for column in kept]
    plain = [_WRAPPED.sub(r"\1", cell) for cell in row]
    units = [_is_unit(cell) for cell in plain if cell not in ("", "-")]
    return row if units and all(units) else None


def _is_unit(text: str) -> bool:
    """Whether a text is a unit, or a product or quotient of units; U and r alone name a phase or a radius."""
    if text in _TURNS:
        return False
    parts = [part for part in _UNIT_PARTS.split(text) if part]
    known = all(part in SYMBOLS or part in COMPOUNDS or part.lower() in _UNIT_WORDS for part in parts)
    return (bool(parts) and known) or text.lower() in _UNIT_WORDS


def _name_and_unit(title: str, titles: Sequence[str]) -> tuple[str, str]:
    """Part a title such as 'id [A]', 'psi_d (mVs)', 'Time, s', 't / s' or 'id_A' into name and unit.

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
    phases = [f"{name}_{letter}" for group in _PHASES if unit in group for letter in group if letter != unit]
    if name and mark and unit in _UNDERSCORE_UNITS and not set(phases) & set(titles):
        return name, unit
    return title, ""


def _texts_beside(layout: _Layout, rows: _IndexArray, kinds: _Cells, kept: _IndexArray) -> tuple[str, ...]:
    """Texts in the columns left out, where few rows have any: one line of text per row."""
    left_out = np.setdiff1d(np.arange(layout.width), kept)
    lines = rows[np.any(kinds[:, left_out] == _TEXT, axis=1)]
    if lines.size > _SAMPLE or 2 * lines.size > rows.size:
        return ()
    cells = [[layout.form.split(layout.lines[line])[column] for column in left_out] for line in lines]
    return tuple(",".join(cell for cell in row if cell).translate(_SHOW) for row in cells)


def _scope_units(preamble: Sequence[str], count: int) -> tuple[str, ...]:
    """Units that an oscilloscope gives as 'Horizontal Units' and 'Vertical Units', '' where there are none."""
    found = {match[1].lower(): match[2] for match in map(_SCOPE_UNITS.match, preamble) if match}
    time = re.split(r"[,;\t]", found.get("horizontal", ""))[0].strip(" \"'")
    channels = [unit for part in re.split(r"[,;\t]", found.get("vertical", "")) if (unit := part.strip(" \"'"))]
    if len(channels) == 1:
        channels *= count - 1
    return (time, *channels) if len(channels) == count - 1 else (time, *[""] * (count - 1))
