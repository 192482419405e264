"""Proven bounds of what a current reference errs by, over its whole domain and in the
arithmetic that is emitted.

The exact currents solve F(i, T) = 0: the torque is T, and the derivative of the copper loss along
the curve of constant torque vanishes, or i_d does, or the voltage is at its limit. The interval
Newton method encloses their distance from the emitted currents: i - i* = J^-1 F with J anywhere in
a box that holds both (R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to Interval
Analysis", 2009, chapter 8). F and J^-1 F at the emitted currents are enclosed by Taylor polynomials
with their remainders in ball arithmetic; what rounding adds comes from
`dqforge.optimizer.certificates.rounding`. Intervals are halved until the bounds meet what was found
by sampling.

What is proven is the distance from the stationary point next to the solver's;
that this is the best one of all is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field
from heapq import heapify, heappop, heappush
from itertools import count, pairwise
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import ORDER, upper
from dqforge.optimizer.certificates.exact_conditions import Condition, Task
from dqforge.optimizer.certificates.interval_newton import (
    UNKNOWN,
    Interval,
    errors_without_currents,
    newton,
)
from dqforge.optimizer.certificates.near_zero_torque import NARROW, bounds_near_zero_torque
from dqforge.optimizer.certificates.rounding import pieces
from dqforge.optimizer.current_reference.forms import (
    Reference,
    ReferenceErrors,
    ReluctanceClosedForm,
)
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

_BITS = 80
_FIRST_PARTS = 16
_CLOSE = 1.01  # Bounds within this factor of the sampled errors are not refined.

# Further factor for flux maps, of which an interval takes some ten times as long.
_SPLINE_SLACK = 1.1

# Bounds that halving lowers by less than this factor are left: what remains is rounding.
_GAIN = 0.98
_DEEPEST = 20
_MOST_INTERVALS = 1500  # Intervals that are looked at; what is left then keeps its bounds.
_HELD_POINTS = 201  # Torques at which it is asked whether the data of a flux map hold the currents.
_FAR = 1.05  # Bounds above this multiple of what was found are worth a second way.

# Shares of current limit, torque, full copper loss, loss and voltage below which no bound is
# refined.
_RESOLUTION = np.array([1e-9, 1e-9, 1e-9, 1e-5, 1e-9, 1e-9])
_TORQUE = 2  # Place of the torque error among the bounds.
_LOSSES = slice(3, 5)  # Places of both loss penalties.


@dataclass(frozen=True, slots=True)
class Certificate:
    """Bounds of `ReferenceErrors`, in the same units; None where none could be proven.

    ``model`` says what they are proven against: the ``equations`` of a machine with constant
    inductances, or the ``splines`` through the points of a flux map. ``intervals`` counts the parts
    of the domain.
    """

    model: Literal["equations", "splines"]
    i_d: float | None
    i_q: float | None
    torque: float
    torque_relative: float
    loss: float | None
    loss_relative: float | None
    voltage_excess: float | None
    intervals: int


@dataclass(frozen=True, slots=True)
class IntervalBounds:
    """Bounds on each interval, arrays of shape (N,) ascending by torque,
    in the units of `Certificate`.

    ``low`` and ``high`` in N m are the ends. What is not proven is inf;
    ``loss_relative`` is 0 below 5 % torque.
    """

    low: FloatArray
    high: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    loss: FloatArray
    loss_relative: FloatArray
    voltage_excess: FloatArray


def _conditions_beyond(
    task: Task, interval: Interval, here: list[Condition], torque_error: float
) -> list[Condition]:
    """Other conditions that may hold for the torque that is made, for which the least loss is
    asked.
    """
    if not task.kinks or not math.isfinite(torque_error):
        return []
    reached = task.conditions(interval.low - torque_error, interval.high + torque_error)
    return [condition for condition in reached if condition not in here]


def _losses(task: Task, interval: Interval, condition: Condition) -> FloatArray:
    """Bounds of the loss penalty alone, shape (2,), against the currents
    that one condition fixes.
    """
    try:
        return newton(task, interval, condition).values()[_LOSSES]
    except ZeroDivisionError:
        return np.full(2, math.inf)


def _bounds(task: Task, interval: Interval, found: FloatArray) -> tuple[FloatArray, bool]:
    """Bounds on an interval by every condition that may hold there, and whether
    narrower ones may be much lower.

    Inf where nothing is proven.
    """
    conditions = task.conditions(interval.low, interval.high)
    best = UNKNOWN.values()
    try:
        best = np.max(
            [newton(task, interval, condition).values() for condition in conditions], axis=0
        )
    except ZeroDivisionError:
        if conditions != ["loss"]:
            best = errors_without_currents(task, interval)
    beyond = _conditions_beyond(task, interval, conditions, float(best[_TORQUE]))
    for condition in beyond:
        best[_LOSSES] = np.maximum(best[_LOSSES], _losses(task, interval, condition))
    may_fall = len(conditions) + len(beyond) > 1 or not np.all(np.isfinite(best))
    if conditions == ["loss"] and np.any(best > _FAR * found):
        try:
            best = np.minimum(best, bounds_near_zero_torque(task, interval).values())
            may_fall = interval.high - interval.low > NARROW * interval.high
        except ZeroDivisionError:
            best = np.minimum(best, errors_without_currents(task, interval))
    return np.asarray(best), may_fall


@dataclass(order=True, slots=True)
class _Open:
    """An interval with its bounds in the order of refinement: the one that is worst
    against what was found first.
    """

    rank: float
    number: int
    interval: Interval = field(compare=False)
    bounds: FloatArray = field(compare=False)
    may_fall: bool = field(compare=False)

    def is_settled(self, level: FloatArray) -> bool:
        """Whether halving is not worth it: the bounds are low, or halving did
        not lower what is too high.
        """
        high = self.bounds > _CLOSE * level
        if not high.any() or self.interval.depth >= _DEEPEST:
            return True
        falls = self.bounds < _GAIN * self.interval.before
        return (
            not self.may_fall
            and bool(np.all(np.isfinite(self.bounds[high])))
            and not bool(np.any(falls & high))
        )


def _refine(task: Task, level: FloatArray) -> list[_Open]:
    """Intervals that make up the domain with their bounds, refined where they
    are worst against a level.
    """
    numbers = count()

    def opened(interval: Interval) -> _Open:
        bounds, may_fall = _bounds(task, interval, level)
        return _Open(-float(np.max(bounds / level)), next(numbers), interval, bounds, may_fall)

    unknown = UNKNOWN.values()
    waiting = [
        opened(Interval(piece, low, high, 0, unknown))
        for piece in pieces(task.reference)
        for low, high in pairwise(np.linspace(piece.low, piece.high, _FIRST_PARTS + 1).tolist())
    ]
    heapify(waiting)
    worst = np.zeros(6)
    settled: list[_Open] = []
    while waiting:
        worst_one = heappop(waiting)
        if worst_one.number + len(waiting) > _MOST_INTERVALS or worst_one.is_settled(
            np.maximum(level, worst / _CLOSE)
        ):
            worst = np.maximum(worst, worst_one.bounds)
            settled.append(worst_one)
            continue
        for half in worst_one.interval.halves(worst_one.bounds):
            heappush(waiting, opened(half))
    return settled


def certify(
    choice: CurrentChoice, reference: Reference, errors: ReferenceErrors
) -> Certificate | None:
    """Prove bounds of the errors of a reference over its whole domain.

    Args:
        choice: What is approximated.
        reference: The emitted constants.
        errors: Errors that were found by sampling: bounds that come within 1 % of them are good
            enough.

    Returns:
        For every torque between zero and the end of the domain, by symmetry for both signs, with
        and without fused multiply-add; None for a machine that is neither linear nor a flux map,
        where the data of a flux map hold the currents on their edge, and where nothing could be
        proven.
    """
    if not isinstance(choice.machine, LinearMachine | SaturatedMachine):
        return None
    if np.any(choice.held(np.linspace(0.0, float(reference.torque_max), _HELD_POINTS)[1:])):
        return None
    form = None if isinstance(reference, FixedReference) else reference.form
    with _ball_arithmetic():
        if isinstance(form, ReluctanceClosedForm) and isinstance(choice.machine, LinearMachine):
            return _square_root(choice.machine, form, float(reference.torque_max))
        return _certify(Task.of(choice, reference), errors)


def interval_bounds(
    choice: CurrentChoice, reference: Reference, errors: ReferenceErrors
) -> IntervalBounds:
    """Bounds interval by interval, of which `certify` states the largest.

    Args:
        choice, reference, errors: As for `certify`; the machine is linear or a flux map, and the
            form is not the square root.

    Raises:
        TypeError: The machine is neither linear nor a flux map.
    """
    with _ball_arithmetic():
        task = Task.of(choice, reference)
        parts = sorted(
            _refine(task, _level(task, _sampled(errors))), key=lambda part: part.interval.low
        )
    low, high = (
        np.array([getattr(part.interval, end) for part in parts]) for end in ("low", "high")
    )
    return IntervalBounds(low, high, *np.array([part.bounds for part in parts]).T)


@contextmanager
def _ball_arithmetic() -> Iterator[None]:
    """Precision and length of series for what follows.

    The library's own settings come back behind it.
    """
    from flint import ctx

    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = _BITS, ORDER + 1
    try:
        yield
    finally:
        ctx.prec, ctx.cap = before


def _sampled(errors: ReferenceErrors) -> FloatArray:
    over = errors.voltage_excess
    rest = [errors.i_d, errors.i_q, errors.torque, errors.loss, errors.loss_relative]
    return np.array([*rest, 0.0 if over is None else over])


def _level(task: Task, sampled: FloatArray) -> FloatArray:
    """Bounds that are good enough, in the order of `Bounds`."""
    i_max, r_s = task.choice.i_max, task.choice.machine.r_s
    most = np.array(
        [i_max, i_max, float(task.reference.torque_max), 1.5 * r_s * i_max**2, 1.0, 1.0]
    )
    slack = 1.0 if isinstance(task.choice.machine, LinearMachine) else _SPLINE_SLACK
    return np.asarray(np.maximum(sampled, _RESOLUTION * most) * slack)


def _certify(task: Task, errors: ReferenceErrors) -> Certificate | None:
    sampled = _sampled(errors)
    parts = _refine(task, _level(task, sampled))
    # What was found is a bound of nothing, but where it is the rounding of doubles alone
    # it may lie above the bound.
    worst = np.maximum(np.max([part.bounds for part in parts], axis=0), sampled)
    i_d, i_q, torque, loss, relative, excess = (
        value if math.isfinite(value) else None for value in worst.tolist()
    )
    if torque is None:
        return None
    return Certificate(
        model="equations" if isinstance(task.choice.machine, LinearMachine) else "splines",
        i_d=i_d,
        i_q=i_q,
        torque=torque,
        torque_relative=math.nextafter(torque / float(task.reference.torque_max), math.inf),
        loss=loss,
        loss_relative=relative,
        voltage_excess=None if errors.voltage_excess is None else excess,
        intervals=len(parts),
    )


def _square_root(machine: LinearMachine, form: ReluctanceClosedForm, end: float) -> Certificate:
    """Bounds of the exact square root: its gain is rounded, and so are the product and the root.

    Both currents have the same magnitude bit for bit, which is the optimum of
    the torque that they make.
    """
    from flint import arb

    gain = 1 / (arb(1.5 * machine.pole_pairs) * abs(arb(machine.l_q) - arb(machine.l_d)))
    unit = arb(2.0**-24)
    share = (abs((arb(float(form.gain)) / gain).sqrt() - 1) + 1) * (1 + unit) * (1 + unit) - 1
    tiny = (arb(2) ** -149).sqrt()
    current = (gain * end).sqrt() * share + tiny
    torque = arb(end) * share * (2 + share) + tiny
    return Certificate(
        model="equations",
        i_d=upper(current),
        i_q=upper(current),
        torque=upper(torque),
        torque_relative=upper(torque / end),
        loss=0.0,
        loss_relative=0.0,
        voltage_excess=None,
        intervals=1,
    )
