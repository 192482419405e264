"""Text layouts of flux maps that are no plain table of columns: the table of layouts,
and what tells each of them.

A layout is recognised by what its tool always writes; what none recognises is read as a table with
a column per quantity.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray, decoded_text
from dqforge.machines.flux_maps.coordinates import turning
from dqforge.machines.flux_maps.map_names import recognised, split_name
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


# Flux maps in the result files of FEMAG (.BCH, .BATCH): the tables of its Psid-Psiq
# and Ld-Lq identifications.
#
# A table begins with a line of titles, then one of units in brackets; its groups of rows are parted
# by empty lines. Flux linkages and torques are given per mm of armature length, which stands above.

_LENGTH = re.compile(
    r"Armature Length\s*\[mm\]\s*:\s*(\d+\.?\d*(?:[eE][+-]?\d{1,2})?)", re.IGNORECASE
)


_PAIRS = re.compile(r"Number of Pole pairs\s*:\s*(\d{1,3})\b", re.IGNORECASE)


_FEMAG_HEAD = 4000


_TITLES = (
    ("i_d", r"(?:curr\.?\s*)?id"),
    ("i_q", r"(?:curr\.?\s*)?iq"),
    ("i", r"wdg\.?-curr\.?"),
    ("beta", r"angle\s*beta"),
    ("psi_d", r"psi_d"),
    ("psi_q", r"psi_q"),
    ("torque", r"torque(?:\s*fe)?"),
)


_CARTESIAN, _POLAR = ("i_d", "i_q", "psi_d", "psi_q"), ("i", "beta", "psi_d", "psi_q")


_SAME_ROWS = 1e-3


@dataclass(frozen=True, slots=True)
class _Table:
    """Columns that are known of one table, their units and the lines of its rows.

    Whether it says r.m.s. values.
    """

    columns: dict[str, FloatArray]
    units: dict[str, str]
    lines: FloatArray
    rms: bool


def is_femag(content: bytes, source: str) -> bool:
    """Whether a file is one of FEMAG, by its suffix or by its first lines."""
    suffix = PurePath(source).suffix.lower()
    head = content[:_FEMAG_HEAD].lower()
    return suffix in (".bch", ".batch") or (b"femag" in head and b"[***" in head)


def femag_arrays(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of the map in a file, in A, Vs and N m of the whole armature length, and its pole
    pairs.

    `_rms` in their names where so.
    """
    text = content.decode("utf-8", "replace").replace("\r\n", "\n")
    tables = _tables(text.split("\n"))
    whole = [
        table
        for form in (_CARTESIAN, _POLAR)
        for table in tables
        if set(form) <= set(table.columns)
    ]
    if not whole:
        ran = _calculation(text)
        raise InputError(
            f"this file of FEMAG{ran} holds no table of a Psid-Psiq or Ld-Lq identification; "
            "run one of them and name its file",
            source=source,
        )
    best = max(whole, key=lambda table: (len(table.lines), "torque" in table.columns))
    columns, units = dict(best.columns), dict(best.units)
    if "torque" not in columns:  # it stands in a further table over the same currents
        for other in tables:
            if "torque" in other.columns and _same_currents(best, other):
                columns["torque"], units["torque"] = other.columns["torque"], other.units["torque"]
                break
    found = _LENGTH.search(text)
    length = float(found[1]) if found else None
    names = {"i": "i", "beta": "beta"}
    arrays = []
    for name, given in columns.items():
        values, unit = given, units[name]
        if "/mm" in unit:
            if length is None:
                raise InputError(
                    "values are per mm and the file does not say its Armature Length", source=source
                )
            values, unit = values * length, unit.replace("/mm", "")
        shown = names.get(name, name) + (
            "_rms" if best.rms and name not in ("beta", "torque") else ""
        )
        arrays.append(NamedArray(shown, shown, values, unit, best.lines.astype(np.intp)))
    if pairs := _PAIRS.search(text):
        arrays.append(NamedArray("pole_pairs", "pole_pairs", np.array([float(pairs[1])])))
    return arrays


def _calculation(text: str) -> str:
    """What FEMAG says that it calculated, in words to follow the file."""
    found = re.search(r"^\*{3,}[ \t]*([^*\n]{1,60}?)[ \t]*\*{3}", text, re.MULTILINE)
    return f" ({found[1]})" if found else ""


def _same_currents(one: _Table, other: _Table) -> bool:
    """Whether two tables have the same currents row by row."""
    return all(
        name in other.columns
        and other.columns[name].shape == one.columns[name].shape
        and np.allclose(other.columns[name], one.columns[name], rtol=_SAME_ROWS, atol=_SAME_ROWS)
        for name in ("i_d", "i_q")
        if name in one.columns
    )


def _tables(lines: Sequence[str]) -> list[_Table]:
    """All tables below titles that name a flux linkage or torque."""
    found, rms = [], False
    for number, line in enumerate(lines[:-1]):
        if line.startswith(("Function:", "I, Psi")):
            rms = "rms" in line.lower()
        titles = _columns(line) if "Psi_" in line or "Torque" in line else {}
        if titles and "[" in lines[number + 1]:
            table = _table(lines, number, titles, rms)
            if table is not None:
                found.append(table)
    return found


def _columns(line: str) -> dict[str, int]:
    """Place of each known quantity in a line of titles parted by tabs or several blanks."""
    places = {}
    for place, title in enumerate(re.split(r"\s*\t\s*|\s{2,}", line.strip())):
        for quantity, pattern in _TITLES:
            if quantity not in places and re.fullmatch(pattern, title.strip(), re.IGNORECASE):
                places[quantity] = place
    if {"i_d", "i_q"} <= set(places):
        return {name: place for name, place in places.items() if name not in ("i", "beta")}
    return places if {"i", "beta"} <= set(places) else {}


def _table(lines: Sequence[str], number: int, titles: dict[str, int], rms: bool) -> _Table | None:
    """Rows below titles and units, up to the first line of text."""
    units = re.findall(r"\[\s*([^\]]*?)\s*\]", lines[number + 1])
    rows, places = [], []
    for below in range(number + 2, len(lines)):
        cells = lines[below].split()
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            break
        if not row:
            continue
        if len(row) <= max(titles.values()):
            break
        rows.append(row[: max(titles.values()) + 1])
        places.append(below + 1)
    if not rows or len(units) <= max(titles.values()):
        return None
    values = np.array(rows)
    return _Table(
        {name: values[:, place] for name, place in titles.items()},
        {name: units[place].replace("Degr", "deg") for name, place in titles.items()},
        np.array(places, dtype=float),
        rms,
    )


# Equivalent circuits that Motor-CAD and Maxwell extract for Ansys Twin Builder (ECE):
# tables over currents and angle.
#
# Between the marks B_Sweepings and E_Sweepings stand both axes of currents and that of the rotor
# angle, between B_OutputMatrix and E_OutputMatrix one row per point: index, d, q and zero-sequence
# flux linkage, torque.

_AXIS = re.compile(r"\(\s*(\d+)\s*:([^()]*)\)")


_POLES = re.compile(r"^\s*Poles\s+(\d{1,3})\s*$", re.MULTILINE)


_COLUMNS = 5


def is_twin_builder(text: str) -> bool:
    """Whether a text is such a table."""
    return "B_OutputMatrix" in text and "B_Sweepings" in text


def twin_builder_arrays(text: str, source: str) -> list[NamedArray]:
    """Arrays i_d, i_q, angle (rad), psi_d, psi_q and torque of all points, shape (K,)."""
    sweeps = _between(text, "Sweepings", source)
    axes = []
    for count, numbers in _AXIS.findall(sweeps):
        try:
            axis = np.array([float(part) for part in numbers.split()])
        except ValueError:
            raise InputError(
                "an axis holds text among its numbers; export the table again", source=source
            ) from None
        if axis.size != int(count):
            raise InputError(
                f"an axis of {count} values has {axis.size}; export the table again", source=source
            )
        axes.append(axis)
    if len(axes) != 3:
        raise InputError(
            f"the table has {len(axes)} axes, not i_d, i_q and the rotor angle", source=source
        )
    rows = [
        line.split()
        for line in _between(text, "OutputMatrix", source).split("\n")[1:]
        if line.strip()
    ]
    first = text.count("\n", 0, text.index("B_OutputMatrix")) + 2
    for number, row in enumerate(rows, first):
        if len(row) != _COLUMNS:
            raise InputError(
                f"this row has {len(row)} numbers, not {_COLUMNS}", source=source, line=number
            )
    size = math.prod(axis.size for axis in axes)
    if len(rows) != size:
        raise InputError(
            f"the table has {len(rows)} rows, its axes make {size} points", source=source
        )
    try:
        table = np.array(rows, dtype=float)
    except ValueError as error:
        raise InputError(
            f"the table holds text among numbers ({error})"[:200], source=source, line=first
        ) from None
    i_d, i_q, angle = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
    lines = np.arange(first, first + size)
    # The torque of the circuit acts on its shaft port and counts against the motion.
    parts = {
        "i_d": i_d,
        "i_q": i_q,
        "angle": np.radians(angle),
        "psi_d": table[:, 1],
        "psi_q": table[:, 2],
    }
    parts["torque"] = -table[:, 4] + 0.0
    arrays = [NamedArray(name, name, values, lines=lines) for name, values in parts.items()]
    if poles := _POLES.search(text):
        arrays.append(NamedArray("poles", "poles", np.array([float(poles[1])])))
    return arrays


def _between(text: str, name: str, source: str) -> str:
    """What stands between the begin and the end mark of a part."""
    begin, end = text.find(f"B_{name}"), text.find(f"E_{name}")
    if not 0 <= begin < end:
        raise InputError(
            f"the part {name} is not closed by E_{name}; export the table again", source=source
        )
    return text[begin:end]
