"""Currents and limit torques of many linear machines by formula, one column per machine.

The equations are those of `dqforge.optimizer.operating_points.mtpa_locus`: every salient machine
with a magnet has the same MTPA curve in per unit, the others have straight lines or square roots.
Nothing iterates towards a tolerance, and every operation is a sum, product, quotient or root of
single elements, which are rounded alike everywhere: a machine has the same numbers in any batch and
on any processor.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import accumulate
from math import comb
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import FitForm, FitMethod, Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.fit import AXES, least_degree
from dqforge.optimizer.curves.fitting import SideConditions
from dqforge.optimizer.curves.single_precision import (
    PiecewisePolynomial,
    SingleArray,
    power_of_series,
)
from dqforge.optimizer.exploration.sensitivities import (
    SeriesSpace,
    lobatto_nodes,
    minimax_fit,
    series_space,
    series_values,
    weighted_fit,
)

_NEWTON_STEPS = 4  # From a start 12 % off at most, the fourth step reaches the last digit.


def drives(batch: MachineBatch, strategy: Strategy) -> BoolArray:
    """Which machines make torque with a strategy, shape (N,).

    Args:
        batch: N machines.
        strategy: ``mtpa`` needs magnet flux or saliency, ``id0`` magnet flux.
    """
    magnet = batch.psi_pm > 0.0
    return magnet if strategy == "id0" else magnet | (batch.saliency != 0.0)


def strategy_currents(
    batch: MachineBatch, strategy: Strategy, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Currents (i_d, i_q) in A of a strategy for torque in N m, without a current limit.

    Args:
        batch: N machines, of every saliency.
        strategy: ``mtpa`` (least copper loss) or ``id0``.
        torque: Torques of any sign in N m, shape (..., N).

    Returns:
        Shape (..., N); NaN for machines that make no torque with the strategy.
    """
    torque = np.asarray(torque, dtype=np.float64)
    if strategy == "id0":
        i_q = torque / _or_nan(batch.torque_per_ampere)
        return np.where(np.isnan(i_q), np.nan, 0.0), i_q
    saliency, size = batch.saliency, np.abs(batch.saliency)
    magnet = batch.psi_pm > 0.0
    curved = magnet & (saliency != 0.0)
    base = batch.psi_pm / (2.0 * np.where(curved, size, 1.0))
    base_torque = 0.75 * batch.pole_pairs * batch.psi_pm * base
    i_d, i_q = _per_unit(np.asarray(torque / np.where(curved, base_torque, 1.0)))
    i_d, i_q = np.sign(saliency) * base * i_d, base * i_q
    if np.all(curved):
        return i_d, i_q
    straight = torque / _or_nan(batch.torque_per_ampere)
    per_square = np.asarray(1.5 * batch.pole_pairs * size, dtype=np.float64)
    root = np.sqrt(np.abs(torque) / _or_nan(per_square))
    without = np.where(magnet, 0.0, -np.sign(saliency) * root)
    alone = np.where(magnet, straight, np.copysign(root, torque))
    return np.where(curved, i_d, without), np.where(curved, i_q, alone)


def _per_unit(torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """MTPA currents (i_d <= 0, i_q) in per unit for torque in per unit of any sign, any shape.

    Newton's method on T = i_q (1 + sqrt(1 + i_q^2)), which is convex, from its asymptotes.
    """
    size = np.abs(torque)
    i_q = size / (1.0 + np.sqrt(1.0 + size))
    for _ in range(_NEWTON_STEPS):
        square = i_q * i_q
        flux = np.sqrt(1.0 + square)
        i_q -= (i_q * (1.0 + flux) - size) / (1.0 + flux + square / flux)
    square = i_q * i_q
    return -square / (1.0 + np.sqrt(1.0 + square)), np.copysign(i_q, torque)


def currents_of_size(
    batch: MachineBatch, strategy: Strategy, current: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Point (i_d, i_q >= 0) in A of a strategy with the current magnitude given.

    i_d = psi/(4 dl) - sqrt((psi/(4 dl))^2 + I^2/2) with dl = l_q - l_d, written without
    cancellation.

    Args:
        batch: N machines.
        strategy: ``mtpa`` or ``id0``.
        current: Magnitudes in A (peak), shape (..., N).
    """
    current = np.asarray(current, dtype=np.float64)
    if strategy == "id0":
        return np.zeros(np.broadcast_shapes(current.shape, batch.l_d.shape)), current + 0.0
    salient = batch.saliency != 0.0
    quarter = batch.psi_pm / (4.0 * np.where(salient, np.abs(batch.saliency), 1.0))
    half_square = 0.5 * current**2
    denominator = quarter + np.sqrt(quarter**2 + half_square)
    is_point = salient & (half_square > 0.0)
    i_d = np.where(is_point, -half_square / np.where(is_point, denominator, 1.0), 0.0)
    i_q = np.sqrt(np.maximum(current**2 - i_d**2, 0.0))
    return np.sign(batch.saliency) * i_d, np.where(salient, i_q, current)


def largest_torques(batch: MachineBatch, strategy: Strategy) -> FloatArray:
    """Largest torque in N m within each machine's ``i_max``, shape (N,); NaN where a strategy makes
    none.

    Args:
        batch: N machines.
        strategy: ``mtpa`` or ``id0``.
    """
    most = batch.torque(*currents_of_size(batch, strategy, batch.i_max))
    return np.where(drives(batch, strategy), most, np.nan)


def _or_nan(value: FloatArray) -> FloatArray:
    """Divisors with NaN for zero."""
    return np.where(value != 0.0, value, np.nan)


# Current references of many linear machines at once: `fit_reference` for columns.
#
# What is fitted, under which conditions and in which forms is as in
# `dqforge.optimizer.current_reference.fit`; minimax fits by reweighting and breakpoints from a
# table make it some thousand times cheaper, and 1 or 2 % worse. Headers are made by the single path
# alone.

_TOGETHER = 512  # Machines fitted at once: their arrays stay in the cache.
_MOST_SEGMENTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceBatch:
    """Current references of N machines.

    Args:
        settings: What was asked for.
        torque_max: Ends of the domains in N m, shape (N,).
        edges, coefficients: By axis where the form has a polynomial: edges in N m, shape (S + 1,
            N), and ascending powers of t - edge in A/(N m)^k, shape (S, n + 1, N).
        errors: Largest errors, arrays of shape (N,).
        solved: False where the single path has to say what is wrong, or to answer: no torque is
            made, the domain asked for needs more current, a breakpoint lies beyond it, or the form
            does not suit the machine. All numbers are NaN there.
    """

    settings: FitSettings
    torque_max: FloatArray
    edges: dict[str, FloatArray]
    coefficients: dict[str, FloatArray]
    errors: BatchErrors
    solved: BoolArray

    def piecewise(self, axis: str, row: int) -> PiecewisePolynomial:
        """The polynomials of one machine, A over N m."""
        return PiecewisePolynomial(
            self.edges[axis][:, row].copy(), self.coefficients[axis][..., row].copy()
        )


def why_not_in_batch(settings: FitSettings) -> str | None:
    """What of fit settings columns do not have, in words; None where they have all of it.

    Args:
        settings: Of a linear machine's reference, for operation below the voltage limit.
    """
    if settings.budget is not None or settings.format not in (None, "float32"):
        return "a budget or a fixed-point format"
    if settings.method not in BATCH_METHODS:
        return f"method {settings.method}"
    if settings.segments > _MOST_SEGMENTS:
        return f"{settings.segments} segments"
    if settings.degree < least_degree(settings.form, settings):
        return f"degree {settings.degree}"
    return None


def fit_references(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy = "mtpa"
) -> ReferenceBatch:
    """Current references of many machines.

    Args:
        batch: N machines.
        settings: Form, method, degree, segments, breakpoints, side conditions, and the end of the
            domain where it is given.
        strategy: ``mtpa`` or ``id0``.

    Raises:
        InputError: The settings ask for what columns do not have (`why_not_in_batch`).
    """
    lacking = why_not_in_batch(settings)
    if lacking is not None:
        raise InputError(f"fit: {lacking} is not fitted in batches")
    end, solved = _domains(batch, settings, strategy)
    rows = np.flatnonzero(solved)
    groups = np.split(rows, np.arange(_TOGETHER, rows.size, _TOGETHER)) if rows.size else []
    parts = [_fitted(batch.taken(group), settings, strategy, end[group]) for group in groups]
    return _spread(settings, np.where(solved, end, np.nan), solved, parts)


def _domains(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy
) -> tuple[FloatArray, BoolArray]:
    """Ends of the domains in N m, and which machines can be fitted over them."""
    most = largest_torques(batch, strategy)
    end = most if settings.torque_max is None else np.full(most.shape, settings.torque_max)
    solved = drives(batch, strategy) & (end <= most * (1.0 + 1e-12))
    if settings.breakpoints:
        solved &= end > settings.breakpoints[-1]
    if settings.form in ("torque-exact", "even-odd"):
        solved &= batch.psi_pm > 0.0
    return end, solved


def _fitted(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy, end: FloatArray
) -> tuple[FormColumns, BatchErrors]:
    magnet = batch.psi_pm > 0.0
    proportional = magnet & ((batch.saliency == 0.0) | (strategy == "id0"))
    rooted = ~magnet & (settings.form == "closed-form")
    edges = _edges(batch, settings, end, proportional)
    coefficients: dict[str, FloatArray] = {}
    for axis in AXES[settings.form]:
        coefficients[axis] = _axis_fit(batch, settings, strategy, edges, coefficients, axis)
        coefficients[axis][..., proportional | rooted] = 0.0
    columns = FormColumns(settings.form, edges, coefficients, proportional, rooted)
    return columns, form_errors(batch, strategy, columns, end)


def _edges(
    batch: MachineBatch, settings: FitSettings, end: FloatArray, straight: BoolArray
) -> dict[str, FloatArray]:
    """Edges of each axis in N m, shape (S + 1, N)."""
    axes, zero = AXES[settings.form], np.zeros_like(end)
    if settings.segments == 1:
        return dict.fromkeys(axes, np.stack([zero, end]))
    if settings.breakpoints is not None:
        return dict.fromkeys(axes, np.stack([zero, zero + settings.breakpoints[0], end]))
    size = np.where(straight, 1.0, np.abs(batch.saliency))
    base_torque = 0.75 * batch.pole_pairs * batch.psi_pm * (batch.psi_pm / (2.0 * size))
    bent = np.full_like(end, np.inf)
    np.divide(end, base_torque, out=bent, where=base_torque > 0.0)
    tau = np.where(straight, 0.0, bent)
    side = SideConditions(settings.exact_at_zero, settings.continuous)
    groups = [(axis,) for axis in axes] if settings.breakpoint_mode == "own" else [axes]
    edges: dict[str, FloatArray] = {}
    for group in groups:
        shares = breakpoint_shares(SharedFit(group, settings.degree, settings.method, side), tau)
        edges |= dict.fromkeys(group, np.stack([zero, shares * end, end]))
    return edges


def _axis_fit(
    batch: MachineBatch,
    settings: FitSettings,
    strategy: Strategy,
    edges: dict[str, FloatArray],
    before: dict[str, FloatArray],
    axis: str,
) -> FloatArray:
    """Coefficients of one axis, shape (S, n + 1, N); ``before`` are those of the axes before it."""
    side, degree = SideConditions(settings.exact_at_zero, settings.continuous), settings.degree
    if settings.form == "even-odd":
        side = SideConditions(True, settings.continuous, (1,) if axis == "d" else (2,))
        degree += axis == "q"
    elif settings.flat_at_zero and axis == "d":
        side = replace(side, absent=(1,))
    space = series_space(degree, settings.segments, side)
    points = segment_points(space.nodes, edges[axis])
    if settings.form == "even-odd" and axis == "q":
        slope = -1.5 * batch.pole_pairs * batch.saliency
        d = power_values(before["d"], edges["d"], points)
        values = points / (batch.torque_per_ampere + slope * d)
    else:
        values = strategy_currents(batch, strategy, points)["dq".index(axis)]
    widths = np.diff(edges[axis], axis=0)
    series, _ = fit_columns(space, settings.method, widths, values)
    coefficients = local_powers(series, widths)
    if side.exact_at_zero:
        coefficients[0, 0] = 0.0  # but for rounding
    coefficients[0, list(side.absent)] = 0.0
    return coefficients


def _spread(
    settings: FitSettings,
    end: FloatArray,
    solved: BoolArray,
    parts: list[tuple[FormColumns, BatchErrors]],
) -> ReferenceBatch:
    """Parts side by side, with NaN where nothing was solved."""

    def spread(pieces: list[FloatArray]) -> FloatArray:
        whole = np.concatenate(pieces, axis=-1) if pieces else np.zeros((0,))
        found = np.full((*whole.shape[:-1], solved.size), np.nan)
        found[..., solved] = whole
        return found

    errors: dict[str, Any] = {
        name: spread([getattr(part, name) for _, part in parts])
        for name in ("i_d", "i_q", "torque", "torque_relative")
    }
    axes = parts[0][0].coefficients if parts else ()
    return ReferenceBatch(
        settings,
        end,
        {axis: spread([columns.edges[axis] for columns, _ in parts]) for axis in axes},
        {axis: spread([columns.coefficients[axis] for columns, _ in parts]) for axis in axes},
        BatchErrors(**errors),
        solved,
    )


# The float arithmetic of many current references at once, and its errors.
#
# The operations are those of `dqforge.optimizer.current_reference.forms`, with every product and
# sum rounded to float32.

# Torques per segment and coefficient at which errors are looked at: between them they rise by 1 %,
# seldom 2 %.
_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class BatchErrors:
    """Largest errors of references, arrays of shape (N,), as `ReferenceErrors` defines them.

    ``i_d`` and ``i_q`` in A against the exact strategy, ``torque`` in N m against the request,
    ``torque_relative`` over the largest torque: of the float32 arithmetic without fused
    multiply-add, found by sampling.
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    torque_relative: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FormColumns:
    """References of N machines in one form.

    ``edges`` in N m by axis, shape (S + 1, N), and ``coefficients`` in double, ascending powers of
    t - edge, shape (S, n + 1, N), by axis where the form has a polynomial. ``proportional`` marks
    machines whose exact reference is a straight line, ``rooted`` those whose exact one is a root.
    """

    form: FitForm
    edges: dict[str, FloatArray]
    coefficients: dict[str, FloatArray]
    proportional: BoolArray
    rooted: BoolArray


def rounded_in_turn(coefficients: FloatArray, widths: FloatArray) -> SingleArray:
    """Floats of ascending coefficients, shape (S, n + 1, N), as `SinglePolynomial.from_double`.

    Args:
        coefficients: In double.
        widths: Widths of the segments, shape (S, N).
    """
    rows = coefficients.copy()
    for power in range(rows.shape[1] - 1, 0, -1):
        change = rows[:, power] - rows[:, power].astype(np.float32)
        scale = change
        for lower in range(power - 1, 0, -1):
            scale = scale * widths
            rows[:, lower] -= _monic_chebyshev(power)[lower] * scale
        rows[:, power] -= change
    # Segments that lack a power keep lacking it and are rounded plainly.
    full = np.all(coefficients[:, 1:] != 0.0, axis=1)[:, np.newaxis]
    return np.where(full, rows, coefficients).astype(np.float32)


@cache
def _monic_chebyshev(degree: int) -> tuple[float, ...]:
    """Ascending coefficients of the monic polynomial with the least largest value on [0, 1]."""
    powers = [
        (-1.0) ** (degree - k) * degree / (degree + k) * comb(degree + k, degree - k) * 4.0**k
        for k in range(degree + 1)
    ]
    return tuple(power / powers[-1] for power in powers)


def form_errors(
    batch: MachineBatch, strategy: Strategy, columns: FormColumns, end: FloatArray
) -> BatchErrors:
    """Errors of references over their domains.

    Args:
        batch: N machines.
        strategy: What is exact.
        columns: References.
        end: Ends of the domains in N m, shape (N,).
    """
    limit = end.astype(np.float32)
    edges = np.concatenate([np.zeros((1, end.size)), *columns.edges.values(), end[np.newaxis]])
    sampled = np.sort(edges, axis=0)  # with own breakpoints each axis has its edges
    degree = max((part.shape[1] - 1 for part in columns.coefficients.values()), default=1)
    points = segment_points(lobatto_nodes(_SAMPLES * (degree + 1) + 1), sampled)
    torque = np.minimum(points.astype(np.float32), limit).reshape(-1, end.size)
    i_d, i_q = (part.astype(np.float64) for part in _currents(batch, columns, torque))
    request = torque.astype(np.float64)
    exact_d, exact_q = strategy_currents(batch, strategy, request)
    worst = _largest(batch.torque(i_d, i_q) - request)
    return BatchErrors(
        _largest(i_d - exact_d), _largest(i_q - exact_q), worst, worst / limit.astype(np.float64)
    )


def _largest(error: FloatArray) -> FloatArray:
    return np.asarray(np.max(np.abs(error), axis=0))


def _currents(
    batch: MachineBatch, columns: FormColumns, torque: SingleArray
) -> tuple[SingleArray, SingleArray]:
    """(i_d, i_q) in A for torques >= 0 in N m, float32, shape (P, N)."""
    values = {
        axis: _polynomial(columns.edges[axis], coefficients, torque)
        for axis, coefficients in columns.coefficients.items()
    }
    magnet = batch.torque_per_ampere.astype(np.float32)
    turn = np.sign(batch.saliency).astype(np.float32)
    # What the exact forms of other machines in the batch divide by zero is not taken.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if columns.form in ("polynomial", "even-odd"):
            found = values["d"], values["q"]
        elif columns.form == "torque-exact":
            slope = (-1.5 * batch.pole_pairs * batch.saliency).astype(np.float32)
            found = values["d"], torque / (slope * values["d"] + magnet)
        else:
            base = (batch.psi_pm / (2.0 * np.abs(batch.saliency))).astype(np.float32)
            root = np.sqrt(values["q"] * values["q"] + base * base)
            found = turn * (base - root), values["q"]
        gain = (1.0 / batch.torque_per_ampere).astype(np.float32)
        rising = (1.0 / (1.5 * batch.pole_pairs * np.abs(batch.saliency))).astype(np.float32)
        rooted = np.sqrt(rising * torque)
        exact_d = np.where(columns.rooted, -turn * rooted, np.float32(0.0))
        exact_q = np.where(columns.rooted, rooted, gain * torque)
    exact = columns.proportional | columns.rooted
    return np.where(exact, exact_d, found[0]), np.where(exact, exact_q, found[1])


def _polynomial(edges: FloatArray, coefficients: FloatArray, torque: SingleArray) -> SingleArray:
    """Piecewise polynomials in float32 at torques (P, N)."""
    floats = rounded_in_turn(coefficients, np.diff(edges, axis=0))
    starts = edges[:-1].astype(np.float32)
    value: NDArray[np.float32] = np.zeros_like(torque)
    for segment, start in enumerate(starts):
        local = torque - start
        part = np.broadcast_to(floats[segment, -1], torque.shape)
        for power in range(floats.shape[1] - 2, -1, -1):
            part = part * local + floats[segment, power]
        value = part if segment == 0 else np.where(torque >= start, part, value)
    return value


# Where two segments best meet, over how far a machine's curve bends: one table for all machines.
#
# In per unit all salient machines have one MTPA curve, so that the best breakpoint over the end of
# the domain is a function of tau alone, the end in units of the curve's base torque. It jumps where
# another low place becomes the lowest. The table holds the best place of each tau, found among all
# breakpoints; between two entries it is interpolated only where both lie in the same low place.

_STEPS = 16  # Entries per octave of tau.

# Powers of two of the first and the last tau: below, errors are rounding; above, the curve is the
# root of the torque but for its very beginning.
_OCTAVES = (-2, 14)

# Breakpoints that are looked at first, over the end of the domain, from 0.001 on; powers as
# products, which are rounded alike everywhere.
_SHARES = 0.95 / np.array(list(accumulate([1.0] + 62 * [1.12], mul)))[::-1]
_PLACES = 2  # So many low places are looked at closer, in steps that shrink thus.
_ZOOMS = (0.12, 0.03)

# Relative distance of two entries from which on they lie in different low places.
_SAME_PLACE = 0.15
_ROUNDING = 1e-13  # Errors of this share of the curve are rounding: every breakpoint is as good.
_WIDE = LinearMachine(pole_pairs=1, r_s=0.0, l_d=1.0, l_q=2.0, psi_pm=1.0, i_max=1.0)
_BASE_TORQUE = 0.375  # Base torque of that machine in N m.


@dataclass(frozen=True, slots=True)
class SharedFit:
    """Fits that share a breakpoint: the axes of the curves, and how they are fitted."""

    axes: tuple[str, ...]
    degree: int
    method: FitMethod
    side: SideConditions


def breakpoint_shares(fit: SharedFit, tau: FloatArray) -> FloatArray:
    """Best breakpoints over the end of the domain, shape (N,).

    Args:
        fit: What is fitted.
        tau: Ends of the domain over the base torque 3/4 p psi_pm^2 / (2 |l_q - l_d|), shape (N,);
            infinite without a magnet, zero where the curve is a straight line.
    """
    shares = np.full(tau.shape, 0.5)
    rooted = np.isinf(tau)
    if np.any(rooted):
        shares[rooted] = _without_magnet(fit)
    bent = (tau > 0.0) & ~rooted
    first, last = (2.0**power for power in _OCTAVES)
    mantissa, power = np.frexp(np.clip(tau, first, np.nextafter(last, 0.0)))
    place = (2.0 * mantissa - 1.0) * _STEPS
    entry = place.astype(np.intp)
    for octave in np.unique(power[bent]).tolist():
        rows = bent & (power == octave)
        table = _octave(fit, octave - 1)
        low, high = table[entry[rows]], table[entry[rows] + 1]
        within = place[rows] - entry[rows]
        same = np.abs(high - low) < _SAME_PLACE * np.minimum(low, high)
        nearest = np.where(within < 0.5, low, high)
        shares[rows] = np.where(same, low + within * (high - low), nearest)
    return shares


@cache
def _octave(fit: SharedFit, power: int) -> FloatArray:
    """Entries of one octave from tau = 2^power on, both ends included."""
    tau = 2.0**power * (1.0 + np.arange(_STEPS + 1) / _STEPS)
    return _best_shares(fit, MachineBatch.varied(_WIDE, tau.size, {}), tau * _BASE_TORQUE)


@cache
def _without_magnet(fit: SharedFit) -> float:
    machine = MachineBatch.varied(_WIDE, 1, {"psi_pm": np.zeros(1)})
    return float(_best_shares(fit, machine, np.ones(1))[0])


def _best_shares(fit: SharedFit, batch: MachineBatch, end: FloatArray) -> FloatArray:
    """Breakpoints with the least cost among all, by looking closer at the lowest places."""
    tried = np.broadcast_to(_SHARES[:, np.newaxis], (_SHARES.size, end.size))
    costs, sizes = _costs(fit, batch, end, tried)
    outer = np.pad(costs, ((1, 1), (0, 0)), constant_values=np.inf)
    is_low = (costs <= outer[:-2]) & (costs <= outer[2:])
    order = np.argsort(np.where(is_low, costs, np.inf), axis=0, kind="stable")[:_PLACES]
    shares = np.take_along_axis(tried, order, axis=0)
    for zoom in _ZOOMS:
        near = shares[:, np.newaxis] * (1.0 + zoom * np.linspace(-1.0, 1.0, 9)[:, np.newaxis])
        near = np.minimum(near, 0.99)
        flat = near.reshape(-1, end.size)
        costs = _costs(fit, batch, end, flat)[0].reshape(near.shape)
        best = np.argmin(costs, axis=1)[:, np.newaxis]
        shares = np.take_along_axis(near, best, axis=1)[:, 0]
        least = np.take_along_axis(costs, best, axis=1)[:, 0]
    lowest = np.argmin(least, axis=0)[np.newaxis]
    found = np.take_along_axis(shares, lowest, axis=0)[0]
    cost = np.take_along_axis(least, lowest, axis=0)[0]
    return np.where(cost <= _ROUNDING * sizes, 0.5, found)


def _costs(
    fit: SharedFit, batch: MachineBatch, end: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What fits cost with breakpoints of shape (B, N), the same shape, and how large curves are."""
    space = series_space(fit.degree, 2, fit.side)
    everyone = batch.taken(np.tile(np.arange(batch.count), shares.shape[0]))
    ends = np.tile(end, shares.shape[0])
    edges = np.stack([0.0 * ends, shares.ravel() * ends, ends])
    points = segment_points(space.nodes, edges)
    curves = dict(zip("dq", strategy_currents(everyone, "mtpa", points), strict=True))
    total, size = np.zeros(ends.size), np.zeros(ends.size)
    for axis in fit.axes:
        cost = fit_columns(space, fit.method, np.diff(edges, axis=0), curves[axis])[1]
        total = np.maximum(total, cost) if fit.method == "minimax" else total + cost
        largest = np.max(np.abs(curves[axis]), axis=(0, 1))
        size = np.maximum(size, largest if fit.method == "minimax" else largest**2 * ends)
    return total.reshape(shares.shape), size[: end.size]


# Fits of columns of curves by the methods of the single path, and their coefficients.
#
# Minimax fits by reweighting, least squares with the weights of Clenshaw and Curtis; both as
# `local_series` has them.

# Methods that fit columns; interpolation is left to the single path.
BATCH_METHODS: tuple[FitMethod, ...] = ("minimax", "least-squares")


def segment_points(nodes: FloatArray, edges: FloatArray) -> FloatArray:
    """Points of every segment, shape (S, P, N), for nodes in [-1, 1] and edges (S + 1, N)."""
    half = 0.5 * np.diff(edges, axis=0)[:, np.newaxis]
    return edges[:-1, np.newaxis] + half * (nodes[:, np.newaxis] + 1.0)


def fit_columns(
    space: SeriesSpace, method: FitMethod, widths: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Series (S, n + 1, N) of curves, and what the method makes small, shape (N,).

    Args:
        space: Admissible series.
        method: ``minimax``, whose cost is the largest error at the nodes, or ``least-squares``,
            whose cost is the integral of the squared error.
        widths: Widths of the segments, shape (S, N).
        values: Curves at the nodes of the segments, shape (S, P, N).
    """
    if method == "minimax":
        return minimax_fit(space, values)
    weights = 0.5 * widths[:, np.newaxis] * _integral_weights(space.nodes.size)[:, np.newaxis]
    series = weighted_fit(space, weights, values)
    # Once more on what is left, whose rounding is a share of the error and not of the curve.
    series = series + weighted_fit(space, weights, values - series_values(space, series))
    squares = weights * np.square(values - series_values(space, series))
    cost = np.zeros(values.shape[2])
    for part in squares.reshape(-1, values.shape[2]):
        cost += part
    return series, cost


@cache
def _integral_weights(count: int) -> FloatArray:
    """Weights of Clenshaw and Curtis at the extrema of a Chebyshev polynomial, shape (count,)."""
    last = count - 1
    weights = []
    for place in range(count):
        total = 1.0
        for k in range(1, last // 2 + 1):
            part = 1.0 if 2 * k == last else 2.0
            total -= part * math.cos(2.0 * k * place * math.pi / last) / (4.0 * k * k - 1.0)
        weights.append((1.0 if place in (0, last) else 2.0) / last * total)
    return np.array(weights)


def local_powers(series: FloatArray, widths: FloatArray) -> FloatArray:
    """Ascending powers of t - edge from Chebyshev series, both of shape (S, n + 1, N).

    Args:
        series: Series on each segment.
        widths: Widths of the segments, shape (S, N).
    """
    degree = series.shape[1] - 1
    found, scale = np.zeros_like(series), np.ones_like(widths)
    for power in range(degree + 1):
        row = power_of_series(degree, power)
        for order in range(power, degree + 1):
            found[:, power] += row[order] * series[:, order]
        found[:, power] /= scale
        scale = scale * (0.5 * widths)
    return found


def power_values(coefficients: FloatArray, edges: FloatArray, argument: FloatArray) -> FloatArray:
    """Values of piecewise polynomials at points that are sorted into segments, shape (S, P, N).

    Args:
        coefficients: Ascending powers of t - edge, shape (S, n + 1, N).
        edges: Edges, shape (S + 1, N).
        argument: Points, shape (S, P, N), of each segment its own.
    """
    local = argument - edges[:-1, np.newaxis]
    value = np.broadcast_to(coefficients[:, -1, np.newaxis], local.shape)
    for power in range(coefficients.shape[1] - 2, -1, -1):
        value = value * local + coefficients[:, power, np.newaxis]
    return np.asarray(value)
