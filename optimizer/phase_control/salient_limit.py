"""Where the voltage of the link ends the torque of a salient machine, in dq and with a table."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import VOLTAGE_ROWS, voltage_bounds
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.phase_control.torque_limit import Largest
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.phase_currents import dq_waveform
from dqforge.optimizer.waveforms.pointwise_currents import pointwise_currents
from dqforge.optimizer.waveforms.salient_reference import largest_torque

_TORQUES = 65
_ROUNDING = 1e-12  # Share of a bound by which rounding alone may exceed it.


@dataclass(frozen=True, slots=True, eq=False)
class Ladder:
    """Torques from 0 to the largest in N m, shape (T,), and the phase currents in A that make them
    and their negatives, shape (2 T, 3, N).
    """

    torques: FloatArray
    currents: FloatArray


def dq_currents(machine: SalientPhaseMachine, choice: CurrentChoice) -> Ladder:
    """Constant dq currents of torques of both signs up to the current limit.

    Args:
        machine: The machine in phase quantities.
        choice: The dq currents of a torque.
    """
    torques = np.linspace(0.0, choice.largest_torque(), _TORQUES)
    i_d, i_q = choice.currents(torques)
    pairs = [
        (float(d), sign * float(q)) for sign in (1.0, -1.0) for d, q in zip(i_d, i_q, strict=True)
    ]
    turns = machine.phases.turns
    currents = np.stack([dq_waveform(i_d, i_q, machine.angles, turns) for i_d, i_q in pairs])
    return Ladder(torques, currents)


@lru_cache(maxsize=8)
def table_currents(machine: SalientPhaseMachine, limits: WaveformLimits) -> Ladder:
    """Currents of constant torque at least copper loss, of both signs up to the current limit.

    Args:
        machine: The machine in phase quantities.
        limits: With the topology and the current limit.

    Raises:
        NoSolutionError: Constant torque cannot be made at some angle.
    """
    torques = np.linspace(0.0, largest_torque(machine, limits), _TORQUES)
    both = np.concatenate([torques, -torques])
    return Ladder(torques, pointwise_currents(machine, both, limits.topology))


def salient_torques(
    machine: SalientPhaseMachine, ladder: Ladder, topology: Topology, margin: float
) -> Largest:
    """Largest torques that the link permits.

    The reluctance torque makes the currents no multiple of the torque: a ladder of torques is
    judged, and the last one counts that is permitted with all below it.

    Args:
        machine: The machine in phase quantities.
        ladder: Torques and their currents.
        topology: How the phases are fed.
        margin: Share of the region that is left free, of 0 to 1.
    """
    torques, currents = ladder.torques, ladder.currents
    low, high, rows = _region(topology, margin)
    part = _part(machine)
    # Voltages are straight in the speed: one set at rest and one per speed tell all.
    at_rest = machine.voltage(currents, np.zeros(len(currents)))
    per_speed = machine.voltage(currents, np.ones(len(currents))) - at_rest
    still, moving = (np.einsum("rk,jkn->jrn", rows, v[..., :part]) for v in (at_rest, per_speed))
    low, high = (1.0 + _ROUNDING) * low[:, np.newaxis], (1.0 + _ROUNDING) * high[:, np.newaxis]

    def largest(omega_e: FloatArray, v_dc: float) -> FloatArray:
        if v_dc <= 0.0:
            return np.zeros_like(omega_e)
        found = np.zeros_like(omega_e)
        for place, omega in enumerate(omega_e):
            found_rows = still + omega * moving
            fits = np.all((found_rows <= high * v_dc) & (found_rows >= low * v_dc), axis=(1, 2))
            both = fits[:_TORQUES] & fits[_TORQUES:]
            count = _TORQUES if both.all() else int(np.argmin(both))
            found[place] = torques[max(count - 1, 0)]
        return found

    return largest


def _region(topology: Topology, margin: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds over the link, shape (r,), and rows on the phase voltages, shape (r, 3)."""
    low, high = voltage_bounds(topology, 1.0 - margin)
    limited = np.isfinite(high)
    return low[limited], high[limited], VOLTAGE_ROWS[limited]


def _part(machine: SalientPhaseMachine) -> int:
    """Angles that must be looked at: bounds are alike for all phases and both signs."""
    return machine.angles // {"sixth": 6, "third": 3, "none": 1}[machine.symmetry]
