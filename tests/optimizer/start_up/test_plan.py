"""What a start needs by its formulas, and what physics or the design forbids, with the number."""

from __future__ import annotations

import math

import pytest
from start_designs import INJECTION, start_design, start_text

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.start_up.plan import StartUpPlan, start_up_plan
from dqforge.optimizer.start_up.solve import StartUp, solve_start_up
from dqforge.reports.answers.check import answer_check

K_T = 1.5 * 4 * 0.05


def plan_of(start: str = "{}", l_q: float = 1.2) -> StartUpPlan:
    plan = start_up_plan(start_design(start, l_q))
    assert plan is not None
    return plan


def solved(start: str = "{}", l_q: float = 1.2) -> StartUp:
    found = solve_start_up(start_design(start, l_q))
    assert found is not None
    return found


def test_the_observer_takes_over_where_resistance_and_dead_time_turn_it_by_15_degrees() -> None:
    wrong = 0.3 * 0.36 * 10.0 + 4.0 / math.pi * 10e3 * 0.5e-6 * 325.0
    assert plan_of().hand_over == pytest.approx(wrong / (0.05 * math.sin(math.radians(15.0))))
    assert plan_of("{hand_over: 600 rpm}").hand_over == pytest.approx(4 * 600.0 * math.pi / 30.0)


@pytest.mark.parametrize(
    ("load", "current", "sine"), [(0.0, 5.0, 0.2), (0.9, 20.0 / 3.0, 0.6), (1.8, 10.0, 0.7)]
)
def test_the_current_of_the_ramp_fits_the_load(load: float, current: float, sine: float) -> None:
    plan = plan_of(f"{{method: i-f, load_torque: {load} N m}}")
    assert plan.ramp_current == pytest.approx(current)
    assert plan.load_angle_sine == pytest.approx(sine)
    assert plan.damping * plan.psi_pm == pytest.approx(0.1 if sine < 0.65 else 0.0)
    assert plan.ramp_acceleration == pytest.approx(4 * 0.1 * K_T * 10.0 / 300e-6)
    swing = 2.0 * math.pi / math.sqrt(4 * K_T * current / 300e-6)
    assert plan.ramp_rise == pytest.approx(2.0 * swing)


def test_alignment_lasts_three_swings_or_300_ms() -> None:
    assert plan_of().align_time == pytest.approx(0.3)
    swing = 2.0 * math.pi / math.sqrt(4 * K_T * 0.1 / 300e-6)
    slow = plan_of("{alignment_current: 0.1 A}")
    assert slow.align_time == pytest.approx(max(0.3, 3.0 * swing))


def test_auto_takes_saliency_from_a_tenth_on_where_it_has_an_estimator() -> None:
    assert plan_of(INJECTION, 1.8).method == "saliency"
    assert plan_of(INJECTION, 1.8).alignment == "two-step"
    assert plan_of("{}", 1.8).method == "i-f"
    assert plan_of(INJECTION, 1.25).method == "i-f"


def test_the_largest_load_of_every_method_is_stated() -> None:
    found = solved("{load_torque: 0.9 N m}", 1.8)
    torque = K_T * 10.0
    assert found.largest_loads["i-f"] == pytest.approx(0.7 * torque)
    assert found.largest_loads["direct"] == pytest.approx(0.5 * torque)
    assert found.largest_load == pytest.approx(0.8 * K_T * found.plan.ramp_current - 0.1 * torque)
    assert "saliency" in found.largest_loads
    assert "saliency" not in solved().largest_loads


@pytest.mark.parametrize(
    ("start", "l_q", "words"),
    [
        ("{method: i-f, load_torque: 2.2 N m}", 1.2, ["2.1 N m", "2.2 N m", "i-f"]),
        ("{method: direct, load_torque: 1.6 N m}", 1.2, ["1.5 N m", "direct"]),
        ("{load: active}", 1.2, ["brake: true"]),
        ("{method: saliency, observer: {method: injection}}", 1.2, ["L_q/L_d = 1", "1.1"]),
        ("{method: saliency}", 1.8, ["control.start_up.observer"]),
        ("{alignment: none, observer: {method: injection}}", 1.8, ["0 %", "two-step"]),
        ("{flying_start: true, trip_current: 2 A}", 1.2, ["2 A"]),
        ("{method: direct, load_torque: 1.4 N m, run_torque: 1 N m, hand_over: 2900 rpm}", 1.2, []),
    ],
)
def test_what_physics_forbids_is_refused_with_the_number(
    start: str, l_q: float, words: list[str]
) -> None:
    with pytest.raises(NoSolutionError) as refusal:
        solve_start_up(start_design(start, l_q))
    for word in ("control.start_up", *words):
        assert word in refusal.value.message


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("{current: 50 A}", ["control.start_up.current: 50 A", "10 A"]),
        ("{alignment_current: 11 A}", ["alignment_current: 11 A", "10 A"]),
        ("{held_current: {value: 8 A, kind: rms}}", ["held_current: 11.31 A", "10 A"]),
        ("{trip_current: 10 A}", ["trip_current: 10 A", "18 A"]),
        ("{v_dc_min: 325 V}", ["v_dc_min: 325 V"]),
        ("{hand_over: 4000 rpm}", ["hand_over: 418.9 rad/s", "machine.max_speed, 314.2 rad/s"]),
    ],
)
def test_what_the_drive_cannot_carry_or_reach_is_refused(start: str, words: list[str]) -> None:
    with pytest.raises(InputError) as refusal:
        solve_start_up(start_design(start))
    for word in words:
        assert word in refusal.value.message


def test_limits_themselves_are_permitted() -> None:
    given = "{current: 10 A, alignment_current: 10 A, trip_current: 10.1 A, hand_over: 3000 rpm}"
    plan = solved(given).plan
    assert plan.ramp_current == plan.align_current == 10.0
    assert plan.trip_current == 10.1


@pytest.mark.slow
def test_check_refuses_what_run_refuses() -> None:
    with pytest.raises(NoSolutionError, match=r"2\.1 N m"):
        answer_check(start_design("{method: i-f, load_torque: 2.2 N m}"))


def test_a_brake_permits_an_active_load() -> None:
    assert solved("{load: active, brake: true}").plan.method == "i-f"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  observer: {method: flux, speed_gain: 0.7, pll_bandwidth: 500 rad/s}\n", "", "position"),
        ("  speed_loop: {spread: 8}\n", "", "speed_loop"),
        ("control: float32", "control: q15", "float32"),
        ("  inertia: 300e-6 kg m^2\n", "", "inertia"),
        ("start_up: {}", "start_up: {observer: {method: flux}}", "at rest"),
        ("  encoder: none\n", "  encoder: none\n  sensorless: {above: 100 rpm}\n", "sensorless"),
        ("  start_up: {}\n", "", "control.start_up"),
        ("  encoder: none\n", "  stop: 0.5 s\n", "stop"),
    ],
)
def test_what_a_start_lacks_is_refused_with_a_place(old: str, new: str, words: str) -> None:
    text = start_text()
    assert old in text
    with pytest.raises(InputError) as refusal:
        load_text(text.replace(old, new).encode(), "start.yaml")
    assert words in refusal.value.message
    assert refusal.value.line is not None
