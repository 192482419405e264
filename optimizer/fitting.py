"""Fits of one curve by polynomials on given segments: interpolation, least squares and minimax.

Side conditions are shared by all three: the value at the start of the domain (no torque step at zero torque) and
continuity at the breakpoints (no current step). Every fit works in Chebyshev series on each segment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.settings import FitMethod
from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.piecewise import PiecewisePolynomial, local_coefficients, power_of_series

Curve = Callable[[FloatArray], FloatArray]

_DENSE_POINTS = 400
"""Check points per segment between which the error of a fit is searched for; odd extrema are far wider apart."""

_TIE_WEIGHT = 2e-4
"""Share of the mean segment error in the minimax objective: keeps segments that do not bind small, and costs at most
this share of the optimum."""

_EXCHANGE_GOAL = 1.0002
"""Attained error over the lower bound of the linear programme at which the exchange stops."""


@dataclass(frozen=True, slots=True)
class SideConditions:
    """Equalities that a fit keeps: zero value at the start of the domain, continuity at the breakpoints.

    ``absent`` are the powers above 0 that the first segment does not have, as a curve that is even or odd lacks them.
    """

    exact_at_zero: bool
    continuous: bool
    absent: tuple[int, ...] = ()


def chebyshev_nodes(count: int) -> FloatArray:
    """Chebyshev nodes of the first kind on [-1, 1], ascending, shape (count,) (paper 000, (25))."""
    order: FloatArray = np.arange(1, count + 1, dtype=np.float64)
    return -np.cos((2.0 * order - 1.0) / (2.0 * count) * np.pi)


def _to_domain(reference: FloatArray, edges: FloatArray) -> FloatArray:
    """Map points of [-1, 1], shape (M,), into every segment, shape (S, M)."""
    width: FloatArray = np.diff(edges)[:, np.newaxis]
    return edges[:-1, np.newaxis] + 0.5 * width * (reference + 1.0)


def _conditions(segments: int, degree: int, side: SideConditions) -> FloatArray:
    """Rows of the homogeneous side conditions on the stacked Chebyshev coefficients, shape (C, S (n + 1))."""
    left, right = chebyshev.chebvander(np.array([-1.0, 1.0]), degree)
    width = degree + 1
    rows = []
    if side.exact_at_zero:
        rows.append(np.concatenate([left, np.zeros((segments - 1) * width)]))
    rest = np.zeros((segments - 1) * width)
    rows += [np.concatenate([power_of_series(degree, power), rest]) for power in side.absent]
    if side.continuous:
        for seam in range(segments - 1):
            row = np.zeros(segments * width)
            row[seam * width : (seam + 1) * width] = right
            row[(seam + 1) * width : (seam + 2) * width] = -left
            rows.append(row)
    return np.array(rows).reshape(len(rows), segments * width)


def _interpolate(curve: Curve, edges: FloatArray, degree: int, side: SideConditions) -> FloatArray:
    """Chebyshev series of the Lagrange interpolant, shape (S, n + 1).

    Without side conditions these are the n + 1 Chebyshev nodes of paper 000 (20) to (25). A side condition takes the
    left end of its segment as one of the n + 1 nodes and leaves n Chebyshev nodes to the rest.
    """
    series = np.empty((edges.size - 1, degree + 1))
    free = chebyshev_nodes(degree + 1)
    tied = np.concatenate([[-1.0], chebyshev_nodes(degree)])
    left_value = 0.0
    first = 0
    if side.absent:  # as many nodes as the coefficients that are left
        basis = _null_space(_conditions(1, degree, SideConditions(side.exact_at_zero, False, side.absent)))
        nodes = chebyshev_nodes(basis.shape[1])
        values = curve(_to_domain(nodes, edges[:2])[0])
        series[0] = basis @ np.linalg.solve(chebyshev.chebvander(nodes, degree) @ basis, values)
        first, left_value = 1, float(np.sum(series[0]))
    for segment in range(first, edges.size - 1):
        is_tied = side.exact_at_zero if segment == 0 else side.continuous
        nodes = tied if is_tied else free
        values = curve(_to_domain(nodes, edges[segment : segment + 2])[0])
        if is_tied:
            values = np.concatenate([[left_value], values[1:]])
        series[segment] = np.linalg.solve(chebyshev.chebvander(nodes, degree), values)
        left_value = float(np.sum(series[segment]))  # every T_k(1) is 1
    return series


def _least_squares(curve: Curve, edges: FloatArray, degree: int, side: SideConditions) -> FloatArray:
    """Chebyshev series with the least integral of the squared error under the side conditions, shape (S, n + 1)."""
    segments = edges.size - 1
    nodes, weights = np.polynomial.legendre.leggauss(degree + 24)
    root = np.sqrt(0.5 * np.diff(edges)[:, np.newaxis] * weights)
    basis = chebyshev.chebvander(nodes, degree)
    target = (curve(_to_domain(nodes, edges)) * root).ravel()
    design = np.zeros((target.size, segments * (degree + 1)))
    for segment in range(segments):
        rows = slice(segment * nodes.size, (segment + 1) * nodes.size)
        columns = slice(segment * (degree + 1), (segment + 1) * (degree + 1))
        design[rows, columns] = basis * root[segment][:, np.newaxis]
    free = _null_space(_conditions(segments, degree, side))
    solution, *_ = np.linalg.lstsq(design @ free, target, rcond=None)
    return (free @ solution).reshape(segments, degree + 1)


def _null_space(conditions: FloatArray) -> FloatArray:
    """Orthonormal basis of the coefficients that satisfy full-rank homogeneous conditions, by columns."""
    columns = conditions.shape[1]
    if conditions.shape[0] == 0:
        return np.eye(columns)
    orthogonal, _ = np.linalg.qr(conditions.T, mode="complete")
    return orthogonal[:, conditions.shape[0] :]


class _MinimaxProgramme:
    """Linear programme for the correction of a feasible fit: least E with |residual - correction| <= E_s <= E.

    The residual is scaled to 1, so that the tolerance of the solver is relative to the error and not to the curve.
    """

    def __init__(self, segments: int, degree: int, side: SideConditions) -> None:
        self.segments = segments
        self.width = degree + 1
        self.degree = degree
        conditions = _conditions(segments, degree, side)
        self.variables = segments * self.width + segments + 1
        self.equalities = np.hstack([conditions, np.zeros((conditions.shape[0], segments + 1))])
        order = np.zeros((segments, self.variables))
        order[:, segments * self.width : -1] = np.eye(segments)
        order[:, -1] = -1.0
        self.order = order
        self.objective = np.zeros(self.variables)
        self.objective[segments * self.width : -1] = _TIE_WEIGHT / segments
        self.objective[-1] = 1.0

    def solve(
        self, segment: np.ndarray[tuple[int], np.dtype[np.intp]], position: FloatArray, residual: FloatArray
    ) -> tuple[FloatArray, float]:
        """Correction series, shape (S, n + 1), and the lower bound of the error, for residuals at given points."""
        from scipy.optimize import linprog

        rows = np.zeros((position.size, self.variables))
        columns = segment[:, np.newaxis] * self.width + np.arange(self.width)
        np.put_along_axis(rows, columns, chebyshev.chebvander(position, self.degree), axis=1)
        level = np.zeros_like(rows)
        level[np.arange(position.size), self.segments * self.width + segment] = -1.0
        solution = linprog(
            self.objective,
            A_ub=np.vstack([rows + level, -rows + level, self.order]),
            b_ub=np.concatenate([residual, -residual, np.zeros(self.segments)]),
            A_eq=self.equalities if self.equalities.size else None,
            b_eq=np.zeros(self.equalities.shape[0]) if self.equalities.size else None,
            bounds=(None, None),
            method="highs-ds",
        )
        if solution.status != 0:
            raise NoSolutionError(f"minimax fit: the linear programme stopped with '{solution.message}'")
        series = solution.x[: self.segments * self.width].reshape(self.segments, self.width)
        return series, float(solution.x[-1])


def _local_peaks(error: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Mask of the local maxima of |error| along the last axis, ends included."""
    padded = np.pad(np.abs(error), ((0, 0), (1, 1)), constant_values=-1.0)
    return (padded[:, 1:-1] >= padded[:, :-2]) & (padded[:, 1:-1] >= padded[:, 2:])


def _minimax(curve: Curve, edges: FloatArray, degree: int, side: SideConditions, *, exchange: bool) -> FloatArray:
    """Chebyshev series with the least largest error under the side conditions, shape (S, n + 1).

    A semi-infinite linear programme: the solution on a few points per segment bounds the optimum from below, its
    largest error on a dense grid from above; peaks are added until the two meet within 0.02 %. With ``exchange``
    false the first solution is returned as it is: within 1 % of the optimum, which ranks breakpoints well enough.
    """
    segments = edges.size - 1
    start = _least_squares(curve, edges, degree, side)
    dense = -np.cos(np.linspace(0.0, np.pi, _DENSE_POINTS + 1))
    values = curve(_to_domain(dense, edges))
    vander = chebyshev.chebvander(dense, degree)
    residual = values - start @ vander.T
    scale = float(np.max(np.abs(residual)))
    if scale <= 1e-14 * float(np.max(np.abs(values), initial=0.0)):
        return start  # the curve is such a polynomial; nothing is left to level
    residual /= scale
    chosen = np.zeros(residual.shape, dtype=np.bool_)
    chosen[:, np.unique(np.linspace(0, dense.size - 1, 12 * degree + 25).round().astype(int))] = True
    chosen |= _local_peaks(residual)
    programme = _MinimaxProgramme(segments, degree, side)
    while True:
        segment, point = np.nonzero(chosen)
        correction, bound = programme.solve(segment, dense[point], residual[chosen])
        error = residual - correction @ vander.T
        peaks = _local_peaks(error) & ~chosen
        if not exchange or float(np.max(np.abs(error))) <= _EXCHANGE_GOAL * bound or not peaks.any():
            return start + scale * correction
        chosen |= peaks


def fit_curve(
    curve: Curve, edges: FloatArray, degree: int, method: FitMethod, side: SideConditions, *, exchange: bool = True
) -> PiecewisePolynomial:
    """Fit one curve on given segments.

    Parameters
    ----------
    curve:
        Vectorised function to fit; with ``exact_at_zero`` it must vanish at the first edge.
    edges:
        Ascending segment limits, shape (S + 1,).
    degree:
        Degree of each segment, at least 1.
    method:
        ``lagrange`` (paper 000, (20) to (25)), ``least-squares`` or ``minimax``.
    side:
        Equalities to keep.
    exchange:
        Only for ``minimax``: false stops after the first linear programme, for ranking breakpoints.

    Raises
    ------
    NoSolutionError
        The linear programme of the minimax fit failed.
    """
    edges = np.asarray(edges, dtype=np.float64)
    if method == "lagrange":
        series = _interpolate(curve, edges, degree, side)
    elif method == "least-squares":
        series = _least_squares(curve, edges, degree, side)
    else:
        series = _minimax(curve, edges, degree, side, exchange=exchange)
    coefficients = local_coefficients(series, edges)
    if side.exact_at_zero:
        coefficients[0, 0] = 0.0  # it is zero but for the rounding of the solution; the firmware drops the addition
    coefficients[0, list(side.absent)] = 0.0
    return PiecewisePolynomial(edges, coefficients)


def squared_error_integral(curve: Curve, fit: PiecewisePolynomial) -> float:
    """Integral of the squared error over the domain (one term of paper 000 (30)), in units of curve^2 x argument."""
    nodes, weights = np.polynomial.legendre.leggauss(fit.degree + 40)
    points = _to_domain(nodes, fit.edges)
    # A node never coincides with an edge, so that each point is evaluated in its own segment.
    squared = (fit(points) - curve(points)) ** 2
    return float(np.sum(0.5 * np.diff(fit.edges)[:, np.newaxis] * weights * squared))


def largest_error(curve: Curve, fit: PiecewisePolynomial) -> float:
    """Largest absolute error on a dense grid over all segments, in units of the curve."""
    inside = -np.cos(np.linspace(0.0, np.pi, _DENSE_POINTS + 1))
    worst = 0.0
    for start, end, series in zip(fit.edges[:-1], fit.edges[1:], fit.coefficients, strict=True):
        local = 0.5 * (end - start) * (inside + 1.0)
        value = np.polynomial.polynomial.polyval(local, series)
        worst = max(worst, float(np.max(np.abs(value - curve(start + local)))))
    return worst
