"""Where two segments best meet, over how far a machine's curve bends: one table for all machines.

In per unit all salient machines have one MTPA curve, so that the best breakpoint over the end of
the domain is a function of tau alone, the end in units of the curve's base torque. It jumps where
another low place becomes the lowest. The table holds the best place of each tau, found among all
breakpoints; between two entries it is interpolated only where both lie in the same low place.
"""

from __future__ import annotations

from functools import cache
from itertools import accumulate
from operator import mul

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import FitMethod
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import SideConditions
from dqforge.optimizer.machine_batch.batch_currents import strategy_currents
from dqforge.optimizer.machine_batch.batch_fits import fit_columns, segment_points
from dqforge.optimizer.machine_batch.local_series import series_space

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
