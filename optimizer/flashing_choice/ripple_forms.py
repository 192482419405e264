"""Torque ripple of a controller in closed form: what its references make, and what its loop leaves
of dead time and of a model that is not quite the machine.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.losses.leg_losses import LegWaveforms
from dqforge.machines.losses.phase_terminals import inductance_over_angle
from dqforge.machines.phase_machines.phase_machine import derivative
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.topologies.topology import TOPOLOGIES, leg_signs
from dqforge.optimizer.flashing_choice.choices import (
    BACK_EMF,
    INDUCTANCE,
    NOISE,
    OFFSET,
    RippleFigures,
)
from dqforge.optimizer.flashing_choice.loop_residuals import (
    followed_offsets,
    noise_gain,
    residual_currents,
)
from dqforge.optimizer.phase_control.phase_controller import PhaseControl

_PEAKS = 6.0  # Peak to peak of noise over its r.m.s., as it is seen in a second of samples.


def dead_time_voltages(inverter: Inverter, wave: LegWaveforms) -> FloatArray:
    """Voltages in V that dead time takes from the phases, shape (3, N).

    Half of it falls on each edge, by the sign that the leg's current has there.

    Args:
        inverter: Dead time, carrier and link.
        wave: Legs of one point.
    """
    flux = inverter.v_dc / inverter.f_sw
    current, away = wave.current[0], flux * wave.rising[0]
    signs = 0.5 * (np.sign(current + away) + np.sign(current - away))
    volts = inverter.dead_time * inverter.f_sw * inverter.v_dc
    lost = leg_signs(inverter.topology) @ np.where(wave.clamped[0], 0.0, -volts * signs)
    if not TOPOLOGIES[inverter.topology].neutral:
        lost = lost - np.mean(lost, axis=0)
    return np.asarray(lost)


def ripple_figures(
    machine: AnyPhaseMachine,
    inverter: Inverter,
    control: PhaseControl,
    currents: FloatArray,
    wave: LegWaveforms,
    omega_m: float,
) -> RippleFigures:
    """Torque ripple over the mean torque.

    Args:
        machine, inverter, control: The drive.
        currents: References in A, shape (3, N).
        wave: Legs of the point, with one row.
        omega_m: Mechanical speed in rad/s, not 0.
    """
    omega = machine.pole_pairs * omega_m
    neutral = TOPOLOGIES[inverter.topology].neutral
    dead = dead_time_voltages(inverter, wave)
    linked = np.einsum("jkl,lj->kj", inductance_over_angle(machine), currents)
    deviations = {
        "inductance": (
            -INDUCTANCE * omega * derivative(linked, machine.turns),
            1.0 + INDUCTANCE,
            1.0,
        ),
        "back_emf": (-BACK_EMF * omega * machine.flux, 1.0, 1.0 + BACK_EMF),
    }

    def ripple(voltages: FloatArray, added: FloatArray, share: float, flux: float) -> float:
        left = residual_currents(
            control, _within(voltages, neutral=neutral), omega, share, machine.turns
        )
        torque = flux * machine.torque(currents + left + added)
        return float(np.ptp(torque) / abs(np.mean(torque)))

    none = np.zeros((3, 1))
    plain = ripple(dead, none, 1.0, 1.0)
    deviating = {
        name: ripple(dead + volts, none, share, flux)
        for name, (volts, share, flux) in deviations.items()
    }
    offset = followed_offsets(control, OFFSET * np.array([1.0, 0.0, 0.0]), omega)
    deviating["offset"] = ripple(dead, offset[:, np.newaxis], 1.0, 1.0)
    deviating["noise"] = math.hypot(plain, _noise_ripple(machine, control, currents))
    return RippleFigures(plain, deviating)


def _within(voltages: FloatArray, *, neutral: bool) -> FloatArray:
    """Voltages that can drive a current."""
    return voltages if neutral else voltages - np.mean(voltages, axis=0)


def _noise_ripple(machine: AnyPhaseMachine, control: PhaseControl, currents: FloatArray) -> float:
    """Peak to peak of the torque, over its mean, that white noise of three sensors makes."""
    plane = machine.flux - np.mean(machine.flux, axis=0)
    zero = np.mean(machine.flux, axis=0)
    l_ab = 0.5 * (control.inductances[0] + control.inductances[1])
    gain = noise_gain(control.gains[1], control.r_s, l_ab, control.t_s)
    gain_0 = noise_gain(control.gains[2], control.r_s, control.inductances[2], control.t_s)
    square = gain**2 * np.sum(plane**2, axis=0) + 3.0 * gain_0**2 * zero**2
    rms = machine.pole_pairs * NOISE * np.sqrt(np.mean(square))
    return float(_PEAKS * rms / abs(np.mean(machine.torque(currents))))
