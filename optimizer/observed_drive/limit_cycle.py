"""How an unstable speed loop on an observer swings in the end.

Its torque becomes a square wave at its limit, the speed a triangle. The fundamental of that torque,
4/pi T_max, moves the shaft by T/(J omega): from peak to peak

    8 T_max/(pi J omega_osc),   omega_osc = 0.9 times the frequency of the unstable pole

(the limit slows the swing: simulated drives swing at 0.82 to 0.93 times that frequency).
"""

from __future__ import annotations

import numpy as np

from dqforge.optimizer.loops.observed_margins import LimitCycle

SLOWING = 0.9  # Frequency of the limit cycle over that of the unstable pole.


def limit_cycle(
    pole: complex, period: float, torque_max: float, inertia: float
) -> LimitCycle | None:
    """Frequency and size of the swing; None of a stable pole, or one that does not swing.

    Args:
        pole: The largest of the closed loop, in the z plane.
        period: Period of the speed controller in s.
        torque_max: Limit of its torque in N m.
        inertia: In kg m^2.
    """
    turning = abs(float(np.angle(pole)))
    if not abs(pole) >= 1.0 or turning < 1e-9:
        return None
    omega = SLOWING * turning / period
    return LimitCycle(omega, 8.0 * torque_max / (np.pi * inertia * omega))
