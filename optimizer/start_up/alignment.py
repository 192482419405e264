"""How long a rotor swings about a current that holds it: theta'' = -(p K_T I/J) sin theta."""

from __future__ import annotations

import math

from dqforge.machines.dq_machines.synchronous import LinearMachine

_LEAST, _SWINGS = 0.3, 3.0  # in s; swings about the current


def swing_time(machine: LinearMachine, current: float) -> float:
    """Time of a small swing in s.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
    """
    torque = 1.5 * machine.pole_pairs * machine.psi_pm * current
    return 2.0 * math.pi / math.sqrt(machine.pole_pairs * torque / (machine.inertia or 0.0))


def alignment_time(machine: LinearMachine, current: float) -> float:
    """Time in s that an alignment is given, per step.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
    """
    return max(_LEAST, _SWINGS * swing_time(machine, current))


def alignment_damping(machine: LinearMachine, current: float, damping: float) -> float:
    """Current across in A per rad/s (electrical) against the turning rotor, for a damping ratio.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
        damping: Ratio of the swing.
    """
    return 2.0 * damping * current * swing_time(machine, current) / (2.0 * math.pi)
