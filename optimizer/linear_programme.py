"""Linear programmes: scaled, solved in more than one way, checked against their own rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError

# In the order of the attempts; the last one with the other choice of presolve.
_METHODS = "highs-ds", "highs-ipm", "highs-ds"

# Largest violation of a scaled row or bound, and largest gap between the cost and its bound by the
# multipliers over 1 plus the cost, with limits of about 1; HiGHS aims at 1e-7.
_CLOSE = 1e-6

# Share of the largest coefficient below which a whole row is what rounding left of zeros.
_NOISE = 1e-12
_NONE = 2, 3  # Status of a programme that nothing fulfils, or that has no least cost.


def least_cost(
    cost: FloatArray,
    rows: Any,
    most: FloatArray,
    *,
    equal: FloatArray | None = None,
    bounds: FloatArray | tuple[float, float] = (-np.inf, np.inf),
    orthogonal: bool = False,
    presolve: bool = True,
) -> FloatArray | None:
    """X of least ``cost`` x with ``rows`` x <= ``most`` and ``equal`` x = 0; None where nothing
    fulfils that or nothing is the least.

    Args:
        cost, rows, most, equal: Shapes (N,), (M, N), (M,) and (K, N); ``rows`` dense or sparse.
        bounds: Least and largest x, shape (N, 2) or one pair for all.
        orthogonal: Solve in an orthonormal basis of the columns: for dense columns that nearly
            depend on each other, as powers do, and unknowns without bounds.
        presolve: Whether the solver first looks for what can be removed.

    Raises:
        NoSolutionError: No method ends with an answer that fulfils the rows.
    """
    from scipy.optimize import linprog

    by_column = _unit(_largest(rows, 0))
    scaled = _times(rows, by_column)
    high = _largest(scaled, 1)
    by_row = _unit(np.where(high > _NOISE * np.max(high), high, 1.0))
    scaled = _times(scaled, by_row[:, np.newaxis])
    triangle = np.eye(1)
    if orthogonal:
        scaled, triangle = np.linalg.qr(scaled)
        root = np.sqrt(scaled.shape[0])
        scaled, triangle = scaled * root, triangle / root
    size = _unit(np.array([np.max(np.abs(most * by_row), initial=0.0)]))[0]
    slope = np.linalg.solve(triangle.T, cost * by_column) if orthogonal else cost * by_column
    slope = slope * _unit(np.array([np.max(np.abs(slope))]))
    right = most * by_row * size
    reach = np.broadcast_to(bounds, (cost.size, 2)) * (size / by_column)[:, np.newaxis]
    ended = ""
    for attempt, method in enumerate(_METHODS):
        found = linprog(
            slope,
            A_ub=scaled,
            b_ub=right,
            A_eq=None if equal is None else equal * by_column,
            b_eq=None if equal is None else np.zeros(equal.shape[0]),
            bounds=reach,
            method=method,
            options={"presolve": presolve != (attempt == len(_METHODS) - 1)},
        )
        if found.status == 0 and _holds(found, slope, scaled, right, reach):
            x = np.linalg.solve(triangle, found.x) if orthogonal else found.x
            return np.asarray(x * by_column / size)
        if found.status in _NONE and attempt > 0:
            return None
        ended = found.message
    raise NoSolutionError(f"a linear programme could not be solved ({ended})")


def _unit(size: FloatArray) -> FloatArray:
    """Powers of two that bring numbers to about 1, so that scaling rounds nothing; 1 for 0."""
    return np.asarray(2.0 ** -np.round(np.log2(np.where(size > 0.0, size, 1.0))))


def _largest(rows: Any, axis: int) -> FloatArray:
    found = abs(rows).max(axis=axis)
    return np.asarray(found.toarray() if hasattr(found, "toarray") else found).ravel()


def _times(rows: Any, factor: FloatArray) -> Any:
    return rows.multiply(factor).tocsr() if hasattr(rows, "multiply") else rows * factor


def _holds(found: Any, cost: FloatArray, rows: Any, most: FloatArray, bounds: FloatArray) -> bool:
    """Whether an answer fulfils its rows and bounds, and its multipliers prove it the least."""
    x, dual = found.x, float(most @ found.ineqlin.marginals)
    for side, part in ((0, found.lower), (1, found.upper)):
        finite = np.isfinite(bounds[:, side])
        dual += float(bounds[finite, side] @ part.marginals[finite])
    violated = max(
        float(np.max(rows @ x - most, initial=0.0)),
        float(np.max(bounds[:, 0] - x, initial=0.0)),
        float(np.max(x - bounds[:, 1], initial=0.0)),
        float(np.max(np.abs(found.eqlin.residual), initial=0.0)),
    )
    least = float(cost @ x)
    return violated <= _CLOSE and abs(least - dual) <= _CLOSE * (1.0 + abs(least))
