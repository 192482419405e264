"""Breakpoints of a split-domain fit: where to start, and a search for any objective.

Dynamic programming over a grid of edges gives the best segmentation of the domain for the errors of
single segments, which are cheap. From there, or from a deterministic global search (DIRECT-L), a
derivative-free local one (Nelder-Mead, restarted once) finishes, both from NLopt; breakpoints of
minimax fits are levelled instead (`edge_levelling`). Nothing is random: the same input gives the
same breakpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import chebyshev

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import Curve, SideConditions, condition_rows, null_space

Objective = Callable[[FloatArray], float]
_NARROWEST = 0.01  # Least width of a segment as a share of the domain.
_POSITION_TOLERANCE = 1e-4  # Share of the domain at which the searches stop.

# Size of the first simplex of the local search and of its restart, as a share of the domain.
_LOCAL_STEPS = (0.03, 0.01)

# Breakpoints are rounded to this many significant digits: readable, the same on every machine, and
# the error of the fit changes by less than 0.1 %.
_DIGITS = 5

# Edges for the dynamic programming as shares of the domain. Denser at low torque, where the curves
# bend most; without a magnet they rise like a root there, and the best segments shrink
# geometrically.
_GRID = np.unique(np.concatenate([np.linspace(0.0, 1.0, 41) ** 1.5, np.geomspace(1e-6, 1e-2, 13)]))

# Coefficients rise with the inverse power of the width of a segment; below, they would leave the
# range of floats.
LEAST_POWER = 1e-30
_LEAST_EDGES = 8  # So many edges of the grid must be usable: more than segments are ever asked for.
_ROUNDING = 1e-13  # Errors of this share of the curve are rounding: there is nothing to level.


def edges_from_cube(position: FloatArray, end: float) -> FloatArray:
    """Map a point of the unit cube, shape (S - 1,), to ascending edges from 0 to ``end``,
    shape (S + 1,).

    Sorting makes the cube cover each set of breakpoints; the least width keeps every segment alive.
    """
    inner = np.sort(position) * (1.0 - _NARROWEST * (position.size + 1))
    inner = inner + _NARROWEST * np.arange(1, position.size + 1)
    return np.concatenate([[0.0], inner * end, [end]])


def _cube_from_edges(edges: FloatArray) -> FloatArray:
    """The inverse of `edges_from_cube`, clipped to the cube."""
    count = edges.size - 2
    inner = edges[1:-1] / edges[-1] - _NARROWEST * np.arange(1, count + 1)
    cube: FloatArray = np.clip(inner / (1.0 - _NARROWEST * (count + 1)), 0.0, 1.0)
    return cube


def round_significant(value: float, digits: int = _DIGITS) -> float:
    """Round to significant decimal digits."""
    return float(f"{value:.{digits - 1}e}")


def rounded_edges(edges: FloatArray) -> FloatArray:
    """Edges, shape (S + 1,), with the inner ones rounded to five significant digits."""
    return np.array([edges[0], *(round_significant(edge) for edge in edges[1:-1]), edges[-1]])


def search(
    coarse: Objective, fine: Objective, segments: int, end: float, start: FloatArray | None = None
) -> FloatArray:
    """Edges with the least objective, shape (S + 1,), inner edges rounded
    to five significant digits.

    Args:
        coarse: Objective of the edges for the global search; may rank only approximately, but must
            be cheap.
        fine: Objective for the local search that follows.
        segments: Number of segments S, at least 1.
        end: End of the domain.
        start: Edges near the best, shape (S + 1,); with them there is no global search.
    """
    if segments == 1:
        return np.array([0.0, end])
    import nlopt

    dimensions = segments - 1

    def minimise(
        algorithm: int, objective: Objective, begin: FloatArray, evaluations: int, step: float
    ) -> FloatArray:
        optimiser = nlopt.opt(algorithm, dimensions)
        optimiser.set_lower_bounds(np.zeros(dimensions))
        optimiser.set_upper_bounds(np.ones(dimensions))
        optimiser.set_min_objective(
            lambda x, _gradient: objective(edges_from_cube(np.array(x), end))
        )
        optimiser.set_maxeval(evaluations)
        optimiser.set_xtol_abs(_POSITION_TOLERANCE)
        optimiser.set_initial_step(step)
        return np.array(optimiser.optimize(begin))

    if start is None:
        best = minimise(
            nlopt.GN_DIRECT_L, coarse, np.full(dimensions, 0.5), 40 * dimensions**2 + 20, 1.0
        )
    else:
        best = _cube_from_edges(start)
    for step in _LOCAL_STEPS:
        best = minimise(nlopt.LN_NELDERMEAD, fine, best, 40 * dimensions, step)
    return rounded_edges(edges_from_cube(best, end))


@dataclass(frozen=True, slots=True)
class SegmentErrors:
    """Near-best errors of all segments between the edges of a grid.

    ``grid`` holds the edges, shape (M,), from 0 to the end of the domain. ``largest[i, j]`` is the
    largest error on the segment from edge i to edge j, that of the worst curve; ``squared[i, j]``
    is the integral of the squared error, summed over the curves; both are infinite for j <= i.
    ``rounding`` is what counts as no error.
    """

    grid: FloatArray
    largest: FloatArray
    squared: FloatArray
    rounding: float

    def best_edges(self, segments: int, *, squared: bool = False) -> FloatArray:
        """Edges of the grid with the least largest error, or the least sum of squared ones,
        shape (S + 1,).

        Dynamic programming: exact on the grid. Even edges where there is no error to divide.
        """
        if self.largest[0, -1] <= self.rounding:
            return np.linspace(0.0, self.grid[-1], segments + 1)
        table, join = (self.squared, np.add) if squared else (self.largest, np.maximum)
        best, choices = table[0], []
        for _ in range(segments - 1):
            joined = join(best[:, np.newaxis], table)
            choices.append(np.argmin(joined, axis=0))
            best = np.min(joined, axis=0)
        path = [self.grid.size - 1]
        for choice in reversed(choices):
            path.append(int(choice[path[-1]]))
        return np.array([0.0, *self.grid[path[::-1]]])


def segment_errors(
    curves: Sequence[Curve], degree: int, side: SideConditions, end: float
) -> SegmentErrors:
    """Errors of fits to all segments of a grid, each alone, by least squares in the Chebyshev
    weight.

    These are within some 10 % of the minimax errors. Continuity is left out;
    the value at zero is kept if asked.

    Args:
        curves: Vectorised functions to fit.
        degree: Degree of each segment.
        side: Of its conditions only ``exact_at_zero`` matters here.
        end: End of the domain.

    Raises:
        NoSolutionError: The domain is so small that its powers leave the range of floats.
    """
    angle = np.linspace(0.0, np.pi, 4 * degree + 13)
    vander = chebyshev.chebvander(-np.cos(angle), degree)
    tied = condition_rows(1, degree, SideConditions(side.exact_at_zero, continuous=False))
    basis, at_zero = orthonormal(vander), orthonormal(vander @ null_space(tied))
    grid = end * _GRID
    grid = grid[(grid == 0.0) | (grid**degree > LEAST_POWER)]
    if grid.size < _LEAST_EDGES:
        raise NoSolutionError(
            f"fit.degree: degree {degree} over a domain of {end:.3g} N m has powers that floats "
            "cannot hold; write a lower degree"
        )
    first, last = np.triu_indices(grid.size, 1)
    half_width = 0.5 * (grid[last] - grid[first])
    points = grid[first, np.newaxis] + half_width[:, np.newaxis] * (1.0 - np.cos(angle))
    shape = (grid.size, grid.size)
    largest, squared = np.full(shape, np.inf), np.full(shape, np.inf)
    worst, total, size = np.zeros(first.size), np.zeros(first.size), 0.0
    for curve in curves:
        values = curve(points)
        residual = unfitted(values.T, basis).T
        residual[first == 0] = unfitted(values[first == 0].T, at_zero).T
        worst = np.maximum(worst, np.max(np.abs(residual), axis=1))
        total += (
            half_width * np.sum(residual**2 * np.sin(angle), axis=1) * (np.pi / (angle.size - 1))
        )
        size = max(size, float(np.max(np.abs(values))))
    largest[first, last], squared[first, last] = worst, total
    return SegmentErrors(grid, largest, squared, _ROUNDING * size)


def unfitted(values: FloatArray, orthonormal: FloatArray) -> FloatArray:
    """What a least-squares fit by orthonormal columns leaves of values, by columns."""
    left: FloatArray = values - orthonormal @ (orthonormal.T @ values)
    return left


def orthonormal(basis: np.ndarray[tuple[int, ...], np.dtype[np.floating]]) -> FloatArray:
    """Orthonormal columns that span those of a basis."""
    orthonormal: FloatArray = np.linalg.qr(basis)[0]
    return orthonormal
