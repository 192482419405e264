"""What the lines of a text table are: encoding, delimiter and decimal sign, rows, comments and
texts; and the named arrays that files of tables and of arrays become.

Lines are classified and counted as arrays of bytes; cells are looked at one by
one only in a few of them.
"""

from __future__ import annotations

import codecs
import importlib
import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

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


def check_size(content: bytes, source: str, most: int = MOST_BYTES) -> None:
    """Refuse a text of more than ``most`` bytes; raises `InputError`."""
    if len(content) > most:
        message = (
            f"the file has {len(content) / 1e6:.4g} MB, at most {most / 1e6:.0f} MB can be read"
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


# Named arrays, which every file of a flux map is made of before anybody asks what they mean, and
# their limits.

MOST_POINTS = 4_000_000  # Values of one array of a file.
_MOST_LISTED = 20


@dataclass(frozen=True, slots=True)
class NamedArray:
    """One array of a file: where it stands, the last part of that, its values and its
    declared unit ('' if none).

    ``lines`` are the one-based lines of a text table that the values of a column stand in,
    shape (K,).
    """

    path: str
    name: str
    values: NDArray[Any]
    unit: str = ""
    lines: NDArray[np.intp] | None = None

    @property
    def group(self) -> str:
        """Where the array stands without its name."""
        return self.path.removesuffix(self.name)

    @property
    def labels(self) -> tuple[str, str, str]:
        """What a user may call the array."""
        return self.path, self.name, f"{self.name} [{self.unit}]"

    @property
    def title(self) -> str:
        """Path with shape, or with what the array holds instead of numbers."""
        path = f"{self.path} [{self.unit}]" if self.unit else self.path
        return f"{path} {self.values.shape}" if self.numeric else f"{path} ({self.held})"

    @property
    def numeric(self) -> bool:
        """Whether the array holds numbers."""
        return self.values.dtype.kind in "iufc"

    @property
    def held(self) -> str:
        """What the array holds, if not numbers."""
        names = {
            "O": "Python objects, cells or references",
            "U": "text",
            "S": "text",
            "b": "truth values",
        }
        return names.get(self.values.dtype.kind, "records")


def listed(arrays: Sequence[NamedArray]) -> str:
    """Names and shapes of arrays, in one line."""
    more = f" and {len(arrays) - _MOST_LISTED} more" if len(arrays) > _MOST_LISTED else ""
    return (
        ", ".join(array.title for array in arrays[:_MOST_LISTED]) + more
        if arrays
        else "no arrays at all"
    )


def check_bytes(total: int, source: str) -> None:
    """Refuse arrays that take too much memory once decoded, as those of a small archive may."""
    if total > MOST_BYTES:
        message = f"the arrays take more than {MOST_BYTES / 1e6:g} MB once decoded"
        raise InputError(f"{message}; save those of the map alone, or a coarser one", source=source)


@contextmanager
def reading(form: str, source: str) -> Iterator[None]:
    """Around a library's reader, which raises anything for a damaged file:
    that becomes one line for the user.

    Raises:
        InputError: What was raised within; of one that the library did not know as such its reason,
            and what to do.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"cannot read this {form} file ({reason}); save it again", source=source
        ) from error


# Arrays of NPZ archives and HDF5 files; what they claim is counted before anything is decoded.

# Bytes of one chunk of an HDF5 dataset, which is decoded whole even where a single value of it is
# asked for.
_MOST_CHUNK = 32_000_000


def arrays_of_npz(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of an NPZ archive; Python objects in it are never loaded."""
    found = []
    with reading("NPZ", source):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            check_bytes(sum(member.file_size for member in archive.infolist()), source)
            for member in archive.infolist():
                _check_claim(archive, member)
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    values = arrays[name]
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    values = np.empty((), dtype=object)
                if isinstance(values, np.ndarray):  # a member that is no array comes as bytes
                    found.append(NamedArray(name, name, values))
    return found


def _check_claim(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Refuse a member whose header claims more numbers than it has bytes:
    they would be allocated first.
    """
    with archive.open(member) as stream:
        if stream.read(6) != b"\x93NUMPY":
            return
        version = tuple(stream.read(2))
        form = np.lib.format
        read = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
        shape, _, kind = read(stream)
        if not kind.hasobject and math.prod(shape) * kind.itemsize > member.file_size:
            raise ValueError(f"{member.filename} claims more values than it holds")


def arrays_of_hdf5(content: bytes, source: str) -> list[NamedArray]:
    """Datasets of an HDF5 or MATLAB 7.3 file, wherever they stand in its tree."""
    try:
        h5py = importlib.import_module("h5py")
    except ImportError as error:
        name = "MAT 7.3" if source.lower().endswith(".mat") else "HDF5"
        message = f"reading {name} needs h5py; install it with: pip install dqforge[h5]"
        raise InputError(message, source=source) from error
    found: list[NamedArray] = []
    matlab, total = content[:10] == b"MATLAB 7.3", 0

    def visit(path: str, node: Any) -> None:
        nonlocal total
        # A dataset whose bytes lie in another file is not this file's;
        # '#refs#' are the contents of MATLAB's cells.
        if not isinstance(node, h5py.Dataset) or node.shape is None or path.startswith("#"):
            return
        if node.external or node.is_virtual or "MATLAB_empty" in node.attrs:
            return
        if _belongs(node):
            total += node.size * node.dtype.itemsize
            check_bytes(total, source)
            _check_chunk(path, node, source)
        values = _dataset(node)
        mirrored = matlab or "MATLAB_class" in node.attrs
        unit = node.attrs.get("units", node.attrs.get("unit", ""))
        shown = path.replace("/", ".") if matlab else path
        found.append(
            NamedArray(
                shown, path.rpartition("/")[2], values.T if mirrored else values, _text(unit)
            )
        )

    with reading("HDF5", source), h5py.File(io.BytesIO(content), "r") as file:
        file.visititems(visit)
    return found


def _numeric(node: Any) -> bool:
    """Whether an HDF5 dataset holds numbers, complex ones as pairs included."""
    return node.dtype.kind in "iufc" or node.dtype.names == ("real", "imag")


def _belongs(node: Any) -> bool:
    """Whether an HDF5 dataset may belong to a map and is worth decoding."""
    text = _text(node.attrs.get("MATLAB_class", "")) == "char"
    return _numeric(node) and not text and node.size <= MOST_POINTS


def _check_chunk(path: str, node: Any, source: str) -> None:
    size = math.prod(node.chunks or ()) * node.dtype.itemsize
    if size > _MOST_CHUNK:
        message = (
            f"{path} lies in chunks of {size / 1e6:.0f} MB, at most {_MOST_CHUNK / 1e6:g} MB can "
            "be read"
        )
        raise InputError(f"{message}; save it in smaller chunks or in one piece", source=source)


def _dataset(node: Any) -> NDArray[Any]:
    """Values of an HDF5 dataset; a stand-in of its shape without memory where
    they cannot belong to a map.
    """
    if _text(node.attrs.get("MATLAB_class", "")) == "char":
        return np.broadcast_to(np.array("", dtype="U1"), node.shape)
    if not _belongs(node):
        return np.broadcast_to(np.zeros((), dtype=float if _numeric(node) else object), node.shape)
    values: NDArray[Any] = np.asarray(node[()])
    if values.dtype.names:
        values = values["real"] + 1j * values["imag"]
    return values


def _text(attribute: Any) -> str:
    """An HDF5 attribute as text, '' where it is none."""
    if isinstance(attribute, np.ndarray) and attribute.size == 1:
        attribute = attribute.item()
    if isinstance(attribute, bytes):
        return attribute.decode("utf-8", errors="replace").strip()
    return attribute.strip() if isinstance(attribute, str) else ""


# Arrays of MATLAB 4 and 5 files; those of version 7.3 are HDF5.

_MATRIX, _COMPRESSED = 14, 15

# Kinds of elements of a MATLAB 5 file, with numpy's names of the numbers.
_STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}

# Classes of its variables, and the flag of complex ones.
_STRUCT, _TEXT, _NUMERIC, _COMPLEX = 2, 4, range(6, 16), 0x800


def arrays_of_mat4(content: bytes, source: str) -> list[NamedArray]:
    """Variables of a MATLAB 4 file."""
    from scipy.io import loadmat

    if 0 not in content[:4]:  # the first number, 0 to 4052, of the format that has no mark
        raise InputError("this is no MATLAB 4, 5 or 7.3 file; save it again", source=source)
    check_bytes(len(content), source)  # it holds numbers as they are, of 8 bytes at most
    with reading("MATLAB", source):
        variables = loadmat(io.BytesIO(content))
    return [
        NamedArray(name, name, values)
        for name, values in variables.items()
        if isinstance(values, np.ndarray)
    ]


def arrays_of_mat5(content: bytes, source: str) -> list[NamedArray]:
    """Variables of a MATLAB 5 file (MathWorks, "MAT-File Format"), fields of
    structs with dotted paths.
    """
    # Not by scipy: damaged files crash its reader (segmentation fault in 1.17),
    # and it inflates whatever there is.
    order = "<" if content[126:128] == b"IM" else ">"
    found: list[NamedArray] = []
    total = 0
    with reading("MATLAB", source):
        for kind, element in _elements(memoryview(content)[128:], order):
            variables = [(kind, element)]
            if kind == _COMPRESSED:
                inflated = zlib.decompressobj().decompress(element, MOST_BYTES + 1 - total)
                total += len(inflated)
                check_bytes(total, source)
                variables = list(_elements(memoryview(inflated), order))
            for inner, variable in variables:
                if inner == _MATRIX:
                    found += _variable(variable, order)
    return found


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Kinds and bytes of the elements of a MATLAB 5 file that stand one behind the other."""
    place = 0
    while place < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start, pad = place + 8, 0 if kind == _COMPRESSED else -size % 8
        if kind >> 16:  # up to four bytes stand within the tag
            kind, size, start, pad = kind & 0xFFFF, kind >> 16, place + 4, 4 - (kind >> 16)
        place = start + size + pad
        if start + size > len(content) or pad < 0:
            raise ValueError("it is cut off or damaged")
        yield kind, content[start : start + size]


def _variable(
    content: memoryview, order: str, path: str = "", name: str = ""
) -> Iterator[NamedArray]:
    """Array of a MATLAB 5 matrix, or all arrays within a struct.

    Cells, objects and sparse matrices hold no map.
    """
    parts = list(_elements(content, order))
    if not parts:
        return
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    form, shape = flags & 0xFF, _numbers(parts[1], order)
    name = name or bytes(parts[2][1]).decode("latin-1")
    path = path or name
    if form == _STRUCT and np.all(shape == 1):
        length, names = int(_numbers(parts[3], order)[0]), bytes(parts[4][1])
        for k, (_, field) in enumerate(parts[5:]):
            title = names[k * length : (k + 1) * length].split(b"\0")[0].decode("latin-1")
            yield from _variable(field, order, f"{path}.{title}", title)
    elif form == _TEXT:
        yield NamedArray(path, name, np.broadcast_to(np.array("", dtype="U1"), shape))
    elif form in _NUMERIC:
        values = _numbers(parts[3], order)
        if flags & _COMPLEX:
            values = values + 1j * _numbers(parts[4], order)
        yield NamedArray(path, name, values.reshape(shape, order="F"))


def _numbers(part: tuple[int, memoryview], order: str) -> NDArray[Any]:
    """Numbers of a MATLAB 5 element, shape (K,)."""
    return np.frombuffer(part[1], dtype=order + _STORED[part[0]])
