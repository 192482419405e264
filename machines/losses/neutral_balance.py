"""What a zero-sequence current saves in copper, and what the pulses drive through the neutral."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import flux_axes, neutral_ripple


@dataclass(frozen=True, slots=True)
class NeutralBalance:
    """Copper that the neutral saves and costs.

    Args:
        saved: Copper loss that currents of constant torque save with a zero sequence, in W/(N m)^2.
        ripple: Neutral current of the pulses at standstill in A, r.m.s., where it is largest on a
            split link.
        cost: Its copper loss in W.
    """

    saved: float
    ripple: float
    cost: float

    @property
    def break_even(self) -> float:
        """Torque in N m from which on it saves more than it costs; infinite where never."""
        return math.sqrt(self.cost / self.saved) if self.saved > 0.0 else math.inf


def neutral_balance(
    machine: PhaseMachine, topology: Topology, v_dc: float, f_sw: float, l_0: float
) -> NeutralBalance:
    """Saving and cost of the neutral.

    A third of the neutral current flows in each phase, so that its copper loss is R I_n^2/3.

    Args:
        machine: The machine.
        topology: How its phases are fed.
        v_dc: Link voltage in V.
        f_sw: Carrier frequency in Hz.
        l_0: Inductance in H that a zero-sequence current meets.
    """
    alpha, beta, zero = flux_axes(machine)
    plane = 1.5 * (alpha**2 + beta**2)
    scale = machine.r_s / machine.pole_pairs**2
    saved = scale * float(np.mean(1.0 / plane) - np.mean(1.0 / (plane + 3.0 * zero**2)))
    # Without voltages every carrier period is alike.
    still = np.zeros((3, 1))
    ripple = float(neutral_ripple(topology, still, v_dc=v_dc, t_s=1.0 / f_sw, l_0=l_0))
    return NeutralBalance(saved, ripple, machine.r_s * ripple**2 / 3.0)
