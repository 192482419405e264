"""A table of numbers with the headings that stand above it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass


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
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.intp]
    preamble: tuple[str, ...]
