"""Proven bounds of what a current reference errs by, over its whole domain and in the
arithmetic that is emitted.

The exact currents solve F(i, T) = 0: the torque is T, and the derivative of the copper loss along
the curve of constant torque vanishes, or i_d does, or the voltage is at its limit. The interval
Newton method encloses their distance from the emitted currents: i - i* = J^-1 F with J anywhere in
a box that holds both (R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to Interval
Analysis", 2009, chapter 8). F and J^-1 F at the emitted currents are enclosed by Taylor polynomials
with their remainders in ball arithmetic; what rounding adds comes from
`dqforge.optimizer.certificates.ball`. Intervals are halved until the bounds meet what was found
by sampling.

What is proven is the distance from the stationary point next to the solver's;
that this is the best one of all is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import field
from heapq import heapify, heappop, heappush
from itertools import count, pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import (
    ORDER,
    Condition,
    Expansion,
    JetFunction,
    Local,
    Piece,
    Task,
    Value,
    conditions_over_box,
    exactly,
    hull,
    jets,
    pieces,
    upper,
    widened,
)
from dqforge.optimizer.current_reference.forms import (
    PENALTY_FROM,
    FixedReference,
    Reference,
    ReferenceErrors,
    ReluctanceClosedForm,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from flint import arb


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


# The interval Newton method: how far emitted currents lie from the exact ones
# on an interval of torques.

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


# Bounds where a reference errs by a good part of the currents themselves,
# as near rest without magnets.

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
