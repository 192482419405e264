"""Regulators at points: the balance of power, frequencies, and the modulators beside them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from current_feedback_design import feedback_design

from dqforge.machines.names import FeedbackMethod
from dqforge.optimizer.current_feedback.regulator_runs import (
    METHODS,
    WorkingPoints,
    load_points,
    modulators_beside,
    regulator_plan,
    run_regulator,
)
from dqforge.optimizer.losses.drive_budget import PARTS


@pytest.mark.thinned
@pytest.mark.parametrize("method", METHODS)
def test_power_in_is_losses_and_shaft_but_for_what_the_field_stores(method: FeedbackMethod) -> None:
    design = feedback_design(method)
    points = load_points(design)
    assert points is not None
    run = run_regulator(design, regulator_plan(design), points)
    assert run.obstacles == ("",)
    budget = run.budget
    np.testing.assert_allclose(budget.imbalance, run.stored, atol=1e-9 * float(budget.total[0]))
    assert float(sum(getattr(budget, part)[0] for part in PARTS)) == pytest.approx(
        float(budget.total[0])
    )
    # A good part of the asked torque is made, and some loss is in every place.
    assert budget.torque[0] == pytest.approx(2.0, rel=0.1)
    for part in ("copper", "ripple_copper", "conduction", "switching"):
        assert getattr(budget, part)[0] > 0.0
    assert run.lowest[0] <= run.frequency[0] <= run.highest[0]
    assert 0.0 < run.rms_error[0] < run.largest_error[0]


def test_switching_loss_follows_the_frequency_and_ripple_the_band() -> None:
    design = feedback_design("hysteresis")
    points = load_points(design)
    assert points is not None
    plan = regulator_plan(design)
    wide, narrow = (
        run_regulator(
            feedback_design("hysteresis", f"control.current_loop.band={band} A"),
            regulator_plan(feedback_design("hysteresis", f"control.current_loop.band={band} A")),
            points,
        )
        for band in (plan.band, 0.5 * plan.band)
    )
    assert narrow.frequency[0] > 1.5 * wide.frequency[0]
    assert narrow.budget.switching[0] > 1.5 * wide.budget.switching[0]
    assert narrow.budget.ripple_copper[0] < 0.4 * wide.budget.ripple_copper[0]


def test_modulators_are_at_the_frequency_of_the_regulator() -> None:
    design = feedback_design("circle")
    points = load_points(design)
    assert points is not None
    run = run_regulator(design, regulator_plan(design), points)
    beside = modulators_beside(design, run, ("svpwm", "ddt-gdpwm"))
    assert beside.total.shape == (2, 1)
    per_hertz = beside.switching[0, 0] / run.frequency[0]
    twice = (
        modulators_beside(design, run.part(slice(None)), ("svpwm",)).switching[0, 0]
        / run.frequency[0]
    )
    assert per_hertz == pytest.approx(twice)
    # Clamping saves about half of the switching loss.
    assert 0.35 < beside.switching[1, 0] / beside.switching[0, 0] < 0.65


def test_a_point_that_cannot_be_run_says_why_and_leaves_the_others() -> None:
    design = feedback_design("circle")
    points = load_points(design)
    assert points is not None
    both = points.and_further(
        WorkingPoints(points.torque, 3.0 * points.omega_m, points.i_d, points.i_q)
    )
    run = run_regulator(design, regulator_plan(design), both)
    assert run.obstacles[0] == ""
    assert "the bridge makes" in run.obstacles[1]
    assert math.isnan(run.frequency[1])
    assert np.isfinite(run.frequency[0])
    assert np.isnan(modulators_beside(design, run, ("svpwm",)).total[0, 1])
