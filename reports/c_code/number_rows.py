"""Rows of numbers in C: the inside of an initialiser."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.reports.c_code.numbers import float_literal


def number_rows(values: NDArray[np.float32], count: int) -> list[str]:
    """Lines of a table, shape (N, M), with so many numbers to a line."""
    lines = []
    for row in values:
        texts = [float_literal(float(value)) for value in row]
        parts = (texts[at : at + count] for at in range(0, len(texts), count))
        lines += ["    {", *(f"        {', '.join(part)}," for part in parts), "    },"]
    return lines
