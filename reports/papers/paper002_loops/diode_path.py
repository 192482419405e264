"""Why the zero-sequence current of Figures 6.13 and 6.15 of paper 002 cannot come from the circuit
of its Figure 5.4, whose neutral returns through two diodes alone.

A current out of the neutral (i_n = i_a + i_b + i_c > 0) flows through the upper diode: the neutral
lies at the positive rail, and no leg lies above it, so that no phase voltage is above 0. A current
into the neutral needs the lower diode, and no phase voltage below 0. Constant torque at least
copper loss has i along the back-EMF and i_n along its sum: where i_n > 0 some phase must have a
voltage above 0 to drive its current.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.waveforms.phase_currents import unit_currents


@dataclass(frozen=True, slots=True)
class DiodePath:
    """What dqy asks of a neutral at constant torque, and when two diodes could give it.

    ``neutral_rms`` in A (sum of the phases); ``share`` of the period in which the phase voltages
    that dqy needs let its neutral current flow through a diode; ``short`` in V the least by which
    the phase voltage farthest from that misses it.
    """

    neutral_rms: float
    share: float
    short: float


def diode_path(machine: PhaseMachine, torque: float, omega_m: float) -> DiodePath:
    """The path for a torque in N m and a mechanical speed in rad/s."""
    currents = torque * unit_currents(machine, "dqy")
    voltages = machine.voltage(currents, machine.pole_pairs * omega_m)
    neutral = np.sum(currents, axis=0)
    # The voltages are half a step behind the angles; so is this.
    way = np.sign(0.5 * (neutral + np.roll(neutral, -1)))
    farthest = np.max(voltages * way, axis=0)
    return DiodePath(
        float(np.sqrt(np.mean(neutral**2))),
        float(np.mean(farthest <= 0.0)),
        float(np.min(farthest)),
    )
