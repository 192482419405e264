"""What constant torque costs once a phase is open, against all three phases.

With a neutral the two phases that are left make constant torque in closed form, i = T f / (p |f|^2)
with the back-EMF of the open phase set to zero; without one they carry one current, and the torque
vanishes twice a period.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.names import OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES

_VANISHING = 1e-6


@dataclass(frozen=True, slots=True)
class OpenPhasePrice:
    """Figures of constant torque with two phases over those with three by dqy.

    Args:
        phase: The one that is open.
        copper, peak: Copper loss and largest phase current, times those of three phases.
        neutral_rms, neutral_peak: Of the neutral current in A.
        neutral: Peak of the neutral over that of a phase while all three are there: what the
            neutral's leg must carry.
        torque_at_peak, torque_at_copper: Share of the torque that is left with the same phase peak,
            and with the same copper loss.
    """

    phase: OpenPhase
    copper: float
    peak: float
    neutral_rms: float
    neutral_peak: float
    neutral: float
    torque_at_peak: float
    torque_at_copper: float


def open_phase_price(
    machine: PhaseMachine, topology: Topology, phase: OpenPhase, torque: float
) -> OpenPhasePrice | None:
    """The price, None where constant torque cannot be made: without a neutral, or where the two
    phases that are left make none at some angle.

    Args:
        machine: The machine.
        topology: How it is fed.
        phase: The phase that carries no current.
        torque: In N m.
    """
    if not TOPOLOGIES[topology].neutral:
        return None
    left = machine.flux.copy()
    left["abc".index(phase)] = 0.0
    squares = [np.sum(flux**2, axis=0) for flux in (machine.flux, left)]
    if min(float(np.min(square)) for square in squares) <= _VANISHING**2 * float(
        np.max(squares[0])
    ):
        return None
    healthy, faulty = (
        torque * flux / (machine.pole_pairs * square)
        for flux, square in zip((machine.flux, left), squares, strict=True)
    )
    copper = float(machine.copper_loss(faulty) / machine.copper_loss(healthy))
    whole_peak = float(np.max(np.abs(healthy)))
    peak = float(np.max(np.abs(faulty))) / whole_peak
    through = np.sum(faulty, axis=0)
    neutral_peak = float(np.max(np.abs(through)))
    return OpenPhasePrice(
        phase=phase,
        copper=copper,
        peak=peak,
        neutral_rms=float(np.sqrt(np.mean(through**2))),
        neutral_peak=neutral_peak,
        neutral=neutral_peak / whole_peak,
        torque_at_peak=1.0 / peak,
        torque_at_copper=1.0 / math.sqrt(copper),
    )
