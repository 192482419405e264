"""What keeps the midpoint of a split link where it belongs."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.phase_control.phase_controller import MidpointGains

# Of the balance in rad/s: far below the current loops and the electrical speeds in use.
BANDWIDTH = 20.0
SWING = 0.05  # Permitted swing of the midpoint, peak to peak over the link voltage.


def midpoint_gains(
    unit_zero: FloatArray, turns: int, torque_max: float, capacitance: float, v_dc: float
) -> MidpointGains:
    """Balance and least speed of a split link.

    C dv_m/dt = 3 i_0, so that i_0 = -k (v_m - v_dc/2) has the bandwidth 3 k/C. Over a period the
    charge of the neutral current moves the midpoint by its span over omega_e C; with order 3 alone
    that is 2 I_n3/(3 omega_e C).

    Args:
        unit_zero: Zero-sequence current per torque over the period in A/(N m), shape (N,).
        turns: Electrical periods that it spans.
        torque_max: Largest torque in N m.
        capacitance: Both halves together in F.
        v_dc: Link voltage in V.

    Raises:
        NoSolutionError: The neutral current has a mean that no capacitor carries.
    """
    balance, allowed = BANDWIDTH * capacitance / 3.0, SWING * v_dc
    mean = float(np.mean(unit_zero)) * torque_max
    if abs(mean) > balance * 0.5 * allowed:
        raise NoSolutionError(
            "control.current_loop.frame: the currents for constant torque have a mean in the "
            f"neutral of up to {3.0 * abs(mean):.3g} A, which the split link does not carry; "
            "write dqx"
        )
    step = 2.0 * np.pi * turns / unit_zero.size
    charge = np.cumsum(unit_zero - np.mean(unit_zero)) * step
    return MidpointGains(
        balance, float(3.0 * torque_max * np.ptp(charge) / (capacitance * allowed))
    )
