"""Flux observer whose steady angle error is corrected by a small network."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.learned_correction import corrected_flux
from dqforge.optimizer.learned_correction import corrected_flux as network
from dqforge.optimizer.learned_correction.corrected_flux import (
    NO_NETWORK,
    LearnedCorrection,
    Network,
    in_words,
    told,
)
from dqforge.optimizer.learned_correction.correction_frame import (
    POINTS,
    SILENT,
    CorrectionFrame,
    Inputs,
    assessed,
    frame_for,
    inputs_of,
    training_drives,
)
from dqforge.optimizer.observers.methods import flux
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.parts import ObserverMethod, ObserverState, ObserverTuning
from dqforge.optimizer.observers.reduced_order import Training, TrainingBox
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Pair

HIDDEN = (8, 8)  # Neurons of the hidden layers where the design names none.
_DRIVES = 4 * POINTS  # A network scatters more than rules with the drives that it learned from.


@dataclass(frozen=True, slots=True)
class NeuralGains:
    """The flux observer, what the correction is told, and its network."""

    flux: FluxGains
    frame: CorrectionFrame
    network: Network


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> NeuralGains:
    """Gains of the flux observer, and a network that answers nought until it is trained."""
    return NeuralGains(flux.design(machine, tuning, t_s, omega_max), SILENT, NO_NETWORK)


def learned(o: Arithmetic, gains: NeuralGains, x: Inputs) -> Reals:
    """What the network answers to inputs of -1 to 1, rad."""
    return network.answered(o, gains.network, gains.frame.limit, x)


def correction(
    o: Arithmetic, gains: NeuralGains, psi: Pair, i: Pair, theta: Reals, omega: Reals
) -> LearnedCorrection:
    """What was learned, within its limit, where every input lies in its range; else nought."""
    return told(o, learned, gains, psi, i, theta, omega)


def step(
    gains: NeuralGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample, see `corrected_flux.step`."""
    return corrected_flux.step(correction, gains, state, v, i, maths)


@lru_cache(maxsize=8)
def _trained(
    gains: NeuralGains,
    machine: LinearMachine,
    frame: CorrectionFrame,
    box: TrainingBox,
    hidden: tuple[int, int],
) -> NeuralGains:
    drives = training_drives(gains.flux, machine, box, _DRIVES)
    wanted = np.clip(-drives.error, -frame.limit, frame.limit)
    found = network.trained_network(inputs_of(frame, drives), wanted, hidden, frame.limit)
    return replace(gains, frame=frame, network=found)


def train(
    gains: NeuralGains,
    machine: LinearMachine,
    settings: ObserverSettings,
    box: TrainingBox,
    omega_max: float,
) -> tuple[NeuralGains, Training]:
    """A network by least squares over the drives of the box.

    Args:
        settings: Hidden layers, filter and limit, where the design names them.
        omega_max: Largest electrical speed in rad/s.
    """
    frame = frame_for(gains.flux, machine, settings, box)
    hidden = HIDDEN if settings.hidden_layers is None else settings.hidden_layers
    found = _trained(gains, machine, frame, box, hidden)

    def corrects(x: FloatArray) -> FloatArray:
        return np.asarray(learned(EXACT, found, tuple(x)), dtype=np.float64)

    trained, size = training_drives(gains.flux, machine, box, _DRIVES), found.network.size
    told = assessed(gains.flux, machine, box, trained, frame, omega_max, corrects, None, size)
    return found, told


def _in_words(tuning: ObserverTuning, gains: Any, t_s: float) -> str:
    layers = f"{len(gains.network.offsets_1)}-{len(gains.network.offsets_2)}"
    return in_words(tuning, gains, t_s, f"network 5-{layers}-1, {gains.network.size} numbers")


METHOD = ObserverMethod(
    name="neural",
    code="neural",
    title="flux observer with a correction of its steady angle by a network",
    design=design,
    start=corrected_flux.start,
    step=step,
    usual=flux.usual_flux,
    searched=flux.METHOD.searched,
    gains=NeuralGains,
    scale=corrected_flux.scale,
    in_words=_in_words,
    sizes=corrected_flux.sizes,
    train=train,
    members=corrected_flux.MEMBERS,
)
