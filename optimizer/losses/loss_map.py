"""Losses of alternatives over a map of torque and speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.modulation.modulators import linear_limit
from dqforge.optimizer.losses.drive_budget import BudgetOptions
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    DriveComparison,
    compare_drives,
    usable_limit,
)
from dqforge.optimizer.operating_points.characteristics import (
    VoltageLimit,
    characteristics,
    fastest_speed,
    voltage_limit,
)


@dataclass(frozen=True, slots=True)
class LossMap:
    """A comparison over N torques in N m and M mechanical speeds in rad/s.

    Its points run row by row.
    """

    torque: FloatArray
    omega_m: FloatArray
    comparison: DriveComparison


def budget_options(design: Design) -> BudgetOptions:
    """What the design says of losses beside those of the fundamental."""
    return BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr)


def _widest(inverter: Inverter, alternatives: Alternatives, margin: float) -> VoltageLimit:
    """Largest limit that one of the alternatives has, dead time and margin taken off."""
    slowest = replace(inverter, f_sw=min(alternatives.frequencies))
    widest = max(alternatives.modulations, key=lambda name: usable_limit(slowest, name))
    taken = 1.0 - usable_limit(slowest, widest, margin) / linear_limit(widest, inverter.v_dc)
    return voltage_limit(inverter, widest, taken)


def solve_map(
    design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int
) -> LossMap:
    """Compare over the motoring quadrant, up to the most torque and the largest
    speed of the best modulator.
    """
    limit = _widest(design.inverter, alternatives, margin)
    figures = characteristics(design.machine, limit.v_max, design.i_max)
    fastest = fastest_speed(design.machine, figures, limit, design.i_max)
    torque = np.linspace(0.0, figures.torque_max, torques + 1)[1:]
    omega = np.linspace(0.0, fastest, speeds + 1)[1:]
    wanted, speed = np.meshgrid(torque, omega, indexing="ij")
    comparison = compare_drives(
        design.machine,
        design.inverter,
        wanted.ravel(),
        speed.ravel(),
        alternatives,
        i_max=design.i_max,
        options=budget_options(design),
        margin=margin,
    )
    return LossMap(torque, omega, comparison)
