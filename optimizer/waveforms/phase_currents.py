"""Phase currents of machines with any back-EMF in closed form, and what a
set of phase currents means.

Three rules for the same mean torque: ``dq`` keeps i_q of the fundamental constant and leaves a
torque ripple; ``dqx`` makes the torque constant without zero-sequence current, ``dqy`` with it.
Both are the pointwise minimum of copper loss: i = T F / (p |F|^2) with F the vector of the three
flux values (dqy), or its part without zero sequence (dqx); thesis of paper 002, chapters 3 and 4.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import link_demand
from dqforge.machines.transforms import DOUBLES, park_inverse

CurrentRule = Literal["dq", "dqx", "dqy"]


_VANISHING = 1e-6


@dataclass(frozen=True, slots=True)
class WaveformFigures:
    """What phase currents mean at an operating point, arrays of shape (K,).

    ``copper`` in W, ``torque`` (mean) and ``ripple`` (peak to peak) in N m, ``rms`` of the most
    loaded phase, ``peak`` and ``neutral_rms`` in A, ``bus`` in V: the least dc-link voltage of the
    topology.
    """

    copper: FloatArray
    torque: FloatArray
    ripple: FloatArray
    rms: FloatArray
    peak: FloatArray
    neutral_rms: FloatArray
    bus: FloatArray


def unit_currents(machine: PhaseMachine, rule: CurrentRule) -> FloatArray:
    """Phase currents per torque in A/(N m), shape (3, N).

    Raises:
        NoSolutionError: At some angle no current of the rule makes torque.
    """
    flux = machine.flux
    if rule == "dq":
        places = machine.turns * np.arange(machine.angles)
        turn = np.exp(-2j * np.pi * places / machine.angles)
        twist = np.exp(2j * np.pi / 3.0 * np.arange(3))[:, np.newaxis]
        # Positive sequence of the fundamental, one phasor for all three phases.
        phasor = 2.0 * np.mean(flux * turn * twist)
        shape = np.real(phasor / turn / twist)
        return np.asarray(shape / np.mean(machine.torque(shape)))
    part = flux - np.mean(flux, axis=0) if rule == "dqx" else flux
    square = np.sum(part**2, axis=0)
    weakest = int(np.argmin(square))
    if square[weakest] <= _VANISHING**2 * np.max(square):
        raise NoSolutionError(
            f"{rule}: at {np.rad2deg(machine.theta[weakest]):.0f} degrees no phase makes torque, "
            "so that it cannot be constant; permit a torque ripple"
        )
    currents: FloatArray = part / (machine.pole_pairs * square)
    return currents


def bus_demand(voltages: FloatArray, topology: Topology) -> FloatArray:
    """Least dc-link voltage in V, shape (...), for phase voltages in V, shape (..., 3, N);
    of two isolated links, of each.
    """
    return link_demand(voltages, topology)


def dq_waveform(i_d: float, i_q: float, angles: int, turns: int = 1) -> FloatArray:
    """Phase currents in A, shape (3, N), of constant dq currents in A, at angles over ``turns``
    electrical periods.
    """
    lag = 2.0 * np.pi * (turns * np.arange(angles) / angles - np.arange(3)[:, np.newaxis] / 3.0)
    return park_inverse(DOUBLES, (np.array(i_d), np.array(i_q)), (np.cos(lag), np.sin(lag))).x


def figures(
    machine: AnyPhaseMachine, currents: FloatArray, omega_m: FloatArray, topology: Topology
) -> WaveformFigures:
    """Figures of phase currents in A, shape (K, 3, N), at mechanical speeds in rad/s,
    shape (K,).
    """
    torque = machine.torque(currents)
    neutral = np.sum(currents, axis=-2)
    voltages = machine.voltage(currents, machine.pole_pairs * omega_m)
    return WaveformFigures(
        copper=machine.copper_loss(currents),
        torque=np.mean(torque, axis=-1),
        ripple=np.max(torque, axis=-1) - np.min(torque, axis=-1),
        rms=np.max(np.sqrt(np.mean(currents**2, axis=-1)), axis=-1),
        peak=np.max(np.abs(currents), axis=(-2, -1)),
        neutral_rms=np.sqrt(np.mean(neutral**2, axis=-1)),
        bus=bus_demand(voltages, topology),
    )


def spectrum(currents: FloatArray, turns: int = 1) -> tuple[FloatArray, FloatArray]:
    """Amplitudes in A, peak, shape (..., 3, H), and orders 0, 1/turns, ... (H - 1)/turns,
    of phase currents over ``turns`` electrical periods, shape (..., 3, N).
    """
    count = currents.shape[-1]
    lines = np.abs(np.fft.rfft(currents, axis=-1)) * (2.0 / count)
    lines[..., 0] *= 0.5
    return lines, np.arange(lines.shape[-1], dtype=np.float64) / turns
