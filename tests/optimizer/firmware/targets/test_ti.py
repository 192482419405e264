"""TI's lab: its own rule, factors that make other gains of it, and the loops of that."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from firmware_asked import SCOOTER, TWO_PI, asked_of, numbers_of, random_asked, scooter
from saturated import ArctanMachine

from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import judge
from dqforge.optimizer.firmware.targets.ti import (
    BANDWIDTHS,
    OLDER_LAB,
    VERSION,
    as_printed,
    configuration,
    configure,
    current_rule,
    profile,
    shortfalls,
    speed_rule,
)

# Motors of TI's public files, as numbers (motor-control-sdk user_mtr1.h).
TEKNIC = {
    "USER_MOTOR1_NUM_POLE_PAIRS": 4,
    "USER_MOTOR1_Rs_Ohm": 0.393955578,
    "USER_MOTOR1_Ls_d_H": 0.000190442806,
    "USER_MOTOR1_Ls_q_H": 0.000190442806,
    "USER_MOTOR1_RATED_FLUX_VpHz": 0.0399353318,
    "USER_MOTOR1_MAX_CURRENT_A": 6.6,
    "USER_MOTOR1_OVER_CURRENT_A": 7.5,
    "USER_MOTOR1_INERTIA_Kgm2": 7.06154e-06,
    "USER_MOTOR1_RATED_VOLTAGE_V": 24.0,
    "USER_MOTOR1_FREQ_MAX_Hz": 600.0,
    "USER_M1_PWM_FREQ_kHz": 15.0,
}


def test_the_flux_of_the_teknic_is_that_of_its_data_sheet() -> None:
    found = configuration("Teknic_M2310PLN04K", TEKNIC)
    assert found.drive.psi_pm == pytest.approx(6.356e-3, rel=1e-4)
    # Its data sheet: 4.64 V (peak, line to line) per 1000 rpm.
    of_the_sheet = 4.64 / math.sqrt(3.0) / (1000.0 * math.pi / 30.0 * 4)
    assert found.drive.psi_pm == pytest.approx(of_the_sheet, rel=7e-3)


def setup_controllers(values: dict[str, float], bandwidth: float, delta: float) -> dict[str, float]:
    """Gains per sample as the firmware computes them, from the block, in its own units."""
    t_s, speed_ticks = 1.0 / (values["USER_M1_PWM_FREQ_kHz"] * 1000.0), 10
    flux = values["USER_MOTOR1_RATED_FLUX_VpHz"] / TWO_PI
    constant = 3.0 * values["USER_MOTOR1_NUM_POLE_PAIRS"] * flux
    constant /= 2.0 * values["USER_MOTOR1_INERTIA_Kgm2"]
    inductance = values["USER_MOTOR1_Ls_q_H"]
    return {
        "kp": inductance * bandwidth,
        "ki": 0.25 * values["USER_MOTOR1_Rs_Ohm"] / inductance * t_s,
        "kp_spd": bandwidth / (delta * constant),
        "ki_spd": bandwidth * t_s * speed_ticks / delta**2,
    }


@pytest.mark.parametrize(("version", "hertz", "delta"), [(VERSION, 200, 20), (OLDER_LAB, 400, 10)])
def test_the_firmwares_own_gains(version: str, hertz: float, delta: float) -> None:
    own = setup_controllers(TEKNIC, TWO_PI * hertz, delta)
    found = configuration("Teknic", TEKNIC, version=version)
    t_s = found.drive.t_s
    assert t_s is not None
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(own["kp"], rel=1e-12)
    # Series form: the integral takes ki times kp times the error each sample.
    assert found.current_q.ki * t_s == pytest.approx(own["kp"] * own["ki"], rel=1e-12)
    assert found.speed is not None
    # An error of 1 rad/s (mechanical) is 4/(2 pi) Hz to the controller.
    assert found.speed.kp == pytest.approx(own["kp_spd"] * 4 / TWO_PI, rel=1e-12)
    per_second = own["kp_spd"] * own["ki_spd"] * 4 / TWO_PI / (10.0 * t_s)
    assert found.speed.ki == pytest.approx(per_second, rel=1e-12)


def test_the_factors_make_the_gains_that_were_asked_for() -> None:
    for asked in random_asked(200):
        found = configure(asked)
        assert found.current_d is not None
        assert found.current_q is not None
        for has, wanted in ((found.current_d, asked.current_d), (found.current_q, asked.current_q)):
            assert has.kp == pytest.approx(wanted.kp, rel=1e-6)
            assert has.ki == pytest.approx(wanted.ki, rel=1e-6)
        assert found.speed is not None
        if asked.speed is not None:
            assert found.speed.kp == pytest.approx(asked.speed.kp, rel=1e-6)
            assert found.speed.ki == pytest.approx(asked.speed.ki, rel=1e-6)
        else:
            assert found.own["USER_MOTOR1_KP_SPD_HIGH_SF"] == 1.0
        numbers = [value for value in found.own.values() if isinstance(value, float)]
        assert numbers == [as_printed(value) for value in numbers]


def test_older_labs_do_not_know_the_factors() -> None:
    own = TEKNIC | {"USER_MOTOR1_KP_IQ_HIGH_SF": 3.0}
    plain = configuration("Teknic", TEKNIC, version=OLDER_LAB)
    assert configuration("Teknic", own, version=OLDER_LAB).current_q == plain.current_q
    now = configuration("Teknic", own)
    assert now.current_q is not None
    rule = current_rule(0.393955578, 0.000190442806, BANDWIDTHS[VERSION].current)
    assert now.current_q.kp == pytest.approx(3.0 * rule.kp)
    assert now.current_q.ki == pytest.approx(3.0 * rule.ki)


def test_the_loops_are_those_of_the_lab() -> None:
    found = configure(scooter())
    loops = profile(found)
    assert (loops.current.order, loops.current.delay) == ("d-first", 1.0)
    assert (loops.current.cross, loops.current.back_emf) == (False, False)
    assert loops.current.d.rule == "integral-first"
    assert loops.current.d.anti_windup == "hold"
    assert loops.current.voltage_share == pytest.approx(1.0, abs=1e-6)
    assert loops.reference == "id-zero"
    assert loops.speed is not None
    assert loops.speed.feedback.filter_time == pytest.approx(1.0 / (TWO_PI * 200.0))
    assert loops.speed.pi.limit == pytest.approx(40.0 * math.sqrt(2.0), rel=1e-6)
    judged = judge(loops, scooter().drive)
    assert judged.current_q is not None
    assert judged.current_q.stable
    assert judged.speed is not None
    assert judged.speed.stable
    assert math.degrees(judged.speed.phase_margin) > 50.0


def test_the_labs_own_speed_loop_is_faster_than_its_rule_by_the_pole_pairs() -> None:
    """Its gain is for rad/s and is given Hz: 15/(2 pi) = 2.39 times the crossover of 63 rad/s."""
    own = BANDWIDTHS[VERSION]
    rule = speed_rule(15, SCOOTER.psi_pm, 0.02, own)
    crossover = rule.kp * 1.5 * 15 * SCOOTER.psi_pm / 0.02
    assert crossover == pytest.approx(own.current / own.delta * 15 / TWO_PI)
    assert crossover == pytest.approx(150.0, rel=1e-3)


def test_periods_that_the_lab_cannot_run_are_told() -> None:
    asked = scooter()
    drive = replace(asked.drive, t_s=0.5 / 20e3)
    found = configure(replace(asked, drive=drive))
    assert found.drive.t_s == pytest.approx(1.0 / 20e3)
    words = [entry.words for entry in shortfalls(replace(asked, drive=drive), found)]
    assert any("control step every 50 us, the design every 25 us" in text for text in words)
    three = configure(replace(asked, drive=replace(asked.drive, t_s=3.0 / 20e3)))
    assert three.own["USER_M1_NUM_PWM_TICKS_PER_ISR_TICK"] == 3


def test_what_holds_without_the_factors_has_a_price() -> None:
    asked = scooter()
    found = shortfalls(asked, configure(asked))
    prices = {price.of: price.value for entry in found for price in entry.prices}
    assert prices["q gain of the firmware's own rule"] == pytest.approx(0.2 - 1.0, rel=1e-3)
    assert prices["q integral gain of the firmware's own rule"] == pytest.approx(-0.95, rel=1e-3)
    assert any("MOTOR1_PI_TUNE" in entry.words for entry in found)


def test_factors_beyond_the_advised_ones_are_told() -> None:
    asked = asked_of(SCOOTER, crossover=TWO_PI * 4000.0)
    words = [entry.words for entry in shortfalls(asked, configure(asked))]
    assert any("USER_MOTOR1_KP_IQ_HIGH_SF 20 is outside" in text for text in words)


def test_saturated_currents_have_a_price_in_torque_and_copper() -> None:
    asked = asked_of(ArctanMachine(inertia=0.01), v_dc=300.0)
    found = shortfalls(asked, configure(asked))
    prices = {price.of: price.value for entry in found for price in entry.prices}
    assert 1e-3 < prices["torque"] < 0.5
    assert prices["copper loss"] > prices["torque"]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"psi_pm": 0.0}, "machine.magnet_flux"),
        ({"inertia": None}, "machine.inertia"),
        ({"r_s": None}, "machine.resistance"),
        ({"i_max": None}, "machine.max_current"),
        ({"inertia": 1e35}, "machine.inertia"),
    ],
)
def test_designs_that_say_too_little_are_refused_by_key(change: dict[str, Any], key: str) -> None:
    asked = scooter()
    with pytest.raises(InputError) as refused:
        configure(replace(asked, drive=replace(asked.drive, **change)))
    assert str(refused.value).startswith(key)


def test_the_range_of_the_currents_is_written_where_it_is_known() -> None:
    asked = scooter()
    words = [entry.words for entry in shortfalls(asked, configure(asked))]
    assert any("must be at least 119.1 A" in text for text in words)
    sensing = CurrentSensing(shunt=0.5e-3, gain=50.0, reference=3.3)
    inverter = replace(asked.design.inverter, current_sensing=sensing)
    known = replace(asked, design=replace(asked.design, inverter=inverter))
    found = configure(known)
    assert found.own["USER_M1_ADC_FULL_SCALE_CURRENT_A"] == pytest.approx(132.0)
    assert found.contradictions == ()
    assert not any("at least" in entry.words for entry in shortfalls(known, found))
    small = replace(inverter, current_sensing=replace(sensing, gain=60.0))
    found = configure(replace(asked, design=replace(asked.design, inverter=small)))
    assert any("47.5 %" in text for text in found.contradictions)


def test_a_block_without_timing_has_no_loops() -> None:
    own = {name: value for name, value in TEKNIC.items() if "PWM" not in name}
    with pytest.raises(InputError, match="USER_M1_PWM_FREQ_kHz"):
        profile(configuration("Teknic", own))


def test_values_that_are_none_are_not_computed_with() -> None:
    own = TEKNIC | {
        "USER_M1_NUM_PWM_TICKS_PER_ISR_TICK": 0,
        "USER_MOTOR1_SPEED_LPF_FC_Hz": 0.0,
        "USER_MOTOR1_Ls_d_H": 0.0,
    }
    found = configuration("x", own)
    assert (found.drive.t_s, found.drive.l_d, found.current_d) == (None, None, None)
    own |= {"USER_M1_NUM_PWM_TICKS_PER_ISR_TICK": 1, "USER_MOTOR1_Ls_d_H": 1e-4}
    speed = profile(configuration("x", own)).speed
    assert speed is not None
    assert speed.feedback.filter_time == pytest.approx(1.0 / (TWO_PI * 200.0))


def test_gains_without_an_integral_are_held_and_without_a_proportional_part_refused() -> None:
    asked = replace(scooter(), current_q=PiGains(0.5, 0.0))
    found = configure(asked)
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(0.5, rel=1e-6)
    assert found.current_q.ki == 0.0
    assert shortfalls(asked, found)
    with pytest.raises(InputError, match=r"control\.current_loop"):
        configure(replace(scooter(), current_q=PiGains(0.0, 1.0)))


def test_contradictions_name_both_numbers() -> None:
    found = configuration("Teknic_M2310PLN04K", TEKNIC)
    assert len(found.contradictions) == 1
    assert "induce 23.96 V" in found.contradictions[0]
    assert "gives 13.86 V" in found.contradictions[0]
    own = TEKNIC | {
        "USER_MOTOR1_OVER_CURRENT_A": 5.0,
        "USER_M1_ADC_FULL_SCALE_CURRENT_A": 10.0,
        "USER_MOTOR1_RATED_SPEED_KRPM": 12.0,
    }
    words = " ".join(configuration("another", own).contradictions)
    for part in ("trips below", "47.5 %", "RATED_SPEED_KRPM 12 is 800 Hz", "Teknic M2310"):
        assert part in words


@pytest.mark.parametrize(("rated", "against"), [(9.3, False), (9.6, True)])
def test_a_rated_speed_within_five_percent_of_the_largest_frequency_is_none(
    rated: float, against: bool
) -> None:
    """620 and 640 Hz against 600 Hz."""
    own = TEKNIC | {"USER_MOTOR1_RATED_SPEED_KRPM": rated}
    words = " ".join(configuration("another", own).contradictions)
    assert ("above FREQ_MAX_Hz 600 Hz" in words) == against


@pytest.mark.parametrize("ticks", [1, 2, 5])
@pytest.mark.parametrize("fastest", [None, 300.0])
def test_every_value_of_the_block_is_that_of_its_rule(ticks: int, fastest: float | None) -> None:
    machine = replace(SCOOTER, l_q=1.7e-4, omega_m_max=fastest)
    asked = asked_of(machine, speed=PiGains(0.7, 9.0), ratio=14)
    t_s = ticks / 20e3
    drive = replace(asked.drive, t_s=t_s, t_speed=14 * t_s)
    found = configure(replace(asked, drive=drive)).own
    v_max, i_max = 48.0 / math.sqrt(3.0), machine.i_max
    most = v_max / (TWO_PI * machine.psi_pm) if fastest is None else fastest * 15 / TWO_PI
    steps = min(ticks, 3)
    expected = {
        "M1_PWM_FREQ_kHz": 20.0,
        "M1_NUM_PWM_TICKS_PER_ISR_TICK": steps,
        "M1_NUM_ISR_TICKS_PER_SPEED_TICK": round(14 * ticks / steps),
        "M1_NOMINAL_DC_BUS_VOLTAGE_V": 48.0,
        "M1_MAX_VS_MAG_PU": 3.0**-0.5,
        "MOTOR1_NUM_POLE_PAIRS": 15,
        "MOTOR1_Rr_Ohm": 0.0,
        "MOTOR1_Rs_Ohm": 0.05,
        "MOTOR1_Ls_d_H": 1e-4,
        "MOTOR1_Ls_q_H": 1.7e-4,
        "MOTOR1_RATED_FLUX_VpHz": TWO_PI * machine.psi_pm,
        "MOTOR1_MAGNETIZING_CURRENT_A": 0.0,
        "MOTOR1_INERTIA_Kgm2": 0.02,
        "MOTOR1_RATED_VOLTAGE_V": 48.0,
        "MOTOR1_VOLT_MIN_V": 0.15 * v_max,
        "MOTOR1_VOLT_MAX_V": v_max,
        "MOTOR1_SPEED_LPF_FC_Hz": 200.0,
    }
    # TI's gains: BWc L and a quarter of R/L; of the speed, times p/(2 pi).
    bandwidth, slower = TWO_PI * 200.0, 20.0
    per_hertz = bandwidth / (slower * 1.5 * 15 * machine.psi_pm / 0.02)
    for axis, wished, inductance in (
        ("ID_", asked.current_d, 1e-4),
        *((f"IQ_{place}", asked.current_q, 1.7e-4) for place in ("START_", "LOW_", "HIGH_")),
    ):
        expected[f"MOTOR1_KP_{axis}SF"] = wished.kp / (bandwidth * inductance)
        expected[f"MOTOR1_KI_{axis}SF"] = wished.ki / wished.kp / (0.25 * 0.05 / inductance)
    for place in ("START_", "LOW_", "HIGH_"):
        expected[f"MOTOR1_KP_SPD_{place}SF"] = 0.7 / (per_hertz * 15 / TWO_PI)
        expected[f"MOTOR1_KI_SPD_{place}SF"] = 9.0 / 0.7 / (bandwidth / slower**2)
    shares = {
        "RES_EST": 0.1, "IND_EST": -0.1, "FORCE_DELTA": 0.01, "ALIGN_DELTA": 0.002, "FLUX": 0.1,
        "ALIGN": 0.25, "STARTUP": 0.5, "TORQUE": 0.5, "OVER": 1.25, "GAIN_IQ_LOW": 0.1,
        "GAIN_IQ_HIGH": 0.5, "MAX": 1.0,
    }  # fmt: skip
    for name, share in shares.items():
        plain = name.startswith(("GAIN", "FORCE", "ALIGN_DELTA"))
        expected[f"MOTOR1_{name}{'' if plain else '_CURRENT'}_A"] = share * i_max
    parts = {
        "FLUX_EXC_FREQ_Hz": 0.1, "FREQ_MIN_Hz": 0.015, "FREQ_LOW_Hz": 0.1, "FREQ_HIGH_Hz": 1.0,
        "SPEED_START_Hz": 0.06, "SPEED_FORCE_Hz": 0.05, "ACCEL_START_Hzps": 0.05,
        "ACCEL_MAX_Hzps": 1.0, "SPEED_FS_Hz": 0.005, "GAIN_SPEED_LOW_Hz": 0.1,
        "GAIN_SPEED_HIGH_Hz": 0.5, "FREQ_MAX_Hz": 1.0,
    }  # fmt: skip
    expected |= {f"MOTOR1_{name}": share * most for name, share in parts.items()}
    numbers = {name.removeprefix("USER_"): value for name, value in found.items()}
    assert numbers.pop("MOTOR1_TYPE") == "MOTOR_TYPE_PM"
    assert set(numbers) == set(expected)
    for name, value in expected.items():
        assert numbers[name] == pytest.approx(value, rel=1e-6), name
    held = configure(replace(asked, drive=replace(drive, t_s=None, t_speed=None))).own
    assert held["USER_M1_NUM_PWM_TICKS_PER_ISR_TICK"] == 1
    assert held["USER_M1_NUM_ISR_TICKS_PER_SPEED_TICK"] == 10


@pytest.mark.parametrize("fastest", [250.0, 320.0, 500.0])
def test_the_speed_at_which_the_voltage_ends_has_its_price(fastest: float) -> None:
    machine = replace(SCOOTER, omega_m_max=fastest)
    asked = asked_of(machine)
    reached = 48.0 / math.sqrt(3.0) / machine.psi_pm / 15
    found = [
        (entry.words, price.value)
        for entry in shortfalls(asked, configure(asked))
        for price in entry.prices
        if price.of == "speed"
    ]
    assert bool(found) == (reached < fastest)
    for words, price in found:
        assert price == pytest.approx(1.0 - reached / fastest, rel=1e-5)
        assert f"the speed ends at {reached * 15 / TWO_PI:.4g} Hz" in words


def test_numbers_of_what_does_not_fit_are_those_of_the_block() -> None:
    own = TEKNIC | {
        "USER_MOTOR1_OVER_CURRENT_A": 5.0,
        "USER_M1_ADC_FULL_SCALE_CURRENT_A": 10.0,
        "USER_MOTOR1_RATED_SPEED_KRPM": 12.0,
    }
    found = configuration("another", own).contradictions
    flux, v_max = TEKNIC["USER_MOTOR1_RATED_FLUX_VpHz"], 24.0 / math.sqrt(3.0)
    expected = [600.0, flux, 600.0 * flux, 24.0, v_max, v_max / flux]
    assert numbers_of(found, "the magnets of") == pytest.approx(expected, rel=1e-3)
    assert numbers_of(found, "trips below") == [5.0, 6.6]
    assert numbers_of(found, "47.5 %") == [6.6, 4.75, 47.5, 10.0]
    assert numbers_of(found, "RATED_SPEED_KRPM") == [12.0, 800.0, 4.0, 600.0]
    assert numbers_of(found, "Teknic M2310")[0] == pytest.approx(7.06154e-6)
    assert not any("Teknic" in text for text in configuration("a TEKNIC", own).contradictions)


@pytest.mark.parametrize(("scale", "told"), [(13.8, True), (14.0, False)])
def test_the_limit_lies_below_what_trips_at_the_latest(scale: float, *, told: bool) -> None:
    """6.6 A over 0.475 is 13.89 A."""
    own = TEKNIC | {"USER_M1_ADC_FULL_SCALE_CURRENT_A": scale}
    words = configuration("x", own).contradictions
    assert any("47.5 %" in text for text in words) == told


@pytest.mark.parametrize("speed", [None, PiGains(0.7, 9.0)])
def test_what_the_rule_runs_is_said_in_numbers(speed: PiGains | None) -> None:
    """BWc = 2 pi 200 Hz, a quarter of R/L; of the speed, times p/(2 pi)."""
    asked = asked_of(replace(SCOOTER, l_q=1.7e-4), speed=speed)
    words = [entry.words for entry in shortfalls(asked, configure(asked))]
    bandwidth = TWO_PI * 200.0
    rule = [bandwidth * 1.7e-4, bandwidth * 0.25 * 0.05]
    kp = bandwidth / (20.0 * 1.5 * 15 * SCOOTER.psi_pm / 0.02) * 15 / TWO_PI
    found = numbers_of(words, "MOTOR1_PI_TUNE")
    expected = [200.0, 4.0, asked.current_q.kp, asked.current_q.ki, *rule]
    expected += [] if speed is None else [kp, 0.7]
    assert [x for x in found if x != 1.0] == pytest.approx(expected, rel=1e-3)
    prices = {
        price.of: price.value
        for entry in shortfalls(asked, configure(asked))
        for price in entry.prices
    }
    if speed is not None:
        name = "speed gain of the firmware's own rule"
        assert prices[name] == pytest.approx(kp / 0.7 - 1.0, rel=1e-5)
    own = asked_of(replace(SCOOTER, l_q=1.7e-4), crossover=bandwidth, speed=speed)
    gains = [replace(x, ki=0.25 * x.ki) for x in (own.current_d, own.current_q)]
    own = replace(own, current_d=gains[0], current_q=gains[1])
    assert not any("PI_TUNE" in entry.words for entry in shortfalls(own, configure(own)))


@pytest.mark.parametrize(
    ("crossover", "told"), [(1990.0, False), (2010.0, True), (20.2, False), (19.8, True)]
)
def test_factors_are_advised_between_a_tenth_and_ten(crossover: float, *, told: bool) -> None:
    """Of the gain at 200 Hz."""
    asked = asked_of(SCOOTER, crossover=TWO_PI * crossover)
    words = [entry.words for entry in shortfalls(asked, configure(asked))]
    assert any("USER_MOTOR1_KP_IQ_HIGH_SF" in text for text in words) == told
    assert not any("KP_IQ_LOW_SF" in text for text in words if "outside" in text)


@pytest.mark.parametrize(("share", "told"), [(99.0, False), (101.0, True)])
def test_the_factor_of_the_speed_may_be_a_hundred(share: float, *, told: bool) -> None:
    bandwidth = TWO_PI * 200.0
    kp = bandwidth / (20.0 * 1.5 * 15 * SCOOTER.psi_pm / 0.02) * 15 / TWO_PI
    asked = asked_of(SCOOTER, speed=PiGains(share * kp, share * kp * bandwidth / 400.0))
    words = [entry.words for entry in shortfalls(asked, configure(asked))]
    assert any("USER_MOTOR1_KP_SPD_HIGH_SF" in text for text in words) == told
