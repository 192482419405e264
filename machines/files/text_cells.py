"""Numbers of the rows of a text table, parsed some ten thousand lines at a time.

Cells are looked at one by one only in a block that holds something else than numbers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.files.text_formats import (
    BLANKS,
    HIDDEN_COMMA,
    NUMBER,
    Format,
    IndexArray,
    Layout,
    kind_of,
)

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
