"""Overmodulation of a design: how far it reaches, the harmonics of its phase voltage, and along the
largest torque over speed what they do to currents, torque and copper.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.modulation.dead_time import (
    ORDERS,
    LowHarmonics,
    low_harmonics,
    voltage_harmonics,
)
from dqforge.machines.modulation.registry import INSCRIBED, SIX_STEP
from dqforge.machines.names import OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import fundamental_share
from dqforge.optimizer.operating_points.characteristics import (
    Characteristics,
    characteristics,
    fastest_speed,
    limited_drive,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

_STEPS = 8  # Indices and speeds that are told.


@dataclass(frozen=True, slots=True)
class LargestTorque:
    """The largest torque over speed beyond the linear range, arrays of shape (N,).

    Args:
        points: Points of most torque, speeds ascending.
        linear_torque: Largest torque in N m at the same speeds without overmodulation; NaN where
            there is none.
        harmonics: What overmodulation adds at the points.
        figures, linear_figures: Characteristics with and without overmodulation.
    """

    points: OptimalPoints
    linear_torque: FloatArray
    harmonics: LowHarmonics
    figures: Characteristics
    linear_figures: Characteristics


@dataclass(frozen=True, slots=True)
class Overmodulation:
    """What overmodulation gives and costs.

    Args:
        method: How vectors beyond the circle in the hexagon are made.
        limit: Largest fundamental over that of six-step operation, before the margin.
        v_max, linear_v_max: Largest phase amplitude in V with and without it, less the margin.
        index: Fundamentals over that of six-step operation from the linear range to the limit,
            shape (K,).
        voltage: Amplitudes of the orders 5, 7, 11, 13, 17, 19 over the fundamental, shape (K, 6).
        largest: The largest torque over speed; None where the currents are not chosen by MTPA.
    """

    method: OvermodulationName
    limit: float
    v_max: float
    linear_v_max: float
    index: FloatArray
    voltage: FloatArray
    largest: LargestTorque | None

    @property
    def orders(self) -> tuple[int, ...]:
        """Orders of ``voltage``."""
        return ORDERS


@on_design("operation")
def solve_overmodulation(design: Design) -> Overmodulation | None:
    """What overmodulation gives and costs, None where the design does not ask for it."""
    inverter, operation = design.inverter, design.operation
    if inverter.overmodulation == "none":
        return None
    share = fundamental_share(inverter, operation.modulation)
    index = np.linspace(INSCRIBED, share, _STEPS)
    linear = INSCRIBED * inverter.v_dc * (1.0 - operation.voltage_margin)
    return Overmodulation(
        method=inverter.overmodulation,
        limit=share / SIX_STEP,
        v_max=design.v_max,
        linear_v_max=linear,
        index=index / SIX_STEP,
        voltage=voltage_harmonics(inverter.overmodulation, index) / index[:, None],
        largest=_largest_torque(design, linear) if design.strategy == "mtpa" else None,
    )


def _largest_torque(design: Design, linear_v_max: float) -> LargestTorque:
    """Points of most torque from where the linear range no longer suffices to the fastest."""
    operation = design.operation
    drive = limited_drive(design, operation.modulation, operation.voltage_margin)
    machine, i_max, v_max = drive.machine, drive.i_max, drive.limit.v_max
    figures = characteristics(machine, v_max, i_max)
    linear = characteristics(machine, linear_v_max, i_max)
    fastest = fastest_speed(machine, figures, drive.limit, i_max)
    low, base = linear.base_speed, figures.base_speed
    corners = [low + (base - low) * part for part in (0.25, 0.5, 0.75, 1.0)]
    beyond = np.linspace(base, fastest, _STEPS - 3)[1:] if fastest > base else np.zeros(0)
    speeds = np.array([speed for speed in [*corners, *beyond] if speed <= fastest])
    most = 2.0 * float(mtpa_locus(machine, i_max).torque[-1])
    points = optimal_points(machine, most, speeds, v_max=v_max, i_max=i_max)
    without = optimal_points(machine, most, speeds, v_max=linear_v_max, i_max=i_max)
    return LargestTorque(
        points=points,
        linear_torque=without.torque,
        harmonics=low_harmonics(
            design.inverter.overmodulation,
            machine,
            points.i_d,
            points.i_q,
            points.omega_m,
            v_dc=design.inverter.v_dc,
        ),
        figures=figures,
        linear_figures=linear,
    )
