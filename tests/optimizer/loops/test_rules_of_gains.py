"""Rules of gains by hand, calmer settings of each, what is advised, and ranges that meet."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.optimizer.loops.observed_margins import CornerJudgement, SpeedRange
from dqforge.optimizer.loops.pi_methods import (
    calmer,
    current_pi,
    largest_factor,
    loop_advice,
    speed_pi,
)

R, L, T_S, J, B, T = 0.7, 3e-3, 1e-4, 2e-3, 4e-4, 1.2e-3


@pytest.mark.parametrize(
    ("settings", "kp", "ki"),
    [
        (CurrentLoopSettings("bandwidth", bandwidth=900.0), 2.7, 630.0),
        (CurrentLoopSettings("damping", bandwidth=900.0, damping=0.8), 4.32 - 0.7, 2430.0),
        (CurrentLoopSettings("magnitude-optimum"), 10.0, 10.0 * 0.7 / 3e-3),
        (CurrentLoopSettings("symmetrical-optimum", spread=2.5), 8.0, 8.0 / (6.25 * 1.5e-4)),
        (CurrentLoopSettings("given", kp=3.0, ki=50.0), 3.0, 50.0),
    ],
)
def test_gains_of_current_loops_are_those_of_the_page(
    settings: CurrentLoopSettings, kp: float, ki: float
) -> None:
    assert current_pi(R, L, T_S, settings) == pytest.approx((kp, ki))


@pytest.mark.parametrize(
    ("settings", "kp", "ki"),
    [
        (SpeedLoopSettings("bandwidth", bandwidth=60.0), 0.12, 1.8),
        (SpeedLoopSettings("damping", bandwidth=60.0, damping=0.8), 0.192 - 4e-4, 7.2),
        (SpeedLoopSettings("symmetrical-optimum", spread=2.5), J / 3e-3, J / 3e-3 / 7.5e-3),
        (SpeedLoopSettings("given", kp=3.0, ki=50.0), 3.0, 50.0),
    ],
)
def test_gains_of_speed_loops_are_those_of_the_page(
    settings: SpeedLoopSettings, kp: float, ki: float
) -> None:
    assert speed_pi(J, B, T, settings) == pytest.approx((kp, ki))


def test_calmer_settings_and_what_is_advised() -> None:
    """A factor of both gains, of the bandwidth, of one over the spread, of what the sensitivity has
    beyond 1; told on the safe side to three digits."""
    key, speed = "control.current_loop", SpeedLoopSettings
    given = calmer(speed("given", kp=4.0, ki=10.0), 0.3)
    assert (given.kp, given.ki) == pytest.approx((1.2, 3.0))
    assert calmer(speed("damping", bandwidth=50.0), 0.3).bandwidth == pytest.approx(15.0)
    for method in ("symmetrical-optimum", "ti"):
        asked: Any = speed(method, spread=3.0)
        assert calmer(asked, 0.3).spread == pytest.approx(10.0)
        said = loop_advice(key, asked, 0.7)
        assert said == "it holds from control.current_loop.spread = 4.29 upwards"
    of_ti: Any = CurrentLoopSettings("ti", bandwidth=700.0)
    assert calmer(of_ti, 0.5).bandwidth == pytest.approx(350.0)
    best = CurrentLoopSettings("optimised", max_sensitivity=1.8)
    assert calmer(best, 0.25).max_sensitivity == pytest.approx(1.2)
    said = loop_advice(key, best, 0.3333)
    assert said == "it holds from control.current_loop.max_sensitivity = 1.266 downwards"
    said = loop_advice(key, replace(of_ti, bandwidth=1000.0), 0.12349)
    assert said == "method 'ti' holds up to control.current_loop.bandwidth = 123 rad/s (19.6 Hz)"
    said = loop_advice(key, CurrentLoopSettings("given", kp=1.0, ki=1.0), 0.45678)
    assert said.endswith("kp and control.current_loop.ki by 0.456 or less")


def test_the_largest_factor_is_just_below_what_holds() -> None:
    for end in (0.9, 0.31, 0.013):
        found = largest_factor(lambda factor, end=end: factor <= end)  # type: ignore[misc]
        assert found is not None
        assert 0.999 * end < found <= end
    assert largest_factor(lambda _: False) is None


def test_motoring_and_braking_hold_where_both_do() -> None:
    one, other = SpeedRange(100.0, 900.0, None, 5, None, 0.02), SpeedRange(
        150.0, 700.0, None, 7, None, 0.01
    )  # fmt: skip
    judged = CornerJudgement(named=True, limits={}, loads=(0.0,), exact=one)
    assert judged.binding is one
    both = replace(judged, braking=other).binding
    assert (both.low, both.high, both.corners, both.speed_error) == (150.0, 700.0, 12, 0.02)
    turned = replace(judged, exact=other, braking=one).binding
    assert (turned.low, turned.high, turned.corners, turned.speed_error) == (150.0, 700.0, 12, 0.02)
    apart = replace(judged, braking=replace(other, low=950.0, high=1200.0)).binding
    assert math.isnan(apart.low)
    assert math.isnan(apart.high)
    none = replace(other, low=math.nan)
    assert replace(judged, braking=none).binding is none
    assert replace(judged, exact=none, braking=other).binding is none
    meet = replace(judged, braking=replace(other, low=900.0, high=1200.0)).binding
    assert (meet.low, meet.high) == (900.0, 900.0)
