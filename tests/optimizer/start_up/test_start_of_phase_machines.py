"""What a start onto the third harmonic needs by its formulas, and what is refused of it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.estimators import solve_tracker
from dqforge.optimizer.start_up.plan import StartUpPlan, start_up_plan
from dqforge.optimizer.start_up.solve import solve_start_up

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "third-harmonic-start.yaml"
RPM = 2 * math.pi / 30.0  # electrical, of two pole pairs


def plan_of(*settings: str) -> StartUpPlan:
    plan = start_up_plan(load_design(EXAMPLE, settings))
    assert plan is not None
    return plan


def test_the_hand_over_lies_above_the_least_speed_of_the_tracker_and_the_way_back_on_it() -> None:
    tracked = solve_tracker(load_design(EXAMPLE))
    assert tracked is not None
    plan = plan_of()
    assert (plan.method, plan.alignment) == ("i-f", "two-step")
    assert plan.hand_over == pytest.approx(1.3 * tracked.omega_low)
    assert plan.back_below == pytest.approx(tracked.omega_low)
    own = plan_of("control.start_up={hand_over: 700 rpm}")
    assert own.hand_over == pytest.approx(700.0 * RPM)
    assert own.back_below == pytest.approx(0.6 * 700.0 * RPM)


def test_it_accelerates_no_faster_than_its_loop_follows_within_3_degrees() -> None:
    plan = plan_of()
    loop = 0.15 * 1800.0 * RPM
    most = math.radians(3.0) * loop**2
    assert plan.run_acceleration == pytest.approx(most, rel=0.01)
    assert plan.ramp_acceleration == pytest.approx(most, rel=0.01)
    assert plan.agree_time == pytest.approx(4.0 / loop, rel=0.01)


def test_its_current_alone_is_compared_with_what_a_start_can_lift() -> None:
    found = solve_start_up(load_design(EXAMPLE))
    assert found is not None
    assert list(found.largest_loads) == ["i-f"]
    assert found.largest_load >= 1.0


def test_a_hand_over_below_its_range_is_refused_with_the_speed() -> None:
    design = load_design(EXAMPLE, ["control.start_up={hand_over: 300 rpm}"])
    with pytest.raises(NoSolutionError, match=r"third-harmonic holds from 35\d.*take over at 300"):
        solve_start_up(design)


def test_phase_currents_of_a_salient_machine_have_no_d_current_to_hold() -> None:
    salient = "machine.inductance_harmonics=[{order: 2, amplitude: -0.5 mH}]"
    loop = "{method: bandwidth, bandwidth: 300 Hz, frame: table}"
    design = load_design(EXAMPLE, [salient, f"control.current_loop={loop}"])
    with pytest.raises(NoSolutionError, match="frame: dq"):
        solve_start_up(design)
    other = load_design(EXAMPLE, [salient, f"control.current_loop={loop.replace('table', 'dq')}"])
    assert solve_start_up(other) is not None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("control.observer={method: flux}", "not on flux; write control.observer"),
        ("control.start_up={method: v-f}", "v-f is no start"),
        ("control.start_up={method: saliency}", "saliency is no start"),
        ("control.start_up={observer: {method: injection}}", "without an estimator at rest"),
        ("control.start_up={flying_start: true}", "sinusoidal back-EMF alone; write false"),
    ],
)
def test_what_it_cannot_do_is_refused_in_one_line(settings: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        load_design(EXAMPLE, [settings])
    assert "\n" not in str(caught.value)


def test_legs_that_let_the_currents_add_up_to_something_are_refused() -> None:
    design = load_design(EXAMPLE, ["inverter.topology=four-leg"])
    with pytest.raises(InputError, match="write three-wire"):
        solve_start_up(design)
