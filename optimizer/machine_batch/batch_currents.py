"""Currents and limit torques of many linear machines by formula, one column per machine.

The equations are those of `dqforge.optimizer.operating_points.mtpa`: every salient machine with a
magnet has the same MTPA curve in per unit, the others have straight lines or square roots. Nothing
iterates towards a tolerance, and every operation is a sum, product, quotient or root of single
elements, which are rounded alike everywhere: a machine has the same numbers in any batch and on any
processor.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.names import Strategy

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
