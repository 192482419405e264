"""What is proven of a saturating machine's current loops while the current changes.

Axis by axis, decoupled as if perfectly. The inductance may be any of those along the current
reference at every sample, and go wherever it likes from one to the next; the tolerances are
constant, and are cut into cells where one Lyapunov function does not serve all of them.

With constant gains the difference between any two currents obeys this, the inductance being an
average between both: whatever their course, they come together. Gains that follow the current do so
for small deviations from a current that is held; with gains and inductances of any two currents
(``any_current``), for deviations of any size from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.changing_loops.changing_steps import (
    Interval,
    LoopRange,
    velocity_step,
)
from dqforge.optimizer.changing_loops.common_function import (
    Growth,
    common_matrix_of,
    fastest_growth,
    neighbours_fall,
)
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.schedule.gain_schedule import AxisSchedule, GainSchedule
from dqforge.optimizer.loops.tolerance_box import Axis, DriveBox

_CELLS = 64  # Cells of the tolerances at most.

# Pieces of the range of inductances that are tried where no function serves all of it.
_STEPS = (2, 4, 8, 16)
_PLACES = 5  # Currents between which the velocity form is tried.


@dataclass(frozen=True, slots=True)
class ChangingAxis:
    """What is proven of one axis.

    Args:
        axis: Which axis.
        inductance: Least and largest along the reference, in H.
        proven: Whether deviations are forgotten however fast the current changes; with scheduled
            gains small ones, and where the gains are those of the current that flows.
        any_current: Of scheduled gains whether they may be those of another current, such as the
            reference of a current on its way, and deviations of any size; None of constant gains.
        rate: Where it is not proven so: the largest change of the inductance per sample, as a
            factor, for which it is; None where it is not needed or none was found.
        cells: Cells of the tolerances that have a function each.
        velocity: Of scheduled gains a change of the current under which the velocity form grows,
            with the currents i_q in A; None where none was found.
    """

    axis: Axis
    inductance: Interval
    proven: bool
    any_current: bool | None
    rate: float | None
    cells: int
    velocity: tuple[Growth, Interval] | None


@dataclass(frozen=True, slots=True)
class _Axis:
    """One axis: its tolerances, and gains over inductances kp t_s/L, ki t_s^2/L with g = L'/L = 1.

    ``share`` is the interval of g over L/L' by the tolerances, ``rho`` that of R t_s/L over all.
    """

    share: Interval
    rho: Interval

    def proven(self, products: Callable[[Interval], tuple[tuple[float, float], ...]]) -> int | None:
        """Cells of the tolerances that serve, None where there would be too many."""
        waiting, found, tried = [self.share], 0, 0
        while waiting:
            low, high = waiting.pop()
            tried += 1
            loops = LoopRange(self.rho, products((low, high)))
            if common_matrix_of(loops) is not None:
                found += 1
            elif tried >= _CELLS or high - low < 1e-3 * low:
                return None
            else:
                waiting += [(low, 0.5 * (low + high)), (0.5 * (low + high), high)]
        return found


def _limits(box: DriveBox, axis: Axis, inductance: Interval) -> _Axis:
    tolerances, design = box.tolerances, box.design
    low_l, high_l = tolerances.limits("l_d" if axis == "i_d" else "l_q")
    low_v, high_v = tolerances.limits("v_dc")
    low_r, high_r = tolerances.limits("r_s")
    low_t, high_t = tolerances.limits("dead_time")
    dead = box.dead_time_resistance if high_t > low_t else 0.0
    least = design.machine.r_s * (1.0 + low_r) + dead * low_t * (1.0 + high_v)
    most = design.machine.r_s * (1.0 + high_r) + dead * high_t * (1.0 + high_v)
    t_s = design.control.t_s
    ends = [
        ohm * t_s / (value * (1.0 + deviation))
        for ohm in (least, most)
        for value in inductance
        for deviation in (low_l, high_l)
    ]
    return _Axis(
        share=((1.0 + low_v) / (1.0 + high_l), (1.0 + high_v) / (1.0 + low_l)),
        rho=(min(ends), max(ends)),
    )


def _constant(box: DriveBox, gains: LoopGains, axis: Axis, inductance: Interval) -> ChangingAxis:
    """Gains that do not follow: both go with 1/L together."""
    limits, t_s = _limits(box, axis, inductance), box.design.control.t_s

    def products(share: Interval, reach: Interval = inductance) -> tuple[tuple[float, float], ...]:
        ends = share[0] * t_s / reach[1], share[1] * t_s / reach[0]
        return tuple((end * gains.kp, end * gains.ki_ts) for end in ends)

    cells = limits.proven(products)
    rate = None if cells is not None else _rate(limits, products, inductance)
    return ChangingAxis(axis, inductance, cells is not None, None, rate, cells or 0, None)


def _rate(
    limits: _Axis,
    products: Callable[[Interval, Interval], tuple[tuple[float, float], ...]],
    inductance: Interval,
) -> float | None:
    """Largest factor by which the inductance may change in a sample, of those tried."""
    for pieces in _STEPS:
        ends = np.geomspace(*inductance, pieces + 1).tolist()
        cells = [
            LoopRange(limits.rho, products(limits.share, reach)).corners()
            for reach in pairwise(ends)
        ]
        if neighbours_fall(cells):
            return float(ends[1] / ends[0])
    return None


def _scheduled(box: DriveBox, schedule: GainSchedule, found: AxisSchedule) -> ChangingAxis:
    """Gains that follow: each over the inductance of the same current, or of any other."""
    inductance = float(np.min(found.inductance)), float(np.max(found.inductance))
    limits, t_s = _limits(box, found.axis, inductance), box.design.control.t_s
    gains = [np.asarray(found.kp), np.asarray(found.ki) * t_s]
    same = [_reached(values / found.inductance) for values in gains]
    other = [
        (float(np.min(values)) / inductance[1], float(np.max(values)) / inductance[0])
        for values in gains
    ]

    def over(sides: list[Interval]) -> Callable[[Interval], tuple[tuple[float, float], ...]]:
        (p_low, p_high), (q_low, q_high) = sides
        return lambda share: tuple(
            (share_p * t_s * p, share_q * t_s * q)
            for share_p, p in zip(share, (p_low, p_high), strict=True)
            for share_q, q in zip(share, (q_low, q_high), strict=True)
        )

    cells, anywhere = limits.proven(over(same)), limits.proven(over(other))
    return ChangingAxis(
        found.axis,
        inductance,
        cells is not None,
        anywhere is not None,
        None,
        cells or 0,
        _velocity(box, schedule, found),
    )


def _reached(values: FloatArray) -> Interval:
    """All values of a curve that is known at many currents: between two it moves by no more than
    the largest step.
    """
    step = float(np.max(np.abs(np.diff(values)), initial=0.0))
    return float(np.min(values)) - step, float(np.max(values)) + step


def _velocity(
    box: DriveBox, schedule: GainSchedule, found: AxisSchedule
) -> tuple[Growth, Interval] | None:
    """How the velocity form grows when the current jumps between a few of the reference."""
    places = np.linspace(0, found.inductance.size - 1, _PLACES).round().astype(int)
    t_s, r_s = box.design.control.t_s, box.design.machine.r_s
    steps = []
    for place in places.tolist():
        inductance, kp, ki = (float(of[place]) for of in (found.inductance, found.kp, found.ki))
        rho = r_s * t_s / inductance
        step = velocity_step(
            math.exp(-rho), -math.expm1(-rho) / rho, t_s / inductance, (kp, ki * t_s)
        )
        steps.append(step)
    growth = fastest_growth(np.array(steps))
    if growth is None:
        return None
    at = [float(schedule.i_q[places[place]]) for place in growth.places]
    return growth, (at[0], at[1])


def prove_changing_currents(
    box: DriveBox,
    largest: tuple[float, float],
    loops: tuple[LoopGains, LoopGains],
    schedule: GainSchedule | None,
) -> tuple[ChangingAxis, ...]:
    """What is proven of both axes while the inductances change; nothing of a linear machine.

    Args:
        box: The drive with its tolerances.
        largest: Largest incremental inductances (l_d, l_q) along the reference in H; the loops are
            tuned for the least ones.
        loops: The current loops of d and q.
        schedule: Their gains over the current, None where they are constant.
    """
    if isinstance(box.design.machine, LinearMachine):
        return ()
    plain = replace(box, spread=(1.0, 1.0))
    if schedule is not None:
        return tuple(_scheduled(plain, schedule, axis) for axis in schedule.axes)
    axes: tuple[Axis, Axis] = ("i_d", "i_q")
    return tuple(
        _constant(plain, loop, axis, (least, most))
        for axis, loop, least, most in zip(axes, loops, box.nominal, largest, strict=True)
    )
