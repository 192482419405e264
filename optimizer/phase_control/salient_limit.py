"""Where the voltage of the link ends the torque of a salient machine, in dq and with a table."""

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
    low, high, rows = _region(topology, margin)
    part = _part(machine)
    # Voltages are straight in the speed: one set at rest and one per speed tell all.
    at_rest = machine.voltage(currents, np.zeros(len(pairs)))
    per_speed = machine.voltage(currents, np.ones(len(pairs))) - at_rest
    still, moving = (np.einsum("rk,jkn->jrn", rows, v[..., :part]) for v in (at_rest, per_speed))
    low, high = low[:, np.newaxis], high[:, np.newaxis]

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


def table_torques(
    machine: SalientPhaseMachine,
    unit: FloatArray,
    torque_max: float,
    topology: Topology,
    margin: float,
) -> Largest:
    """Largest torques that the link permits, of currents in proportion to the torque.

    Voltages are straight in the torque at every angle, as without saliency, but with the machine's
    own inductances.

    Parameters
    ----------
    machine:
        The machine in phase quantities.
    unit:
        Currents of the phases per torque in A/(N m) at its angles, shape (3, N).
    torque_max:
        Largest torque of the current limit in N m.
    topology:
        How the phases are fed.
    margin:
        Share of the region that is left free, of 0 to 1.
    """
    low, high, rows = _region(topology, margin)
    none = np.zeros_like(unit)
    emf, at_rest = machine.voltage(none, np.array(1.0)), machine.voltage(unit, np.array(0.0))
    per_speed = machine.voltage(unit, np.array(1.0)) - at_rest - emf
    start, still, moving = ((rows @ v)[:, : _part(machine)] for v in (emf, at_rest, per_speed))

    def largest(omega_e: FloatArray, v_dc: float) -> FloatArray:
        found = np.full(omega_e.size, torque_max)
        if v_dc <= 0.0:
            return np.zeros_like(omega_e)
        for sense in (1.0, -1.0):
            omega = sense * omega_e[:, np.newaxis, np.newaxis]
            slope = np.maximum(np.abs(still + omega * moving), 1e-12)
            above = high[:, np.newaxis] * v_dc - omega * start
            below = omega * start - low[:, np.newaxis] * v_dc
            ends = np.minimum(above, below) / slope
            found = np.minimum(found, np.min(ends, axis=(1, 2)))
        return np.asarray(np.maximum(found, 0.0))

    return largest


def _region(topology: Topology, margin: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds over the link, shape (r,), and rows on the phase voltages, shape (r, 3)."""
    low, high = voltage_bounds(topology, 1.0 - margin)
    limited = np.isfinite(high)
    return low[limited], high[limited], VOLTAGE_ROWS[limited]


def _part(machine: SalientPhaseMachine) -> int:
    """Angles that must be looked at: bounds are alike for all phases and both signs."""
    return machine.angles // {"sixth": 6, "third": 3, "none": 1}[machine.symmetry]
