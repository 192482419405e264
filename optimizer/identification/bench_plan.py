"""What to run on a bench before it is run: points of current and speed, their order, and the
intervals to expect.

The points are those of rows at constant speed (`voltage_terms`): both directions, both signs of
i_q, several amplitudes, with and without i_d, at two speeds. Their covariance is the inverse of the
Fisher information of these terms,

    C = sigma^2 (X^T X)^-1

with the columns X of all terms at all points and the standard deviation sigma of a point's mean
voltage. A point is one independent row, however many rows of a log it has: what a model leaves of a
voltage changes slowly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.torque_band import torque_parts
from dqforge.optimizer.identification.voltage_terms import (
    TERMS,
    SteadyRows,
    voltage_columns,
)

# Amplitudes of the current as shares of the limit, large and small ones in turn, and its angles
# from the q axis in rad.
_AMPLITUDES = (1.0, 0.25, 0.75, 0.5)
_ANGLES = tuple(math.radians(degrees) for degrees in (0.0, 35.0, 70.0))
# Speeds as shares of that at which the magnets alone take the voltage limit.
_SPEEDS = (0.3, 0.6)
# Points that need more of the voltage limit are left out.
_MOST_VOLTAGE = 0.95
# Without a word on it: what sound sweeps leave of the voltage, 0.1 to 0.4 %.
_NOISE = 0.003
_SECONDS = 2.0
_NORMAL = 1.959964
# Terms by the tolerance that scales the same part of the torque.
_SCALED_BY = {"psi_pm": "magnet_flux", "l_d": "inductance_d", "l_q": "inductance_q"}
# Errors of the torque for which the number of points is told.
_SHARES = (0.02, 0.01, 0.005)


@dataclass(frozen=True, slots=True)
class PlannedPoint:
    """A point of the sheet: mechanical speed in rad/s, currents in A, time in s."""

    omega_m: float
    i_d: float
    i_q: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Expected:
    """A parameter with the half width of its 95 % interval, both in ``unit``."""

    key: str
    label: str
    unit: str
    value: float
    half: float


@dataclass(frozen=True, slots=True)
class BenchPlan:
    """The points in their order, and what they are good for.

    Args:
        points: In the order in which they are to be run.
        left_out: Points that the voltage limit does not permit.
        noise: Standard deviation in V of the mean voltage of a point.
        expected: Parameters after one pass over the points.
        torque: Half width of the 95 % interval of the largest torque, as a share of it, after one
            pass.
        least_points: How many points of this kind a torque within a share takes, by that share.
    """

    points: tuple[PlannedPoint, ...]
    left_out: int
    noise: float
    expected: tuple[Expected, ...]
    torque: float
    least_points: Mapping[float, int]


@on_design("machine")
def plan_bench(design: Design) -> BenchPlan:
    """Points for the machine of a design, and the intervals to expect.

    Raises:
        NoSolutionError: The machine has no magnets, or the voltage limit leaves no points.
    """
    machine = linearised(design.machine)
    if machine.psi_pm <= 0.0:
        raise NoSolutionError(
            "machine: the speeds of a plan follow from the magnets, and this machine has none"
        )
    base = design.v_max / (machine.pole_pairs * machine.psi_pm)
    wanted = _grid(design.i_max, base)
    omega_m, i_d, i_q = wanted.T
    omega_e = machine.pole_pairs * omega_m
    u_d = machine.r_s * i_d - omega_e * machine.l_q * i_q
    u_q = machine.r_s * i_q + omega_e * (machine.psi_pm + machine.l_d * i_d)
    kept = np.hypot(u_d, u_q) <= _MOST_VOLTAGE * design.v_max
    if np.count_nonzero(kept) < 2 * len(_AMPLITUDES):
        raise NoSolutionError(
            f"inverter.v_dc: of {kept.size} points only {np.count_nonzero(kept)} lie within the "
            "voltage limit; write the largest link of the bench"
        )
    zeros = np.zeros(np.count_nonzero(kept), dtype=np.intp)
    rows = SteadyRows(("plan",), zeros, omega_e[kept], i_q[kept], u_q[kept], i_d[kept], u_d[kept])
    noise = _NOISE * design.v_max
    columns = voltage_columns(rows)
    whole = np.column_stack(list(columns.values()))
    covariance = np.asarray(noise**2 * np.linalg.inv(whole.T @ whole), dtype=np.float64)
    values = _values(design)
    expected = tuple(
        Expected(key, *TERMS[key], values[key], _NORMAL * math.sqrt(covariance[place, place]))
        for place, key in enumerate(columns)
        if key in values
    )
    torque = _torque(design, list(columns), covariance)
    count = len(rows.i_q)
    least = {
        share: max(2 * len(columns), math.ceil(count * (torque / share) ** 2)) for share in _SHARES
    }
    points = tuple(
        PlannedPoint(float(speed), float(d), float(q), _SECONDS) for speed, d, q in wanted[kept]
    )
    return BenchPlan(points, kept.size - count, noise, expected, torque, least)


def _grid(i_max: float, base: float) -> FloatArray:
    """Speeds in rad/s and currents in A, shape (N, 3), in the order of the bench.

    Large and small amplitudes follow each other, and each point its mirror image in i_q, so that
    the winding is as warm in one quadrant as in the other.
    """
    rows = [
        (
            way * speed * base,
            -amplitude * i_max * math.sin(angle),
            sign * amplitude * i_max * math.cos(angle),
        )
        for amplitude in _AMPLITUDES
        for angle in _ANGLES
        for speed in _SPEEDS
        for way in (1.0, -1.0)
        for sign in (1.0, -1.0)
    ]
    return np.array(rows)


def _values(design: Design) -> dict[str, float]:
    """What is known before of each term that is a parameter of the machine."""
    machine = linearised(design.machine)
    return {
        "resistance": machine.r_s,
        "magnet_flux": machine.psi_pm,
        "inductance_d": machine.l_d,
        "inductance_q": machine.l_q,
        "inverter_voltage": design.inverter.lost_per_dead_time * design.inverter.dead_time,
    }


def _torque(design: Design, terms: list[str], covariance: FloatArray) -> float:
    """Half width of the 95 % interval of the largest torque as a share, by linearisation."""
    from dqforge.optimizer.operating_points.solve import solve_curves

    chosen, values = solve_curves(design).chosen, _values(design)
    i_d, i_q = chosen.i_d[-1:], chosen.i_q[-1:]
    torque = float(design.machine.torque(i_d, i_q)[0])
    gradient = np.zeros(len(terms))
    for name, part in torque_parts(linearised(design.machine), i_d, i_q).items():
        key = _SCALED_BY[name]
        gradient[terms.index(key)] = float(part[0]) / (values[key] * torque)
    return float(_NORMAL * math.sqrt(gradient @ covariance @ gradient))
