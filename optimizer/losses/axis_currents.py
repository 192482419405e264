"""Currents of many linear machines at points of torque and speed, within current and voltage.

Where neither limits, the currents are those of a formula. Along the curve of one torque the squared
voltage of a machine with constant inductances is convex in i_d::

    |v|^2 = R^2 (i_d^2 + i_q^2) + omega^2 (psi_d^2 + psi_q^2) + 2 R omega T/k,   k = 3/2 p,
    i_q = T / (k (psi - (l_q - l_d) i_d))

since i_q^2 is. From the least-current point, where the voltage is too high, Newton's method
therefore runs to the crossing with the limit of least current without ever passing it, or finds
the curve level above the limit: then the voltage cannot be kept, whatever the current.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.losses.machine_budget import machine_budget
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions
from dqforge.optimizer.losses.drive_comparison import AIM, EXCESS, ROUNDS
from dqforge.optimizer.machine_batch.batch_currents import largest_torques, strategy_currents

_STEPS = 60
_STILL = 1e-13  # Newton step over the size of the current after which a crossing stands still.
_ROUNDING = 1e-9  # Relative slack within which a limit counts as kept, as of single points.
_DOUBT = 1e-6  # Relative distance from a limit within which a single machine decides.


@dataclass(frozen=True, slots=True, eq=False)
class AxisCurrents:
    """Currents of N points, arrays of shape (N,).

    Args:
        i_d, i_q: In A, NaN where the torque is out of reach.
        reached: Whether they make the torque within the limits.
        doubtful: True where a limit is so near that only the solver of single machines says on
            which side the point lies, or finds it.
    """

    i_d: FloatArray
    i_q: FloatArray
    reached: BoolArray
    doubtful: BoolArray


def axis_currents(
    machines: MachineBatch,
    strategy: Strategy,
    torque: FloatArray,
    omega_m: FloatArray,
    v_max: FloatArray,
    options: BudgetOptions,
) -> AxisCurrents:
    """Currents of one strategy at N points, a machine for each, as
    `dqforge.optimizer.losses.drive_comparison.strategy_currents` of single machines.

    Args:
        machines: A machine per point, its current limit in ``i_max``.
        strategy: ``mtpa``, which weakens the field, or ``id0``, which does not look at the voltage.
        torque, omega_m: In N m and rad/s, any sign, shape (N,).
        v_max: Largest phase amplitudes in V, shape (N,).
        options: What else drops voltage; the field is weakened for it, too.
    """
    if strategy == "id0":
        return _without_weakening(machines, torque)
    found = _within(machines, torque, omega_m, v_max)
    i_d, i_q = found.i_d.copy(), found.i_q.copy()
    reached, doubtful = found.reached.copy(), found.doubtful.copy()
    volts = v_max.copy()
    for _ in range(ROUNDS):
        made = machine_budget(
            machines, i_d, i_q, omega_m, loss=options.machine_loss, heat=options.winding
        )
        amplitude = np.hypot(made.v_d, made.v_q)
        with np.errstate(invalid="ignore"):
            high = made.steady & (amplitude > v_max * (1.0 + EXCESS))
        (over,) = np.nonzero(high & reached)
        if not over.size:
            break
        volts[over] *= v_max[over] / amplitude[over] * (1.0 - AIM)
        again = _within(machines.taken(over), torque[over], omega_m[over], volts[over])
        i_d[over], i_q[over] = again.i_d, again.i_q
        reached[over], doubtful[over] = again.reached, doubtful[over] | again.doubtful
    return AxisCurrents(i_d, i_q, reached, doubtful)


def _without_weakening(machines: MachineBatch, torque: FloatArray) -> AxisCurrents:
    """i_d = 0, up to the current limit; a machine without magnet makes no torque."""
    magnet = machines.psi_pm > 0.0
    most = machines.torque(np.zeros(torque.shape), machines.i_max)
    reached = np.where(magnet, np.abs(torque) <= most * (1.0 + 1e-12), torque == 0.0)
    i_q = np.where(magnet, torque / np.where(magnet, machines.torque_per_ampere, 1.0), 0.0)
    return AxisCurrents(
        np.where(reached, 0.0, np.nan),
        np.where(reached, i_q, np.nan),
        reached,
        np.zeros(torque.shape, dtype=np.bool_),
    )


def _within(
    machines: MachineBatch, torque: FloatArray, omega_m: FloatArray, v_max: FloatArray
) -> AxisCurrents:
    """Least current for a torque within the limits of current and voltage."""
    i_d, i_q = strategy_currents(machines, "mtpa", torque)
    omega_e = machines.pole_pairs * omega_m
    most = largest_torques(machines, "mtpa")
    size = np.abs(torque)
    with np.errstate(invalid="ignore"):
        reached = size <= most * (1.0 + _ROUNDING)
        doubtful = np.abs(size / most - 1.0) < _DOUBT
    v_d, v_q = machines.voltage(i_d, i_q, omega_e)
    # An amplitude that rounding alone lifts over the limit leads to the same currents.
    (rows,) = np.nonzero(reached & (v_d * v_d + v_q * v_q > v_max * v_max))
    if rows.size:
        some = machines.taken(rows)
        weak = _weakened(some, i_d[rows], torque[rows], omega_e[rows], v_max[rows])
        i_d[rows], i_q[rows] = weak.i_d, weak.i_q
        reached[rows], doubtful[rows] = weak.reached, doubtful[rows] | weak.doubtful
    return AxisCurrents(
        np.where(reached, i_d, np.nan), np.where(reached, i_q, np.nan), reached, doubtful
    )


def _weakened(
    machines: MachineBatch,
    i_d: FloatArray,
    torque: FloatArray,
    omega_e: FloatArray,
    v_max: FloatArray,
) -> AxisCurrents:
    """Crossing of the torque's curve with the voltage limit from the least-current point on."""
    along = torque / (1.5 * machines.pole_pairs)
    limit = v_max * v_max
    x, moves = i_d.copy(), np.ones(i_d.shape, dtype=np.bool_)
    level = np.zeros(i_d.shape, dtype=np.bool_)
    excess = np.zeros(i_d.shape)
    for _ in range(_STEPS):
        square, slope = _square_and_slope(machines, x, along, omega_e)
        gap = square - limit
        excess = np.where(moves, gap / limit, excess)
        level |= moves & (slope <= 0.0) & (gap > 0.0)
        moves = moves & ~level
        step = np.where(moves, gap / np.where(slope > 0.0, slope, 1.0), 0.0)
        x = x - step
        moves = moves & (np.abs(step) > _STILL * (np.abs(x) + 1e-3 * machines.i_max))
        if not np.any(moves):
            break
    i_q = along / (machines.psi_pm - machines.saliency * x)
    room = np.hypot(x, i_q) / machines.i_max
    reached = ~level & ~moves & (room <= 1.0 + _ROUNDING)
    doubtful = (level & (excess < _DOUBT)) | moves | (~level & (np.abs(room - 1.0) < _DOUBT))
    return AxisCurrents(x, i_q, reached, doubtful)


def _square_and_slope(
    machines: MachineBatch, i_d: FloatArray, along: FloatArray, omega_e: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """|v|^2 in V^2 along the curve of one torque and its derivative by i_d."""
    flux = machines.psi_pm - machines.saliency * i_d
    i_q = along / flux
    bend = machines.saliency * i_q / flux
    v_d, v_q = machines.voltage(i_d, i_q, omega_e)
    slope_d = machines.r_s - omega_e * machines.l_q * bend
    slope_q = machines.r_s * bend + omega_e * machines.l_d
    return v_d * v_d + v_q * v_q, 2.0 * (v_d * slope_d + v_q * slope_q)
