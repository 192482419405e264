"""Rows that are made for sensitivities: two samples, and each column of one within the other.

Base row k of samples A and B makes D + 2 rows: A, B, and A with each column of B in its turn
(Saltelli and others 2010, doi:10.1016/j.cpc.2009.09.018).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray


def saltelli_places(first: int, end: int, inputs: int) -> tuple[IndexArray, IndexArray]:
    """Where rows of the design come from: for each row its row of the base samples, and which
    sample it is of, 0 for A, 1 for B and 2 + i for A with column i of B; shape (end - first,).

    Row k belongs to base row k // (D + 2), so that a longer study begins with the same rows.

    Args:
        first, end: Rows first to end - 1.
        inputs: Number of inputs D.
    """
    rows = np.arange(first, end, dtype=np.intp)
    return rows // (inputs + 2), rows % (inputs + 2)


def saltelli_inputs(sample: FloatArray, which: IndexArray) -> FloatArray:
    """Shares of the distributions for rows of the design, shape (n, D).

    Args:
        sample: For each row the numbers in (0, 1) of its base row, those of A and then those of B,
            shape (n, 2 D).
        which: Which sample each row is of, as `saltelli_places` gives it.
    """
    inputs = sample.shape[1] // 2
    from_b = (which[:, np.newaxis] == 1) | (which[:, np.newaxis] == 2 + np.arange(inputs))
    return np.where(from_b, sample[:, inputs:], sample[:, :inputs])
