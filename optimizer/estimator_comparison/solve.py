"""Every estimator and start-up of a drive over its speeds and loads: who errs least where,
and which pair to flash.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    ClosedLoop,
    Question,
    StartCandidate,
    closed_loop,
)
from dqforge.optimizer.estimator_comparison.compared import (
    ComparedEstimator,
    ComparedStart,
    estimators,
    starts,
)
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.conditions import conditions, loads_at
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT

# Speeds of the comparison over the largest one.
SPEED_SHARES = (0.0, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0)
COMPARED_LOADS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Torques of the comparison over the largest one.

# In the map of who wins: nobody holds there, or the voltage does not reach it.
NOBODY, UNREACHED = -1, -2
_STANDSTILL = 1e-3  # of the largest speed: an error of the speed that is none at standstill
_KEY = re.compile(r"^control\.(observer|start_up)(\.method)?: ")


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorComparison:
    """The comparison.

    Args:
        asked: What was asked of all.
        estimators, starts: The candidates, in the order of the registry.
        winner: Index among the estimators of the one with the least error of those that hold,
            `NOBODY` or `UNREACHED`, shape (S, L).
        pair: What to flash.
        uncounted: Why cycles and bytes were not measured; empty where they were.
    """

    asked: Question
    estimators: tuple[ComparedEstimator, ...]
    starts: tuple[ComparedStart, ...]
    winner: NDArray[np.int64]
    pair: FlashedPair
    uncounted: str = "the cost was not measured"

    def estimator(self, name: str) -> ComparedEstimator:
        """The one of that name."""
        return next(row for row in self.estimators if row.candidate.name == name)


def ask(design: Design) -> Question:
    """What is asked of every candidate.

    Args:
        design: The drive.
    """
    machine = design.machine
    omega_m = design.control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    omega_max = machine.pole_pairs * omega_m
    omega, loads = np.array(SPEED_SHARES) * omega_max, loads_at(design, COMPARED_LOADS)
    volts = [
        np.hypot(*machine.voltage(np.array([load.i_d]), np.array([load.i_q]), omega))
        for load in loads
    ]
    return Question(
        design,
        omega_max,
        omega,
        np.array(COMPARED_LOADS),
        loads,
        np.stack(volts, axis=1) <= design.v_max,
        conditions(design, omega_max),
        _loops(design),
    )


def _loops(design: Design) -> tuple[LoopGains, LoopGains, LoopGains] | None:
    """The loops as with an encoder, None where there is no speed loop to judge."""
    try:
        found = solve_gains(replace(design, control=replace(design.control, observer=None)))
    except NoSolutionError:
        return None
    return None if found.speed is None else (found.i_d, found.i_q, found.speed)


def reason_of(error: Exception) -> str:
    """A refusal without the key that it begins with.

    Args:
        error: An `InputError` or a `NoSolutionError`.
    """
    return _KEY.sub("", str(getattr(error, "message", error)))


def _compared(asked: Question, candidate: Candidate) -> ComparedEstimator:
    refusal = candidate.refusal(asked)
    if refusal:
        return ComparedEstimator(candidate, refusal)
    try:
        figures = candidate.figures(asked)
    except (NoSolutionError, InputError) as error:
        return ComparedEstimator(candidate, reason_of(error))
    permitted = np.maximum(SPEED_LIMIT * asked.omega, _STANDSTILL * asked.omega_max)
    holds = (figures.angle <= ANGLE_LIMIT) & (figures.speed <= permitted[:, None])
    return ComparedEstimator(candidate, "", figures, holds)


def _started(asked: Question, candidate: StartCandidate) -> ComparedStart:
    refusal = candidate.refusal(asked)
    if refusal:
        return ComparedStart(candidate, refusal)
    try:
        return ComparedStart(candidate, "", candidate.figures(asked))
    except (NoSolutionError, InputError) as error:
        return ComparedStart(candidate, reason_of(error))


def winners(asked: Question, rows: Sequence[ComparedEstimator]) -> NDArray[np.int64]:
    """Index of the estimator with the least r.m.s. error of the angle among those that hold.

    Args:
        asked: The question.
        rows: The estimators.
    """
    errors: list[FloatArray] = []
    for row in rows:
        if row.figures is None or row.holds is None or not row.candidate.competes(asked):
            errors.append(np.full(asked.reached.shape, np.inf))
        else:
            errors.append(np.where(row.holds, row.figures.angle, np.inf))
    stacked = np.stack(errors)
    best = np.argmin(stacked, axis=0)
    found = np.where(np.isfinite(np.min(stacked, axis=0)), best, NOBODY)
    return np.where(asked.reached, found, UNREACHED)


@on_design("control")
def compare_estimators(
    design: Design,
    candidates: Sequence[Candidate] | None = None,
    told: Callable[[str], None] | None = None,
) -> EstimatorComparison:
    """Every estimator and start-up.

    Args:
        design: The drive.
        candidates: The estimators to compare; all of them when None.
        told: Called with the name of each before it is asked.

    Raises:
        InputError, NoSolutionError: The design has no loops, or no torque.
    """
    asked = ask(design)
    chosen = estimators() if candidates is None else candidates
    found = []
    for candidate in chosen:
        if told is not None:
            told(candidate.name)
        found.append(_compared(asked, candidate))
    rows = tuple(found)
    at_speed = estimator_at_speed(asked, rows, closed_loop)
    pair = chosen_pair(asked, rows, (), at_speed)
    asked = replace(asked, at_speed=pair.at_speed, from_standstill=pair.from_standstill)
    begun = tuple(_started(asked, candidate) for candidate in starts())
    pair = chosen_pair(asked, rows, begun, at_speed)
    return EstimatorComparison(asked, rows, begun, winners(asked, rows), pair)


def with_success(
    found: EstimatorComparison, starts: Sequence[ComparedStart]
) -> EstimatorComparison:
    """The comparison with start-ups that were tried, and the pair that follows.

    Args:
        found: The comparison.
        starts: Its start-ups, in their order.
    """
    old = found.pair
    at_speed = None if old.at_speed is None else AtSpeed(old.at_speed, old.loop, old.passed)
    pair = chosen_pair(found.asked, found.estimators, starts, at_speed)
    return replace(found, starts=tuple(starts), pair=pair)


def named(only: str) -> tuple[Candidate, ...]:
    """The estimators of a list of names, in the order of the registry.

    Args:
        only: Names with commas in between.

    Raises:
        InputError: There is none of that name.
    """
    every = {candidate.name: candidate for candidate in estimators()}
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in every]
    if unknown or not wanted:
        what = unknown[0] if unknown else "nothing"
        raise InputError(f"--only: no estimator is named {what}; write some of {', '.join(every)}")
    return tuple(candidate for name, candidate in every.items() if name in wanted)


# Which pair to flash: what starts the drive, and what it runs on at speed, with the speeds between
# which they change hands.

# Speed of the hand-over downwards over that upwards: the hysteresis keeps a drive from chattering
# between two estimators.
BACK = 0.6

# Least speed of the hand-over over the largest one: below, little of the EMF is left beside what no
# tolerance names.
LEAST_SHARE = 0.1
_JUDGED = 4  # estimators whose speed loop is looked at


@dataclass(frozen=True, slots=True)
class FlashedPair:
    """What to flash; names of candidates, None where there is none.

    Args:
        at_speed: The estimator at speed.
        from_standstill: The estimator from standstill.
        start: The start-up.
        up, down: Electrical speeds in rad/s from which the estimator at speed takes over, the
            start-up's own at least, and below which it gives back; None where no estimator holds at
            every load.
        held: Share of the cells that the drive reaches in which one of both estimators holds.
        held_at_speed: The same of the estimator at speed alone.
        loop: The speed loop over the estimator at speed; None where it was not judged.
        passed: Estimators that hold in more cells, but whose speed loop holds from a higher speed
            on, or nowhere.
        gap: Electrical speeds in rad/s between which neither holds at every load, None without a
            gap.
    """

    at_speed: str | None
    from_standstill: str | None
    start: str | None
    up: float | None
    down: float | None
    held: float
    held_at_speed: float
    gap: tuple[float, float] | None
    loop: ClosedLoop | None = None
    passed: tuple[str, ...] = ()


def _merit(asked: Question, row: ComparedEstimator) -> tuple[float, float]:
    """Cells that an estimator holds, then how little it errs: the larger, the better."""
    assert row.figures is not None
    assert row.holds is not None
    error = np.minimum(row.figures.angle, ANGLE_LIMIT)[asked.reached]
    return (
        float(np.count_nonzero(row.holds & asked.reached)),
        -float(np.sqrt(np.mean(error**2))),
    )


def ranked(
    asked: Question, rows: Sequence[ComparedEstimator], *, from_standstill: bool
) -> list[ComparedEstimator]:
    """Estimators that hold somewhere, by falling merit.

    Args:
        asked: What was asked.
        rows: What was found.
        from_standstill: Which kind.
    """
    known = [
        row
        for row in rows
        if row.figures is not None
        and row.candidate.from_standstill == from_standstill
        and row.candidate.competes(asked)
        and _merit(asked, row)[0] > 0.0
    ]
    return sorted(known, key=lambda row: _merit(asked, row), reverse=True)


@dataclass(frozen=True, slots=True)
class AtSpeed:
    """The estimator at speed by its name, its speed loop, and those that were passed over."""

    name: str
    loop: ClosedLoop | None
    passed: tuple[str, ...] = ()


def estimator_at_speed(
    asked: Question,
    rows: Sequence[ComparedEstimator],
    judge: Callable[[Question, str], ClosedLoop | None],
) -> AtSpeed | None:
    """The one with the least speed of the hand-over among the best by merit whose speed loop holds
    at every corner from some speed on; the first by merit where none does, or where there is no
    speed loop to judge.

    Args:
        asked: What was asked.
        rows: What was found.
        judge: (question, name) -> the speed loop over it.
    """
    order = ranked(asked, rows, from_standstill=False)[:_JUDGED]
    if not order:
        return None
    judged = [AtSpeed(row.candidate.name, judge(asked, row.candidate.name)) for row in order]
    speeds = [
        _up(asked, row, found.loop) if found.loop is not None and found.loop.robust else None
        for row, found in zip(order, judged, strict=True)
    ]
    known = [(speed, place) for place, speed in enumerate(speeds) if speed is not None]
    if not known:
        return judged[0]
    _, best = min(known)
    return replace(judged[best], passed=tuple(found.name for found in judged[:best]))


def _up(asked: Question, row: ComparedEstimator, loop: ClosedLoop | None) -> float | None:
    """Speed in rad/s from which an estimator holds at every load, and the speed loop over it at
    every corner.
    """
    found = _hand_over(asked, row)
    if found is None or loop is None or not np.isfinite(loop.low):
        return found
    return max(found, loop.low)


def _hand_over(asked: Question, row: ComparedEstimator | None) -> float | None:
    """Speed in rad/s from which an estimator holds at every load, `LEAST_SHARE` at least."""
    if row is None or row.figures is None or not np.isfinite(row.figures.omega_low):
        return None
    return max(row.figures.omega_low, LEAST_SHARE * asked.omega_max)


# The start-up that runs on an estimator from standstill on; the others turn the rotor blindly.
BY_SALIENCY = "saliency"


def _taken_over(begin: float | None, row: ComparedStart) -> float | None:
    """Speed in rad/s of the hand-over with a start-up: its own at least."""
    if begin is None or row.figures is None:
        return begin
    return max(begin, row.figures.hand_over)


def _reaches(row: ComparedStart, low: ComparedEstimator | None, begin: float | None) -> bool:
    """Whether the estimator from standstill, where a start-up needs one, holds up to the
    hand-over.
    """
    up = _taken_over(begin, row)
    if row.candidate.name != BY_SALIENCY or up is None:
        return True
    return low is not None and low.figures is not None and low.figures.omega_high >= up


def _start(rows: Sequence[ComparedStart]) -> ComparedStart | None:
    """The start-up that succeeds most often, then that starts the largest load."""

    def merit(row: ComparedStart) -> tuple[float, float]:
        assert row.figures is not None
        return row.figures.success or 0.0, row.figures.largest_load

    return max((row for row in rows if row.figures is not None), key=merit, default=None)


def _share(asked: Question, rows: Sequence[ComparedEstimator | None]) -> float:
    held = np.zeros(asked.reached.shape, dtype=np.bool_)
    for row in rows:
        if row is not None and row.holds is not None:
            held |= row.holds
    return float(np.mean(held[asked.reached]))


def _gap(
    low: ComparedEstimator | None, up: float | None, start: str | None
) -> tuple[float, float] | None:
    """Speeds that neither estimator has, where nothing else turns the rotor."""
    if up is None or (low is None and start is not None):
        return None
    reach = 0.0 if low is None or low.figures is None else low.figures.omega_high
    reach = reach if np.isfinite(reach) else 0.0
    return None if not reach < up else (reach, up)


def chosen_pair(
    asked: Question,
    rows: Sequence[ComparedEstimator],
    starts: Sequence[ComparedStart],
    at_speed: AtSpeed | None,
) -> FlashedPair:
    """The pair, with its hand-over.

    From standstill that is the estimator that holds in most cells among those that work there, the
    least error deciding between equals; none where the start-up has no use for it. A start-up on an
    estimator that ends below the hand-over is none of the pair.

    Args:
        asked: What was asked.
        rows, starts: What was found.
        at_speed: The estimator at speed, whose speed loop's least speed bounds the hand-over.
    """
    named = None if at_speed is None else at_speed.name
    loop = None if at_speed is None else at_speed.loop
    high = next((row for row in rows if row.candidate.name == named), None)
    low = next(iter(ranked(asked, rows, from_standstill=True)), None)
    begin = None if high is None else _up(asked, high, loop)
    start = _start([row for row in starts if _reaches(row, low, begin)])
    up = begin if start is None else _taken_over(begin, start)
    begun = None if start is None else start.candidate.name
    if begun is not None and begun != BY_SALIENCY:
        low = None
    return FlashedPair(
        at_speed=named,
        from_standstill=None if low is None else low.candidate.name,
        start=begun,
        up=up,
        down=None if up is None else BACK * up,
        held=_share(asked, (high, low)),
        held_at_speed=_share(asked, (high,)),
        gap=_gap(low, begin, begun),
        loop=loop,
        passed=() if at_speed is None else at_speed.passed,
    )
