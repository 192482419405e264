"""What the lines of a text table are: encoding, delimiter and decimal sign, rows,
comments and texts.

Lines are classified and counted as arrays of bytes; cells are looked at one by
one only in a few of them.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

BoolArray = NDArray[np.bool_]


IndexArray = NDArray[np.intp]


MOST_BYTES = 256_000_000


SAMPLE = 300


NUMBER, TEXT, GARBLED = 0, 1, 2


# Delimiters inside quotes are no delimiters; they are kept as characters that no file uses
# until the cells are split.
_QUOTED = re.compile(r'"([^"\n]*)"')


HIDDEN_COMMA = "\ue000"


_HIDE = str.maketrans(",;\t| ", "\ue000\ue001\ue002\ue003\ue004")


SHOW = str.maketrans("\ue000\ue001\ue002\ue003\ue004", ",;\t| ")


BLANKS = re.compile(r"[ \t]+")


_POINT_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?", re.ASCII)


_COMMA_NUMBER = re.compile(rf"[+-]?\d+(?:[,{HIDDEN_COMMA}]\d+)?(?:[eEdD][+-]?\d+)?", re.ASCII)


# What follows a decimal comma, but no comma that parts cells: zeros before other digits,
# an exponent after many.
_LIKE_DECIMALS = re.compile(r"-0,|,0\d|,\d\d+[eEdD]")


_NAN = re.compile(r"[+-]?nan", re.IGNORECASE)


_GARBLED_NUMBER = re.compile(r"(?=\D*\d)[+-]?[\d.,;'|\s]+(?:[eEdD][+-]?\d+)?")


_DATE = re.compile(r"\d{1,4}\.\d{1,2}\.\d{1,4}\.?(?:\s.*)?")


@dataclass(frozen=True, slots=True)
class Format:
    """How cells are parted and numbers written: '' parts nothing, ' ' is any run of blanks."""

    delimiter: str
    decimal: str

    def split(self, line: str) -> list[str]:
        """Cells of a line, stripped of blanks."""
        if self.delimiter == " ":
            return BLANKS.split(line.strip(" \t"))
        return [cell.strip() for cell in (line.split(self.delimiter) if self.delimiter else [line])]

    def number(self, cell: str) -> float | None:
        """Value of a cell, NaN of an empty one, None of text."""
        if not cell or _NAN.fullmatch(cell):
            return math.nan
        if not (_POINT_NUMBER if self.decimal == "." else _COMMA_NUMBER).fullmatch(cell):
            return None
        value = float(re.sub("[dD]", "e", cell.replace(",", ".").replace(HIDDEN_COMMA, ".")))
        return value if math.isfinite(value) else None

    def numeric(self, line: str) -> bool:
        """Whether all cells of a line are numbers or empty, with one number at least."""
        numbers = [self.number(cell) for cell in self.split(line)]
        return None not in numbers and any(number == number for number in numbers)  # noqa: PLR0124 - not NaN


# Of formats that explain the lines equally well, the first is taken.
_FORMATS = tuple(
    Format(delimiter, decimal) for delimiter in ("", ";", "\t", "|", ",", " ") for decimal in ".,"
)


COMMAS = Format(",", ".")


_ONE_COLUMN = Format("", ",")


@dataclass(frozen=True, slots=True)
class Layout:
    """Lines of a file with what they are.

    `content` marks lines with more than blanks, rulers and comments, `plain` those among them that
    hold nothing but characters of numbers, `fits` those with as many cells as the rows, `width`;
    `long` have one more, empty, at the end.
    """

    lines: list[str]
    form: Format
    width: int
    content: BoolArray
    comment: BoolArray
    plain: BoolArray
    fits: BoolArray
    long: BoolArray

    def rows_from(self, start: int) -> IndexArray:
        """Indices of the rows from a line on, up to the first that does not fit."""
        body = start + np.flatnonzero(self.content[start:])
        wrong = np.flatnonzero(~self.fits[body])
        return body[: wrong[0]] if wrong.size else body

    def said_above(self, line: int) -> IndexArray:
        """Indices of the comments and lines of content above a line."""
        return np.flatnonzero(self.content[:line] | self.comment[:line])

    def numbers(self, line: int) -> list[float | None]:
        """Values of the cells of a line; None where text stands."""
        return [self.form.number(cell) for cell in self.form.split(self.lines[line])]


def check_size(content: bytes, source: str) -> None:
    """Refuse a text of more than `MOST_BYTES`; raises `InputError`."""
    if len(content) > MOST_BYTES:
        message = (
            f"the file has {len(content) / 1e6:.4g} MB, at most {MOST_BYTES / 1e6:.0f} MB can be "
            "read"
        )
        raise InputError(f"{message}; save fewer columns or samples", source=source)


def decoded_text(content: bytes, source: str) -> str:
    """Text of a file with line feeds at the ends of lines, without quotes."""
    check_size(content, source)
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if wide:
            raise InputError(
                "the UTF-16 text is damaged; save the table again", source=source
            ) from error
        text = content.decode("latin-1")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(
            "this is binary data, not text; export the table as CSV", source=source, line=line
        )
    if not text.strip():
        raise InputError(
            "the file is empty; give a table with two rows of numbers at least",
            source=source,
            line=1,
        )
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if re.match(r"sep=.\n", text, re.IGNORECASE):  # an order to the spreadsheet
        text = text[text.index("\n") :]
    return (
        _QUOTED.sub(lambda quoted: quoted[1].strip().translate(_HIDE), text)
        if '"' in text
        else text
    )


def _holds(
    data: NDArray[np.uint8], starts: IndexArray, characters: bytes, *, others: bool = False
) -> BoolArray:
    """Whether each line holds one of some characters, or one of all others but the end of the
    line.
    """
    wanted = np.full(256, others)
    wanted[list(characters)] = not others
    wanted[10] = False
    return np.logical_or.reduceat(wanted[data], starts)


def layout_of(lines: list[str], source: str) -> Layout:
    """Classify the lines, find out the format and the number of columns."""
    data, starts = _bytes(lines)
    comment = (data[starts] == ord("#")) | (data[starts] == ord("%"))
    content = ~comment & _holds(data, starts, b" \t,;|-=+:_*~", others=True)
    digits = content & _holds(data, starts, b"0123456789")
    plain = digits & ~_holds(data, starts, b"0123456789+-.,;|\t eEdDnNaA?", others=True)
    typical = np.flatnonzero(plain if plain.any() else digits)
    if not typical.size:
        raise no_numbers(source)
    form = _format(lines, typical, (content, comment))
    # Lines are counted by single delimiters; the text of comments and titles keeps its blanks.
    blanks = form.delimiter == " "
    cells = (
        [BLANKS.sub(" ", line).strip(" ") for line in lines]
        if blanks
        else [line.rstrip(" ") for line in lines]
    )
    counts, ends = _counts(cells, form.delimiter)
    widths = [int(np.bincount(number[typical]).argmax()) for number in (counts, counts - ends)]
    fitting = [(counts == width) | (counts - ends == width) for width in widths]
    best = int(np.argmax([np.count_nonzero(fit[typical]) for fit in fitting]))
    return Layout(
        lines, form, widths[best], content, comment, plain, fitting[best], counts > widths[best]
    )


def _bytes(lines: Sequence[str]) -> tuple[NDArray[np.uint8], IndexArray]:
    """Characters as bytes ('?' for those beyond ASCII), and where each line starts."""
    data = np.frombuffer(("\n".join(lines) + "\n").encode("ascii", "replace"), np.uint8)
    return data, np.concatenate([[0], np.flatnonzero(data == 10)[:-1] + 1])


def _counts(lines: Sequence[str], delimiter: str) -> tuple[IndexArray, IndexArray]:
    """Number of cells of each line, and 1 for each that ends in a delimiter."""
    if not delimiter:
        return np.ones(len(lines), np.intp), np.zeros(len(lines), np.intp)
    data, starts = _bytes(lines)
    marks = data == ord(delimiter)
    last = np.append(starts[1:], data.size) - 2
    return np.add.reduceat(marks, starts, dtype=np.intp) + 1, (
        marks[last] & (last >= starts)
    ).astype(np.intp)


def _format(lines: list[str], typical: IndexArray, headers: Sequence[BoolArray]) -> Format:
    """The format that makes most numbers and least text of the typical lines.

    Args:
        lines: All lines of the file.
        typical: Indices of lines that seem to hold numbers.
        headers: Marks of two kinds of lines, either of which may hold the header.
    """
    places = np.unique(np.linspace(0, typical.size - 1, SAMPLE).astype(np.intp))
    sample = [lines[place] for place in typical[places]]
    best = max(_FORMATS, key=lambda form: _score(form, sample))
    if best != COMMAS:
        return best
    if not all(_COMMA_NUMBER.fullmatch(lines[place].strip()) for place in typical):
        return best
    above = [lines[place] for kind in headers for place in np.flatnonzero(kind[: typical[0]])[-1:]]
    if above:
        return best if any("," in line for line in above) else _ONE_COLUMN
    decimals = any(
        "," not in lines[place] or _LIKE_DECIMALS.search(lines[place]) for place in typical
    )
    return _ONE_COLUMN if decimals else best


def _score(form: Format, sample: Sequence[str]) -> int:
    """Numbers less texts in the lines with the usual number of cells, less the other lines.

    Digits around a semicolon, tab or bar tell that it parts cells;
    around a comma they may be decimals.
    """
    rows = [form.split(line) for line in sample]
    usual = int(np.bincount([len(row) for row in rows]).argmax())
    cells = [cell for row in rows if len(row) == usual for cell in row if cell]
    texts = [cell for cell in cells if form.number(cell) is None]
    unparted = sum(bool(re.search(r"[;|\t]", cell)) and kind_of(cell) == GARBLED for cell in texts)
    nans = sum(bool(_NAN.fullmatch(cell)) for cell in cells)
    return (
        len(cells) - nans - 2 * len(texts) - 10 * unparted - sum(len(row) != usual for row in rows)
    )


def no_numbers(source: str) -> InputError:
    """Error of a text without a table."""
    return InputError(
        "no line holds a row of numbers; write one row per line, cells parted by commas, "
        "semicolons, tabs or blanks",
        source=source,
        line=1,
    )


def kind_of(cell: str) -> int:
    """Whether a cell that is no number is text, or a number written in another way."""
    shown = cell.translate(SHOW)
    return GARBLED if _GARBLED_NUMBER.fullmatch(shown) and not _DATE.fullmatch(shown) else TEXT
