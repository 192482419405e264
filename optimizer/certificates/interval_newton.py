"""The interval Newton method: how far emitted currents lie from the exact ones
on an interval of torques.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import Expansion, Value, exactly, hull, upper, widened
from dqforge.optimizer.certificates.enclosures import JetFunction, jets
from dqforge.optimizer.certificates.exact_conditions import (
    Condition,
    Local,
    Task,
    conditions_over_box,
)
from dqforge.optimizer.certificates.rounding import Piece
from dqforge.optimizer.current_reference.forms import PENALTY_FROM

if TYPE_CHECKING:
    from flint import arb


_GROWTH = 1.3
_NEWTON_TRIES = 5

# A box that asks for so much more room than it has would never hold what it encloses.
_DIVERGING = 3.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds on one interval: A, A, N m, W, share of the least loss (0 below 5 % torque),
    share of the voltage.
    """

    i_d: float
    i_q: float
    torque: float
    loss: float
    loss_relative: float
    voltage_excess: float

    def values(self) -> FloatArray:
        """All bounds in order, shape (6,)."""
        return np.array([getattr(self, name) for name in self.__dataclass_fields__])


UNKNOWN = Bounds(*[math.inf] * 6)


@dataclass(frozen=True, slots=True)
class Interval:
    """Torques from ``low`` to ``high`` on one piece, with the bounds of the
    interval that it is a half of.
    """

    piece: Piece
    low: float
    high: float
    depth: int
    before: FloatArray

    @property
    def middle(self) -> float:
        """Torque in the middle, N m."""
        return 0.5 * (self.low + self.high)

    def halves(self, bounds: FloatArray) -> list[Interval]:
        """Both halves, which remember the bounds of the whole."""
        parts = ((self.low, self.middle), (self.middle, self.high))
        return [Interval(self.piece, low, high, self.depth + 1, bounds) for low, high in parts]


def _series(
    task: Task, piece: Piece, jet: JetFunction, condition: Condition
) -> Callable[[Value], list[Value]]:
    """Functions of the torque: its error, the condition, the first Newton step in i_d and i_q,
    the voltage excess.
    """

    def evaluate(torque: Value) -> list[Value]:
        i_d, i_q = piece.currents(torque)
        at = task.local(jet(i_d, i_q), i_d, i_q, condition, gradient=False)
        error = at.torque - torque
        inverse = 1 / (at.t_d * at.c_q - at.t_q * at.c_d)
        step_d = (error * at.c_q - at.condition * at.t_q) * inverse
        step_q = (at.condition * at.t_d - error * at.c_d) * inverse
        return [error, at.condition, step_d, step_q, at.excess]

    return evaluate


def newton(task: Task, interval: Interval, condition: Condition) -> Bounds:
    """Bounds on an interval where one condition fixes the exact currents.

    Raises:
        ZeroDivisionError: The interval is too wide, or the exact currents are not isolated there.
    """
    from flint import arb

    piece, expansion = interval.piece, Expansion(interval.low, interval.high)
    i_d, i_q = expansion.enclose(piece.currents)
    rounding_d, rounding_q = (bound.abs_upper() for bound in piece.rounding(expansion.ball))
    formulas = jets(task.choice.machine, i_d + arb(0, rounding_d), i_q + arb(0, rounding_q))
    parts = [expansion.enclose(_series(task, piece, formula, condition)) for formula in formulas]
    error, second, step_d, step_q, excess = (
        hull(list(column)) for column in zip(*parts, strict=True)
    )
    steps = (step_d.abs_upper(), step_q.abs_upper())
    reach = [
        step * _GROWTH + 2 * rounding + arb(1e-30)
        for step, rounding in zip(steps, (rounding_d, rounding_q), strict=True)
    ]
    for _ in range(_NEWTON_TRIES):
        box = (i_d + arb(0, reach[0]), i_q + arb(0, reach[1]))
        at = conditions_over_box(task, box, condition)
        inverse = 1 / (at.t_d * at.c_q - at.t_q * at.c_d)
        if not inverse.is_finite():
            raise ZeroDivisionError
        # The derivatives at the emitted currents and those of the mean value
        # theorem lie in the same balls.
        wide = [[2 * value.rad() for value in row] for row in ((at.t_d, at.t_q), (at.c_d, at.c_q))]
        moved = [row[0] * steps[0] + row[1] * steps[1] for row in wide]
        distance = (
            steps[0]
            + ((at.c_q * moved[0]).abs_upper() + (at.t_q * moved[1]).abs_upper())
            * inverse.abs_upper(),
            steps[1]
            + ((at.c_d * moved[0]).abs_upper() + (at.t_d * moved[1]).abs_upper())
            * inverse.abs_upper(),
        )
        missed = (
            second.abs_upper() + at.c_d.abs_upper() * rounding_d + at.c_q.abs_upper() * rounding_q
        )
        along = (at.t_q * inverse).abs_upper() * missed, (at.t_d * inverse).abs_upper() * missed
        # The box holds the rounded currents as well, and what lies along the curve of
        # constant torque from there.
        needed = [
            max(d.abs_upper(), rounding) + a
            for d, a, rounding in zip(distance, along, (rounding_d, rounding_q), strict=True)
        ]
        if all(bool(need < room) for need, room in zip(needed, reach, strict=True)):
            torque = (
                error.abs_upper()
                + at.t_d.abs_upper() * rounding_d
                + at.t_q.abs_upper() * rounding_q
            )
            loss, relative = _penalty(task, at, box, missed, inverse, condition)
            low_load = interval.high < PENALTY_FROM * float(task.reference.torque_max)
            return Bounds(
                i_d=upper(distance[0] + rounding_d),
                i_q=upper(distance[1] + rounding_q),
                torque=upper(torque),
                loss=loss,
                loss_relative=0.0 if low_load else relative,
                voltage_excess=_voltage_excess(task, excess, at, rounding_d, rounding_q),
            )
        if bool(needed[0] + needed[1] > _DIVERGING * (reach[0] + reach[1])):
            break
        reach = [need.abs_upper() * _GROWTH for need in needed]
    raise ZeroDivisionError


def _penalty(
    task: Task, at: Local, box: tuple[arb, arb], missed: arb, inverse: arb, condition: Condition
) -> tuple[float, float]:
    """Copper loss above the least for the torque that is made: in W, and over that least loss.

    Along the curve of constant torque the currents are off by ``missed`` / det (-dT/di_q, dT/di_d).
    At a free optimum the Lagrangian |i|^2 - lambda T has no gradient there, so that its Hessian
    alone counts; elsewhere the gradient.
    """
    i_d, i_q = box
    shift = missed * inverse
    if condition == "loss":
        factor = (i_d * at.t_d + i_q * at.t_q) / (at.t_d * at.t_d + at.t_q * at.t_q)
        bend = at.t_q * at.t_q * (1 - factor * at.t_dd) + at.t_d * at.t_d * (1 - factor * at.t_qq)
        square = (bend + 2 * factor * at.t_dq * at.t_d * at.t_q) * shift * shift
    else:
        square = 2 * (i_q * at.t_d - i_d * at.t_q) * shift
    more, least = square.abs_upper(), (i_d * i_d + i_q * i_q).abs_lower() - square.abs_upper()
    relative = upper(more / least) if least > 0 else math.inf
    return upper(more * 1.5 * exactly(task.choice.machine.r_s)), relative


def _voltage_excess(task: Task, excess: arb, at: Local, rounding_d: arb, rounding_q: arb) -> float:
    """Phase voltage above its limit over the limit, at least 0."""
    if task.choice.speed is None:
        return 0.0
    most = excess.upper() + at.e_d.abs_upper() * rounding_d + at.e_q.abs_upper() * rounding_q
    return max(upper((1 + most).sqrt()) - 1.0, 0.0)


def torque_and_voltage(task: Task, interval: Interval) -> tuple[arb, float]:
    """Ball of the torque error in N m, and the bound of the voltage excess.

    They need no exact currents.
    """
    expansion = Expansion(interval.low, interval.high)
    i_d, i_q = expansion.enclose(interval.piece.currents)
    rounding_d, rounding_q = interval.piece.rounding(expansion.ball)
    box = widened(i_d, rounding_d), widened(i_q, rounding_q)

    def errors(formula: JetFunction) -> Callable[[Value], list[Value]]:
        def evaluate(torque: Value) -> list[Value]:
            at = interval.piece.currents(torque)
            made, excess = task.torque_and_excess(formula(*at), *at)
            return [made - torque, excess]

        return evaluate

    formulas = jets(task.choice.machine, *box, slopes=False)
    rows = [expansion.enclose(errors(formula)) for formula in formulas]
    error, excess = (hull(list(column)) for column in zip(*rows, strict=True))
    at = conditions_over_box(task, box, "voltage")
    room = at.t_d.abs_upper() * rounding_d + at.t_q.abs_upper() * rounding_q
    return widened(error, room), _voltage_excess(task, excess, at, rounding_d, rounding_q)


def errors_without_currents(task: Task, interval: Interval) -> FloatArray:
    """Torque error and voltage alone: where torque and voltage limit touch,
    the exact currents are not isolated.
    """
    try:
        error, over = torque_and_voltage(task, interval)
    except ZeroDivisionError:
        return UNKNOWN.values()
    return Bounds(math.inf, math.inf, upper(error), math.inf, math.inf, over).values()
