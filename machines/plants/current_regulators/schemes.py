"""Regulators beyond hysteresis and ramp comparison: what they are told, and controllers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.names import SampledRuleName
from dqforge.machines.plants.current_regulators.circle import CircleController
from dqforge.machines.plants.current_regulators.delayed_rule import DelayedRule
from dqforge.machines.plants.current_regulators.sampled_rules import RuleConstants
from dqforge.machines.plants.current_regulators.trajectory import (
    TrajectoryController,
    patterns_of,
    steady_trajectory,
)
from dqforge.machines.plants.fed_machine import BridgeDrive, Plant
from dqforge.machines.plants.switching_events import Controller
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Sampled:
    """A sampled rule with its computing time of one sample, as it is emitted.

    Args:
        rule: ``predictive``, ``circle`` or ``look-up-table`` (paper 001, 6.2.4.4 and 6.2.4.3).
        t_s: Sampling period in s.
        band, outer_band: As in `RuleConstants`, in A.
        real: Precision: single is that of the emitted C.
    """

    rule: SampledRuleName
    t_s: float
    band: float = 0.0
    outer_band: float = 0.0
    real: Any = np.float32

    def constants(self, drive: BridgeDrive) -> RuleConstants:
        """What the rule knows of a drive."""
        machine = drive.machine
        return RuleConstants(
            self.rule,
            machine.r_s,
            machine.l_d,
            machine.l_q,
            machine.psi_pm,
            self.t_s,
            self.band,
            self.outer_band,
        )


@dataclass(frozen=True, slots=True)
class Circle:
    """The circle of Holtz and Stadtfeld (paper 001, 6.2.4.4), acting at the circle itself.

    Args:
        radius: Largest error in A.
        per_commutation: Whether the longest time counts per commutation, as in the source, or by
            itself.
    """

    radius: float
    per_commutation: bool = True


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Optimal pulse patterns whose edges track the current (paper 001, 6.2.4.5).

    Args:
        angles: Angles N in a quarter of the period: each leg turns on 2 N + 1 times per period.
        t_s: Sampling period in s of the error.
        offset: Error in A (i_d, i_q) with which a run starts; zero is the steady state.
        tracking: Whether the edges are moved; without it the pattern runs by itself.
    """

    angles: int
    t_s: float
    offset: tuple[float, float] = (0.0, 0.0)
    tracking: bool = True


FurtherScheme = Sampled | Circle | Trajectory


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")


def check_further(drive: BridgeDrive, scheme: FurtherScheme) -> None:
    """Refuse numbers that no scheme can have, and a tied star point."""
    if drive.neutral_inductance is not None:
        raise InputError(
            "neutral_inductance: only hysteresis regulates three currents; leave the star point "
            "isolated"
        )
    if isinstance(scheme, Circle):
        _positive("radius", scheme.radius, "A")
        return
    _positive("t_s", scheme.t_s, "s")
    if isinstance(scheme, Trajectory):
        if scheme.angles < 1:
            raise InputError(f"angles: expected 1 at least, got {scheme.angles}")
    elif scheme.rule != "predictive":
        _positive("band", scheme.band, "A")
        if scheme.rule == "look-up-table" and not scheme.outer_band >= scheme.band:
            raise InputError("outer_band: expected the band in A at least")


def check_further_points(plant: Plant, scheme: FurtherScheme) -> None:
    """Refuse what the bridge cannot make: the circle and the pattern need it, rules judge by it."""
    machine, v_dc = plant.drive.machine, plant.drive.v_dc
    voltage = np.hypot(*machine.voltage(plant.i_d, plant.i_q, plant.omega_e))
    limit = v_dc / math.sqrt(3.0)
    if float(np.max(voltage)) >= limit and not isinstance(scheme, Trajectory):
        raise InputError(
            f"the references need {float(np.max(voltage)):.4g} V, the bridge makes {limit:.4g} V "
            "(v_dc/sqrt(3)); lower speed or currents, or raise v_dc"
        )
    if isinstance(scheme, Trajectory) and float(np.min(plant.omega_e)) <= 0.0:
        raise InputError("omega_m: pulse patterns are made for positive speeds")


def further_work(plant: Plant, scheme: FurtherScheme) -> FloatArray:
    """Commutations per second that are to be expected at most, shape (N,)."""
    if isinstance(scheme, Sampled):
        return np.full(plant.i_d.size, 3.0 / scheme.t_s)
    if isinstance(scheme, Trajectory):
        # The samples take as long as commutations do.
        edges = 3.0 * (4.0 * scheme.angles + 2.0) * np.abs(plant.omega_e) / (2.0 * math.pi)
        return np.asarray(edges + 1.0 / scheme.t_s)
    machine = plant.drive.machine
    slope = plant.drive.v_dc / min(machine.l_d, machine.l_q)
    return np.full(plant.i_d.size, 2.0 * slope / scheme.radius)


def further_start(
    plant: Plant, scheme: FurtherScheme, legs: BoolArray
) -> tuple[Controller, FloatArray, BoolArray]:
    """Controller, state (N, 9) and switching state (N, 3) at the angle 0; ``legs`` are those that
    the voltages of the references suggest.
    """
    if isinstance(scheme, Sampled):
        rule = DelayedRule(scheme.constants(plant.drive), legs, scheme.real)
        return rule, plant.start(legs), legs
    if isinstance(scheme, Circle):
        controller = CircleController(
            scheme.radius, plant.i_d.size, per_commutation=scheme.per_commutation
        )
        return controller, plant.start(legs), legs
    steady = steady_trajectory(plant, *patterns_of(plant, scheme.angles))
    legs = steady.legs_at_start()
    state = steady.states[:, 0].copy()
    state[:, :2] += scheme.offset
    return TrajectoryController(steady, scheme.t_s, tracking=scheme.tracking), state, legs
