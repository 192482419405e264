"""Pulse patterns of a design that tracks trajectories, at the points at which it is judged."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.current_regulators.pulse_patterns import optimal_pattern
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_feedback.regulator_numbers import RegulatorPlan
from dqforge.optimizer.current_feedback.regulator_runs import WorkingPoints


@dataclass(frozen=True, slots=True)
class DesignPattern:
    """One pattern.

    Args:
        omega_m: Mechanical speed in rad/s at which it is meant.
        index: Amplitude of the phase voltage over half the DC link.
        sign: Level of a leg behind the angle 0 of its voltage's sine.
        angles: Of a quarter of the period, in rad.
    """

    omega_m: float
    index: float
    sign: int
    angles: tuple[float, ...]


def design_patterns(
    design: Design, plan: RegulatorPlan, points: WorkingPoints
) -> tuple[DesignPattern, ...]:
    """Patterns at points; none of another regulator, or where no pattern makes the voltage.

    Args:
        design: The drive.
        plan: Its regulator.
        points: Where.
    """
    if plan.method != "trajectory":
        return ()
    omega_e = design.machine.pole_pairs * points.omega_m
    voltage = np.hypot(*design.machine.voltage(points.i_d, points.i_q, omega_e))
    found = []
    for speed, turning, amplitude in zip(points.omega_m, omega_e, voltage, strict=True):
        index = float(amplitude / (0.5 * design.inverter.v_dc))
        try:
            pattern = optimal_pattern(plan.angles(float(turning) / (2.0 * math.pi)), index)
        except NoSolutionError:
            continue
        angles = tuple(float(angle) for angle in pattern.angles)
        found.append(DesignPattern(float(speed), index, pattern.sign, angles))
    return tuple(found)
