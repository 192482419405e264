"""Which pair to flash: what starts the drive, and what it runs on at speed, with the speeds between
which they change hands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.candidate import Question
from dqforge.optimizer.estimator_comparison.closed_loop import ClosedLoop
from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT

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
