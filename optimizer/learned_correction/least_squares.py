"""Least squares of many samples in few unknowns, in a fixed order of operations."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray

# Share of the mean square of a column that is added: unknowns that no sample tells are nought.
_RIDGE = 1e-10


def least_squares(columns: FloatArray, wanted: FloatArray) -> FloatArray:
    """Factors of K columns, shape (K, M), whose sum is nearest to ``wanted``, shape (M,).

    By the normal equations and Cholesky's factors, summed by numpy's own loops and not by a linear
    algebra library, whose order of summation depends on its threads.
    """
    square = np.einsum("in,jn->ij", columns, columns)
    right = np.einsum("in,n->i", columns, wanted)
    count = len(right)
    square[np.arange(count), np.arange(count)] += (
        _RIDGE * float(np.mean(np.diag(square))) + np.finfo(float).tiny
    )
    factor = np.zeros_like(square)
    for k in range(count):
        rest = square[k:, k] - np.einsum("ij,j->i", factor[k:, :k], factor[k, :k])
        factor[k:, k] = rest / np.sqrt(rest[0])
    found = np.zeros(count)
    for k in range(count):
        found[k] = (right[k] - np.einsum("j,j->", factor[k, :k], found[:k])) / factor[k, k]
    for k in reversed(range(count)):
        behind = np.einsum("j,j->", factor[k + 1 :, k], found[k + 1 :])
        found[k] = (found[k] - behind) / factor[k, k]
    return found
