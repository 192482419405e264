"""Breakpoints of a split-domain fit: where to start, and a search for any objective.

Dynamic programming over a grid of edges gives the best segmentation of the domain for the errors of
single segments, which are cheap. From there, or from a deterministic global search (DIRECT-L), a
derivative-free local one (Nelder-Mead, restarted once) finishes, both from NLopt; breakpoints of
minimax fits are levelled instead (`edge_levelling`). Nothing is random: the same input gives the
same breakpoints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations, product

import numpy as np
from numpy.polynomial import chebyshev

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import (
    Curve,
    Mask,
    MinimaxProgramme,
    SideConditions,
    condition_rows,
    local_peaks,
    null_space,
    to_domain,
)

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


# Breakpoints of minimax fits as what they are: variables of the same problem.
#
# Successive linear programmes change coefficients and breakpoints together until the errors
# of the segments are level.

# Largest move of a breakpoint in one step, as a share of the narrower segment beside it, first and
# last.
_MOST_STEPS = 25
_FIRST_RADIUS = 0.15
_LAST_RADIUS = 1e-3

# Starts that rough curves get beside the first, and when a curve is rough: its Chebyshev
# coefficients from nine degrees above that of the fit are together more than half the one next to
# it. Closed forms have 1e-3, with a root at zero 0.1; a saturation model has up to 4 where the
# errors come down to the bends of its curves.
_OTHER_STARTS = 8
_PRIMES = np.array([2.0, 3.0, 5.0, 7.0])
_HIGHER, _ROUGH = 9, 0.5

# What is tried around the best end of three or more segments, where low places are long and flat
# valleys with bends: breakpoints as powers of their share of the domain, all of them and one at a
# time, again if that lowers the error by 0.2 %.
_ROUNDS = 2
_POWERS = (0.8, 1.25)
_GAIN = 0.998

# What is tried beside the end of two segments that had one start alone, where estimates there are
# not above this multiple of its own.
_NEAR_POWERS, _NEARLY = (1.15, 1.0 / 1.15), 1.45
Levelled = tuple[FloatArray, float]  # Edges of shape (S + 1,), and the error that they leave.

# Relative distance between the attained error and its linear model at which the levelling stops.
_LEVEL_GOAL = 1e-3
_FEWER = 4  # Every fourth point is enough to compare segmentations.

# Step of the numerical derivative by a breakpoint, as a share of the narrower segment beside it.
_DIFFERENCE = 1e-3


def level_edges(
    curves: Sequence[Curve], degree: int, segments: int, side: SideConditions, end: float
) -> FloatArray:
    """Edges with the least largest error of minimax fits to all curves, shape (S + 1,),
    rounded as by `search`.

    Args:
        curves: Vectorised functions to fit on the same segments, in the same unit.
        degree: Degree of each segment.
        segments: Number of segments S, at least 1.
        side: Equalities that the fits keep.
        end: End of the domain.

    Raises:
        NoSolutionError: A linear programme failed.

    Notes:
        In the local variable of each segment the side conditions do not depend on the breakpoints,
        and the curves do so smoothly: minimise over coefficients and breakpoints the largest
        |f(x(xi, t)) - p(xi)|. Each step solves this with f linear in t within a trust region
        (Madsen, J. Inst. Maths Applics 16, 1975, pp. 321-328). Only what polynomials cannot follow
        enters, so that the model holds for moves of a tenth of a segment.
    """
    if segments == 1:
        return np.array([0.0, end])
    errors = segment_errors(curves, degree, side, end)
    first = errors.best_edges(segments)
    if errors.largest[0, -1] <= errors.rounding:
        return rounded_edges(first)
    levelling = _Levelling(curves, degree, segments, side)
    starts = Segmentations(errors, segments).starts(levelling.estimates)
    if levelling.is_rough(first):
        starts += _other_starts(first)
    runs = [levelling.run(start, errors.rounding) for start in starts]
    found = _best(runs, degree, (first, math.inf))
    if segments == 2 and len(starts) == 1:
        runs = [levelling.run(edges, errors.rounding) for edges in levelling.hidden(found[0])]
        beside = _best(runs, degree, found)
        found = beside if _error(beside) < _GAIN * _error(found) else found
    for _ in range(_ROUNDS if segments > 2 else 0):
        runs = [levelling.run(start, errors.rounding) for start in _beside(found[0])]
        beside = _best(runs, degree, found)
        if _error(beside) > _GAIN * _error(found):
            break
        found = beside
    return rounded_edges(found[0])


def _best(runs: list[Levelled], degree: int, default: Levelled) -> Levelled:
    """The least error of those whose powers floats can hold: segments of level errors may be too
    narrow for that where a curve is steep at zero.
    """
    held = (levelled for levelled in runs if _widths_hold(levelled[0], degree))
    return min(held, key=_error, default=default)


def _error(found: Levelled) -> float:
    return found[1]


def _widths_hold(edges: FloatArray, degree: int) -> bool:
    """Whether floats hold the powers of every segment's width."""
    return bool(np.min(np.diff(edges)) ** degree > LEAST_POWER)


def _beside(edges: FloatArray) -> list[FloatArray]:
    """Segmentations beside one: all breakpoints, or one of them, nearer to zero,
    and farther from it.
    """
    shares = edges / edges[-1]
    exponents = np.vstack([np.ones(edges.size), np.eye(edges.size)[1:-1]])
    moved = [shares ** (power**exponent) for exponent in exponents for power in _POWERS]
    return [edges[-1] * found for found in moved if np.all(np.diff(found) > 0.0)]


def _other_starts(edges: FloatArray) -> list[FloatArray]:
    """Segmentations around one, with widths up to 2.2 times as large or small, spread evenly:
    multiples of roots.
    """
    widths = np.diff(edges)
    starts = []
    for index in range(1, _OTHER_STARTS + 1):
        spread = np.modf(index * np.sqrt(_PRIMES[: widths.size]))[0]
        scaled = np.cumsum(widths * np.exp(0.8 * (2.0 * spread - 1.0)))
        starts.append(np.array([0.0, *(edges[-1] * scaled[:-1] / scaled[-1]), edges[-1]]))
    return starts


class _Levelling:
    """Successive linear programmes for the breakpoints of minimax fits."""

    def __init__(
        self, curves: Sequence[Curve], degree: int, segments: int, side: SideConditions
    ) -> None:
        self.curves = curves
        self.shape = (len(curves), segments)
        # 16 points per extremum: between them the error rises by less than 0.5 %.
        self.nodes = -np.cos(np.linspace(0.0, np.pi, 16 * (degree + 1) + 1))
        self.basis = chebyshev.chebvander(self.nodes, degree)
        free = null_space(condition_rows(segments, degree, side))
        self.feasible = orthonormal(np.kron(np.eye(segments), self.basis) @ free)
        self.few = orthonormal(np.kron(np.eye(segments), self.basis[::_FEWER]) @ free)
        self.programme = MinimaxProgramme(len(curves), segments, degree, side, moves=segments - 1)

    def residual(self, edges: FloatArray) -> FloatArray:
        """What the least-squares fits under the side conditions leave of the curves, shape (A, S,
        P).
        """
        points = to_domain(self.nodes, edges)
        values = np.array([curve(points).ravel() for curve in self.curves])
        return unfitted(values.T, self.feasible).T.reshape(*self.shape, self.nodes.size)

    def estimates(self, edges: FloatArray) -> FloatArray:
        """Largest errors of least-squares fits under the side conditions, at fewer points,
        of many segmentations.

        Some 10 to 50 % above the minimax errors; edges of shape (K, S + 1) to (K,).
        """
        width = np.diff(edges)[:, :, np.newaxis]
        points = edges[:, :-1, np.newaxis] + 0.5 * width * (self.nodes[::_FEWER] + 1.0)
        worst = np.zeros(edges.shape[0])
        for curve in self.curves:
            left = unfitted(curve(points).reshape(edges.shape[0], -1).T, self.few)
            worst = np.maximum(worst, np.max(np.abs(left), axis=0))
        return worst

    def slopes(self, edges: FloatArray, reach: FloatArray, base: FloatArray) -> FloatArray:
        """Change of the residual per move of each breakpoint, in multiples of ``reach``, shape (A,
        S, P, S - 1).
        """
        changes = []
        for index, size in enumerate(reach, start=1):
            moved = edges.copy()
            moved[index] += _DIFFERENCE * size
            changes.append((self.residual(moved) - base) / _DIFFERENCE)
        return np.stack(changes, axis=-1)

    def is_rough(self, edges: FloatArray) -> bool:
        """Whether a curve has so much beyond the next degree that segmentations other than
        the best one may be level.

        A smooth curve leaves a multiple of the next Chebyshev polynomial on each segment, whose
        size rises with the width: then the level segmentation is the only one. Not so where the
        errors of short and long segments differ by what lies between.
        """
        high = _HIGHER + self.programme.degree
        later = self.residual(edges)[:, 1:].reshape(
            -1, self.nodes.size
        )  # a root at zero is steep there, but not rough
        series = chebyshev.chebfit(self.nodes, later.T, 3 * high)
        size = float(np.max(np.abs(series[self.programme.degree + 1])))
        return float(np.max(np.sum(np.abs(series[high:]), axis=0))) > _ROUGH * size

    def hidden(self, edges: FloatArray) -> list[FloatArray]:
        """Segmentations beside one into two, nearer to zero and farther from it, that the estimates
        hold to be nearly as good: a low place there may be lower, and hidden.
        """
        shares = edges / edges[-1]
        moved = edges[-1] * np.array([shares**power for power in _NEAR_POWERS])
        sizes = self.estimates(np.vstack([edges, moved]))
        return list(moved[sizes[1:] < _NEARLY * sizes[0]])

    def run(self, edges: FloatArray, rounding: float) -> Levelled:
        """Edges of level errors from a start, shape (S + 1,), and the error.

        Stops at errors below ``rounding``.
        """
        chosen: Mask = np.zeros((*self.shape, self.nodes.size), dtype=np.bool_)
        chosen[:, :, ::8] = True
        base = self.residual(edges)
        error, best, model, radius = base, float(np.max(np.abs(base))), np.inf, _FIRST_RADIUS
        for _ in range(_MOST_STEPS):
            if best <= rounding:
                break
            chosen |= local_peaks(error)
            reach = np.minimum(np.diff(edges)[:-1], np.diff(edges)[1:])
            series, moves, bound = self._solve(
                chosen, base / best, self.slopes(edges, reach, base) / best, radius
            )
            before, model = model, bound * best
            trial = edges.copy()
            trial[1:-1] += moves * reach
            trial_base = self.residual(trial)
            trial_error = trial_base - best * series @ self.basis.T
            worst = float(np.max(np.abs(trial_error)))
            step = float(np.max(np.abs(moves)))
            settled = (
                step < min(10.0 * _LAST_RADIUS, 0.99 * radius)
                and abs(model - before) < _LEVEL_GOAL * model
            )
            if settled or radius < _LAST_RADIUS:
                return (
                    trial,
                    model,
                )  # what is left between error and model lies between the chosen points
            if worst < best:
                edges, base, error, best = trial, trial_base, trial_error, worst
                if best < (1.0 + _LEVEL_GOAL) * model and step < 0.99 * radius:
                    break
            else:
                radius *= 0.5
                chosen |= local_peaks(trial_error)
        return edges, best

    def _solve(
        self, chosen: Mask, residual: FloatArray, slopes: FloatArray, radius: float
    ) -> tuple[FloatArray, FloatArray, float]:
        curve, segment, point = np.nonzero(chosen)
        block = curve * self.shape[1] + segment
        return self.programme.solve(
            block, self.nodes[point], residual[chosen], slopes[chosen], radius
        )


# Where the searches for breakpoints begin: one start for each low place of the
# error over all segmentations.
#
# The error of the best fits need not fall to one lowest place as the breakpoints move. Where a
# derivative of the curve changes its sign, the error of a segment across that place first falls and
# then rises with its length, and the ties between the segments add to it: two segmentations with a
# worse one between them are common. So the error is looked at over a lattice of segmentations, and
# a search begins from each of its low places.

# Steps of the lattice along the domain, by the number of segments: 31, 136 and 120 segmentations.
_STEPS = {2: 32, 3: 18, 4: 11}

# Multiple of the least error up to which a low place is a start. What a search reaches from there
# is lower than what is looked at by up to so much, and by more in one place than in another.
_LOW = 2.0
_MOST_PLACES = 3

# Multiple of the least cost up to which places count as one plain, on which small errors of the
# cost hide the best.
_PLAIN = 1.5
_WIDE = 3  # Steps from which on a plain is wide: then it is entered from its ends as well.
_APART = 0.5  # Steps of the lattice from which on two starts lead to different ends.


class Segmentations:
    """A lattice of segmentations of the domain, denser where the curves bend.

    Its steps along the domain are equal shares of the best segmentation into twice as many parts.
    ``squared`` says that the first start is that of the squared errors.
    """

    def __init__(self, errors: SegmentErrors, segments: int, *, squared: bool = False) -> None:
        self.first = errors.best_edges(segments, squared=squared)
        self.steps = _STEPS[segments]
        self.level = errors.best_edges(2 * segments)
        self.share = np.linspace(0.0, float(self.steps), self.level.size)
        self.places = list(combinations(range(1, self.steps), segments - 1))
        inner = np.interp(np.array(self.places, dtype=np.float64), self.share, self.level)
        zero = np.zeros((len(self.places), 1))
        self.edges = np.concatenate([zero, inner, zero + self.level[-1]], axis=1)

    def place(self, edges: FloatArray) -> FloatArray:
        """Where breakpoints lie, in steps of the lattice: edges of shape (S + 1,) to (S - 1,)."""
        return np.interp(edges[1:-1], self.level, self.share)

    def low_places(self, cost: FloatArray) -> list[FloatArray]:
        """Segmentations whose cost, shape (K,), no neighbour undercuts: at most three,
        the least one first.
        """
        value = dict(zip(self.places, cost.tolist(), strict=True))
        moves = [move for move in product((-1, 0, 1), repeat=len(self.places[0])) if any(move)]

        def is_low(place: tuple[int, ...]) -> bool:
            beside = (tuple(a + b for a, b in zip(place, move, strict=True)) for move in moves)
            return all(value[place] <= value.get(other, np.inf) for other in beside)

        order = [
            index for index in np.argsort(cost, kind="stable") if cost[index] <= _LOW * np.min(cost)
        ]
        return [self.edges[index] for index in order if is_low(self.places[index])][:_MOST_PLACES]

    def ends_of_plain(self, cost: FloatArray) -> list[FloatArray]:
        """The best segmentations at both ends of the low plain, along each breakpoint for which it
        is wide.
        """
        low = np.flatnonzero(cost <= _PLAIN * np.min(cost))
        places = np.array(self.places)[low]
        found = []
        for along in places.T:
            for end in (np.min(along), np.max(along)) if np.ptp(along) >= _WIDE else ():
                at_end = low[along == end]
                found.append(self.edges[at_end[np.argmin(cost[at_end])]])
        return found

    def starts(self, cost: Callable[[FloatArray], FloatArray]) -> list[FloatArray]:
        """Segmentations to begin from, each of shape (S + 1,): the best one without ties,
        and the low places.

        Args:
            cost: What segmentations of shape (K, S + 1) err by, shape (K,); need not be what the
                search lowers.
        """
        kept = [self.first]
        costs = cost(self.edges)
        for edges in self.low_places(costs) + self.ends_of_plain(costs):
            here = self.place(edges)
            if all(np.max(np.abs(here - self.place(other))) > _APART for other in kept):
                kept.append(edges)
        return kept
