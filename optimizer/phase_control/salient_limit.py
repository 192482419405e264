"""Where the voltage of the link ends the torque of a salient machine in dq."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.topologies.regions import VOLTAGE_ROWS, voltage_bounds
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.phase_control.torque_limit import Largest
from dqforge.optimizer.waveforms.phase_currents import dq_waveform

_TORQUES = 65


def salient_torques(
    machine: SalientPhaseMachine, choice: CurrentChoice, topology: Topology, margin: float
) -> Largest:
    """Largest torques that the link permits, of constant dq currents.

    The reluctance torque makes the currents no multiple of the torque: a ladder of torques is
    judged, and the last one counts that is permitted with all below it.

    Parameters
    ----------
    machine:
        The machine in phase quantities.
    choice:
        The dq currents of a torque.
    topology:
        How the phases are fed.
    margin:
        Share of the region that is left free, of 0 to 1.
    """
    torque_max = choice.largest_torque()
    torques = np.linspace(0.0, torque_max, _TORQUES)
    i_d, i_q = choice.currents(torques)
    pairs = [
        (float(d), sign * float(q)) for sign in (1.0, -1.0) for d, q in zip(i_d, i_q, strict=True)
    ]
    turns = machine.phases.turns
    currents = np.stack([dq_waveform(i_d, i_q, machine.angles, turns) for i_d, i_q in pairs])
    # Bounds are alike for all phases and both signs: what repeats needs no second look.
    part = machine.angles // {"sixth": 6, "third": 3, "none": 1}[machine.symmetry]
    low, high = voltage_bounds(topology, 1.0 - margin)
    limited = np.isfinite(high)
    # Voltages are straight in the speed: one set at rest and one per speed tell all.
    at_rest = machine.voltage(currents, np.zeros(len(pairs)))
    per_speed = machine.voltage(currents, np.ones(len(pairs))) - at_rest
    still, moving = (
        np.einsum("rk,jkn->jrn", VOLTAGE_ROWS[limited], v[..., :part]) for v in (at_rest, per_speed)
    )
    low, high = low[limited, np.newaxis], high[limited, np.newaxis]

    def largest(omega_e: FloatArray, v_dc: float) -> FloatArray:
        if v_dc <= 0.0:
            return np.zeros_like(omega_e)
        found = np.zeros_like(omega_e)
        for place, omega in enumerate(omega_e):
            rows = still + omega * moving
            fits = np.all((rows <= high * v_dc) & (rows >= low * v_dc), axis=(1, 2))
            both = fits[:_TORQUES] & fits[_TORQUES:]
            count = _TORQUES if both.all() else int(np.argmin(both))
            found[place] = torques[max(count - 1, 0)]
        return found

    return largest
