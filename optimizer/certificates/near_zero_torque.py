"""Bounds where a reference errs by a good part of the currents themselves,
as near rest without magnets.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import Expansion, Value, exactly, hull, upper, widened
from dqforge.optimizer.certificates.enclosures import jets
from dqforge.optimizer.certificates.exact_conditions import Task, conditions_over_box
from dqforge.optimizer.certificates.interval_newton import (
    UNKNOWN,
    Bounds,
    Interval,
    newton,
    torque_and_voltage,
)
from dqforge.optimizer.current_reference.forms import PENALTY_FROM

if TYPE_CHECKING:
    from flint import arb


_WIDEST = 1.5  # Ratio of torques up to which the exact currents for them are enclosed together.
NARROW = 0.02  # Width over torque to which intervals near rest are halved, whatever that gains.


@dataclass(frozen=True, slots=True)
class _Chord:
    """A straight line between the exact currents at both ends of an interval,
    in place of a reference.
    """

    low: float
    at_low: tuple[float, float]
    slope: tuple[float, float]

    @classmethod
    def of(cls, task: Task, low: float, high: float) -> _Chord:
        start, end = task.exact(low), task.exact(high)
        return cls(
            low, start, ((end[0] - start[0]) / (high - low), (end[1] - start[1]) / (high - low))
        )

    def currents(self, torque: Value) -> tuple[Value, Value]:
        x = torque - exactly(self.low)
        i_d, i_q = (
            x * exactly(slope) + exactly(at)
            for slope, at in zip(self.slope, self.at_low, strict=True)
        )
        return i_d, i_q

    def rounding(self, _torque: arb) -> tuple[arb, arb]:
        return exactly(0.0), exactly(0.0)


def bounds_near_zero_torque(task: Task, interval: Interval) -> Bounds:
    """Bounds where a reference errs by a good part of the currents themselves, as near rest.

    The exact currents are enclosed for themselves, about the chord between the solver's,
    and then compared.
    """
    expansion = Expansion(interval.low, interval.high)
    i_d, i_q = expansion.enclose(interval.piece.currents)
    rounding_d, rounding_q = interval.piece.rounding(expansion.ball)
    currents = widened(i_d, rounding_d), widened(i_q, rounding_q)
    error, over = torque_and_voltage(task, interval)
    exact = _exact_near_rest(task, interval.low, interval.high)
    loss, relative = _loss_beside(task, interval, currents, error)
    low_load = interval.high < PENALTY_FROM * float(task.reference.torque_max)
    return Bounds(
        i_d=upper(currents[0] - exact[0]),
        i_q=upper(currents[1] - exact[1]),
        torque=upper(error),
        loss=loss,
        loss_relative=0.0 if low_load else relative,
        voltage_excess=over,
    )


def _loss_beside(
    task: Task, interval: Interval, currents: tuple[arb, arb], error: arb
) -> tuple[float, float]:
    """Copper loss above the least for the torque that is made, which is off by ``error``.

    In W and as a share.

    The Hessian of the Lagrangian, as in `_penalty`, at the whole distance from the exact
    currents for that torque.
    """
    i_d, i_q = currents
    scale, square = 1.5 * exactly(task.choice.machine.r_s), i_d * i_d + i_q * i_q
    machine = task.choice.machine
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0:
        apart, least = _apart(interval, machine.saliency).abs_upper(), 2 * (i_d * i_q).abs_lower()
        more = apart * apart
        return upper(more * scale), upper(more / least) if least > 0 else math.inf
    low, high = interval.low + float(error.lower()), interval.high + float(error.upper())
    if low <= 0.0 or high > _WIDEST * low:
        return upper(square * scale), math.inf
    count_of_parts = math.ceil((high / low - 1.0) / NARROW)
    edges = np.geomspace(low * (1.0 - 1e-9), high * (1.0 + 1e-9), count_of_parts + 1).tolist()
    parts = [_exact_near_rest(task, *ends) for ends in pairwise(edges)]
    exact_d, exact_q = (hull(list(column)) for column in zip(*parts, strict=True))
    off_d, off_q = i_d - exact_d, i_q - exact_q
    at = conditions_over_box(task, (i_d.union(exact_d), i_q.union(exact_q)), "loss")
    factor = (exact_d * at.t_d + exact_q * at.t_q) / (at.t_d * at.t_d + at.t_q * at.t_q)
    straight = (1 - factor * at.t_dd) * off_d * off_d + (1 - factor * at.t_qq) * off_q * off_q
    more = (straight - 2 * factor * at.t_dq * off_d * off_q).abs_upper()
    least = (exact_d * exact_d + exact_q * exact_q).abs_lower()
    if not more.is_finite() or not least > 0:
        return upper(square * scale), math.inf
    return upper(more * scale), upper(more / least)


def _apart(interval: Interval, saliency: float) -> arb:
    """Ball of what |i_d| and |i_q| differ by: without a magnet |i|^2 is its square above the least,
    2 |i_d i_q|.
    """
    sign = 1 if saliency > 0.0 else -1

    def difference(torque: Value) -> list[Value]:
        i_d, i_q = interval.piece.currents(torque)
        return [i_q + i_d * sign]

    expansion = Expansion(interval.low, interval.high)
    (apart,) = expansion.enclose(difference)
    rounding_d, rounding_q = interval.piece.rounding(expansion.ball)
    return widened(apart, rounding_d + rounding_q)


def _exact_near_rest(task: Task, low: float, high: float) -> tuple[arb, arb]:
    """Balls of the exact currents between two torques, of which the lower one may be zero.

    A square root of the torque where inductances are constant and there is no magnet. From zero
    torque on: the least current rises with the torque, so that any current that makes at least the
    highest one is not shorter.
    """
    from flint import arb

    machine = task.choice.machine
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0:
        factor = arb(1.5 * machine.pole_pairs) * abs(arb(machine.l_q) - arb(machine.l_d))
        ends = [(arb(end) / factor).sqrt() for end in (low, high)]
        size = ends[0].union(ends[1])
        return (-size if machine.saliency > 0.0 else size), size
    if low > 0.0:
        chord = _Chord.of(task, low, high)
        interval = Interval(chord, low, high, 0, UNKNOWN.values())  # type: ignore[arg-type]
        distance = newton(task, interval, "loss")
        i_d, i_q = Expansion(interval.low, interval.high).enclose(chord.currents)
        return widened(i_d, arb(distance.i_d)), widened(i_q, arb(distance.i_q))
    end_d, end_q = (arb(current * 1.01) for current in task.exact(high))
    formulas = jets(machine, end_d, end_q)
    if not all(
        task.local(jet(end_d, end_q), end_d, end_q, "loss").torque >= high for jet in formulas
    ):
        raise ZeroDivisionError
    longest = (end_d * end_d + end_q * end_q).sqrt().abs_upper()
    return arb(0, longest), arb(0).union(longest)
