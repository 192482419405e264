"""A sampled rule in the loop: what it names at a sample is on from the next one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.plants.current_regulators.sampled_rules import (
    RuleConstants,
    RuleInputs,
    SampledRule,
)
from dqforge.machines.plants.current_regulators.state_table import LEGS, Codes, codes_of
from dqforge.machines.plants.fed_machine import I_D, I_Q, Plant
from dqforge.machines.plants.switching_events import LegByLeg


class DelayedRule(LegByLeg):
    """Controller of `follow` around a `SampledRule`.

    Args:
        constants: The rule and what it knows of the drive.
        legs: Switching states (N, 3) of the first sampling period.
        real: Precision of the rule; single precision is the model of the emitted C.
    """

    def __init__(self, constants: RuleConstants, legs: BoolArray, real: Any = np.float32) -> None:
        self.interval, self.scale = constants.t_s, 1.0
        self._rule = SampledRule(constants, real)
        self._named: Codes = codes_of(legs)

    def margin(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        """Never positive: nothing commutates between samples."""
        return np.full(legs.shape, -1.0)

    def decide(
        self, plant: Plant, state: FloatArray, time: FloatArray, _legs: BoolArray
    ) -> BoolArray:
        """The state named a sample ago; the next one is named meanwhile."""
        now = self._named[plant.number]
        theta = np.mod(plant.omega_e * time, 2.0 * math.pi)
        told = RuleInputs(
            plant.i_d,
            plant.i_q,
            state[:, I_D],
            state[:, I_Q],
            np.cos(theta),
            np.sin(theta),
            plant.omega_e,
            np.full(now.shape, plant.drive.v_dc),
        )
        self._named[plant.number] = self._rule.next_codes(now, told)
        return np.asarray(LEGS[now])
