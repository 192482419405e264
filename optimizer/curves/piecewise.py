"""Piecewise polynomials on [0, end], each segment in its own variable x = t - start.

The local variable is what the firmware evaluates, too: powers of t itself cancel badly on the later
segments, where degree 6 in single precision would lose more than the fit gains.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class PiecewisePolynomial:
    """A polynomial per segment.

    Args:
        edges: Ascending segment limits, shape (S + 1,), from 0 to the end of the domain.
        coefficients: Ascending powers of x = t - edges[s], shape (S, n + 1).
    """

    edges: FloatArray
    coefficients: FloatArray

    @property
    def segments(self) -> int:
        """Number of segments S."""
        return int(self.coefficients.shape[0])

    @property
    def degree(self) -> int:
        """Degree n of every segment."""
        return int(self.coefficients.shape[1]) - 1

    @property
    def breakpoints(self) -> FloatArray:
        """Inner edges, shape (S - 1,)."""
        return self.edges[1:-1]

    def __call__(self, argument: FloatArray) -> FloatArray:
        """Value at ``argument`` of any shape; a breakpoint itself belongs to
        the segment on its right.
        """
        argument = np.asarray(argument, dtype=np.float64)
        segment = np.searchsorted(self.breakpoints, argument, side="right")
        local = argument - self.edges[segment]
        rows = self.coefficients[segment]
        value = rows[..., -1]
        for power in range(self.degree - 1, -1, -1):
            value = value * local + rows[..., power]
        return np.asarray(value)

    def jumps(self) -> FloatArray:
        """Right minus left limit at each breakpoint, shape (S - 1,)."""
        width = np.diff(self.edges)[:-1]
        left: FloatArray = np.array(
            [
                np.polynomial.polynomial.polyval(w, c)
                for w, c in zip(width, self.coefficients, strict=False)
            ]
        )
        return self.coefficients[1:, 0] - left


@cache
def _chebyshev_to_local(degree: int) -> FloatArray:
    """Matrix from a Chebyshev series in s to ascending powers of s + 1, shape (n + 1, n + 1),
    rows by T_k.
    """
    powers = np.zeros((degree + 1, degree + 1))
    for order in range(degree + 1):
        unit = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[order])
        powers[order, : unit.size] = unit
    shift: FloatArray = np.array(
        [
            [comb(j, k) * (-1.0) ** (j - k) if k <= j else 0.0 for k in range(degree + 1)]
            for j in range(degree + 1)
        ]
    )
    matrix: FloatArray = powers @ shift
    return matrix


def power_of_series(degree: int, power: int) -> FloatArray:
    """Row that gives the coefficient of (s + 1)^power from a Chebyshev series in s,
    shape (n + 1,).
    """
    row: FloatArray = _chebyshev_to_local(degree)[:, power]
    return row


def local_coefficients(chebyshev: FloatArray, edges: FloatArray) -> FloatArray:
    """Convert Chebyshev series on each segment, shape (S, n + 1), to ascending powers of t -
    edges[s].
    """
    degree = chebyshev.shape[1] - 1
    half_width = 0.5 * np.diff(edges)[:, np.newaxis]
    # With s in [-1, 1] on the segment, t - start = half_width * (s + 1).
    converted: FloatArray = (
        chebyshev @ _chebyshev_to_local(degree) / half_width ** np.arange(degree + 1)
    )
    return converted
