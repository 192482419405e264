"""Losses of a phase machine as its terminals see them: any phase currents, any way of feeding.

The equivalent circuit is that of `machine_budget`, with waveforms in place of phasors: copper and
magnet loss as resistances in series, iron loss as a conductance beside the induced voltage. The
currents given make the torque; the iron's current comes on top, without zero sequence where the
topology carries none.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.losses.machine_budget import WindingHeat, warm_ratio
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.names import OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import between, derivative
from dqforge.machines.phase_machines.salient_phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES

_STANDSTILL = 1e-9  # Electrical speed in rad/s below which the iron loses nothing.


@dataclass(frozen=True, slots=True)
class PhaseTerminals:
    """A machine at K points over an electrical period of N angles; arrays (K,) unless said.

    Args:
        torque, shaft_power: Mean torque in N m and its power in W.
        copper, iron, magnet: Losses in W; copper at the winding temperature, without the ripple of
            switching.
        neutral: Loss in W of the neutral's conductor.
        resistance: Resistance of a phase in Ohm that makes the copper loss.
        winding_temperature: In degC, NaN without data of the winding's heat or where it is not
            steady.
        steady: False where the winding temperature runs away.
        currents, voltages: Of the phases at the terminals in A and V, shape (K, 3, N).
        between: Voltages in V half a step behind each angle, shape (K, 3, N), where corners show:
            what the link must reach.
    """

    torque: FloatArray
    shaft_power: FloatArray
    copper: FloatArray
    iron: FloatArray
    magnet: FloatArray
    neutral: FloatArray
    resistance: FloatArray
    winding_temperature: FloatArray
    steady: BoolArray
    currents: FloatArray
    voltages: FloatArray
    between: FloatArray


def allowed_currents(topology: Topology, open_phase: OpenPhase | None = None) -> FloatArray:
    """Orthonormal basis (3, m) of the phase currents that can flow.

    Args:
        topology: Without a neutral the phase currents add to zero.
        open_phase: A phase that carries none.
    """
    barred = [] if TOPOLOGIES[topology].neutral else [np.ones(3)]
    if open_phase is not None:
        barred.append(np.eye(3)["abc".index(open_phase)])
    if not barred:
        return np.eye(3)
    _, size, turned = np.linalg.svd(np.array(barred))
    return np.asarray(turned[int(np.sum(size > 1e-9)) :].T)


def inductance_over_angle(machine: AnyPhaseMachine) -> FloatArray:
    """Inductance matrices of the phases in H, shape (N, 3, 3).

    Args:
        machine: With or without saliency.
    """
    if isinstance(machine, SalientPhaseMachine):
        return machine.inductance
    return np.broadcast_to(machine.inductances, (machine.angles, 3, 3))


def phase_terminals(
    machine: AnyPhaseMachine,
    currents: FloatArray,
    omega_m: FloatArray,
    topology: Topology,
    *,
    loss: MachineLoss = NO_EXTRA_LOSS,
    heat: WindingHeat | None = None,
    open_phase: OpenPhase | None = None,
    neutral_resistance: float = 0.0,
    neutral_inductance: float = 0.0,
) -> PhaseTerminals:
    """Losses and terminal waveforms in the steady state.

    ::

        e   = omega_e (d(L i)/dtheta + f)               induced, with 3 L_n on the zero sequence
        i_t = i + g P e,  g = 2/3 k_iron / omega_e^2    P leaves what the topology can carry
        v   = (R + 2/3 k_m omega_e^2) i_t + e + R_n sum(i_t)

    Derivatives are central differences on the angles, which are antisymmetric: with constant
    inductances the power at the terminals is that of the losses and the shaft to rounding.

    Args:
        machine: The machine in phase quantities.
        currents: Phase currents in A that make the torque, shape (K, 3, N).
        omega_m: Mechanical speeds in rad/s, shape (K,).
        topology, open_phase: How the phases are fed.
        loss, heat: AC copper, iron and magnet loss; how warm the winding becomes, None keeps its
            resistance.
        neutral_resistance, neutral_inductance: Of the neutral's conductor and choke in Ohm and H.
    """
    omega = machine.pole_pairs * np.asarray(omega_m, dtype=np.float64)
    linked = np.einsum("jkl,...lj->...kj", inductance_over_angle(machine), currents)
    linked = linked + neutral_inductance * np.sum(currents, axis=-2, keepdims=True)
    induced = omega[:, None, None] * (derivative(linked, machine.turns) + machine.flux)
    basis = allowed_currents(topology, open_phase)
    part = np.einsum("kl,...lj->...kj", basis @ basis.T, induced)
    still = np.abs(omega) < _STANDSTILL
    turning = np.where(still, 1.0, omega)
    conductance = np.where(still, 0.0, loss.iron_factor(turning) / (1.5 * turning * turning))
    terminal = currents + conductance[:, None, None] * part
    size = _mean_square(terminal)
    extra = loss.ac_copper * omega * omega
    ratio, steady = np.ones(omega.shape), np.ones(omega.shape, dtype=np.bool_)
    temperature = np.full(omega.shape, np.nan)
    if heat is not None:
        ratio, steady = warm_ratio(heat, machine.r_s * size, extra)
        warmth = machine.r_s * size * (ratio + extra / ratio)
        temperature = heat.coolant_temperature + heat.thermal_resistance * warmth
    resistance = machine.r_s * (ratio + extra / ratio)
    series = resistance + loss.magnet * omega * omega / 1.5
    through = np.sum(terminal, axis=-2, keepdims=True)
    torque = np.mean(machine.torque(currents), axis=-1)
    value, slope = between(terminal, machine.turns)
    sums = (np.sum(part, axis=-2, keepdims=True) for part in (value, slope))
    drop = (series - machine.r_s)[:, None, None] * value
    drop = drop + neutral_resistance * next(sums)
    drop = drop + neutral_inductance * omega[:, None, None] * next(sums)
    return PhaseTerminals(
        torque=torque,
        shaft_power=torque * omega_m,
        copper=resistance * size,
        iron=conductance * _mean_square(part),
        magnet=loss.magnet * omega * omega * size / 1.5,
        neutral=neutral_resistance * _mean_square(through),
        resistance=resistance,
        winding_temperature=temperature,
        steady=steady,
        currents=terminal,
        voltages=series[:, None, None] * terminal + induced + neutral_resistance * through,
        between=machine.voltage(terminal, omega) + drop,
    )


def _mean_square(waveform: FloatArray) -> FloatArray:
    """Mean over the angles of the sum of squares of the rows, (K, n, N) to (K,)."""
    return np.asarray(np.mean(np.sum(waveform**2, axis=-2), axis=-1))
