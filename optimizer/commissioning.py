"""Tests that a drive runs on its own machine, for `identify`: voltage steps on a locked rotor, an
acceleration, and coasting.

The rotor stands where the frame of the voltages says: the d test turns it there by itself, with the
q test the shaft is locked. No parameter is needed: the voltage rises until the current is that of
the test, and the steps are quarters of what it took.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import IntEnum
from typing import Annotated, Any

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, Member, cast, where


class CommissioningTest(IntEnum):
    """What is tested; the shaft is locked for the q axis and free for the others."""

    D_AXIS = 0
    Q_AXIS = 1
    SHAFT = 2


class CommissioningState(IntEnum):
    """What a test is doing."""

    IDLE = 0
    RISE = 1
    STEPS = 2
    ACCELERATE = 3
    COAST = 4
    DONE = 5
    FAULT = 6


# What is said of them.
TESTS = {
    CommissioningTest.D_AXIS: "shaft free, it turns to the angle of the frame",
    CommissioningTest.Q_AXIS: "shaft locked there",
    CommissioningTest.SHAFT: "shaft free, without a load",
}
STATES = {
    CommissioningState.IDLE: "no gate pulses, no test",
    CommissioningState.RISE: "the voltage rises until the current is that of the test",
    CommissioningState.STEPS: "quarters of that voltage, logged",
    CommissioningState.ACCELERATE: "the current control makes i_q, logged",
    CommissioningState.COAST: "no gate pulses, logged",
    CommissioningState.DONE: "no gate pulses, the log may be read",
    CommissioningState.FAULT: "no gate pulses, the current was too large",
}


@dataclass(frozen=True, slots=True)
class CommissioningGains:
    """Numbers of the tests."""

    current: Annotated[float, Member("to which the voltage rises, and of the acceleration", "A")]
    trip: Annotated[float, Member("square of the current at which a test ends with a fault", "A^2")]
    rise: Annotated[float, Member("by which the voltage rises per sample", "V")]
    most: Annotated[float, Member("to which it may rise", "V")]
    omega_most: Annotated[float, Member("mechanical speed at which coasting begins", "rad/s")]
    omega_least: Annotated[float, Member("mechanical speed at which coasting ends", "rad/s")]
    hold: Annotated[int, Member("samples of a step of the voltage", whole=True)]
    longest: Annotated[int, Member("samples of acceleration and of coasting at most", whole=True)]
    every: Annotated[int, Member("samples of a row of the log, of steps", whole=True)]
    slowly: Annotated[int, Member("samples of a row of the log, of the shaft", whole=True)]
    rows: Annotated[int, Member("that the log holds", whole=True)]


@dataclass(slots=True)
class Commissioning:
    """What the drive is to do, and what is kept from sample to sample; its start makes it."""

    state: Annotated[Any, Member("", kind=CommissioningState)]
    test: Annotated[Any, Member("", kind=CommissioningTest)]
    u_d: Annotated[Any, Member("voltage to apply at an electrical angle of 0", "V")]
    u_q: Annotated[Any, Member("the same of the q axis", "V")]
    i_q: Annotated[Any, Member("reference of the current control while accelerating", "A")]
    top: Annotated[Any, Member("voltage at which the current was that of the test", "V")]
    level: Annotated[Any, Member("number of the step", whole=True)]
    count: Annotated[Any, Member("samples of this step, or since the shaft moves", whole=True)]
    wait: Annotated[Any, Member("samples until the next row of the log", whole=True)]
    next: Annotated[Any, Member("place of the next row in the log", whole=True)]
    logged: Annotated[Any, Member("rows in the log, the newest before next", whole=True)]
    take: Annotated[Any, Member("1: this sample belongs into the log at place", whole=True)]
    place: Annotated[Any, Member("where this sample belongs", whole=True)]
    coast: Annotated[Any, Member("place of the first row of coasting", whole=True)]


def at_rest() -> Commissioning:
    """Members before the start."""
    zero: Any = 0.0
    idle, test = CommissioningState.IDLE, CommissioningTest.D_AXIS
    return Commissioning(idle, test, zero, zero, zero, zero, 0, 0, 0, 0, 0, 0, 0, 0)


def single(gains: CommissioningGains) -> CommissioningGains:
    """The numbers as the firmware has them: floats in single precision."""
    whole = {name: getattr(gains, name) for name in ("hold", "longest", "every", "slowly", "rows")}
    return replace(cast(gains, SINGLE), **whole)


_S, _T = CommissioningState, CommissioningTest


def named(o: Arithmetic, value: CommissioningState | CommissioningTest) -> Any:
    """A state or a test by its name."""
    return o.constant(f"COMMISSIONING_{value.name}", value)


def _in(o: Arithmetic, state: Commissioning, value: CommissioningState) -> Any:
    return o.equal(state.state, named(o, value))


def start(o: Arithmetic, gains: CommissioningGains, state: Commissioning, test: Any) -> None:
    """Begin a test with an empty log."""
    current: Any = gains.current
    zero = o.full(0.0, current)
    state.test = test
    state.state, state.i_q = named(o, _S.RISE), zero
    state.u_d, state.u_q, state.top = zero, zero, zero
    state.level, state.count, state.wait = 0, 0, 0
    state.next, state.logged, state.take, state.place, state.coast = 0, 0, 0, 0, 0

    def move() -> None:
        state.state, state.i_q = named(o, _S.ACCELERATE), current

    where(o, o.equal(test, named(o, _T.SHAFT)), move, state)


def commissioning_stop(o: Arithmetic, state: Commissioning) -> None:
    """No voltage and no current any more."""
    zero = o.full(0.0, state.top)
    state.u_d, state.u_q, state.i_q = zero, zero, zero


def _ended(o: Arithmetic, state: Commissioning, end: CommissioningState) -> None:
    o.call(commissioning_stop, state)
    state.state = named(o, end)


def step(
    o: Arithmetic, gains: CommissioningGains, state: Commissioning, i: Dq, omega_m: Reals
) -> None:
    """One sample.

    Args:
        o: The arithmetic.
        gains, state: Of the tests.
        i: Current in A at the sampling instant, of the frame of the test.
        omega_m: Mechanical speed in rad/s; 0 where it is not known and the shaft does not turn.
    """
    square = o.let("square", i.d * i.d + i.q * i.q)
    fed = _in(o, state, _S.RISE) | _in(o, state, _S.STEPS) | _in(o, state, _S.ACCELERATE)
    beyond = o.negated(square <= gains.trip) & fed

    def act() -> None:
        o.cases(
            "",
            (
                _in(o, state, _S.RISE),
                lambda: _rise(o, gains, state, square),
            ),
            (
                _in(o, state, _S.STEPS),
                lambda: _steps(o, gains, state),
            ),
            (
                _in(o, state, _S.ACCELERATE),
                lambda: _accelerate(o, gains, state, omega_m),
            ),
            (
                _in(o, state, _S.COAST),
                lambda: _coast(o, gains, state, omega_m),
            ),
            otherwise=lambda: o.remark("nothing to do"),
            changing=(state,),
        )

    o.cases(
        "",
        (beyond, lambda: _ended(o, state, _S.FAULT)),
        otherwise=act,
        changing=(state,),
    )
    o.call(commissioning_log, gains, state)


def _rise(o: Arithmetic, gains: CommissioningGains, state: Commissioning, square: Reals) -> None:
    there = (square >= gains.current * gains.current) | (state.top >= gains.most)

    def begin() -> None:
        state.state, state.level, state.count = named(o, _S.STEPS), 0, 0
        o.call(commissioning_feed, state)

    def further() -> None:
        state.top = o.let("top", state.top + gains.rise)
        o.call(commissioning_apply, state, state.top)

    o.cases("", (there, begin), otherwise=further, changing=(state,))


def commissioning_feed(o: Arithmetic, state: Commissioning) -> None:
    """The voltage of a step: quarters of the top, first forward and then backward."""
    quarters = o.real(o.masked(state.level, 3)) + 1.0
    size = o.let("size", (0.25 * quarters) * state.top)
    u = o.let("u", o.choose(state.level < 4, size, -size))
    o.call(commissioning_apply, state, u)


def commissioning_apply(o: Arithmetic, state: Commissioning, u: Reals) -> None:
    """A voltage on the axis of the test."""
    zero = o.full(0.0, state.top)

    def along() -> None:
        state.u_d, state.u_q = u, zero

    def across() -> None:
        state.u_d, state.u_q = zero, u

    d_axis = o.equal(state.test, named(o, _T.D_AXIS))
    o.cases("", (d_axis, along), otherwise=across, changing=(state,))


def _steps(o: Arithmetic, gains: CommissioningGains, state: Commissioning) -> None:
    state.count = o.let("count", state.count + 1)

    def onward() -> None:
        state.level, state.count = state.level + 1, 0
        o.call(commissioning_feed, state)

    last = (state.count >= gains.hold) & (state.level >= 7)
    o.cases(
        "",
        (last, lambda: _ended(o, state, _S.DONE)),
        (state.count >= gains.hold, onward),
        otherwise=lambda: None,
        changing=(state,),
    )


def _accelerate(
    o: Arithmetic, gains: CommissioningGains, state: Commissioning, omega_m: Reals
) -> None:
    state.count = o.let("count", state.count + 1)
    enough = o.negated(omega_m < gains.omega_most) | (state.count >= gains.longest)

    def coast() -> None:
        _ended(o, state, _S.COAST)
        state.count, state.coast = 0, state.next

    where(o, enough, coast, state)


def _coast(o: Arithmetic, gains: CommissioningGains, state: Commissioning, omega_m: Reals) -> None:
    state.count = o.let("count", state.count + 1)
    over = o.negated(omega_m > gains.omega_least) | (state.count >= gains.longest)
    where(o, over, lambda: _ended(o, state, _S.DONE), state)


def commissioning_log(o: Arithmetic, gains: CommissioningGains, state: Commissioning) -> None:
    """Whether this sample belongs into the log, and where; a full log loses its oldest rows."""
    state.take = 0
    shaft = _in(o, state, _S.ACCELERATE) | _in(o, state, _S.COAST)
    active = _in(o, state, _S.STEPS) | shaft

    def keep() -> None:
        state.take, state.place = 1, state.next
        moved = o.equal(state.test, named(o, _T.SHAFT))
        state.wait = o.let("rest", o.choose(moved, gains.slowly, gains.every)) - 1
        following = o.let("following", state.next + 1)
        state.next = o.choose(following >= gains.rows, 0, following)
        state.logged = o.choose(state.logged < gains.rows, state.logged + 1, state.logged)

    def skip() -> None:
        state.wait = state.wait - 1

    def due() -> None:
        o.cases("", (o.equal(state.wait, 0), keep), otherwise=skip, changing=(state,))

    where(o, active, due, state)


# From a design to the numbers.

# Steps of a voltage last so many time constants of the slower axis, as the design knows it.
_TIME_CONSTANTS = 6.0
_LEAST_HOLD = 20
_TRIP = 1.5
_RISE_S = 0.2  # In which the voltage may rise to its limit,
_RISE_LAG = 0.05  # ... with the current that far behind, as a share.
_COAST_SHARE = 0.2
_SPEED_SHARE = 0.5  # Back-EMF over the voltage limit at which coasting begins.
_SLOW_S = 0.05  # Time constant of a winding without resistance.


@dataclass(frozen=True, slots=True)
class CommissioningFit:
    """Numbers of the tests; ``t_s`` in s, times of steps and shaft in s."""

    gains: CommissioningGains
    t_s: float
    locked: float
    shaft: float


@on_design("control")
def solve_commissioning(design: Design) -> CommissioningFit | None:
    """The tests that a design asks for, None where it asks for none."""
    settings = design.control.commissioning
    if settings is None:
        return None
    t_s = design.control.t_s
    current = settings.current or 0.5 * design.i_max
    machine = linearised(design.machine)
    slow = max(machine.l_d, machine.l_q) / machine.r_s if machine.r_s > 0.0 else _SLOW_S
    every = max(1, math.ceil(8 * _TIME_CONSTANTS * slow / t_s / settings.rows))
    hold = every * math.ceil(max(_TIME_CONSTANTS * slow / t_s, _LEAST_HOLD) / every)
    longest = math.ceil(settings.shaft_time / t_s)
    limit = design.v_max
    flux = max(machine.psi_pm, abs(machine.l_d - machine.l_q) * current)
    speed = settings.speed or _SPEED_SHARE * limit / (machine.pole_pairs * flux)
    gains = CommissioningGains(
        current=current,
        trip=(_TRIP * current) ** 2,
        rise=t_s * min(limit / _RISE_S, _RISE_LAG * current * machine.r_s / slow or math.inf),
        most=limit,
        omega_most=speed,
        omega_least=_COAST_SHARE * speed,
        hold=hold,
        longest=longest,
        every=every,
        slowly=max(1, math.ceil(2 * longest / settings.rows)),
        rows=settings.rows,
    )
    return CommissioningFit(gains, t_s, 8 * hold * t_s, 2 * longest * t_s)
