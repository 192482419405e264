"""Bounds of the voltage that a two-dimensional reference takes, resistance included,
on boxes of torque and excess.

With the flux linkage a of the last evaluation and what was taken for the squared current there,
J^2, the step holds omega^2 a^2 + 2 R omega s k t + R^2 J^2 <= V^2, where k t = T/(3/2 p) and s = 1
motoring, -1 generating. So, with z = R/(omega a) and q = k t/a,

    |v|^2/V^2 - 1 <= (|psi|^2/a^2 - 1 + 2 s z k e/a + z^2 (|i|^2 - J^2)) / (1 + 2 s z q + z^2 J^2)

where e is the error of the torque: nothing but what boxes of torque and excess flux linkage bound,
and z, which V >= V_least holds to 1/z >= sqrt(q^2 + (V_least/R)^2 - J^2) - s q; where the voltage
is larger than it need be, at low speed, larger z count for less.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, VoltageRegion

# Share of the squared voltage that the rounded operations of the step may add. Each adds at most
# 2^-24 of its result, in squared voltages: 1 the square, 3 times 4 the drop by the torque, 5 and 5
# what is left of both, twice 5 the root, twice 5 the quotient; at most 5 the squared current with
# its factor.
ROUNDING = 64.0 * 2.0**-24

# Share of the squared voltage up to which the drop by the torque is known to stay, for `ROUNDING`.
LARGEST_SHARE = 4.0

# Errors over the largest torque and over the flux linkage up to which the least current of a torque
# is taken.
TORQUE_SHARE, FLUX_SHARE = 0.01, 0.02
_MORE = 1.02  # squared currents beyond the limit, for z alone
_SLACK = 1.0 + 1e-12


@dataclass(frozen=True, slots=True)
class Taken:
    """What is known on each box, arrays of shape (N,).

    Torques in N m and available flux linkages in Wb from ``t_low`` and ``a_low`` to ``t_high`` and
    ``a_high``; ``less`` and ``more`` bound the torque made less t and t less the torque made in N
    m, ``flux`` is the squared flux linkage over the squared available one less 1, ``current`` the
    squared current in A^2.
    """

    t_low: FloatArray
    t_high: FloatArray
    a_low: FloatArray
    a_high: FloatArray
    more: FloatArray
    less: FloatArray
    flux: FloatArray
    current: FloatArray


def voltage_excess(region: VoltageRegion, step: DropReference, taken: Taken) -> FloatArray:
    """Upper bounds of |v|^2/V^2 - 1 on boxes without what `ROUNDING` and `moved` add,
    shape (N,).
    """
    machine, i_max = region.machine, region.flux.i_max
    r_s, k = machine.r_s, 1.0 / (1.5 * machine.pole_pairs)
    if r_s == 0.0:
        return np.asarray(taken.flux)
    whole = (LEAST_VOLTAGE * region.v_max / r_s) ** 2 - _MORE * i_max**2
    q_low = k * np.maximum(taken.t_low, 0.0) / taken.a_high / _SLACK
    q_high = k * np.maximum(taken.t_high, 0.0) / taken.a_low * _SLACK
    bound = np.full(taken.flux.shape, float(step.reserve) / r_s**2)
    if step.near is not None:
        constant, slope = (float(part) for part in step.near)
        bound = np.minimum(bound, (constant + slope * taken.a_low**2) / r_s**2)
    beyond = np.maximum(taken.current - bound / _SLACK, 0.0)

    # Motoring the largest z rises with q; the bound lies between those without drop
    # and with the largest one.
    z = _SLACK / (np.sqrt(q_high**2 + whole) - q_high)
    more = 2.0 * z * k * np.maximum(taken.more, 0.0) / taken.a_low
    motoring = np.maximum(taken.flux, (taken.flux + more) / (1.0 + 2.0 * z * q_low)) + z**2 * beyond

    # Generating it falls with q, and the drop helps: the less the larger the
    # least current of the torque.
    z = _SLACK / (np.sqrt(q_low**2 + whole) + q_low)
    less = 2.0 * z * k * np.maximum(taken.less, 0.0) / taken.a_low
    top = np.maximum(taken.flux + less + z**2 * beyond, 0.0)
    least = q_high * (1.0 - FLUX_SHARE) - TORQUE_SHARE * k * region.flux.torque_max / taken.a_low
    below = 1.0 - 2.0 * z * q_high + (z * np.maximum(least, 0.0)) ** 2
    fine = (below > 0.0) & (2.0 * z * q_high <= LARGEST_SHARE * below)
    generating = np.where(fine, top / np.where(fine, below, 1.0), np.inf)
    return np.asarray(np.maximum(motoring, generating) * _SLACK + 1e-12)


def moved(region: VoltageRegion, step: DropReference, rise: float, room: float) -> float:
    """What |v|^2/V^2 - 1 may gain where the second evaluation takes more current than the first.

    ``rise`` in A^2/Wb bounds how the squared current may rise with the available flux linkage,
    which grows by at most z^2 a J^2 between the two; ``room`` in A^2 bounds what rounding adds to
    the squared current of either.
    """
    r_s, i_max = region.machine.r_s, region.flux.i_max
    if step.passes < 2 or r_s == 0.0:
        return 0.0
    k = 1.0 / (1.5 * region.machine.pole_pairs)
    q = _MORE * i_max + TORQUE_SHARE * k * region.flux.torque_max / region.flux.flux_min
    whole = (LEAST_VOLTAGE * region.v_max / r_s) ** 2 - _MORE * i_max**2
    z = 1.0 / (np.sqrt(q**2 + whole) - q)
    share = _MORE * (z * i_max) ** 2
    return float((share * rise * region.flux.flux_max + 2.0 * room) * z**2 * _SLACK)
