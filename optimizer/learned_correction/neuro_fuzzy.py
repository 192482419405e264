"""Flux observer whose steady angle error is corrected by Takagi-Sugeno rules."""

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
from dqforge.optimizer.learned_correction import correction_frame as fuzzy_rules
from dqforge.optimizer.learned_correction.corrected_flux import LearnedCorrection, in_words, told
from dqforge.optimizer.learned_correction.correction_frame import (
    NO_RULES,
    SILENT,
    CorrectionFrame,
    FuzzyRules,
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


@dataclass(frozen=True, slots=True)
class NeuroFuzzyGains:
    """The flux observer, what the correction is told, and its rules."""

    flux: FluxGains
    frame: CorrectionFrame
    rules: FuzzyRules


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> NeuroFuzzyGains:
    """Gains of the flux observer, and rules that answer nought until they are trained."""
    return NeuroFuzzyGains(flux.design(machine, tuning, t_s, omega_max), SILENT, NO_RULES)


def learned(o: Arithmetic, gains: NeuroFuzzyGains, x: Inputs) -> Reals:
    """What the rules answer to inputs of -1 to 1, rad."""
    return fuzzy_rules.answered(o, gains.rules, x)


def correction(
    o: Arithmetic, gains: NeuroFuzzyGains, psi: Pair, i: Pair, theta: Reals, omega: Reals
) -> LearnedCorrection:
    """What was learned, within its limit, where every input lies in its range; else nought."""
    return told(o, learned, gains, psi, i, theta, omega)


def step(
    gains: NeuroFuzzyGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample, see `corrected_flux.step`."""
    return corrected_flux.step(correction, gains, state, v, i, maths)


@lru_cache(maxsize=8)
def _trained(
    gains: NeuroFuzzyGains, machine: LinearMachine, frame: CorrectionFrame, box: TrainingBox
) -> NeuroFuzzyGains:
    drives = training_drives(gains.flux, machine, box)
    rules = fuzzy_rules.trained_rules(inputs_of(frame, drives), -drives.error)
    return replace(gains, frame=frame, rules=rules)


def train(
    gains: NeuroFuzzyGains,
    machine: LinearMachine,
    settings: ObserverSettings,
    box: TrainingBox,
    omega_max: float,
) -> tuple[NeuroFuzzyGains, Training]:
    """Rules by one least-squares solve over the drives of the box.

    Args:
        settings: Filter and limit, where the design names them.
        omega_max: Largest electrical speed in rad/s.
    """
    frame = frame_for(gains.flux, machine, settings, box)
    found = _trained(gains, machine, frame, box)

    def corrects(x: FloatArray) -> FloatArray:
        answer = corrected_flux.limited(EXACT, learned(EXACT, found, tuple(x)), frame.limit)
        return np.asarray(answer, dtype=np.float64)

    bound = fuzzy_rules.largest_rule(found.rules, frame)
    numbers = len(found.rules.answers)
    trained = training_drives(gains.flux, machine, box)
    told = assessed(gains.flux, machine, box, trained, frame, omega_max, corrects, bound, numbers)
    return found, told


def _in_words(tuning: ObserverTuning, gains: Any, t_s: float) -> str:
    return in_words(tuning, gains, t_s, "16 rules of 5 numbers")


METHOD = ObserverMethod(
    name="neuro-fuzzy",
    code="neuro_fuzzy",
    title="flux observer with a correction of its steady angle by fuzzy rules",
    design=design,
    start=corrected_flux.start,
    step=step,
    usual=flux.usual_flux,
    searched=flux.METHOD.searched,
    gains=NeuroFuzzyGains,
    scale=corrected_flux.scale,
    in_words=_in_words,
    sizes=corrected_flux.sizes,
    train=train,
    members=corrected_flux.MEMBERS,
)
