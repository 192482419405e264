"""SimpleFOC: its own rule, the members for a design, and the loops that they amount to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from firmware_asked import SCOOTER, asked_of, numbers_of, random_asked, scooter

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, judge
from dqforge.optimizer.firmware.targets.simplefoc import (
    SIMPLEFOC,
    as_printed,
    configuration,
    configure,
    flux_or_kv,
    profile,
    rule,
    shortfalls,
)


def slow_enough(asked: Asked) -> bool:
    """Whether the library does not refuse the bandwidth itself."""
    period = asked.drive.t_s
    assert period is not None
    pairs = (
        (asked.current_d.kp, asked.drive.l_d),
        (asked.current_q.kp, asked.drive.l_q),
    )
    return all(kp / (inductance or 1.0) < math.pi / period for kp, inductance in pairs)


def test_the_scooter_is_what_was_tried_inside_the_library() -> None:
    own = configure(scooter()).own
    assert own["pole_pairs"] == 15
    assert own["KV_rating"] == 60.0
    assert (own["PID_current_q.P"], own["PID_current_q.I"]) == (0.628319, 314.159)
    assert (own["phase_resistance"], own["axis_inductance.q"]) == (0.05, 1e-4)
    assert (own["current_limit"], own["voltage_limit"]) == (56.5685, 27.7128)
    assert own["LPF_current_q.Tf"] == 0.0
    assert own["PID_velocity.output_ramp"] == 0.0


def test_kv_is_that_of_the_librarys_back_emf() -> None:
    """estimateBEMF: vel/(KV sqrt 3)/(rpm to rad/s) is the phase voltage p psi vel."""
    kv = float(configure(scooter()).own["KV_rating"])
    speed, rpm_to_rads = 100.0, 0.10471975512
    assert speed / (kv * math.sqrt(3.0)) / rpm_to_rads == pytest.approx(
        SCOOTER.pole_pairs * SCOOTER.psi_pm * speed, rel=1e-6
    )
    assert flux_or_kv(15, flux_or_kv(15, 60.0)) == pytest.approx(60.0)


def test_the_librarys_own_rule() -> None:
    """tuneCurrentController at 1000 Hz."""
    found = rule(1e-4, 0.05, 1000.0)
    assert found["P"] == pytest.approx(0.6283185)
    assert found["I"] == pytest.approx(314.15927)
    assert found["Tf"] == pytest.approx(1.0 / (2.0 * math.pi * 5000.0))


def test_every_number_is_one_that_the_file_prints() -> None:
    tried = 0
    for asked in random_asked(200):
        if not slow_enough(asked):
            with pytest.raises(InputError, match="more than half"):
                configure(asked)
            continue
        tried += 1
        for value in configure(asked).own.values():
            assert value == as_printed(float(value))
    assert tried > 150


def test_gains_of_the_axes_are_their_own() -> None:
    asked = asked_of(replace(SCOOTER, l_q=3e-4))
    held = configure(asked)
    assert held.current_d is not None
    assert held.current_q is not None
    assert held.current_q.kp == pytest.approx(3.0 * held.current_d.kp, rel=1e-5)
    assert held.current_q.ki == held.current_d.ki


def test_the_loops_have_the_structure_of_the_library() -> None:
    loops = profile(configure(scooter()))
    current, speed = loops.current, loops.speed
    assert (current.q.rule, current.q.anti_windup, current.q.limit) == (
        "trapezoid",
        "clamp",
        27.7128,
    )
    assert (current.order, current.cross, current.back_emf) == ("axes", True, False)
    assert current.modulation == "svpwm"
    assert current.voltage_share == pytest.approx(1.0)
    assert speed is not None
    assert (speed.pi.rule, speed.pi.t_s, speed.pi.limit) == ("trapezoid", 1e-3, 56.5685)
    assert (speed.feedback.kind, speed.feedback.t_s) == ("low-pass", 1e-3)
    assert loops.reference == "id-zero"


def test_the_rules_of_the_library_step_by_step() -> None:
    """The trapezoid and the filter as they are computed, against what the profile says of them."""
    pi = profile(configure(scooter())).current.q
    errors = np.random.default_rng(3).normal(size=50)
    integral = before = 0.0
    for error in errors:
        integral += pi.ki * pi.t_s * 0.5 * (error + before)
        before = float(error)
    half = np.concatenate(([0.0], errors[:-1]))
    assert integral == pytest.approx(float(np.sum(pi.ki * pi.t_s * 0.5 * (errors + half))))


def test_a_filter_on_the_currents_is_judged_and_named() -> None:
    asked, held = scooter(), configure(scooter())
    none = judge(profile(held), asked.drive).current_q
    assert none is not None
    for filter_time, least_lost in ((1.0 / (2.0 * math.pi * 5000.0), 8.0), (0.53e-3, 40.0)):
        own = {**held.own, "LPF_current_q.Tf": filter_time, "LPF_current_d.Tf": filter_time}
        filtered = configuration("filtered", own)
        judged = judge(profile(filtered), asked.drive).current_q
        assert judged is not None
        assert math.degrees(none.phase_margin - judged.phase_margin) > least_lost
        said = [one for one in filtered.contradictions if "LPF_current_q.Tf" in one]
        lag = math.degrees(math.atan(0.628319 / 1e-4 * filter_time))
        assert f"{lag:.0f} deg" in said[0]
    assert held.contradictions == ()


def test_the_librarys_defaults_are_named_where_a_sketch_leaves_them() -> None:
    own = {"pole_pairs": 7, "phase_resistance": 0.1, "phase_inductance": 5e-5, "KV_rating": 100.0}
    found = configuration("sketch", own | {"torque_controller": 2})
    assert found.current_q == PiGains(3.0, 300.0)
    said = "\n".join(found.contradictions)
    assert "LPF_current_q.Tf 0.005 s takes 90 deg" in said
    assert "half of the loop's 1e+04 Hz" in said
    assert any("period of loopFOC() is not in the file: 100 us" in one for one in found.conventions)
    coarse = numbers_of(found.contradictions, "PID_current_q.P 3")
    assert coarse == pytest.approx([3.0, 3.0 / 5e-5 / (2.0 * math.pi), 1e4], rel=1e-3)
    # Half of the loop's frequency is pi/T L.
    for share, told in ((0.99, False), (1.01, True)):
        kp = share * math.pi * 1e4 * 5e-5
        more = configuration("sketch", own | {"torque_controller": 2, "PID_current_q.P": kp})
        assert (
            any("PID_current_q.P" in one and "half" in one for one in more.contradictions) == told
        )


@pytest.mark.parametrize("kind", [0, 1, 3])
def test_without_controlled_currents_there_are_no_loops(kind: int) -> None:
    held = configure(scooter())
    found = configuration("voltage", {**held.own, "torque_controller": kind})
    assert (found.current_q, found.speed) == (None, None)
    with pytest.raises(InputError, match="foc_current"):
        profile(found)


def test_the_speed_filter_leaves_the_speed_loop_its_margin() -> None:
    asked = scooter()
    held = configure(asked)
    filter_time = float(held.own["LPF_velocity.Tf"])
    assert filter_time == pytest.approx(0.1 / 100.0, rel=1e-3)
    default = configuration("default", {**held.own, "LPF_velocity.Tf": 0.005})
    ours, theirs = (judge(profile(one), asked.drive).speed for one in (held, default))
    assert ours is not None
    assert theirs is not None
    assert math.degrees(ours.phase_margin - theirs.phase_margin) > 15.0
    (lag,) = [one for one in shortfalls(asked, held) if "LPF_velocity.Tf" in one.words]
    assert lag.prices[0].value == pytest.approx(math.atan(0.1), rel=1e-3)
    expected = [1.0, math.degrees(math.atan(0.1)), 100.0]
    assert numbers_of([lag.words], "") == pytest.approx(expected, rel=1e-2)
    words = [one.words for one in shortfalls(asked, held)]
    assert numbers_of(words, "from a timer") == [50.0]
    volts = 250.0 * 15 * SCOOTER.psi_pm
    assert numbers_of(words, "whole back-EMF") == pytest.approx([volts], rel=1e-3)


def test_the_ratio_of_the_loops_is_what_move_leaves_out() -> None:
    for ratio in (1, 2, 20):
        asked = asked_of(SCOOTER, speed=PiGains(1.0, 1.0), ratio=ratio)
        held = configure(asked)
        assert held.own["motion_downsample"] == ratio - 1
        assert held.drive.t_speed == pytest.approx(ratio * 50e-6)


def test_no_d_current_is_priced() -> None:
    salient = replace(SCOOTER, l_q=4e-4)
    asked = asked_of(salient)
    (lost,) = [one for one in shortfalls(asked, configure(asked)) if "d current" in one.words]
    torque, copper = lost.prices
    assert 0.02 < torque.value < copper.value
    none = asked_of(SCOOTER)
    assert not [one for one in shortfalls(none, configure(none)) if "d current" in one.words]


@pytest.mark.parametrize(
    ("machine", "crossover", "words"),
    [
        (replace(SCOOTER, psi_pm=0.0), 6e3, "machine.magnet_flux"),
        (SCOOTER, 2.0 * math.pi * 10.1e3, "control.current_loop"),
    ],
)
def test_what_the_library_cannot_hold_is_refused(
    machine: LinearMachine, crossover: float, words: str
) -> None:
    with pytest.raises(InputError, match=words) as refused:
        configure(asked_of(machine, crossover=crossover))
    if machine.psi_pm:
        assert numbers_of([str(refused.value)], "") == [10100.0, 20000.0, 10000.0]


def test_the_method_offers_both_axes() -> None:
    assert (SIMPLEFOC.name, SIMPLEFOC.free) == ("simplefoc", "axes")


@pytest.mark.parametrize("kp", [0.05, 5.0])
@pytest.mark.parametrize("ratio", [1, 7])
def test_every_member_is_that_of_its_rule(kp: float, ratio: int) -> None:
    machine = replace(SCOOTER, l_q=1.7e-4)
    asked = asked_of(machine, speed=PiGains(kp, 9.0), ratio=ratio)
    own, v_max = configure(asked).own, 48.0 / math.sqrt(3.0)
    constant = 1.5 * 15 * machine.psi_pm
    expected = {
        "v_dc": 48.0,
        "loop_period": 5e-5,
        "pole_pairs": 15,
        "phase_resistance": 0.05,
        "axis_inductance.d": 1e-4,
        "axis_inductance.q": 1.7e-4,
        "KV_rating": 60.0,
        "foc_modulation": 1,
        "torque_controller": 2,
        "controller": 1,
        "motion_downsample": ratio - 1,
        "PID_velocity.P": kp,
        "PID_velocity.I": 9.0,
        "LPF_velocity.Tf": min(0.005, 0.1 * 0.02 / (constant * kp)),
        "PID_velocity.limit": machine.i_max,
        "current_limit": machine.i_max,
        "velocity_limit": 250.0,
    } | dict.fromkeys(("voltage_limit", "PID_current_q.limit", "PID_current_d.limit"), v_max)
    for axis, gains in (("q", asked.current_q), ("d", asked.current_d)):
        expected |= {f"PID_current_{axis}.P": gains.kp, f"PID_current_{axis}.I": gains.ki}
        expected[f"LPF_current_{axis}.Tf"] = 0.0
    for loop in ("PID_velocity", "PID_current_q", "PID_current_d"):
        expected |= {f"{loop}.D": 0.0, f"{loop}.output_ramp": 0.0}
    assert set(own) == set(expected)
    for name, value in expected.items():
        assert own[name] == pytest.approx(value, rel=1e-5), name
