"""The largest torque of a machine within a current limit."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.names import Strategy


def largest_torque_within(machine: Machine, i_max: float, strategy: Strategy = "mtpa") -> float:
    """Largest torque in N m within a current limit in A.

    Of saturated machines by a scan, good for a cross-check.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
        strategy: Which currents make the torque.
    """
    if isinstance(machine, LinearMachine):
        saliency = machine.saliency if strategy == "mtpa" else 0.0
        return largest_torque(machine.pole_pairs, machine.psi_pm, saliency, i_max)
    angle = np.linspace(0.0, np.pi, 721) if strategy == "mtpa" else np.array([0.5 * np.pi])
    region = machine.region
    if region is None or region.covers(i_max):
        return float(np.max(machine.torque(i_max * np.cos(angle), i_max * np.sin(angle))))
    length = np.array([min(i_max, region.end_of_ray(part)) for part in angle])
    return float(np.max(machine.torque(length * np.cos(angle), length * np.sin(angle))))


def largest_torque(pole_pairs: int, psi_pm: float, saliency: float, i_max: float) -> float:
    """Torque in N m that a linear machine gives at most with a peak phase current `i_max` in A.

    Args:
        pole_pairs: Number of pole pairs.
        psi_pm: Flux linkage of the magnets in Wb.
        saliency: Inductance difference l_q - l_d in H, of either sign.
        i_max: Length of the current vector in A.
    """
    # dT/d(angle) = 0 with i_d = -x: 2 s x^2 + psi x - s i^2 = 0; the sign of s only mirrors i_d.
    s = abs(saliency)
    # The conjugate form of the root has no cancellation, and gives x = 0 for s = 0.
    root = psi_pm + math.sqrt(psi_pm * psi_pm + 8.0 * s * s * i_max * i_max)
    x = 2.0 * s * i_max * i_max / root if root > 0.0 else 0.0
    return 1.5 * pole_pairs * (psi_pm + s * x) * math.sqrt(max(i_max * i_max - x * x, 0.0))
