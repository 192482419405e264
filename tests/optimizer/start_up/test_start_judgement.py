"""Judgement of starts: every failure by its name, silent ones among them, and how sure a rate
is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.optimizer.exploration.acceptance import wilson
from dqforge.optimizer.start_up.solve import (
    Failure,
    StartRate,
    StartRecord,
    StartVerdict,
    judge_start,
    percentile,
)

TIME = np.linspace(0.0, 2.0, 2001)
SPEED = 100.0


def good() -> StartRecord:
    """Up to speed in half a second, the observer ruling from 0.3 s on, 2 deg off."""
    return StartRecord(
        time=TIME,
        omega_m=np.minimum(2.0 * SPEED * TIME, SPEED),
        reference=np.full_like(TIME, SPEED),
        angle_error=np.full_like(TIME, math.radians(2.0)),
        ruling=(TIME >= 0.3).astype(np.float64),
        reported=False,
    )


def judged(record: StartRecord) -> StartVerdict:
    return judge_start(record, 0.3)


def test_figures_of_a_good_start() -> None:
    found = judged(good())
    assert found.started
    assert not found.silent
    assert math.isclose(found.time_90, 0.45, abs_tol=2e-3)
    assert math.isclose(found.angle_error, math.radians(2.0))
    assert math.isclose(found.hand_over_error, math.radians(2.0))
    assert abs(found.speed_error) < 1e-9
    assert found.back_turn == 0.0


def failing() -> dict[Failure, StartRecord]:
    record, late = good(), TIME > 1.0
    swinging = record.omega_m + 0.15 * SPEED * np.sin(40.0 * TIME) * late
    return {
        "no hand-over": replace(record, ruling=np.zeros_like(TIME)),
        "stalled": replace(record, omega_m=np.where(late, 0.0, record.omega_m)),
        "half a turn": replace(record, angle_error=np.where(late, 3.0, 0.1)),
        "swings": replace(record, omega_m=swinging),
        "angle": replace(record, angle_error=np.where(late, 0.7, 0.1)),
        "speed": replace(record, omega_m=0.9 * record.omega_m),
        "overload": replace(record, broken=True),
    }


@pytest.mark.parametrize("name", sorted(failing()))
def test_every_failure_has_its_name(name: Failure) -> None:
    record = failing()[name]
    assert judged(record).failure == name
    assert judged(record).silent
    assert not judged(replace(record, reported=True)).silent


def test_drive_that_stops_after_it_ran_has_stalled() -> None:
    """The observer no longer rules, because the drive itself has stopped."""
    ruling = ((TIME >= 0.3) & (TIME < 1.2)).astype(np.float64)
    record = replace(good(), ruling=ruling, omega_m=np.where(TIME < 1.2, SPEED, 0.0), reported=True)
    assert judged(record).failure == "stalled"
    assert not judged(record).silent


def test_negative_speeds_are_judged_alike() -> None:
    record = good()
    assert judged(replace(record, omega_m=-record.omega_m, reference=-record.reference)).started
    assert judged(replace(record, omega_m=-record.omega_m)).failure is not None


def test_turning_back_is_measured() -> None:
    """20 rad/s backwards for 50 ms."""
    omega = np.where(TIME < 0.05, -20.0, SPEED)
    assert math.isclose(judged(replace(good(), omega_m=omega)).back_turn, 1.0, rel_tol=0.1)


def test_limits_are_where_they_are_said_to_be() -> None:
    record = good()
    held = np.full_like(TIME, SPEED)
    assert judged(replace(record, omega_m=1.049 * held)).started
    assert judged(replace(record, omega_m=1.051 * held)).failure == "speed"
    assert judged(replace(record, angle_error=0.52 + 0.0 * TIME)).started
    assert judged(replace(record, angle_error=0.53 + 0.0 * TIME)).failure == "angle"


def test_rate_counts_failures_by_name() -> None:
    records = [good(), good(), *failing().values(), failing()["swings"]]
    rate = StartRate(0.3, tuple(judged(record) for record in records))
    assert (rate.count, rate.succeeded, rate.silent) == (10, 2, 8)
    assert rate.rate == 0.2
    assert rate.failures["swings"] == 2
    assert next(iter(rate.failures)) == "swings"
    assert rate.interval == wilson(2, 10)
    assert math.isclose(percentile(rate.verdicts, "angle_error", 50), math.radians(2.0))
