"""Breakpoints of minimax fits as what they are: variables of the same problem.

Successive linear programmes change coefficients and breakpoints together until the errors
of the segments are level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import chebyshev

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.curves.breakpoints import (
    LEAST_POWER,
    orthonormal,
    rounded_edges,
    segment_errors,
    unfitted,
)
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
from dqforge.optimizer.curves.segmentations import Segmentations

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
