"""What becomes of the answer to a step: it settles, or why it does not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray

Outcome = Literal["settles", "limit cycle", "divergence", "steady error", "never reaches"]
BAND = 0.05  # Share of a step within which an answer must lie over the last quarter of its time.
_KEPT = 0.9  # of the swing from the last quarter but one to the last: what keeps more swings on
_DRIFT = 0.1  # of the band, from quarter to quarter: what moves more has not come to rest
_TURNS = 4  # through its mean in the last half: fewer are no oscillation


@dataclass(frozen=True, slots=True)
class StepAnswer:
    """One answer over its last quarter.

    ``lowest``, ``highest`` and ``mean`` are those of the value there; ``period`` in s that of an
    oscillation, nan without one; ``settling`` in s the time from the step until the value stays in
    the band, nan where it does not.
    """

    outcome: Outcome
    lowest: float
    highest: float
    mean: float
    period: float
    settling: float


def step_answer(
    time: FloatArray,
    value: FloatArray,
    before: float,
    after: float,
    *,
    span: float | None = None,
    bounded: bool = True,
) -> StepAnswer:
    """Read off what a value did after a step of its reference.

    Args:
        time: In s from the step on, shape (N,).
        value: What was to follow, shape (N,).
        before, after: The reference, in the unit of the value.
        span: Size of the step that the band is a share of, where it is not that of this reference.
        bounded: Whether the run came to its end.
    """
    if not bounded or value.size < 8:
        return StepAnswer("divergence", *_ends(value), float("nan"), float("nan"))
    last = value[(3 * value.size) // 4 :]
    earlier = value[value.size // 2 : (3 * value.size) // 4]
    band = BAND * (abs(after - before) if span is None else span)
    off = np.abs(value - after) > band
    if not bool(np.any(off[(3 * value.size) // 4 :])):
        outside = np.flatnonzero(off)
        first = int(outside[-1]) + 1 if outside.size else 0
        return StepAnswer("settles", *_ends(last), float("nan"), float(time[first] - time[0]))
    period = _period(time[value.size // 2 :], value[value.size // 2 :])
    swing, swing_before = float(np.ptp(last)), float(np.ptp(earlier))
    outcome: Outcome
    if math.isfinite(period) and swing > band and swing > _KEPT * swing_before:
        outcome = "limit cycle"
    elif swing > 0.5 * band or abs(float(np.mean(last) - np.mean(earlier))) > _DRIFT * band:
        outcome = "never reaches"
    else:
        outcome = "steady error"
    return StepAnswer(
        outcome, *_ends(last), period if outcome == "limit cycle" else float("nan"), float("nan")
    )


def _ends(value: FloatArray) -> tuple[float, float, float]:
    kept = value[np.isfinite(value)]
    if not kept.size:
        return (float("nan"),) * 3
    return float(np.min(kept)), float(np.max(kept)), float(np.mean(kept))


def _period(time: FloatArray, value: FloatArray) -> float:
    """Mean period in s of passages through the mean, nan where there are too few."""
    above = value > np.mean(value)
    turns = np.flatnonzero(above[1:] != above[:-1])
    if turns.size < _TURNS:
        return float("nan")
    return float(2.0 * (time[turns[-1]] - time[turns[0]]) / (turns.size - 1))
