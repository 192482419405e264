"""An independent minimax: the second algorithm of Remez in mpmath, 40 digits,
one segment at a time.
"""

from __future__ import annotations

import mpmath
import numpy as np


def per_unit_currents(torque: mpmath.mpf) -> tuple[mpmath.mpf, mpmath.mpf]:
    """MTPA currents in per unit by Newton's method on T = i_q (1 + sqrt(1 + i_q^2)),
    to all digits of the context.
    """
    if torque == 0:
        return mpmath.mpf(0), mpmath.mpf(0)
    i_q = min(torque / 2, mpmath.sqrt(torque))
    for _ in range(12):
        flux = mpmath.sqrt(1 + i_q**2)
        i_q -= (i_q * (1 + flux) - torque) / (1 + flux + i_q**2 / flux)
    return 1 - mpmath.sqrt(1 + i_q**2), i_q


def remez(axis: int, degree: int, start: float, end: float) -> float:
    """Least largest error of a polynomial of the degree for i_d (axis 0) or i_q (axis 1) on [start,
    end], per unit.
    """
    with mpmath.workdps(40):
        a, b = mpmath.mpf(start), mpmath.mpf(end)
        count = degree + 2
        nodes = [
            (a + b) / 2 - (b - a) / 2 * mpmath.cos(mpmath.pi * k / (count - 1))
            for k in range(count)
        ]
        grid = [(a + b) / 2 - (b - a) / 2 * mpmath.cos(mpmath.pi * k / 240) for k in range(241)]
        values = [per_unit_currents(x)[axis] for x in grid]
        for _ in range(30):
            matrix = mpmath.matrix(count, count)
            right = mpmath.matrix(count, 1)
            for row, x in enumerate(nodes):
                for power in range(degree + 1):
                    matrix[row, power] = x**power
                matrix[row, degree + 1] = (-1) ** row
                right[row] = per_unit_currents(x)[axis]
            solution = mpmath.lu_solve(matrix, right)
            level = abs(solution[degree + 1])
            error = [
                value - mpmath.fsum(solution[power] * x**power for power in range(degree + 1))
                for x, value in zip(grid, values, strict=True)
            ]
            worst = max(abs(e) for e in error)
            if worst <= level * mpmath.mpf("1.0005"):
                return float(level)
            nodes = _alternating_extrema(grid, error, count)
        raise AssertionError("Remez did not converge")


def _alternating_extrema(
    grid: list[mpmath.mpf], error: list[mpmath.mpf], count: int
) -> list[mpmath.mpf]:
    """The largest point of each run of equal sign.

    ``count`` neighbouring runs with the largest sum are kept.
    """
    runs: list[tuple[mpmath.mpf, mpmath.mpf]] = []
    previous = 0
    for x, e in zip(grid, error, strict=True):
        sign = 1 if e > 0 else -1
        if sign != previous:
            runs.append((abs(e), x))
        elif abs(e) > runs[-1][0]:
            runs[-1] = (abs(e), x)
        previous = sign
    while len(runs) > count:
        runs.pop(0 if runs[0][0] < runs[-1][0] else -1)
    assert len(runs) == count
    return [x for _, x in runs]


def dense_lower_bound(curve_values: np.ndarray, basis: np.ndarray, equalities: np.ndarray) -> float:
    """Least largest error on a dense grid under equalities, solved by cvxpy with Clarabel."""
    import cvxpy as cp

    coefficients, level = cp.Variable(basis.shape[1]), cp.Variable()
    constraints = [cp.abs(basis @ coefficients - curve_values) <= level]
    if equalities.size:
        constraints.append(equalities @ coefficients == 0)
    problem = cp.Problem(cp.Minimize(level), constraints)
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return float(level.value)
