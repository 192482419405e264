"""VESC: its own rule, the configuration of a design, and the loops that this amounts to."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import pytest
from firmware_asked import SCOOTER, asked_of, numbers_of, random_asked, scooter

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import judge
from dqforge.optimizer.firmware.targets.vesc import VESC, configure, profile, rule, shortfalls
from dqforge.optimizer.firmware.vesc_format import KEYS, as_printed, configuration

# Pairs in public headers of boards and firmware, as numbers: R, L, lambda, kp, ki, observer gain,
# and the time constant where both gains are of one rule.
PUBLIC = (
    (0.0491708, 2.33379e-05, 0.00215029, 0.0233379, 49.1707, 2.16274e8, 1e-3),
    (0.097, 4.85e-05, 0.0015, 0.097, 194.0, 4.4444e8, 0.5e-3),
    (0.014, 15.95e-06, 0.006122, 0.0159, 16.20, 26.68e6, None),
    (0.015, 1.4248e-05, 0.015787, 0.0178, 45.56, 4.01e6, None),
)


def test_the_vendor_pair_is_reproduced_to_the_digits_that_it_has(shared_data: Path) -> None:
    with (shared_data / "vendor_gains" / "vesc_pairs.csv").open(encoding="utf-8") as file:
        rows = {row["file"].split("/")[2]: row for row in csv.DictReader(file)}
    row = rows["m600"]
    found = rule(float(row["R_ohm"]), float(row["L_H"]), float(row["lambda_Wb"]))
    # kp is stated with four digits, the gain of the observer with three.
    assert found["foc_current_kp"] == pytest.approx(float(row["kp"]), rel=1.01e-4)
    assert found["foc_current_ki"] == pytest.approx(float(row["ki"]), rel=1e-4)
    assert found["foc_observer_gain"] == pytest.approx(float(row["observer_gain"]), rel=1e-3)


@pytest.mark.parametrize("pair", PUBLIC, ids=lambda pair: f"{pair[0]:g} Ohm")
def test_further_public_pairs(pair: tuple[float, float, float, float, float, float, float]) -> None:
    r_s, inductance, psi, kp, ki, gain, tc = pair
    found = rule(r_s, inductance, psi, tc or 1e-3)
    assert found["foc_observer_gain"] == pytest.approx(gain, rel=2e-3)
    own = {
        "foc_motor_r": r_s,
        "foc_motor_l": inductance,
        "foc_motor_flux_linkage": psi,
        "foc_current_kp": kp,
        "foc_current_ki": ki,
        "foc_observer_gain": gain,
    }
    said = configuration("pair", own).contradictions
    if tc is not None:
        assert found["foc_current_kp"] == pytest.approx(kp, rel=1e-4)
        assert found["foc_current_ki"] == pytest.approx(ki, rel=1e-4)
        assert said == ()
    else:
        (sentence,) = said
        assert f"{kp:g}" in sentence
        assert f"{ki:g}" in sentence
        assert f"{kp / inductance:.4g} rad/s" in sentence
        assert f"{ki / r_s:.4g} rad/s" in sentence


def test_gains_edited_by_hand_and_the_gain_of_older_versions_are_named(shared_data: Path) -> None:
    with (shared_data / "vendor_gains" / "vesc_pairs.csv").open(encoding="utf-8") as file:
        row = next(row for row in csv.DictReader(file) if "bbshd" in row["file"])
    own = {
        "foc_motor_r": float(row["R_ohm"]),
        "foc_motor_l": float(row["L_H"]),
        "foc_motor_flux_linkage": float(row["lambda_Wb"]),
        "foc_current_kp": float(row["kp"]),
        "foc_current_ki": float(row["ki"]),
        "foc_observer_gain": float(row["observer_gain"]),
    }
    gains, observer = configuration("bbshd", own).contradictions
    assert "1161 rad/s" in gains
    assert "1000 rad/s" in gains
    assert "37.86" in gains
    assert "307.1/lambda^2 instead of VESC's 1000/lambda^2 = 2.312e+06" in observer
    assert "10/(R lambda^2) = 7.092e+05" in observer


def test_the_scooter_is_what_was_tried_inside_the_firmware() -> None:
    """firmware of the tries: 1000 Hz, 20 kHz, 48 V; what the controller held then."""
    own = configure(scooter()).own
    assert {name: own[name] for name in ("foc_current_kp", "foc_current_ki", "foc_motor_r")} == {
        "foc_current_kp": 0.628319,
        "foc_current_ki": 314.159,
        "foc_motor_r": 0.05,
    }
    assert own["foc_motor_l"] == 0.0001
    assert own["foc_motor_flux_linkage"] == 0.00612588
    assert own["foc_f_zv"] == 40000.0
    assert own["si_motor_poles"] == 30
    assert own["foc_dt_us"] == 0.5
    assert own["l_current_max"] == 56.5685
    assert own["l_current_min"] == -56.5685


def test_speed_gains_are_those_that_the_firmware_computes_with() -> None:
    """foc_run_pid_control_speed, spelled out: error in erpm, gains over 20, share of the limit."""
    asked = scooter()
    held = configure(asked)
    assert asked.speed is not None
    assert held.speed is not None
    error = 1.7  # rad/s, mechanical
    erpm = error * 15 * 60.0 / (2.0 * math.pi)
    kp, i_max = float(held.own["s_pid_kp"]), float(held.own["l_current_max"])
    amperes = erpm * kp * (1.0 / 20.0) * i_max
    assert amperes == pytest.approx(asked.speed.kp * error, rel=1e-5)
    assert held.speed.kp == pytest.approx(asked.speed.kp, rel=1e-5)
    assert held.speed.ki == pytest.approx(asked.speed.ki, rel=1e-5)
    assert held.own["s_pid_kd"] == 0.0
    assert held.drive.t_speed == pytest.approx(1e-3)


def test_every_number_is_one_that_the_file_prints() -> None:
    for asked in random_asked(200):
        for name, value in configure(asked).own.items():
            assert value == as_printed(float(value))
            assert KEYS[name].least <= float(value) <= KEYS[name].most
            assert isinstance(value, int) == (KEYS[name].kind == "whole")


def test_the_tracking_loop_is_fast_where_the_speed_is_controlled() -> None:
    fast = configure(scooter())
    assert (fast.own["foc_pll_kp"], fast.own["foc_pll_ki"]) == (2000.0, 1e6)
    loops = profile(fast)
    assert loops.observer is not None
    assert loops.observer.warnings == ()
    assert "foc_pll_ki" not in configure(scooter(with_speed=False)).own


def test_a_tracking_loop_that_is_asked_for_is_written() -> None:
    held = configure(replace(scooter(), pll=PiGains(1500.0, 4e5)))
    assert (held.own["foc_pll_kp"], held.own["foc_pll_ki"]) == (1500.0, 4e5)
    speed = profile(held).speed
    assert speed is not None
    assert (speed.feedback.kp, speed.feedback.ki) == (1500.0, 4e5)
    with pytest.raises(InputError, match=r"control\.firmware\.pll_ki"):
        configure(replace(scooter(), pll=PiGains(4000.0, 4e6)))


def test_the_default_of_the_tracking_loop_is_named_and_oscillates() -> None:
    asked, held = scooter(), configure(scooter())
    slow = replace(held, own={**held.own, "foc_pll_kp": 2000.0, "foc_pll_ki": 30000.0})
    loops = profile(slow)
    assert loops.observer is not None
    (warning,) = loops.observer.warnings
    assert "15.1 rad/s" in warning
    assert "1e+06" in warning
    judged, good = judge(loops, asked.drive).speed, judge(profile(held), asked.drive).speed
    assert judged is not None
    assert good is not None
    assert judged.phase_margin < math.radians(25.0)
    assert good.phase_margin > math.radians(50.0)


def test_the_loops_have_the_structure_of_the_firmware() -> None:
    loops = profile(configure(scooter()))
    current, speed = loops.current, loops.speed
    assert (current.d.rule, current.d.anti_windup, current.order) == (
        "integral-first",
        "clamp",
        "d-first",
    )
    assert current.d == current.q
    assert (current.d.t_s, current.delay, current.voltage_share) == (5e-5, 0.5, 0.95)
    assert (current.cross, current.back_emf) == (True, True)
    assert speed is not None
    assert (speed.pi.rule, speed.pi.t_s, speed.pi.limit) == ("integral-last", 1e-3, 56.5685)
    assert (speed.feedback.kind, speed.feedback.kp, speed.feedback.ki) == ("pll", 2000.0, 1e6)
    # 25000 erpm/s, the tool's default, on 15 pole pairs.
    assert speed.ramp == pytest.approx(25000.0 / 15 * 2.0 * math.pi / 60.0)


def test_filtered_speeds_have_the_share_of_the_firmware() -> None:
    held = configure(scooter())
    for source, share in ((1, 0.01), (2, 0.2)):
        speed = profile(replace(held, own={**held.own, "s_pid_speed_source": source})).speed
        assert speed is not None
        feedback = speed.feedback
        assert feedback.kind == "low-pass"
        assert feedback.t_s / (feedback.t_s + feedback.filter_time) == pytest.approx(share)


def test_both_zero_vectors_halve_the_period() -> None:
    held = configure(scooter())
    both = configuration("both", {**held.own, "foc_control_sample_mode": 1})
    current = profile(both).current
    assert (current.d.t_s, current.delay) == (2.5e-5, 1.0)


def test_one_pair_for_two_inductances_is_the_mean_and_is_priced() -> None:
    asked = asked_of(replace(SCOOTER, l_d=1e-4, l_q=3e-4))
    held = configure(asked)
    assert held.current_d == held.current_q
    assert held.current_q is not None
    assert held.current_q.kp == pytest.approx(2e3 * math.pi * 2e-4, rel=1e-5)
    assert held.drive.l_d == pytest.approx(1e-4)
    assert held.drive.l_q == pytest.approx(3e-4)
    priced = next(one for one in shortfalls(asked, held) if "two inductances" in one.words)
    prices = {price.of: price.value for price in priced.prices}
    assert prices["phase margin of the d axis"] > math.radians(5.0)
    assert prices["phase margin of the q axis"] < 0.0


def test_currents_of_a_linear_machine_cost_nothing_on_a_linear_machine() -> None:
    salient = replace(SCOOTER, l_q=4e-4)
    asked = asked_of(salient)
    held = configure(asked)
    assert held.own["foc_mtpa_mode"] == 1
    assert profile(held).reference == "mtpa-linear"
    assert not [one for one in shortfalls(asked, held) if "torque" in one.words]
    without = configuration("off", {**held.own, "foc_mtpa_mode": 0})
    (lost,) = [one for one in shortfalls(asked, without) if "torque" in one.words]
    torque, copper = lost.prices
    # The optimum of a linear machine in closed form.
    d_l, psi, i = 3e-4, salient.psi_pm, salient.i_max
    i_d = (psi - math.sqrt(psi**2 + 8.0 * (d_l * i) ** 2)) / (4.0 * d_l)
    best = (psi - d_l * i_d) * math.sqrt(i**2 - i_d**2)
    assert torque.value == pytest.approx(1.0 - psi * i / best, rel=1e-3)
    assert copper.value > torque.value


def test_a_surface_magnet_machine_at_its_rates_is_held_but_for_voltage() -> None:
    asked = asked_of(replace(SCOOTER, inertia=0.2), v_dc=96.0)
    (voltage,) = shortfalls(asked, configure(asked))
    assert "l_max_duty" in voltage.words
    (price,) = voltage.prices
    assert price.value == pytest.approx(0.05)


def test_a_light_rotor_outruns_the_speed_that_is_fed_forward() -> None:
    light = replace(SCOOTER, inertia=1e-3)
    asked = asked_of(light)
    (lags,) = [one for one in shortfalls(asked, configure(asked)) if "lags" in one.words]
    # A ramp of slope a through the filter y += 0.01 (x - y) is 99 steps behind.
    constant = light.pole_pairs * light.psi_pm
    acceleration = 1.5 * constant * light.i_max / 1e-3
    speed = filtered = 0.0
    for _ in range(5000):
        speed += acceleration * 50e-6
        filtered += 0.01 * (speed - filtered)
    assert lags.prices[0].value == pytest.approx(constant * (speed - filtered), rel=1e-3)
    heavy = asked_of(replace(SCOOTER, inertia=0.2))
    assert not [one for one in shortfalls(heavy, configure(heavy)) if "lags" in one.words]


def test_rates_that_the_firmware_has_not_are_named() -> None:
    asked = asked_of(SCOOTER, speed=PiGains(1.0, 1.0), ratio=33)
    held = configure(asked)
    assert held.drive.t_speed == 1e-3
    (rate,) = [one for one in shortfalls(asked, held) if "speed controller every" in one.words]
    assert "1000 us" in rate.words
    assert "1650 us" in rate.words


@pytest.mark.parametrize(
    ("machine", "f_sw", "key"),
    [
        (replace(SCOOTER, psi_pm=0.0), 20e3, "machine.magnet_flux"),
        (SCOOTER, 100e3, "inverter.switching_frequency"),
        (replace(SCOOTER, i_max=6000.0), 20e3, "machine.max_current"),
        (replace(SCOOTER, omega_m_max=1e6), 20e3, "machine.max_speed"),
        (replace(SCOOTER, pole_pairs=200), 20e3, "machine.pole_pairs"),
        (replace(SCOOTER, psi_pm=1e-5), 20e3, "machine.magnet_flux"),
    ],
)
def test_what_the_format_cannot_hold_is_refused(
    machine: LinearMachine, f_sw: float, key: str
) -> None:
    with pytest.raises(InputError, match=key):
        configure(asked_of(machine, f_sw=f_sw))


@pytest.mark.parametrize("missing", ["foc_f_zv", "foc_current_kp"])
def test_loops_of_half_a_configuration_are_refused(missing: str) -> None:
    held = configure(scooter())
    own = {name: value for name, value in held.own.items() if name != missing}
    with pytest.raises(InputError, match=missing):
        profile(configuration("half", own))


def test_the_method_offers_one_pair() -> None:
    assert (VESC.name, VESC.free) == ("vesc", "one-pair")


def test_a_carrier_that_the_format_does_not_hold_is_refused_with_what_it_holds() -> None:
    asked = scooter()
    fast = replace(asked, drive=replace(asked.drive, f_sw=100e3))
    with pytest.raises(InputError, match="write at most 75 kHz"):
        VESC.configure(fast)


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("ratio", [1, 30, 2000])
@pytest.mark.parametrize("pll", [None, PiGains(900.0, 1.1e5)])
def test_every_value_is_that_of_its_rule(steps: int, ratio: int, pll: PiGains | None) -> None:
    machine = replace(SCOOTER, l_q=1.7e-4)
    asked = asked_of(machine, speed=PiGains(0.7, 9.0), dead_time=4e-7, ratio=ratio)
    t_s = 5e-5 / steps
    asked = replace(asked, pll=pll, drive=replace(asked.drive, t_s=t_s, t_speed=ratio * t_s))
    own, erpm = configure(asked).own, 15 * 30.0 / math.pi
    scale = erpm * machine.i_max / 20.0
    rates = (25.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 2500.0, 5000.0, 10000.0)
    rate = 1.0 / (ratio * t_s)
    expected = {
        "motor_type": 2,
        "l_current_max": machine.i_max,
        "l_current_min": -machine.i_max,
        "l_abs_current_max": 1.5 * machine.i_max,
        "l_min_erpm": -250.0 * erpm,
        "l_max_erpm": 250.0 * erpm,
        "foc_current_kp": 0.5 * (asked.current_d.kp + asked.current_q.kp),
        "foc_current_ki": 0.5 * (asked.current_d.ki + asked.current_q.ki),
        "foc_f_zv": 40e3,
        "foc_dt_us": 0.4,
        "foc_motor_l": 1.35e-4,
        "foc_motor_ld_lq_diff": 0.7e-4,
        "foc_motor_r": 0.05,
        "foc_motor_flux_linkage": machine.psi_pm,
        "foc_observer_gain": 1e3 / machine.psi_pm**2,
        "foc_control_sample_mode": steps - 1,
        "foc_cc_decoupling": 3,
        "foc_mtpa_mode": 1,
        "sp_pid_loop_rate": min((k for k in range(9) if rates[k] >= 0.999 * rate), default=8),
        "s_pid_kp": 0.7 / scale,
        "s_pid_ki": 9.0 / scale,
        "s_pid_kd": 0.0,
        "s_pid_speed_source": 0,
        "foc_pll_kp": 2000.0 if pll is None else 900.0,
        "foc_pll_ki": 1e6 if pll is None else 1.1e5,
        "si_motor_poles": 30,
    }
    assert set(own) == set(expected)
    for name, value in expected.items():
        assert own[name] == pytest.approx(value, rel=1e-4, abs=1e-12), name


def test_numbers_of_what_does_not_fit_are_those_of_the_configuration() -> None:
    """Gains of two rules, an observer of another version and of none, poles and an encoder."""
    own = {
        "foc_motor_r": 0.05,
        "foc_motor_l": 1e-4,
        "foc_motor_flux_linkage": 5e-3,
        "foc_current_kp": 0.1,
        "foc_current_ki": 70.0,
        "foc_observer_gain": 10.0 / (0.05 * 25e-6),
        "foc_motor_ld_lq_diff": -2.1e-4,
        "si_motor_poles": 14,
        "foc_encoder_ratio": 14.0,
        "foc_sensor_mode": 1,
        "l_current_max": 60.0,
        "l_abs_current_max": 55.0,
        "l_current_min": 3.0,
    }
    found = configuration("x", own).contradictions
    gains = numbers_of(found, "edited by hand")
    assert gains == pytest.approx([0.1, 1000.0, 70.0, 1400.0, 50.0], rel=1e-3)
    expected = [8e6, 200.0, 2.0, 1000.0, 2.0, 4e7, 10.0, 2.0, 8e6]
    assert numbers_of(found, "older versions set") == pytest.approx(expected)
    assert numbers_of(found, "trips below") == [55.0, 60.0]
    assert numbers_of(found, "limits braking") == [3.0]
    assert numbers_of(found, "without inductance") == pytest.approx([-2.1e-4, 1e-4])
    assert numbers_of(found, "turns the field") == [14.0, 14.0, 7.0]
    other = configuration("x", own | {"foc_observer_gain": 5e6}).contradictions
    assert "older" not in next(text for text in other if "foc_observer_gain" in text)
    fits = {"foc_observer_gain": 4e7, "foc_current_ki": 50.0, "foc_encoder_ratio": 7.0}
    fits |= {"foc_motor_ld_lq_diff": 1.9e-4, "l_abs_current_max": 60.0, "l_current_min": -3.0}
    assert configuration("x", own | fits).contradictions == ()


@pytest.mark.parametrize("fastest", [100.0, 700.0])
def test_what_vesc_does_not_hold_is_said_in_numbers(fastest: float) -> None:
    asked = asked_of(replace(SCOOTER, omega_m_max=fastest, inertia=1e-3), dead_time=900e-9)
    found = shortfalls(asked, configure(asked))
    words = [entry.words for entry in found]
    prices = {price.of: price.value for entry in found for price in entry.prices}
    counted, psi = asked.design.v_max, SCOOTER.psi_pm
    limit = 0.95 * 48.0 / math.sqrt(3.0)
    lost = numbers_of(words, "l_max_duty")
    assert lost == pytest.approx([95.0, limit, counted], rel=1e-3)
    assert prices["voltage"] == pytest.approx(1.0 - limit / counted, rel=1e-3)
    reached = limit / (15 * psi)
    assert ("speed" in prices) == (fastest > reached)
    if fastest > reached:
        expected = [fastest * 15 * psi, limit, reached]
        assert numbers_of(words, "foc_fw_current_max") == pytest.approx(expected, rel=1e-3)
        assert prices["speed"] == pytest.approx(1.0 - reached / fastest, rel=1e-3)
    volts = 0.9e-6 * 20e3 * 48.0 / 3.0
    assert numbers_of(words, "foc_dt_us")[-2:] == pytest.approx([volts, 0.675], rel=2e-3)
    assert prices["voltage in the observer"] == pytest.approx(volts, rel=1e-3)
    acceleration = 1.5 * 15 * psi * SCOOTER.i_max / 1e-3
    expected = [99 * 0.05, acceleration, 15 * psi * acceleration * 99 * 50e-6]
    lags = numbers_of(words, "forward by a speed")
    assert [x for x in lags if x != 2.0] == pytest.approx(expected, rel=1e-2)
