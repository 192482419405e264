"""Currents for a torque at least copper loss (MTPA) and at i_d = 0, exactly,
for machines with constant inductances.

In per unit of i_base = psi_pm / (2 |l_q - l_d|) and T_base = 3/4 p psi_pm i_base the optimum of
every salient machine is one curve, T = i_q (1 + sqrt(1 + i_q^2)) with |i_d| = sqrt(1 + i_q^2) - 1
(paper 000, (5) to (19)). Its inverse has a closed form; nothing here iterates towards a tolerance.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class PerUnitBase:
    """Base current in A (peak) and base torque in N m of the MTPA curve (paper 000, (5))."""

    current: float
    torque: float


def per_unit_base(machine: LinearMachine) -> PerUnitBase:
    """Bases of the normalised MTPA curve.

    Raises:
        InputError: The machine has no saliency or no magnet, so that the curve has no scale of its
            own.
    """
    if machine.saliency == 0.0 or machine.psi_pm == 0.0:
        raise InputError(
            "per-unit MTPA needs a magnet and l_d different from l_q; this machine's curve is a "
            "straight line"
        )
    current = machine.psi_pm / (2.0 * abs(machine.saliency))
    return PerUnitBase(current=current, torque=0.75 * machine.pole_pairs * machine.psi_pm * current)


def mtpa_per_unit(torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """MTPA currents (i_d <= 0, i_q) in per unit for torque in per unit of any sign, shape (N,).

    The quartic i_d (2 - i_d)^3 + T^2 = 0 is solved by its resolvent cubic in hyperbolic form; two
    Newton steps on T = i_q (1 + sqrt(1 + i_q^2)), which is convex, then remove the rounding of that
    expression.
    """
    magnitude = np.abs(np.asarray(torque, dtype=np.float64))
    # Far below 1e-100 the curve is its tangent i_q = T/2 to every digit,
    # and the quotient below would overflow.
    safe = np.maximum(magnitude, 1e-100)
    root = -(4.0 * safe / np.sqrt(3.0)) * np.sinh(
        np.arcsinh(3.0 * np.sqrt(3.0) / (4.0 * safe)) / 3.0
    )
    half_sum = 1.0 + np.sqrt(np.maximum(1.0 + root, 0.0))
    divisor = 0.5 * (
        half_sum + np.sqrt(half_sum**2 - 2.0 * root + 4.0 * np.sqrt(0.25 * root**2 + magnitude**2))
    )
    i_q = magnitude / divisor
    for _ in range(2):
        flux = np.sqrt(1.0 + i_q * i_q)
        i_q = i_q - (i_q * (1.0 + flux) - magnitude) / (1.0 + flux + i_q * i_q / flux)
    return -(i_q * i_q) / (1.0 + np.sqrt(1.0 + i_q * i_q)), np.copysign(i_q, torque)


def _reluctance_currents(
    machine: LinearMachine, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """MTPA currents without a magnet: |i_d| = |i_q|, i_d with the sign that
    makes positive i_q drive.
    """
    current = np.sqrt(np.abs(torque) / (1.5 * machine.pole_pairs * abs(machine.saliency)))
    return -np.sign(machine.saliency) * current, np.copysign(current, torque)


def mtpa_currents(machine: LinearMachine, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents (i_d, i_q) in A with least copper loss for torque in N m, shape (N,),
    without a current limit.

    Holds for l_q > l_d (i_d < 0), l_d > l_q (i_d > 0), surface machines (i_d = 0) and
    machines without a magnet.

    Raises:
        InputError: The machine has neither magnet nor saliency.
    """
    torque = np.asarray(torque, dtype=np.float64)
    if machine.psi_pm == 0.0:
        if machine.saliency == 0.0:
            raise InputError("the machine has neither magnet flux nor saliency: it makes no torque")
        return _reluctance_currents(machine, torque)
    if machine.saliency == 0.0:
        return np.zeros_like(torque), torque / machine.torque_per_ampere
    base = per_unit_base(machine)
    i_d, i_q = mtpa_per_unit(torque / base.torque)
    return np.sign(machine.saliency) * base.current * i_d, base.current * i_q


def id0_currents(machine: LinearMachine, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents with i_d = 0 for torque in N m, shape (N,): i_q = 2 T / (3 p psi_pm) (paper 000 (4),
    corrected).

    Raises:
        InputError: The machine has no magnet.
    """
    if machine.psi_pm == 0.0:
        raise InputError(
            "strategy id0 needs magnet flux; without it no torque is made at i_d = 0: use strategy "
            "mtpa"
        )
    torque = np.asarray(torque, dtype=np.float64)
    return np.zeros_like(torque), torque / machine.torque_per_ampere


def mtpa_at_current(machine: LinearMachine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point (i_d, i_q >= 0) in A of the MTPA curve with the given current magnitude in A (peak),
    shape (N,).

    i_d = psi/(4 dl) - sqrt((psi/(4 dl))^2 + I^2/2) with dl = l_q - l_d,
    written without cancellation.

    Args:
        machine: Any machine.
        current: Magnitudes in A (peak), shape (N,).
    """
    current = np.asarray(current, dtype=np.float64)
    if machine.saliency == 0.0:
        return np.zeros_like(current), current
    quarter = machine.psi_pm / (4.0 * abs(machine.saliency))
    half_square = 0.5 * current**2
    denominator = quarter + np.sqrt(quarter**2 + half_square)
    with np.errstate(invalid="ignore"):
        i_d = np.where(current > 0.0, -half_square / denominator, 0.0)
    return np.sign(machine.saliency) * i_d, np.sqrt(np.maximum(current**2 - i_d**2, 0.0))
