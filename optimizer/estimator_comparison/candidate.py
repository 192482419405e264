"""What stands in the comparison: an estimator or a start-up with what is asked of it.

A candidate is a record of functions. Each says by a reason with its number why physics forbids it,
or what it does at the speeds and loads of a question. A further kind of estimator is a further
function that lists candidates, in `dqforge.optimizer.estimator_comparison.registry`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.capture_range import CaptureMap
from dqforge.optimizer.estimator_comparison.sensitivity import Slopes
from dqforge.optimizer.estimators.solve import TunedTracker
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.observers.tuning_numbers import Disturbances, Load


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
