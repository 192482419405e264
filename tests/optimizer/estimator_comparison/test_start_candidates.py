"""Start-ups in the comparison: the plan's own numbers, and refusals with theirs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.estimator_comparison.candidate import Question, StartCandidate
from dqforge.optimizer.estimator_comparison.compared import (
    planned_time,
    start_candidates,
    started_design,
)
from dqforge.optimizer.estimator_comparison.solve import ask
from dqforge.optimizer.start_up.plan import start_up_plan

ABB = "abb-ipmsm-2k2"


def question() -> Question:
    asked = ask(catalogue.load(ABB))
    return replace(asked, at_speed="matsui-voltage", from_standstill="injection")


def named(name: str) -> StartCandidate:
    return next(c for c in start_candidates() if c.name == name)


def test_every_way_to_start_stands_there_once() -> None:
    assert {c.name for c in start_candidates()} == {"i-f", "v-f", "direct", "saliency"}


def test_a_ramp_starts_what_its_current_bears() -> None:
    """0.8 K_T I less what accelerates: a tenth of K_T I, by hand."""
    asked = question()
    figures = named("i-f").figures(asked)
    machine = asked.design.machine
    rated = 1.5 * machine.pole_pairs * asked.loads[2].psi_pm * asked.design.i_max
    assert figures.largest_load == pytest.approx(0.7 * rated)
    assert figures.success is None


def test_the_time_of_a_ramp_is_that_of_its_speed() -> None:
    """Alignment, then the ramp whose acceleration rises linearly: omega_h/a and half the rise."""
    asked = question()
    plan = start_up_plan(started_design(asked, "i-f"))
    assert plan is not None
    assert planned_time(plan) >= plan.align_time + plan.hand_over / plan.ramp_acceleration
    assert named("i-f").figures(asked).duration == planned_time(plan)


def test_the_design_of_a_start_has_the_chosen_estimators() -> None:
    asked = question()
    made = started_design(asked, "saliency", hand_over=100.0)
    control = made.control
    assert control.observer is not None
    assert control.start_up is not None
    assert control.start_up.observer is not None
    assert control.observer.method == "matsui-voltage"
    assert control.start_up.observer.method == "injection"
    assert control.start_up.hand_over == pytest.approx(100.0 / made.machine.pole_pairs)
    plan = start_up_plan(made)
    assert plan is not None
    assert plan.hand_over == pytest.approx(100.0)


def test_what_a_start_needs_is_told() -> None:
    asked = question()
    start = named("i-f")
    assert start.refusal(asked) == ""
    none = replace(asked, at_speed=None)
    assert start.refusal(none) == "no estimator holds at speed"
    machine = replace(linearised(asked.design.machine), inertia=None)
    without = replace(asked, design=replace(asked.design, machine=machine))
    assert start.refusal(without) == "machine.inertia is not known"
    control = replace(asked.design.control, speed_loop=None)
    loopless = replace(asked, design=replace(asked.design, control=control))
    assert start.refusal(loopless) == "there is no control.speed_loop"
