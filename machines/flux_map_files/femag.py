"""Flux maps in the result files of FEMAG (.BCH, .BATCH): the tables of its Psid-Psiq
and Ld-Lq identifications.

A table begins with a line of titles, then one of units in brackets; its groups of rows are parted
by empty lines. Flux linkages and torques are given per mm of armature length, which stands above.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.records import dataclass

_LENGTH = re.compile(
    r"Armature Length\s*\[mm\]\s*:\s*(\d+\.?\d*(?:[eE][+-]?\d{1,2})?)", re.IGNORECASE
)


_PAIRS = re.compile(r"Number of Pole pairs\s*:\s*(\d{1,3})\b", re.IGNORECASE)


_HEAD = 4000


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
    head = content[:_HEAD].lower()
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
