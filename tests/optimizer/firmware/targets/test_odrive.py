"""ODrive 0.5: what a design becomes, and the loops that run."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from drives import RELUCTANCE
from firmware_asked import SCOOTER, TWO_PI, asked_of, numbers_of, random_asked, scooter
from firmware_loops import assert_current_loops_hold

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, judge
from dqforge.optimizer.firmware.moteus_format import MOST_SENSITIVITY
from dqforge.optimizer.firmware.targets.odrive import ODRIVE, configuration

configure, profile, shortfalls = ODRIVE.configure, ODRIVE.profile, ODRIVE.shortfalls
BANDWIDTH = "motor.config.current_control_bandwidth"


def test_the_scooter() -> None:
    asked = scooter()
    held = configure(asked)
    own = held.own
    assert own["motor.config.pole_pairs"] == 15
    assert own["motor.config.phase_inductance"] == 1e-4
    # ODrive's own rule for the torque constant, with KV in rpm per volt.
    assert own["motor.config.torque_constant"] == pytest.approx(8.27 / 60.0, rel=2e-4)
    bandwidth = float(own[BANDWIDTH])
    assert held.current_d == held.current_q == PiGains(bandwidth * 1e-4, bandwidth * 0.05)
    assert asked.speed is not None
    constant = 1.5 * 15 * SCOOTER.psi_pm
    assert own["controller.config.vel_gain"] == pytest.approx(
        TWO_PI * constant * asked.speed.kp, rel=1e-6
    )
    assert own["controller.config.vel_limit"] == pytest.approx(250.0 / TWO_PI, rel=1e-6)


def test_the_loops_of_the_scooter() -> None:
    asked = scooter()
    loops = profile(configure(asked))
    assert loops.current.q.t_s == pytest.approx(125e-6)
    assert loops.current.voltage_share == 0.8
    assert loops.current.angle_advance == 1.5
    judged = judge(loops, asked.drive)
    assert judged.current_q is not None
    assert judged.current_q.phase_margin >= asked.design.control.current_loop.min_phase_margin
    assert judged.speed is not None
    assert judged.speed.stable
    assert loops.speed is not None
    assert loops.speed.feedback.ki == pytest.approx(0.25 * loops.speed.feedback.kp**2)
    assert loops.speed.feedback.kp * 125e-6 < 1.0


def test_too_fast_a_wish_is_lowered_to_what_8_khz_hold() -> None:
    asked = asked_of(SCOOTER, crossover=2e4)
    held = configure(asked)
    judged = judge(profile(held), asked.drive).current_q
    assert judged is not None
    assert judged.max_sensitivity <= MOST_SENSITIVITY
    # pi/2 - 1.5 T w is 61 deg there.
    assert float(held.own[BANDWIDTH]) == pytest.approx(2710.0, rel=0.02)
    words = " ".join(entry.words for entry in shortfalls(asked, held))
    assert f"current_control_bandwidth {held.own[BANDWIDTH]:g} rad/s is the only" in words


def test_the_pll_never_comes_where_the_firmware_refuses_it() -> None:
    fast = replace(scooter(), pll=PiGains(50000.0, 1.0))
    own = configure(fast).own
    assert 2.0 * float(own["encoder.config.bandwidth"]) * 125e-6 < 1.0


def test_one_inductance_for_two_axes_is_told_with_both_crossovers() -> None:
    asked = asked_of(replace(SCOOTER, l_q=2e-4))
    held = configure(asked)
    assert held.own["motor.config.phase_inductance"] == pytest.approx(1.5e-4)
    found = shortfalls(asked, held)
    assert any(
        "one inductance, 150 uH, stands for 100 uH (d) and 200 uH (q)" in entry.words
        for entry in found
    )
    prices = {price.of: price.value for entry in found for price in entry.prices}
    assert prices["crossover (d)"] > 1.5 * prices["crossover (q)"]
    assert prices["torque"] > 0.0
    judged = judge(profile(held), asked.drive)
    assert judged.current_d is not None
    assert judged.current_q is not None
    rates = judged.current_d.crossover, judged.current_q.crossover
    assert (prices["crossover (d)"], prices["crossover (q)"]) == rates
    assert any(f"crossovers {rates[0]:.4g} rad/s (d) and {rates[1]:.4g}" in x.words for x in found)
    # Four fifths of the voltage is what it makes.
    assert prices["voltage"] == pytest.approx(0.2)
    near = asked_of(replace(SCOOTER, l_q=1.0008e-4))
    assert not any("one inductance, 100" in x.words for x in shortfalls(near, configure(near)))


def test_rates_that_are_not_those_of_the_design_are_told() -> None:
    asked = scooter()
    words = " ".join(entry.words for entry in shortfalls(asked, configure(asked)))
    assert "switching frequency 20 kHz becomes 24 kHz" in words
    assert "current control every 50 us becomes 125 us" in words


@pytest.mark.parametrize(
    ("micro", "told"), [(5000.0, True), (3900.0, False), (2.1, False), (1.9, True)]
)
def test_inductances_that_its_calibration_refuses_are_told(micro: float, *, told: bool) -> None:
    size = 1e-6 * micro
    asked = asked_of(replace(SCOOTER, l_d=size, l_q=size, r_s=2e3 * size))
    words = " ".join(entry.words for entry in shortfalls(asked, configure(asked)))
    assert (f"{micro:g} uH is outside 2 to 4000 uH" in words) == told


def test_conventions_say_kv_and_what_the_feedforward_does() -> None:
    """KV = 60/(2 pi) 1.5 sqrt(3)/constant; of R times the reference at a = omega L/R the excess is
    a^(-(a + 1)/(a - 1)).
    """
    values = {
        "motor.config.torque_constant": 0.138,
        "motor.config.phase_resistance": 0.05,
        "motor.config.phase_inductance": 1e-4,
        "motor.config.current_control_bandwidth": 2000.0,
        "motor.config.R_wL_FF_enable": True,
        "controller.config.vel_gain": 0.1,
    }
    words = " ".join(configuration("drive", values).conventions)
    assert f"KV {30.0 / math.pi * 0.5 * math.sqrt(3.0) / 0.138:.3g}" in words
    assert f"overshoots by {4.0 ** (-5.0 / 3.0):.1%}" in words
    assert "stands for both axes" in words
    assert "N m per turn/s" in words
    without = configuration("drive", {"controller.config.vel_limit": 3.0}).conventions
    assert any("no torque_constant" in text for text in without)


@pytest.mark.parametrize("asked", list(random_asked(6, seed=3)))
def test_loops_of_any_machine_hold(asked: Asked) -> None:
    assert_current_loops_hold(ODRIVE, asked)


def test_machines_without_magnets_are_refused() -> None:
    with pytest.raises(InputError, match=r"machine\.magnet_flux: ODrive"):
        configure(asked_of(RELUCTANCE))


def test_a_motor_that_was_not_calibrated_has_no_loops() -> None:
    with pytest.raises(InputError, match="calibrate the motor"):
        profile(configuration("drive", {"motor.config.phase_resistance": 0.0}))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"motor.config.torque_constant": 0.04}, "is what ODrive ships"),
        (
            {
                "motor.config.torque_constant": 0.138,
                "motor.config.pole_pairs": 15,
                "sensorless_estimator.config.pm_flux_linkage": 0.00306,
            },
            "is not 1.5 pole_pairs pm_flux_linkage = 0.06885",
        ),
        ({"encoder.config.bandwidth": 4000.0}, "kp T = 1 is not below 1"),
        (
            {
                "encoder.config.mode": 1,
                "encoder.config.cpr": 8192,
                "motor.config.pole_pairs": 15,
            },
            "is not 6 pole_pairs = 90",
        ),
        (
            {"motor.config.current_lim": 70.0, "motor.config.requested_current_range": 60.0},
            "above requested_current_range 60 A",
        ),
        ({"motor.config.current_control_bandwidth": 5000.0}, "above 0.5 the current loops ring"),
        ({"motor.config.pre_calibrated": True}, "pre_calibrated is true, but"),
    ],
)
def test_contradictions(values: dict[str, float], words: str) -> None:
    assert any(words in found for found in configuration("drive", values).contradictions)


@pytest.mark.parametrize("pll", [None, PiGains(3000.0, 2.25e6), PiGains(9000.0, 2e7)])
@pytest.mark.parametrize("speed", [PiGains(0.05, 0.1), PiGains(0.7, 9.0), PiGains(5.0, 9.0)])
def test_every_value_of_an_axis_is_that_of_its_rule(pll: PiGains | None, speed: PiGains) -> None:
    machine = replace(SCOOTER, l_q=1.7e-4)
    asked = replace(asked_of(machine, speed=speed), pll=pll)
    own = {name.replace("config.", ""): value for name, value in configure(asked).own.items()}
    constant, margin = 1.5 * 15 * machine.psi_pm, 0.2 * machine.i_max
    own_pll = max(1000.0, 8.0 * speed.kp * constant / 0.02)
    expected = {
        "motor.motor_type": 0,
        "motor.pre_calibrated": True,
        "motor.pole_pairs": 15,
        "motor.phase_resistance": 0.05,
        "motor.phase_inductance": 1.35e-4,
        "motor.torque_constant": constant,
        "motor.current_lim": machine.i_max,
        "motor.current_lim_margin": margin,
        "motor.requested_current_range": machine.i_max + margin,
        "motor.R_wL_FF_enable": False,
        "motor.bEMF_FF_enable": True,
        "controller.vel_limit": 250.0 / TWO_PI,
        "controller.inertia": TWO_PI * 0.02,
        "controller.vel_gain": TWO_PI * constant * speed.kp,
        "controller.vel_integrator_gain": TWO_PI * constant * speed.ki,
        "encoder.bandwidth": min(own_pll if pll is None else 0.5 * pll.kp, 3200.0),
    }
    assert 100.0 < float(own.pop("motor.current_control_bandwidth")) < TWO_PI * 1001.0
    assert set(own) == set(expected)
    for name, value in expected.items():
        down = 1e-3 if "margin" in name or "range" in name or "bandwidth" in name else 1e-5
        assert own[name] == pytest.approx(value, rel=down), name
        assert float(own[name]) <= value * (1.0 + 1e-6), name


def test_numbers_of_what_does_not_fit_are_those_of_the_axis() -> None:
    found = configuration(
        "drive",
        {
            "motor.config.torque_constant": 0.138,
            "motor.config.pole_pairs": 15,
            "motor.config.current_lim": 70.0,
            "motor.config.requested_current_range": 60.0,
            "motor.config.current_control_bandwidth": 5000.0,
            "sensorless_estimator.config.pm_flux_linkage": 0.00306,
            "encoder.config.bandwidth": 4200.0,
            "encoder.config.mode": 1,
            "encoder.config.cpr": 8192,
        },
    ).contradictions
    assert numbers_of(found, "pm_flux_linkage") == [0.138, 1.5, pytest.approx(1.5 * 15 * 0.00306)]
    assert numbers_of(found, "kp T") == pytest.approx([4200.0, 2.0 * 4200.0 * 125e-6, 1.0])
    assert numbers_of(found, "cpr") == [8192.0, 6.0, 90.0]
    assert numbers_of(found, "current_lim") == [70.0, 60.0]
    assert numbers_of(found, "ring") == pytest.approx([5000.0, 125.0, 0.625, 0.5], abs=0.006)
    within = configuration("drive", {"motor.config.current_control_bandwidth": 3990.0})
    assert within.contradictions == ()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"encoder.config.bandwidth": 3999.0}, False),
        ({"encoder.config.bandwidth": 3300.0}, False),
        (
            {"encoder.config.mode": 1, "encoder.config.cpr": 90, "motor.config.pole_pairs": 15},
            False,
        ),
        (
            {
                "motor.config.torque_constant": 0.0695,
                "motor.config.pole_pairs": 15,
                "sensorless_estimator.config.pm_flux_linkage": 0.00306,
            },
            False,
        ),
        (
            {
                "motor.config.torque_constant": 0.0705,
                "motor.config.pole_pairs": 15,
                "sensorless_estimator.config.pm_flux_linkage": 0.00306,
            },
            True,
        ),
    ],
)
def test_what_just_holds_is_no_contradiction(values: dict[str, float], *, named: bool) -> None:
    assert bool(configuration("drive", values).contradictions) == named
