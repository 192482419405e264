"""Text layouts of flux maps that are no plain table of columns: the table of layouts,
and what tells each of them.

A layout is recognised by what its tool always writes; what none recognises is read as a table with
a column per quantity.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.files.text_formats import decoded_text
from dqforge.machines.flux_map_files.coordinates import turning
from dqforge.machines.flux_map_files.femag import femag_arrays, is_femag
from dqforge.machines.flux_map_files.names import recognised
from dqforge.machines.flux_map_files.twin_builder import is_twin_builder, twin_builder_arrays
from dqforge.machines.flux_map_files.units import split_name
from dqforge.machines.records import dataclass

# Size up to which a text is looked through for another layout than columns, cell by cell.
_MOST_BYTES = 16_000_000
_Rows = Sequence[Sequence[str]]
_HEAD = 400
_LEAST = 4
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"^([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)$", re.ASCII)
_MARKS = (";", "\t", ",", " ")


@dataclass(frozen=True, slots=True)
class TextLayout:
    """One layout of text files.

    ``is_it`` tells it from the cells of the first lines, ``read`` makes
    arrays of those of all lines.
    """

    name: str
    is_it: Callable[[_Rows], bool]
    read: Callable[[_Rows, str], list[NamedArray]]


def arrays_of_layout(content: bytes, source: str) -> list[NamedArray] | None:
    """Arrays of a text in one of the special layouts, None for a plain table of columns."""
    if is_femag(content, source):
        return femag_arrays(content, source)
    if len(content) > _MOST_BYTES:
        return None
    text = decoded_text(content, source)
    if is_twin_builder(text):
        return twin_builder_arrays(text, source)
    lines = text.split("\n")
    head = _cells(lines[:_HEAD])
    for layout in LAYOUTS:
        if layout.is_it(head):
            return layout.read(_cells(lines), source)
    return None


def _cells(lines: Sequence[str]) -> list[list[str]]:
    """Cells of lines, parted by the mark that gives most lines the same number of cells.

    Decimal points throughout.
    """
    sample = [line for line in lines[:_HEAD] if any(character.isdigit() for character in line)]
    best, most = " ", 0
    for mark in _MARKS:
        widths = [len(_split(line, mark)) for line in sample]
        usual = max(set(widths), key=lambda width: (widths.count(width), width), default=1)
        if usual > 1 and widths.count(usual) > most:
            best, most = mark, widths.count(usual)
    rows = [_split(line, best) for line in lines]
    if best == ",":
        return rows
    return [[_DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in row] for row in rows]


def _split(line: str, mark: str) -> list[str]:
    """Cells of a line without blanks around; a mark at its end ends the last cell."""
    if mark == " ":
        return line.split()
    cells = [cell.strip() for cell in line.split(mark)]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell))


def _numeric(cells: Sequence[str]) -> bool:
    """Whether all cells are numbers, nan or empty, with one number at least."""
    known = [_is_number(cell) for cell in cells]
    return any(known) and all(
        ok or cell.lower() in ("", "nan") for ok, cell in zip(known, cells, strict=True)
    )


def _numbers(cells: Sequence[str]) -> list[float]:
    return [
        float(re.sub("[dD]", "e", cell)) if _is_number(cell) else float("nan") for cell in cells
    ]


def _quantity(title: str) -> tuple[str, ...]:
    """What a title stands for as the name of an array."""
    name, unit = split_name(title)
    return recognised(NamedArray(title, name, np.zeros(2), unit))


# One row per quantity, one column per case, as JMAG exports case tables.
def _is_case_table(head: _Rows) -> bool:
    """Whether the first cells of rows name quantities whose numbers stand beside them."""
    titles = [
        row[0]
        for row in head
        if len(row) > _LEAST and _numeric(row[-_LEAST:]) and not _numeric(row[:1])
    ]
    found = {quantity for title in titles for quantity in _quantity(title)}
    return len(found & {"i_d", "i_q", "i", "beta", "psi_d", "psi_q", "l_d", "l_q"}) >= _LEAST


def _case_arrays(rows: _Rows, source: str) -> list[NamedArray]:
    """Rows of a case table as arrays; a unit may stand in the cell behind the title."""
    found: list[NamedArray] = []
    for number, row in enumerate(rows, 1):
        if len(row) <= _LEAST or not row[0] or _numeric(row[:1]):
            continue
        beside = next((k for k in range(1, len(row)) if _is_number(row[k])), len(row))
        if beside == len(row) or not _numeric(row[beside:]):
            continue
        name, unit = split_name(row[0])
        unit = unit or next((re.sub(r"[\[\]()]", "", cell) for cell in row[1:beside] if cell), "")
        values = np.array(_numbers(row[beside:]))
        if found and values.size != found[0].values.size:
            message = f"this row has {values.size} cases, the first one {found[0].values.size}"
            raise InputError(f"{message}; complete it", source=source, line=number)
        found.append(NamedArray(name, name, values, unit, np.full(values.size, number)))
    return found


# One matrix per quantity below a line with its title, as the UltraZohm writes them,
# with or without axes of their own.
def _titled_blocks(rows: Sequence[Sequence[str]]) -> list[tuple[str, int, list[Sequence[str]]]]:
    """Title, first line and rows of the blocks of numbers that stand below a line
    with a single cell of text.
    """
    blocks: list[tuple[str, int, list[Sequence[str]]]] = []
    title, body, begin = "", list[Sequence[str]](), 0
    for number, row in enumerate([*rows, ["end"]], 1):
        alone = [cell for cell in row if cell]
        if (len(row) > 1 and _numeric(row)) or (len(row) > 2 and _numeric(row[1:])):
            body, begin = [*body, row], begin or number
        elif alone:
            if title and len(body) >= 2:
                blocks.append((title, begin, body))
            title, body, begin = (alone[0] if len(alone) == 1 else ""), [], 0
    return blocks


def _is_blocks(head: _Rows) -> bool:
    titles = [
        row[0] for row in head if len([cell for cell in row if cell]) == 1 and not _numeric(row)
    ]
    found = {quantity for title in titles for quantity in _quantity(title)}
    return {"psi_d", "psi_q"} <= found


def _block_arrays(rows: _Rows, source: str) -> list[NamedArray]:
    """Blocks as arrays; where no block holds the currents, they stand above and
    beside the flux linkages.
    """
    blocks = [
        (title, begin, body) for title, begin, body in _titled_blocks(rows) if _quantity(title)
    ]
    known = {quantity for title, *_ in blocks for quantity in _quantity(title)}
    if "i_d" not in known:
        return oriented(
            [a for title, begin, body in blocks for a in matrix_arrays(title, body, begin, source)]
        )
    found = []
    for title, begin, body in blocks:
        unit = split_name(title)[1]
        quantity = _quantity(title)[0]
        found.append(NamedArray(title, quantity, _rectangle(body, begin, source), unit))
    return found


def _rectangle(body: Sequence[Sequence[str]], begin: int, source: str) -> FloatArray:
    """Numbers of a block, shape (rows, columns)."""
    width = len(body[0])
    for number, row in enumerate(body, begin):
        if len(row) != width:
            message = f"this row of a matrix has {len(row)} numbers, the first one {width}"
            raise InputError(f"{message}; complete it", source=source, line=number)
    return np.array([_numbers(row) for row in body])


# One matrix: i_d across, i_q down. Which of the two is which, the flux linkages tell later.
def _is_matrix(head: _Rows) -> bool:
    """Whether a single matrix with its axes stands in a file: one more cell than
    numbers in its first row.
    """
    rows = [row for row in head if any(row) and not row[0].startswith(("#", "%"))]
    if len(rows) <= _LEAST or len(rows[0]) <= _LEAST or _is_number(rows[0][0]):
        return False
    return _numeric(rows[0][1:]) and all(
        len(row) == len(rows[0]) and _numeric(row) for row in rows[1:_LEAST]
    )


def _matrix_file(rows: _Rows, source: str) -> list[NamedArray]:
    """A matrix of a file of its own; its quantity is what the file is given for."""
    content = [
        (number, row)
        for number, row in enumerate(rows, 1)
        if any(row) and not row[0].startswith(("#", "%"))
    ]
    return matrix_arrays("matrix", [row for _, row in content], content[0][0], source)


def matrix_arrays(
    title: str, body: Sequence[Sequence[str]], begin: int, source: str
) -> list[NamedArray]:
    """Both axes and the values of a matrix whose first row and first column are the currents."""
    for number, row in enumerate(body[1:], begin + 1):
        if len(row) != len(body[0]):
            message = f"this row of the matrix has {len(row)} cells, the first one {len(body[0])}"
            raise InputError(f"{message}; complete it", source=source, line=number)
    name, unit = split_name(title)
    quantity = _quantity(title)
    across, down = (
        np.array(_numbers(body[0][1:])),
        np.array([_numbers(row[:1])[0] for row in body[1:]]),
    )
    values = np.array([_numbers(row[1:]) for row in body[1:]])
    return [
        NamedArray("i_d", "i_d", across),
        NamedArray("i_q", "i_q", down),
        NamedArray(title, quantity[0] if quantity else name, values, unit),
    ]


def oriented(arrays: list[NamedArray]) -> list[NamedArray]:
    """Arrays of matrices whose axes are exchanged where the flux linkages
    tell that i_q stands across.
    """
    found: dict[str, NamedArray] = {}
    for array in arrays:
        for quantity in recognised(array):
            found.setdefault(quantity, array)
    if not {"i_d", "i_q", "psi_d", "psi_q"} <= set(found):
        return arrays
    across, down, psi_d, psi_q = (found[name].values for name in ("i_d", "i_q", "psi_d", "psi_q"))
    if not psi_d.shape == psi_q.shape == (down.size, across.size) or min(psi_d.shape) < 2:
        return arrays
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # infinities are for others to judge, as NaN are
        steps = np.outer(np.sign(np.diff(down)), np.sign(np.diff(across)))
        exchanged = np.nansum(turning(psi_d, psi_q) * steps) > 0.0
    if not exchanged:
        return arrays
    other = {"i_d": "i_q", "i_q": "i_d"}
    return [
        replace(
            array,
            name=other[array.name],
            path=array.path.removesuffix(array.name) + other[array.name],
        )
        if array.name in other
        else array
        for array in arrays
    ]


# Layouts of cells in the order in which they are tried, after those of Twin Builder and FEMAG.
LAYOUTS = (
    TextLayout("case table", _is_case_table, _case_arrays),
    TextLayout("blocks", _is_blocks, _block_arrays),
    TextLayout("matrix", _is_matrix, _matrix_file),
)
