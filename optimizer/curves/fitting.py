"""Fits of one curve by polynomials on given segments: interpolation, least squares and minimax.

Side conditions are shared by all three: the value at the start of the domain (no torque step at
zero torque) and continuity at the breakpoints (no current step). Every fit works in Chebyshev
series on each segment.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import FitMethod
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import (
    PiecewisePolynomial,
    local_coefficients,
    power_of_series,
)
from dqforge.optimizer.linear_programme import least_cost

# Check points per segment between which the error of a fit is searched for; odd extrema are far
# wider apart.
Curve = Callable[[FloatArray], FloatArray]
IndexArray = np.ndarray[tuple[int, ...], np.dtype[np.intp]]
Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
_DENSE_POINTS = 400

# Share of the mean segment error in the minimax objective: keeps segments that do not bind small,
# and costs at most this share of the optimum.
_TIE_WEIGHT = 2e-4

# Attained error over the lower bound of the linear programme at which the exchange stops.
_EXCHANGE_GOAL = 1.0002


@dataclass(frozen=True, slots=True)
class SideConditions:
    """Equalities that a fit keeps: zero value at the start of the domain,
    continuity at the breakpoints.

    ``absent`` are the powers above 0 that the first segment does not have,
    as a curve that is even or odd lacks them.
    """

    exact_at_zero: bool
    continuous: bool
    absent: tuple[int, ...] = ()


def chebyshev_nodes(count: int) -> FloatArray:
    """Chebyshev nodes of the first kind on [-1, 1], ascending, shape (count,) (paper 000, (25))."""
    order: FloatArray = np.arange(1, count + 1, dtype=np.float64)
    return -np.cos((2.0 * order - 1.0) / (2.0 * count) * np.pi)


@cache
def gauss_rule(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss and Legendre on [-1, 1], shape (count,) each.

    They take longer than a whole fit.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def to_domain(reference: FloatArray, edges: FloatArray) -> FloatArray:
    """Map points of [-1, 1], shape (M,), into every segment, shape (S, M)."""
    width: FloatArray = np.diff(edges)[:, np.newaxis]
    return edges[:-1, np.newaxis] + 0.5 * width * (reference + 1.0)


def condition_rows(segments: int, degree: int, side: SideConditions) -> FloatArray:
    """Rows of the homogeneous side conditions on the stacked Chebyshev coefficients, shape (C,
    S (n + 1)).
    """
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

    Without side conditions these are the n + 1 Chebyshev nodes of paper 000 (20) to (25). A side
    condition takes the left end of its segment as one of the n + 1 nodes and leaves n Chebyshev
    nodes to the rest.
    """
    series = np.empty((edges.size - 1, degree + 1))
    free = chebyshev_nodes(degree + 1)
    tied = np.concatenate([[-1.0], chebyshev_nodes(degree)])
    left_value = 0.0
    first = 0
    if side.absent:  # as many nodes as the coefficients that are left
        basis = null_space(
            condition_rows(1, degree, SideConditions(side.exact_at_zero, False, side.absent))
        )
        nodes = chebyshev_nodes(basis.shape[1])
        values = curve(to_domain(nodes, edges[:2])[0])
        series[0] = basis @ np.linalg.solve(chebyshev.chebvander(nodes, degree) @ basis, values)
        first, left_value = 1, float(np.sum(series[0]))
    for segment in range(first, edges.size - 1):
        is_tied = side.exact_at_zero if segment == 0 else side.continuous
        nodes = tied if is_tied else free
        values = curve(to_domain(nodes, edges[segment : segment + 2])[0])
        if is_tied:
            values = np.concatenate([[left_value], values[1:]])
        series[segment] = np.linalg.solve(chebyshev.chebvander(nodes, degree), values)
        left_value = float(np.sum(series[segment]))  # every T_k(1) is 1
    return series


def _least_squares(
    curve: Curve, edges: FloatArray, degree: int, side: SideConditions
) -> FloatArray:
    """Chebyshev series with the least integral of the squared error under the side conditions,
    shape (S, n + 1).
    """
    segments = edges.size - 1
    nodes, weights = gauss_rule(degree + 24)
    root = np.sqrt(0.5 * np.diff(edges)[:, np.newaxis] * weights)
    basis = chebyshev.chebvander(nodes, degree)
    target = (curve(to_domain(nodes, edges)) * root).ravel()
    design = np.zeros((target.size, segments * (degree + 1)))
    for segment in range(segments):
        rows = slice(segment * nodes.size, (segment + 1) * nodes.size)
        columns = slice(segment * (degree + 1), (segment + 1) * (degree + 1))
        design[rows, columns] = basis * root[segment][:, np.newaxis]
    free = null_space(condition_rows(segments, degree, side))
    solution, *_ = np.linalg.lstsq(design @ free, target, rcond=None)
    return (free @ solution).reshape(segments, degree + 1)


def null_space(conditions: FloatArray) -> FloatArray:
    """Orthonormal basis of the coefficients that satisfy full-rank homogeneous conditions,
    by columns.
    """
    columns = conditions.shape[1]
    if conditions.shape[0] == 0:
        return np.eye(columns)
    orthogonal, _ = np.linalg.qr(conditions.T, mode="complete")
    return orthogonal[:, conditions.shape[0] :]


class MinimaxProgramme:
    """Linear programme for the correction of feasible fits: least E with
    |residual - correction| <= E_s <= E.

    Any number of curves share E. The residuals may depend linearly on ``moves`` further variables
    that all curves share and that are bounded: small changes of the breakpoints. Residuals are to
    be scaled to 1, so that the tolerance of the solver is relative to the error and not to the
    curve.
    """

    def __init__(
        self, curves: int, segments: int, degree: int, side: SideConditions, moves: int = 0
    ) -> None:
        self.blocks = curves * segments
        self.shape = (curves, segments, degree + 1)
        self.degree = degree
        self.moves = moves
        conditions = np.kron(np.eye(curves), condition_rows(segments, degree, side))
        self.coefficients = self.blocks * (degree + 1)
        self.variables = self.coefficients + self.blocks + moves + 1
        self.equalities = np.hstack(
            [conditions, np.zeros((conditions.shape[0], self.blocks + moves + 1))]
        )
        levels = slice(self.coefficients, self.coefficients + self.blocks)
        self.order = np.zeros((self.blocks, self.variables))
        self.order[:, levels] = np.eye(self.blocks)
        self.order[:, -1] = -1.0
        self.objective = np.zeros(self.variables)
        self.objective[levels] = _TIE_WEIGHT / self.blocks
        self.objective[-1] = 1.0

    def solve(
        self,
        block: IndexArray,
        position: FloatArray,
        residual: FloatArray,
        slopes: FloatArray | None = None,
        radius: float = 0.0,
    ) -> tuple[FloatArray, FloatArray, float]:
        """Correction series, shape (A, S, n + 1), the moves, and the lower bound of the error.

        Args:
            block: Curve and segment of each residual as one index, shape (N,), curve by curve.
            position: Where in [-1, 1] on the segment, shape (N,).
            residual: Residual there, shape (N,).
            slopes: Change of the residual per unit of each move, shape (N, moves).
            radius: Largest magnitude of a move.

        Raises:
            NoSolutionError: The solver failed.
        """
        rows = np.zeros((position.size, self.variables))
        width = self.degree + 1
        columns = block[:, np.newaxis] * width + np.arange(width)
        np.put_along_axis(rows, columns, chebyshev.chebvander(position, self.degree), axis=1)
        if slopes is not None:
            rows[:, -1 - self.moves : -1] = -slopes
        level = np.zeros_like(rows)
        level[np.arange(position.size), self.coefficients + block] = -1.0
        limits = np.full((self.variables, 2), (-np.inf, np.inf))
        limits[-1 - self.moves : -1] = (-radius, radius)
        x = least_cost(
            self.objective,
            np.vstack([rows + level, -rows + level, self.order]),
            np.concatenate([residual, -residual, np.zeros(self.blocks)]),
            equal=self.equalities if self.equalities.size > 0 else None,
            bounds=limits,
            presolve=False,  # nothing can be removed, and looking takes a quarter of the time
        )
        if x is None:
            raise NoSolutionError("minimax fit: the side conditions leave no curve")
        series = x[: self.coefficients].reshape(self.shape)
        return series, x[-1 - self.moves : -1], float(x[-1])


def local_peaks(error: FloatArray) -> Mask:
    """Mask of the local maxima of |error| along the last axis, ends included."""
    size = np.abs(error)
    peaks = np.ones(size.shape, dtype=np.bool_)
    peaks[..., 1:] &= size[..., 1:] >= size[..., :-1]
    peaks[..., :-1] &= size[..., :-1] >= size[..., 1:]
    return peaks


def _minimax(
    curve: Curve, edges: FloatArray, degree: int, side: SideConditions, *, exchange: bool
) -> FloatArray:
    """Chebyshev series with the least largest error under the side conditions, shape (S, n + 1).

    A semi-infinite linear programme: the solution on a few points per segment bounds the optimum
    from below, its largest error on a dense grid from above; points are added until the two meet
    within 0.02 %. With ``exchange`` false the first solution is returned as it is: within 1 % of
    the optimum, which ranks breakpoints well enough.
    """
    segments = edges.size - 1
    start = _least_squares(curve, edges, degree, side)
    dense = -np.cos(np.linspace(0.0, np.pi, _DENSE_POINTS + 1))
    values = curve(to_domain(dense, edges))
    vander = chebyshev.chebvander(dense, degree)
    residual = values - start @ vander.T
    scale = float(np.max(np.abs(residual)))
    if scale <= 1e-14 * float(np.max(np.abs(values), initial=0.0)):
        return start  # the curve is such a polynomial; nothing is left to level
    residual /= scale
    chosen = np.zeros(residual.shape, dtype=np.bool_)
    chosen[:, np.unique(np.linspace(0, dense.size - 1, 12 * degree + 25).round().astype(int))] = (
        True
    )
    chosen |= local_peaks(residual)
    programme = MinimaxProgramme(1, segments, degree, side)
    refined = False
    while True:
        segment, point = np.nonzero(chosen)
        (correction,), _, bound = programme.solve(segment, dense[point], residual[chosen])
        error = np.abs(residual - correction @ vander.T)
        worst = np.max(error, axis=1)
        missed = worst > _EXCHANGE_GOAL * bound
        if not exchange or np.all(
            chosen[missed]
        ):  # none missed, or no point left to add: the tolerance of the solver
            solution: FloatArray = start + scale * correction
            return solution
        chosen |= error > bound
        if refined:
            # a segment with room overshoots elsewhere, time and again, if it gets single points
            chosen[missed] = True
        refined = True


def fit_curve(
    curve: Curve,
    edges: FloatArray,
    degree: int,
    method: FitMethod,
    side: SideConditions,
    *,
    exchange: bool = True,
) -> PiecewisePolynomial:
    """Fit one curve on given segments.

    Args:
        curve: Vectorised function to fit; with ``exact_at_zero`` it must vanish at the first edge.
        edges: Ascending segment limits, shape (S + 1,).
        degree: Degree of each segment, at least 1.
        method: ``lagrange`` (paper 000, (20) to (25)), ``least-squares`` or ``minimax``.
        side: Equalities to keep.
        exchange: Only for ``minimax``: false stops after the first linear programme, for ranking
            breakpoints.

    Raises:
        NoSolutionError: The linear programme of the minimax fit failed.
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
        coefficients[0, 0] = (
            0.0  # it is zero but for the rounding of the solution; the firmware drops the addition
        )
    coefficients[0, list(side.absent)] = 0.0
    return PiecewisePolynomial(edges, coefficients)


def squared_error_integral(curve: Curve, fit: PiecewisePolynomial) -> float:
    """Integral of the squared error over the domain (one term of paper 000 (30)),
    in units of curve^2 x argument.
    """
    nodes, weights = gauss_rule(fit.degree + 40)
    points = to_domain(nodes, fit.edges)
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
