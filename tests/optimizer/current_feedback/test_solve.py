"""Defaults of regulators, and what the speed loop sees of them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from current_feedback_design import feedback_design

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.current_feedback import (
    RampComparison,
    hysteresis_frequency,
    slope_ratio,
)
from dqforge.optimizer.control_design.gain_set import gains_or_reason, solve_gains
from dqforge.optimizer.current_feedback.regulator_runs import (
    bridge_of,
    load_points,
    regulator_plan,
    run_regulator,
    speed_loop,
    speed_points,
)


def test_defaults_aim_at_the_switching_frequency() -> None:
    design = feedback_design("hysteresis")
    plan = regulator_plan(design)
    assert float(hysteresis_frequency(400.0, 4e-3, plan.band, 0.0)) == pytest.approx(3e3)
    ramp = regulator_plan(design, "ramp-comparison").scheme(100.0)
    assert isinstance(ramp, RampComparison)
    # At the voltage limit the output is half as steep as the triangle.
    speed = 400.0 / math.sqrt(3.0) / (3.0 * 0.1)
    assert float(slope_ratio(bridge_of(design), ramp, 0.0, 0.0, speed)) == pytest.approx(0.5)
    assert 1.0 / regulator_plan(design, "circle").t_s == pytest.approx(30e3)
    assert 1.0 / regulator_plan(design, "trajectory").t_s == pytest.approx(6e3)
    assert regulator_plan(design, "trajectory").angles(200.0) == 7
    assert regulator_plan(design, "trajectory").angles(600.0) == 2


def test_given_numbers_are_taken() -> None:
    design = feedback_design(
        "look-up-table",
        "control.current_loop.band=0.7 A",
        "control.current_loop.outer_band=0.9 A",
        "control.current_loop.sampling=50 kHz",
    )
    plan = regulator_plan(design)
    assert (plan.band, plan.outer_band, plan.t_s) == (0.7, 0.9, 20e-6)
    alone = feedback_design("look-up-table", "control.current_loop.outer_band=0.1 A")
    with pytest.raises(InputError, match="less than the band"):
        regulator_plan(alone)


def test_such_a_design_has_no_gains() -> None:
    design = feedback_design("hysteresis")
    gains, reason = gains_or_reason(design)
    assert gains is None
    assert "switches the bridge itself" in reason
    with pytest.raises(InputError, match="has no gains"):
        solve_gains(design)


def test_speed_loop_takes_the_regulator_as_a_lag() -> None:
    """The delay is that of the run, and a slower regulator makes a slower speed loop."""
    design, loops = feedback_design("hysteresis"), []
    points = load_points(design)
    assert points is not None
    run = run_regulator(design, regulator_plan(design), points)
    for share in (1.0, 0.05):
        slower = replace(run, frequency=share * run.frequency)
        found = speed_loop(design, slower)
        assert found is not None
        lag, speed = found
        assert lag.delay == pytest.approx(0.5 / float(slower.frequency[0]))
        assert lag.bandwidth == pytest.approx(min(1.0 / lag.delay, 0.3 * 3e3))
        assert speed.stable
        loops.append(speed)
    assert loops[1].margins.crossover < 0.8 * loops[0].margins.crossover
    bare = replace(design, control=replace(design.control, speed_loop=None))
    assert speed_loop(bare, run) is None


def test_points_beyond_reach_are_left_out() -> None:
    points = speed_points(feedback_design("circle"))
    assert 1 <= points.omega_m.size <= 4
    with pytest.raises((InputError, NoSolutionError)):
        load_points(feedback_design("circle", "losses.points[0].speed=100000 rpm"))
