"""Best fits of many curves at once by Chebyshev series on their own segments.

In the local variable of each segment the side conditions do not depend on the breakpoints, so that
all curves share one space of admissible series. Weighted least squares there are small systems,
solved for all curves together; the minimax fit comes from reweighting (C. L. Lawson, Contributions
to the theory of linear least maximum approximation, thesis, UCLA, 1961).

Arrays keep the curves along their last axis, and every operation is a sum, product, quotient or
root of single elements in a fixed order: no curve's numbers depend on how many others there are, on
a library's kernels or on the processor.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import SideConditions
from dqforge.optimizer.curves.piecewise import power_of_series

_REWEIGHTINGS = 5  # More gain nothing: the error is within 1 or 2 % of the least one.
_NODES = 5  # Nodes of a segment per coefficient: between them the error rises by 2 %, seldom 5 %.
_LEAST_WEIGHT = 1e-10
_LEAST_PIVOT = 1e-14  # Share of a diagonal below which a pivot is rounding.


@dataclass(frozen=True, slots=True, eq=False)
class SeriesSpace:
    """Chebyshev series on S segments, degree n, that keep side conditions, looked at in P nodes.

    ``nodes`` in [-1, 1], shape (P,); ``basis`` the Chebyshev polynomials up to degree 2 n there,
    shape (2 n + 1, P). Functions that are not zero on segment s: their series ``parts[s]``, shape
    (A, n + 1), their places among all ``count`` functions ``places[s]``, and what turns the moments
    of the weights into their products, ``products[s]``, shape (A (A + 1) / 2, 2 n + 1).
    """

    degree: int
    nodes: FloatArray
    basis: FloatArray
    count: int
    parts: tuple[FloatArray, ...]
    places: tuple[tuple[int, ...], ...]
    products: tuple[FloatArray, ...]

    @property
    def segments(self) -> int:
        """Number of segments S."""
        return len(self.parts)


def lobatto_nodes(count: int) -> FloatArray:
    """Extrema of a Chebyshev polynomial on [-1, 1], ends included, ascending, shape (count,)."""
    return np.array([-math.cos(math.pi * place / (count - 1)) for place in range(count)])


def chebyshev_values(degree: int, nodes: FloatArray) -> FloatArray:
    """Chebyshev polynomials up to a degree at points of [-1, 1], shape (n + 1, P)."""
    rows = [np.ones_like(nodes), nodes + 0.0]
    while len(rows) <= degree:
        rows.append(2.0 * nodes * rows[-1] - rows[-2])
    return np.array(rows[: degree + 1])


@cache
def series_space(degree: int, segments: int, side: SideConditions) -> SeriesSpace:
    """Space of series of a degree on segments under side conditions.

    Args:
        degree: Degree n of each segment, at least 1.
        segments: Number of segments S.
        side: Equalities to keep.
    """
    nodes = lobatto_nodes(_NODES * (degree + 1) + 1)
    left = [(-1.0) ** order for order in range(degree + 1)]
    right = [1.0] * (degree + 1)
    at_start = ([left] if side.exact_at_zero else []) + [
        power_of_series(degree, power).tolist() for power in side.absent
    ]
    kept = [at_start if segment == 0 else [] for segment in range(segments)]
    parts: list[list[list[float]]] = [[] for _ in kept]
    places: list[list[int]] = [[] for _ in kept]
    count = 0
    for segment, conditions in enumerate(kept):
        seams = [left] * (side.continuous and segment > 0)
        seams += [right] * (side.continuous and segment < segments - 1)
        for free in _null_space(degree + 1, [*conditions, *seams]):
            parts[segment].append(free)
            places[segment].append(count)
            count += 1
    for seam in range(segments - 1 if side.continuous else 0):
        outer = [left] if seam > 0 else []
        parts[seam].append(_meeting(right, [*kept[seam], *outer]))
        outer = [right] if seam + 1 < segments - 1 else []
        parts[seam + 1].append(_meeting(left, outer))
        for segment in (seam, seam + 1):
            places[segment].append(count)
        count += 1
    arrays = tuple(np.array(part).reshape(-1, degree + 1) for part in parts)
    products = tuple(_products(part) for part in arrays)
    basis = chebyshev_values(2 * degree, nodes)
    return SeriesSpace(degree, nodes, basis, count, arrays, tuple(map(tuple, places)), products)


def _null_space(size: int, rows: list[list[float]]) -> list[list[float]]:
    """Orthonormal vectors that every row maps to zero, by Gram and Schmidt."""
    found: list[list[float]] = []
    for candidate in [*rows, *np.eye(size).tolist()]:
        vector = list(candidate)
        for _ in range(2):  # once more for the rounding of the first pass
            for other in found:
                share = math.fsum(a * b for a, b in zip(vector, other, strict=True))
                vector = [a - share * b for a, b in zip(vector, other, strict=True)]
        length = math.sqrt(math.fsum(a * a for a in vector))
        if length > 1e-6:
            found.append([a / length for a in vector])
    return found[len(rows) :]


def _meeting(end: list[float], conditions: list[list[float]]) -> list[float]:
    """The shortest series of value 1 at an end of its segment that keeps the conditions."""
    free = _null_space(len(end), conditions)
    shares = [math.fsum(a * b for a, b in zip(end, vector, strict=True)) for vector in free]
    size = math.fsum(share * share for share in shares)
    return [
        math.fsum(share * vector[k] for share, vector in zip(shares, free, strict=True)) / size
        for k in range(len(end))
    ]


def _products(part: FloatArray) -> FloatArray:
    """Products of functions as sums of Chebyshev moments: T_i T_j = (T_(i+j) + T_|i-j|) / 2.

    Series of shape (A, n + 1) to (A (A + 1) / 2, 2 n + 1), pairs (a, b <= a) row by row.
    """
    size = part.shape[1]
    rows = []
    for a in range(part.shape[0]):
        for b in range(a + 1):
            row = np.zeros(2 * size - 1)
            for i in range(size):
                for j in range(size):
                    half = 0.5 * part[a, i] * part[b, j]
                    row[i + j] += half
                    row[abs(i - j)] += half
            rows.append(row)
    return np.array(rows)


def combined(matrix: FloatArray, rows: FloatArray) -> FloatArray:
    """Product of a constant matrix (R, C) and rows (C, N), summed in the order of the columns."""
    total, term = (
        np.zeros((matrix.shape[0], rows.shape[1])),
        np.empty((matrix.shape[0], rows.shape[1])),
    )
    for column in range(rows.shape[0]):
        np.multiply(matrix[:, column, np.newaxis], rows[column], out=term)
        total += term
    return total


def series_values(space: SeriesSpace, series: FloatArray) -> FloatArray:
    """Values of series of shape (S, n + 1, N) at the nodes, shape (S, P, N)."""
    basis = space.basis[: space.degree + 1].T
    return np.stack([combined(basis, part) for part in series])


def weighted_fit(space: SeriesSpace, weights: FloatArray, values: FloatArray) -> FloatArray:
    """Series with the least weighted sum of squared errors at the nodes, shape (S, n + 1, N).

    Args:
        space: Admissible series.
        weights: Weights of the squares, shape (S, P, N).
        values: What is to be fitted at the nodes, shape (S, P, N).
    """
    count, size = space.count, weights.shape[2]
    normal, right = np.zeros((count, count, size)), np.zeros((count, size))
    for segment, (part, places) in enumerate(zip(space.parts, space.places, strict=True)):
        weight = weights[segment]
        squares = combined(space.products[segment], combined(space.basis, weight))
        moments = combined(space.basis[: space.degree + 1], weight * values[segment])
        found = combined(part, moments)
        pair = 0
        for a, row in enumerate(places):
            right[row] += found[a]
            for column in places[: a + 1]:
                normal[row, column] += squares[pair]
                pair += 1
    solution = _solved(normal, right)
    return np.stack(
        [
            combined(part.T, solution[list(places)])
            for part, places in zip(space.parts, space.places, strict=True)
        ]
    )


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions (F, N) of positive definite systems, lower halves (F, F, N), by Cholesky."""
    count = right.shape[0]
    factor, solution = normal.copy(), right.copy()
    inverse = np.empty_like(right)
    for column in range(count):
        least = _LEAST_PIVOT * normal[column, column] + 1e-300
        for before in range(column):
            factor[column:, column] -= factor[column:, before] * factor[column, before]
        inverse[column] = 1.0 / np.sqrt(np.maximum(factor[column, column], least))
        factor[column:, column] *= inverse[column]
        solution[column] *= inverse[column]
        solution[column + 1 :] -= factor[column + 1 :, column] * solution[column]
    for column in range(count - 1, -1, -1):
        for behind in range(column + 1, count):
            solution[column] -= factor[behind, column] * solution[behind]
        solution[column] *= inverse[column]
    return solution


def minimax_fit(space: SeriesSpace, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Series of nearly the least largest error, shape (S, n + 1, N), and that error at the nodes.

    Each reweighting multiplies the weights by the error that is left: they gather where the error
    of the best fit has its extrema.

    Args:
        space: Admissible series.
        values: What is to be fitted at the nodes, shape (S, P, N).
    """
    ones = np.ones_like(values)
    first = weighted_fit(space, ones, values)
    rest = values - series_values(space, first)
    scale = np.max(np.abs(rest), axis=(0, 1))
    # Corrections are fitted to what is left, so that rounding is a share of the error.
    rest /= np.where(scale > 0.0, scale, 1.0)
    left, weights = rest, ones
    best, worst = np.zeros_like(first), np.ones_like(scale)
    for _ in range(_REWEIGHTINGS):
        weights = weights * np.abs(left)
        weights /= np.maximum(np.max(weights, axis=(0, 1)), 1e-300)
        np.maximum(weights, _LEAST_WEIGHT, out=weights)
        correction = weighted_fit(space, weights, rest)
        left = rest - series_values(space, correction)
        size = np.max(np.abs(left), axis=(0, 1))
        better = size < worst
        worst = np.where(better, size, worst)
        best = np.where(better, correction, best)
    return first + scale * best, scale * worst
