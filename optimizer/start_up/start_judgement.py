"""Whether a drive has started, and what went wrong where it has not, from a record of the start.

A start has succeeded when in the last part of the record the observer rules, the speed is held at
its reference, the observer's angle is right and nothing swings. What is not so has a name: what the
drive itself reports, and what really happened. A failure that the drive does not report is silent.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.records import dataclass

# What really happened: the observer never took over; the rotor stands or creeps; the observer is
# about half an electrical turn off; the speed swings; the angle, or the speed, is off by more than
# the limit; the current ran beyond every limit.
Failure = Literal["no hand-over", "stalled", "half a turn", "swings", "angle", "speed", "overload"]
SPEED_LIMIT = 0.05  # Largest deviation of the mean speed from its reference, relative.
ANGLE_LIMIT = math.radians(30.0)  # Largest error of the observer's angle in rad, r.m.s.
SWING_LIMIT = 0.2  # Largest swing of the speed, peak to peak, over its reference.
_STANDS = 0.2  # of the reference: slower is a standstill
_HALF_TURN = 0.5 * math.pi
_Z_95 = 1.959963984540054


@dataclass(frozen=True, slots=True, eq=False)
class StartRecord:
    """Samples of one start, shapes (N,).

    Args:
        time: In s, ascending.
        omega_m: True mechanical speed in rad/s.
        reference: The speed that is asked for, mechanical, in rad/s; it must not be zero at the
            end.
        angle_error: The observer's angle less the true one in rad, wrapped; nan where none is
            known.
        ruling: Whether the observer rules.
        reported: Whether the drive reports a fault, at the end or in a try before.
        broken: Whether the current ran beyond every limit.
    """

    time: FloatArray
    omega_m: FloatArray
    reference: FloatArray
    angle_error: FloatArray
    ruling: FloatArray
    reported: bool
    broken: bool = False


@dataclass(frozen=True, slots=True)
class StartVerdict:
    """How a start went.

    Args:
        failure: What happened, None where the drive has started.
        reported: Whether the drive reported a fault.
        speed_error: Mean speed at the end over its reference, less 1.
        angle_error: Error of the observer's angle at the end in rad, r.m.s.; nan where the record
            has none.
        swing: Swing of the speed at the end, peak to peak, over its reference.
        time_90: When 90 % of the reference was first reached, in s; nan if never.
        hand_over_error: Error of the observer's angle in rad when it took over; nan if it never
            did.
        back_turn: Largest mechanical movement against the direction of the start, in rad.
    """

    failure: Failure | None
    reported: bool
    speed_error: float
    angle_error: float
    swing: float
    time_90: float
    hand_over_error: float
    back_turn: float

    @property
    def started(self) -> bool:
        """Whether the drive has started."""
        return self.failure is None

    @property
    def silent(self) -> bool:
        """Whether it has not, and does not say so."""
        return self.failure is not None and not self.reported


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _back_turn(time: FloatArray, speed: FloatArray) -> float:
    """Farthest that a shaft turns back from where it was, in rad; speed in rad/s."""
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)
    return max(0.0, -float(np.min(np.cumsum(steps), initial=0.0)))


def _failure(
    record: StartRecord, last: IndexArray, speed_error: float, angle_error: float, swing: float
) -> Failure | None:
    """The first of what can be said of the last samples."""
    rules, stands = bool(np.all(record.ruling[last] > 0.0)), abs(1.0 + speed_error) < _STANDS
    ruled = bool(np.any(record.ruling > 0.0))
    said: tuple[tuple[Failure, bool], ...] = (
        ("overload", record.broken),
        ("stalled", stands and ruled),
        ("no hand-over", not rules),
        ("half a turn", float(np.mean(np.abs(record.angle_error[last]))) > _HALF_TURN),
        ("swings", swing >= SWING_LIMIT),
        ("angle", not angle_error <= ANGLE_LIMIT),
        ("speed", not abs(speed_error) <= SPEED_LIMIT),
    )
    return next((name for name, holds in said if holds), None)


def judge_start(record: StartRecord, settled: float) -> StartVerdict:
    """How a start went.

    Args:
        record: Its samples.
        settled: Length in s of the last part, in which everything must hold.
    """
    last = np.flatnonzero(record.time >= record.time[-1] - settled)
    wanted = float(record.reference[-1])
    share = record.omega_m / wanted
    speed_error, swing = float(np.mean(share[last])) - 1.0, float(np.ptp(share[last]))
    angle_error = _rms(record.angle_error[last])
    reached = np.flatnonzero(share >= 0.9)
    ruling = np.flatnonzero(record.ruling > 0.0)
    return StartVerdict(
        failure=_failure(record, last, speed_error, angle_error, swing),
        reported=record.reported,
        speed_error=speed_error,
        angle_error=angle_error,
        swing=swing,
        time_90=float(record.time[reached[0]]) if reached.size else math.nan,
        hand_over_error=float(record.angle_error[ruling[0]]) if ruling.size else math.nan,
        back_turn=_back_turn(record.time, record.omega_m * np.sign(wanted)),
    )


def wilson_interval(succeeded: int, count: int) -> tuple[float, float]:
    """Score interval of Wilson, 95 %, of a share of which ``succeeded`` of ``count`` were seen.

    Args:
        succeeded: How many.
        count: Of how many, at least one.
    """
    share, z = succeeded / count, _Z_95
    centre = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    spread = share * (1.0 - share) / count + z * z / (4.0 * count * count)
    half = z * math.sqrt(spread) / (1.0 + z * z / count)
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True, slots=True)
class StartRate:
    """How often drives started.

    Args:
        load: Load torque over the torque of the current limit in the q axis.
        verdicts: One per start.
    """

    load: float
    verdicts: tuple[StartVerdict, ...]

    @property
    def count(self) -> int:
        """How many starts."""
        return len(self.verdicts)

    @property
    def succeeded(self) -> int:
        """How many of them succeeded."""
        return sum(verdict.started for verdict in self.verdicts)

    @property
    def rate(self) -> float:
        """The share that succeeded."""
        return self.succeeded / self.count

    @property
    def interval(self) -> tuple[float, float]:
        """Within which the true share lies with 95 %."""
        return wilson_interval(self.succeeded, self.count)

    @property
    def failures(self) -> dict[str, int]:
        """How often each failure, the most frequent first."""
        found = Counter(one.failure for one in self.verdicts if one.failure is not None)
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    @property
    def silent(self) -> int:
        """How many failed without a report."""
        return sum(verdict.silent for verdict in self.verdicts)


def percentile(verdicts: Sequence[StartVerdict], name: str, share: float) -> float:
    """Percentile of the magnitude of one figure over the starts that succeeded; nan without any.

    Args:
        verdicts: Of the starts.
        name: Of the figure: a field of `StartVerdict`.
        share: In percent.
    """
    values = [abs(float(getattr(one, name))) for one in verdicts if one.started]
    return float(np.percentile(values, share)) if values else math.nan
