"""What stands in the comparison: an estimator or a start-up with what is asked of it.

A candidate is a record of functions. Each says by a reason with its number why physics forbids it,
or what it does at the speeds and loads of a question. A further kind of estimator is a further
function that lists candidates, in `dqforge.optimizer.estimator_comparison.compared`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.sections.chosen_together import (
    COMPENSATED,
    SPEED_GAIN,
    SPEED_GAIN_COMPENSATED,
    SPREAD,
)
from dqforge.machines.design.settings import ControlSettings, ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import SPEED_OBSERVER, ObserverMethodName, StartUpMethodName
from dqforge.machines.plants.drive_motion import Plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.measured_speed_loop import judge_observed
from dqforge.optimizer.estimator_comparison.capture_range import CaptureMap, capture_of
from dqforge.optimizer.estimators.solve import TunedTracker
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.conditions import loads_at, training_box
from dqforge.optimizer.observers.judgement import DEAD_TIME, PARAMETERS, ObserverJudgement, judge_at
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import Disturbances, Load, steady_observer
from dqforge.optimizer.observers.tuning import PositionObserver, tune_position_observer


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What every candidate is asked.

    Args:
        design: The drive.
        omega_max: Its largest electrical speed in rad/s.
        omega: Electrical speeds in rad/s, ascending from standstill, shape (S,).
        shares: Torques over the largest one, ascending from braking, shape (L,).
        loads: The loads there.
        reached: Whether the drive's voltage reaches a speed at a load, shape (S, L).
        disturbances: What an estimator has to live with: noise, tolerances, dead time.
        loops: Both current loops and the speed loop as tuned for an encoder; None without a speed
            loop.
        at_speed, from_standstill: Names of the chosen estimators, of which start-ups are asked;
            None where there is none.
    """

    design: Design
    omega_max: float
    omega: FloatArray
    shares: FloatArray
    loads: tuple[Load, ...]
    reached: NDArray[np.bool_]
    disturbances: Disturbances
    loops: tuple[LoopGains, LoopGains, LoopGains] | None
    at_speed: str | None = None
    from_standstill: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorFigures:
    """What an estimator does.

    Args:
        angle: R.m.s. of all steady errors of the angle and of its noise in rad, inf where it is
            lost, shape (S, L).
        speed: R.m.s. of the steady errors of the electrical speed in rad/s, shape (S, L).
        noise: Standard deviation of the angle in rad, shape (S, L).
        omega_low, omega_high: Electrical speeds in rad/s between which it holds at every load; nan
            where it never does.
        left: Crossover in rad/s that it leaves for the speed loop, None where it leaves none or
            where that is not known.
        slopes: Errors per unit of their causes, None where they are not known.
        capture: Starts from which it locks, None where none were tried.
        observer: The tuned observer, None of candidates of other kinds.
        tracker: The tuned tracker likewise.
    """

    angle: FloatArray
    speed: FloatArray
    noise: FloatArray
    omega_low: float
    omega_high: float
    left: float | None = None
    slopes: Slopes | None = None
    capture: CaptureMap | None = None
    observer: PositionObserver | None = None
    tracker: TunedTracker | None = None


@dataclass(frozen=True, slots=True)
class Candidate:
    """An estimator.

    Args:
        name: The word of ``control.observer.method``.
        title: In words.
        refusal: question -> why physics or the design forbids it, with the number; empty where it
            may be.
        figures: question -> what it does; may raise `NoSolutionError` or `InputError`, whose
            message is then the reason why it cannot be.
        from_standstill: Whether it works at standstill, so that a drive may start on it.
        six_step: Whether it makes the drive a six-step drive, whose currents are others: it wins
            and is flashed in such a design alone, where the others are not.
    """

    name: str
    title: str
    refusal: Callable[[Question], str]
    figures: Callable[[Question], EstimatorFigures]
    from_standstill: bool = False
    six_step: bool = False

    def competes(self, asked: Question) -> bool:
        """Whether it can be flashed in the drive of the question."""
        return self.six_step == (asked.design.control.six_step is not None)


@dataclass(frozen=True, slots=True)
class TriedStarts:
    """Starts that were tried against a load.

    Args:
        load: Friction over the torque of the current limit.
        count, succeeded: How many, and how many of them succeeded.
        interval: Within which the true share lies with 95 %.
        failures: How often each failure, by its name.
    """

    load: float
    count: int
    succeeded: int
    interval: tuple[float, float]
    failures: Mapping[str, int]

    @property
    def rate(self) -> float:
        """The share that succeeded."""
        return self.succeeded / self.count


@dataclass(frozen=True, slots=True, eq=False)
class StartFigures:
    """What a start-up does.

    Args:
        largest_load: Largest load torque in N m that it starts against.
        hand_over: Electrical speed in rad/s at which it hands over.
        duration: Time in s to the hand-over by plan.
        design: The design with the chosen estimators and this start; None where it is not known.
        tried: Starts over the box of the design, by load; none where none were tried.
        untried: Why they could not be tried; empty where they could, or were not asked for.
    """

    largest_load: float
    hand_over: float
    duration: float
    design: Design | None = None
    tried: tuple[TriedStarts, ...] = ()
    untried: str = ""

    @property
    def success(self) -> float | None:
        """Least share of starts that succeed, over the loads; None where none were tried."""
        return min((part.rate for part in self.tried), default=None)


@dataclass(frozen=True, slots=True)
class StartCandidate:
    """A way to start.

    Args:
        method: The word of ``control.start_up.method``.
        title: In words.
        refusal, figures: As of `Candidate`; success is tried elsewhere, by the emitted C.
    """

    method: StartUpMethodName
    title: str
    refusal: Callable[[Question], str]
    figures: Callable[[Question], StartFigures]

    @property
    def name(self) -> str:
        """Its word."""
        return self.method


# The position observers as candidates: judged by their steady states, tried from wrong starts.

_SLOPE_LOAD = 0.5  # torque over the largest one, motoring


def observer_candidates() -> tuple[Candidate, ...]:
    """A candidate per method, and the speed observer, which cannot do without an encoder."""
    behind_encoder = Candidate(
        SPEED_OBSERVER,
        "reduced-order speed observer",
        lambda _: "it observes the speed alone, in the angle of an encoder",
        _never,
    )
    return (behind_encoder, *(_candidate(name) for name in METHODS))


def _never(_: Question) -> EstimatorFigures:
    raise AssertionError("a candidate that is refused is not asked")


def _candidate(name: str) -> Candidate:
    return Candidate(name, METHODS[name].title, _refusal, lambda asked: _figures(asked, name))


def _refusal(asked: Question) -> str:
    psi_pm = linearised(asked.design.machine).psi_pm
    if psi_pm > 0.0:
        return ""
    return f"psi_pm = {psi_pm:g} Wb: without a magnet there is nothing to see at no current"


def settings_of(asked: Question, name: str) -> ObserverSettings:
    """What a design that asks for an observer has: the design's own where it is this very one, else
    the usual ones, with those that are chosen together with the speed loop.

    Args:
        asked: The question.
        name: Of a method.
    """
    control = asked.design.control
    own, loop = control.observer, control.speed_loop
    if own is not None and own.method == name:
        return own
    plain = ObserverSettings(method=cast(ObserverMethodName, name))
    if name != "flux" or loop is None or loop.method != "symmetrical-optimum":
        return plain
    known, inverter = asked.disturbances, asked.design.inverter
    left = max(abs(known.lost), abs(known.lost_least))
    whole = 4.0 / np.pi * inverter.f_sw * inverter.v_dc * inverter.dead_time
    small = left <= COMPENSATED * whole
    return replace(plain, speed_gain=SPEED_GAIN_COMPENSATED if small else SPEED_GAIN)


def tuned_observer(asked: Question, name: str) -> PositionObserver:
    """The observer of a method, with the design's own settings where it asks for this very one.

    Args:
        asked: The question.
        name: Of a method.
    """
    design = asked.design
    learns = METHODS[name].train is not None
    return tune_position_observer(
        linearised(design.machine),
        settings_of(asked, name),
        design.control.t_s,
        design.inverter.v_dc,
        asked.omega_max,
        asked.disturbances,
        training_box(design, asked.omega_max) if learns else None,
    )


def _figures(asked: Question, name: str) -> EstimatorFigures:
    observer = tuned_observer(asked, name)
    judged = [_judged(asked, observer, m) for m in range(len(asked.loads))]

    def over(values: list[FloatArray], standstill: float) -> FloatArray:
        """Of all speeds and loads: standstill, where an observer sees nothing, then the rest."""
        return np.vstack([np.full(len(judged), standstill), np.stack(values, axis=1)])

    load = loads_at(asked.design, (_SLOPE_LOAD,))[0]
    return EstimatorFigures(
        angle=over([part.steady for part in judged], np.inf),
        speed=over([part.speed_total for part in judged], np.inf),
        noise=over([part.noise for part in judged], np.inf),
        omega_low=observer.judgement.steady_low,
        omega_high=observer.judgement.steady_high,
        left=_left(asked, observer),
        slopes=slopes_of(observer, load, np.array(SLOPE_SHARES) * asked.omega_max),
        capture=capture_of(asked.design, observer),
        observer=observer,
    )


def _judged(asked: Question, observer: PositionObserver, load: int) -> ObserverJudgement:
    """At one load, over the speeds from the first above standstill."""
    alone = replace(asked.disturbances, loads=(asked.loads[load],))
    return judge_at(
        observer.method, observer.gains, observer.t_s, observer.machine, alone, asked.omega[1:]
    )


def _left(asked: Question, observer: PositionObserver) -> float | None:
    """Crossover in rad/s that is left for the speed loop."""
    if asked.loops is None:
        return None
    loops = asked.loops
    found = judge_observed(asked.design, loops, None, observer, thorough=False).observed
    return None if found is None else found.left


# What an estimator errs by per unit of each cause: derivatives of the steady errors by R, L_d,
# L_q, psi and the voltage that a dead time takes.

CAUSES = (*PARAMETERS, DEAD_TIME)
SLOPE_SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)  # Speeds over the largest one at which they are given.
_STEP = 1e-3  # of a parameter; of the voltage R i for the dead time


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives at one load.

    Args:
        omega: Electrical speeds in rad/s, shape (S,).
        angle: By cause the angle error in rad per relative change of the machine's parameter, and
            per V of lost voltage for the dead time, shape (S,); nan where the angle is lost.
        speed: The same of the speed error in rad/s.
    """

    omega: FloatArray
    angle: dict[str, FloatArray]
    speed: dict[str, FloatArray]


def slopes_of(observer: PositionObserver, load: Load, omega: FloatArray) -> Slopes:
    """Derivatives of the steady errors by central differences.

    Args:
        observer: The observer.
        load: Currents, and the machine there.
        omega: Electrical speeds in rad/s, shape (S,).
    """
    count, cases = len(omega), len(CAUSES)
    exact = np.array([observer.machine.r_s, load.l_d, load.l_q, load.psi_pm])
    current = complex(load.i_d, load.i_q)
    volt = observer.machine.r_s * abs(current)
    rows = np.repeat(exact[None, :], 2 * cases, axis=0)
    lost = np.zeros(2 * cases)
    for k, cause in enumerate(CAUSES):
        for row, sign in ((2 * k, 1.0), (2 * k + 1, -1.0)):
            if cause == DEAD_TIME:
                lost[row] = sign * _STEP * volt
            else:
                rows[row, k] *= 1.0 + sign * _STEP
    found = steady_observer(
        observer.method,
        observer.gains,
        observer.t_s,
        Plants(*np.repeat(rows, count, axis=0).T),
        np.full(2 * cases * count, current),
        np.tile(omega, 2 * cases),
        0.0,
        np.repeat(lost, count),
    )
    holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)

    def slopes(error: FloatArray) -> dict[str, FloatArray]:
        values = np.where(holds, error, np.nan).reshape(cases, 2, count)
        size = {DEAD_TIME: 2.0 * _STEP * volt}
        return {
            cause: (values[k, 0] - values[k, 1]) / size.get(cause, 2.0 * _STEP)
            for k, cause in enumerate(CAUSES)
        }

    return Slopes(omega, slopes(found.theta_error), slopes(found.omega_error))


# The speed loop over an observer, both judged as one: as `tune` would in a design that asks for
# this observer.


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """The loop.

    Args:
        margin, crossover: Phase margin in rad and crossover in rad/s at the worst speed.
        holds: Whether it is stable with the margin that the design asks for.
        low: Least electrical speed in rad/s from which every corner of the tolerances is stable,
            dead time apart; nan where there is none.
    """

    margin: float
    crossover: float
    holds: bool
    low: float

    @property
    def robust(self) -> bool:
        """Whether it has its margin, and there is a speed at which every corner is stable."""
        return self.holds and math.isfinite(self.low)


def control_over(asked: Question, name: str) -> ControlSettings:
    """Control of the design with another observer, as in a design that leaves open what is chosen
    together: a speed loop by the symmetrical optimum counts the lag of the observer.

    Args:
        asked: The question.
        name: Of the observer.
    """
    control = asked.design.control
    loop, own = control.speed_loop, control.observer
    other = own is None or own.method != name
    if other and loop is not None and loop.method == "symmetrical-optimum":
        loop = replace(loop, spread=SPREAD, counts_observer=True)
    return replace(control, observer=settings_of(asked, name), speed_loop=loop)


def closed_loop(asked: Question, name: str) -> ClosedLoop | None:
    """The speed loop over an observer; None without a speed loop, or where it has none.

    Args:
        asked: The question.
        name: Of the observer.
    """
    design = asked.design
    if design.control.speed_loop is None or asked.loops is None or name not in METHODS:
        return None
    chosen = replace(control_over(asked, name), start_up=None, six_step=None)
    try:
        speed = solve_gains(replace(design, control=chosen)).speed
    except (InputError, NoSolutionError):
        return None
    found = None if speed is None else speed.observed
    if speed is None or found is None:
        return None
    low = float("nan") if found.corners is None else found.corners.binding.low
    return ClosedLoop(speed.phase_margin, speed.crossover, found.holds, low)
