"""Flux linkage over torque for the build with stator frame orientation: the table that
motor-ctrl-lib joins by lines, from the machine as it is instead of a constant ratio of inductances.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.infineon_format.infineon_keys import TABLE_POINTS, as_printed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.mtpa import mtpa_currents

_BETWEEN = 8


@dataclass(frozen=True, slots=True, eq=False)
class FluxTable:
    """Stator flux linkage over torque.

    Args:
        most: Torque in N m of the last point; the first is at 0.
        flux: In Wb at even steps, shape (TABLE_POINTS,), rounded as printed.
        error: Largest deviation in Wb of the lines between them from the machine's own.
        of_constants: Largest deviation in Wb of what constant inductances give, as the library
            works it out.
    """

    most: float
    flux: FloatArray
    error: float
    of_constants: float


def largest_torque(design: Design) -> float:
    """Largest torque in N m within the current limit, by the design's strategy."""
    return CurrentChoice(design.machine, design.strategy, design.i_max).largest_torque()


def flux_table(design: Design) -> FluxTable:
    """The table for a design, whose machine may saturate.

    Its lines are shifted by half of what they miss between the points, which halves their error.

    Args:
        design: The design.
    """
    most = as_printed(largest_torque(design))
    choice = CurrentChoice(design.machine, design.strategy, design.i_max)
    torque = np.linspace(0.0, most, (TABLE_POINTS - 1) * _BETWEEN + 1)
    i_d, i_q = choice.currents(torque)
    exact = np.hypot(*design.machine.flux(i_d, i_q))
    points = exact[::_BETWEEN].copy()
    missed = exact - np.interp(torque, torque[::_BETWEEN], points)
    inside = missed[:-1].reshape(TABLE_POINTS - 1, _BETWEEN)
    middle = 0.5 * (np.max(inside, axis=1) + np.min(inside, axis=1))
    points[1:-1] += 0.5 * (middle[:-1] + middle[1:])
    flux = np.array([as_printed(float(value)) for value in points])
    error = np.max(np.abs(exact - np.interp(torque, torque[::_BETWEEN], flux)))
    constant = _of_constants(design, torque)
    return FluxTable(most, flux, float(error), float(np.max(np.abs(exact - constant))))


def _of_constants(design: Design, torque: FloatArray) -> FloatArray:
    """Flux linkage in Wb over torque in N m, shape (N,), with the inductances at zero current."""
    linear = linearised(design.machine)
    return np.hypot(*linear.flux(*mtpa_currents(linear, torque)))
