"""NXP's motor control as a target: what is configured, what then runs, what it cannot hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import nxp_published as published
import pytest
from firmware_asked import numbers_of
from nxp_designs import asked_for, design_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, judge
from dqforge.optimizer.firmware.mcat_numbers import EDITIONS, FLOAT_2022, FLOAT_2025, constants
from dqforge.optimizer.firmware.mcat_sheet import McatFile
from dqforge.optimizer.firmware.targets.nxp import NXP, configured, own_values, profile


def _published(data: published.Published) -> Configuration:
    own = {f"M1_{name}": float(text) for name, text in data.constants.items()}
    return McatFile("m", EDITIONS[data.version], {**data.inputs, **own}).configuration()


def test_gains_of_a_design_are_held_to_six_digits(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path))
    found = NXP.configure(asked)
    assert found.version == "2025"
    for has, wished in (
        (found.current_d, asked.current_d),
        (found.current_q, asked.current_q),
        (found.speed, asked.speed),
    ):
        assert has is not None
        assert wished is not None
        assert has.kp == pytest.approx(wished.kp, rel=5e-6)
        assert has.ki == pytest.approx(wished.ki, rel=5e-6)
    assert found.contradictions == ()
    assert found.drive.psi_pm == pytest.approx(asked.drive.psi_pm)
    assert found.drive.v_dc == pytest.approx(asked.design.inverter.v_dc)
    assert found.drive.omega_m_max == pytest.approx(asked.drive.omega_m_max, rel=5e-6)


def test_the_inputs_in_the_comment_make_the_same_constants(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    inputs = {key: value for key, value in found.own.items() if not key.startswith("M1_")}
    for name, value in constants(EDITIONS["2025"], inputs).items():
        assert found.own[name] == pytest.approx(value, rel=2e-6), name


def test_two_inductances_keep_their_gains_and_the_inputs_say_so(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path, inductance_q="260 uH"))
    found = NXP.configure(asked)
    assert found.current_d is not None
    assert found.current_d.ki == pytest.approx(asked.current_d.ki, rel=5e-6)
    assert any("M1_D_KI_GAIN" in words for words in found.contradictions)
    held = [fall for fall in NXP.shortfalls(asked, found) if "one F0 and ksi" in fall.words]
    assert len(held) == 1
    assert {price.of for price in held[0].prices} >= {"M1_D_KI_GAIN"}


def test_no_d_current_has_its_price_in_torque(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path, inductance_q="400 uH"))
    falls = NXP.shortfalls(asked, NXP.configure(asked))
    price = {price.of: price.value for fall in falls for price in fall.prices}
    assert price["torque"] > 0.005
    assert price["copper loss"] > price["torque"]


def test_the_scale_of_the_currents_is_that_of_their_measurement(tmp_path: Path) -> None:
    sensing = "  current_sensing: {shunt: 1 mOhm, gain: 20, reference: 3.3 V}\n"
    found = NXP.configure(asked_for(design_of(tmp_path, inverter=sensing)))
    assert found.own["M1_I_MAX"] == pytest.approx(82.5)
    narrow = "  current_sensing: {shunt: 5 mOhm, gain: 20, reference: 3.3 V}\n"
    with pytest.raises(InputError, match=r"current_sensing: a full scale of 16\.5 A"):
        NXP.configure(asked_for(design_of(tmp_path, inverter=narrow)))


def test_fixed_point_counts_gains_in_its_integers(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path, loop="q_formats: auto"))
    found = NXP.configure(asked)
    assert found.version == "2022 fixed point"
    assert found.current_q is not None
    amperes, volts = found.own["M1_I_MAX"], found.own["M1_U_DCB_MAX"]
    assert isinstance(amperes, float)
    assert isinstance(volts, float)
    steps = found.current_q.kp * amperes / (volts / math.sqrt(3.0)) * 32768.0
    assert steps == pytest.approx(round(steps), abs=1e-6)
    assert found.current_q.kp == pytest.approx(asked.current_q.kp, rel=1e-3)
    runs = profile(found)
    assert runs.current.q.rule == "trapezoid"
    assert runs.current.voltage_share == pytest.approx(0.9, abs=1e-4)


@pytest.mark.parametrize(
    ("without", "words"),
    [
        (
            lambda asked: replace(asked, drive=replace(asked.drive, psi_pm=0.0)),
            "machine.magnet_flux",
        ),
        (
            lambda asked: replace(asked, drive=replace(asked.drive, omega_m_max=None)),
            "machine.max_speed",
        ),
        (
            lambda asked: replace(asked, drive=replace(asked.drive, l_d=None)),
            "machine.inductance_d",
        ),
        (lambda asked: replace(asked, drive=replace(asked.drive, r_s=None)), "machine.resistance"),
    ],
)
def test_what_is_missing_is_named_by_its_key(
    tmp_path: Path, without: Callable[[Asked], Asked], words: str
) -> None:
    asked = asked_for(design_of(tmp_path))
    with pytest.raises(InputError, match=words):
        NXP.configure(without(asked))


def test_a_design_without_speed_loop_leaves_its_gains_at_zero(tmp_path: Path) -> None:
    found = NXP.configure(replace(asked_for(design_of(tmp_path)), speed=None))
    assert found.own["M1_SPEED_PI_PROP_GAIN"] == 0.0
    assert profile(found).speed is None


def test_the_loops_of_a_file_of_2025() -> None:
    runs = profile(_published(published.FLOAT_2025))
    rate = 2.0 * math.pi * 360.0
    assert runs.current.d.rule == "trapezoid"
    assert runs.current.order == "d-first"
    assert runs.current.delay == 1.0
    assert runs.current.voltage_share == pytest.approx(0.9, rel=1e-5)
    assert runs.current.d.ki == pytest.approx(rate * rate * 0.000375, rel=1e-5)
    assert runs.speed is not None
    assert runs.speed.feedback.whole
    assert runs.speed.feedback.kp == pytest.approx(4.0 * math.pi * 80.0, rel=1e-5)
    assert runs.speed.feedback.ki == pytest.approx((2.0 * math.pi * 80.0) ** 2, rel=1e-5)
    assert runs.speed.feedback.filter_time == pytest.approx(1.0 / (2 * math.pi * 400), rel=1e-4)
    assert runs.speed.pi.filter_time == pytest.approx(1.0 / (2 * math.pi * 100), rel=1e-4)
    assert runs.speed.ramp == pytest.approx(10_000 * 2 * math.pi / 60, rel=1e-5)
    assert runs.observer is not None
    assert runs.observer.rate == pytest.approx(2.0 * math.pi * 600.0, rel=0.02)


def test_the_same_filter_runs_slower_in_the_older_age() -> None:
    runs = profile(_published(published.FLOAT_2022))
    assert runs.current.q.rule == "integral-first"
    assert runs.speed is not None
    assert runs.speed.pi.filter_time == pytest.approx(1.0 / (2 * math.pi * 6.25), rel=1e-4)


def test_published_current_loops_have_the_margins_of_their_poles() -> None:
    for data in (published.FLOAT_2025, published.FLOAT_2022, published.FIXED_2022):
        found = _published(data)
        judged = judge(profile(found), found.drive)
        assert judged.current_d is not None
        assert judged.current_d.stable
        assert math.radians(45.0) < judged.current_d.phase_margin < math.radians(85.0)


def test_the_tracking_observer_that_is_asked_for_is_held(tmp_path: Path) -> None:
    asked = replace(asked_for(design_of(tmp_path)), pll=PiGains(800.0, 160_000.0))
    runs = profile(NXP.configure(asked))
    assert runs.speed is not None
    assert runs.speed.feedback.kp == pytest.approx(800.0, rel=1e-5)
    assert runs.speed.feedback.ki == pytest.approx(160_000.0, rel=1e-5)


def test_an_older_age_is_configured_with_the_same_loops(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path))
    new, old = NXP.configure(asked), configured(asked, FLOAT_2022)
    assert old.version == "2022"
    assert new.current_q is not None
    assert old.current_q is not None
    assert old.current_q.ki == pytest.approx(new.current_q.ki, rel=1e-5)
    assert old.own["M1_D_KI_GAIN"] == pytest.approx(2.0 * float(new.own["M1_D_KI_GAIN"]), rel=1e-5)


def test_a_file_without_gains_is_refused_with_what_it_lacks() -> None:
    found = replace(_published(published.FLOAT_2025), current_d=None)
    with pytest.raises(InputError, match="gains of both axes"):
        profile(found)


def test_an_older_age_says_the_same_machine_and_loops(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path))
    newest = NXP.configure(asked)
    for version in ("2022", "2019"):
        older = configured(asked, EDITIONS[version])
        assert older.drive.psi_pm == pytest.approx(newest.drive.psi_pm, rel=1e-5)
        assert older.current_q is not None
        assert newest.current_q is not None
        assert older.current_q.ki == pytest.approx(newest.current_q.ki, rel=1e-5)
        assert older.speed is not None
        assert newest.speed is not None
        assert older.speed.ki == pytest.approx(newest.speed.ki, rel=1e-5)


def test_inputs_say_the_limits_unrounded(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path))
    found = NXP.configure(asked)
    assert found.drive.i_max == pytest.approx(asked.design.i_max, rel=1e-11)
    edited = {**found.own, "M1_SPEED_LOOP_HIGH_LIMIT": 5.0}
    assert McatFile("m", FLOAT_2025, edited).configuration().drive.i_max == 5.0


@pytest.mark.parametrize("version", ["2025", "2022"])
@pytest.mark.parametrize("slow", [False, True])
def test_every_input_is_that_of_its_rule(tmp_path: Path, version: str, *, slow: bool) -> None:
    asked = asked_for(design_of(tmp_path, inductance_q="300 uH"))
    drive, design = asked.drive, asked.design
    if slow:  # a slow loop of the speed, a tracking observer of its own, slow sampling
        asked = replace(
            asked,
            speed=PiGains(2.0, 3.0),
            pll=PiGains(90.0, 2500.0),
            drive=replace(drive, t_s=1e-3, t_speed=5e-3),
        )
        drive = asked.drive
    edition = EDITIONS[version]
    found = {
        name: value
        for name, value in own_values(asked, edition).items()
        if not name.startswith("M1_")
    }
    psi, r_s, l_d, l_q, turn = drive.psi_pm, 0.05, 1e-4, 1.5e-4, 2.0 * math.pi
    assert psi is not None
    assert asked.speed is not None
    assert drive.t_s is not None
    assert drive.t_speed is not None
    constant, i_max, inertia = 1.5 * 15 * psi, 40.0 * math.sqrt(2.0), 0.02
    current = math.sqrt(asked.current_q.ki / l_q)
    speed = math.sqrt(asked.speed.ki * constant / inertia)
    follows = asked.speed.kp * constant / inertia
    share = design.v_max * math.sqrt(3.0) / 48.0
    bemf = max(asked.current_q.kp / l_q, r_s / l_d)
    tracking = 50.0 if slow else min(max(8.0 * follows, 20.0 * turn), 0.25 * bemf)
    slope = 0.5 * constant * i_max / inertia * 60.0 / turn
    bases = design.control.bases
    expected = {
        "parametersPP": 15.0,
        "parametersRs": r_s,
        "parametersLd": l_d,
        "parametersLq": l_q,
        "parametersKe": constant,
        "parametersJ": inertia,
        "parametersIphNom": i_max,
        "parametersUphNom": 48.0 / math.sqrt(3.0),
        "parametersNnom": 2500.0,
        "parametersImax": bases.current,
        "parametersUdcbMax": max(math.sqrt(3.0) * bases.voltage, 72.0),
        "parametersUdcbTrip": 57.6,
        "parametersUdcbUnder": 31.2,
        "parametersUdcbOver": 62.4,
        "parametersNover": 2750.0,
        "parametersNmin": 125.0,
        "parametersNmax": max(2750.0, bases.speed * 60.0 / turn),
        "parametersEblock": 0.5 * 15 * psi * 125.0 * turn / 60.0,
        "parametersEblockPer": 2000.0,
        "parametersUdcbIIRf0": min(100.0, 0.05 / drive.t_s),
        "parametersCalibDuration": 0.2,
        "parametersFaultDuration": 2.0,
        "parametersFreewheelDuration": 1.5,
        "parametersScalarUqMin": 0.1 * r_s * i_max,
        "parametersScalarVHzRatio": 100.0,
        "parametersAlignVoltage": 0.3 * r_s * i_max,
        "parametersAlignDuration": min(0.4, 65535 * drive.t_s),
        "currentLoopSampleTime": drive.t_s,
        "currentLoopF0": current / turn,
        "currentLoopKsi": (asked.current_q.kp + r_s) / (2.0 * current * l_q),
        "currentLoopOutputLimit": 100.0 * min(0.9, share),
        "speedLoopSampleTime": drive.t_speed,
        "speedLoopIncUp": slope,
        "speedLoopIncDown": slope,
        "speedLoopCutOffFreq": min(max(100.0, 20.0 * follows / turn), 0.2 / drive.t_speed),
        "speedLoopUpperLimit": i_max,
        "speedLoopLowerLimit": -i_max,
        "speedLoopManualConstantTunning": 0.0 if version == "2025" else 1.0,
        "speedLoopSLKp": asked.speed.kp / 15,
        "speedLoopSLKi": asked.speed.ki / 15 * edition.speed_share * drive.t_speed,
        "speedLoopF0": speed / turn,
        "speedLoopKsi": asked.speed.kp * constant / (2.0 * speed * inertia),
        "sensorlessBemfObsrvF0": bemf / turn,
        "sensorlessBemfObsrvKsi": 1.0,
        "sensorlessTrackObsrvF0": tracking / turn,
        "sensorlessTrackObsrvKsi": 0.9 if slow else 1.0,
        "sensorlessTrackObsrvIIRSpeedCutOff": min(
            max(400.0, 5.0 * tracking / turn), 0.2 / drive.t_s
        ),
        "sensorlessStartupRamp": 0.5 * slope,
        "sensorlessStartupCurrent": 0.3 * i_max,
        "sensorlessMergingSpeed": 250.0,
        "sensorlessMergingCoeff": 100.0,
    }
    assert set(found) == set(expected)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-9), name


@pytest.mark.parametrize("fastest", [200.0, 261.8, 900.0])
def test_what_the_file_lacks_is_said_in_numbers(tmp_path: Path, fastest: float) -> None:
    """Voltage at 90 %, the speed at which the back-EMF meets it, volts between the axes."""
    asked = asked_for(design_of(tmp_path, inductance_q="300 uH"))
    asked = replace(asked, drive=replace(asked.drive, omega_m_max=fastest))
    falls = NXP.shortfalls(asked, NXP.configure(asked))
    words = [fall.words for fall in falls]
    price = {price.of: price.value for fall in falls for price in fall.prices}
    psi, i_max, l_q = asked.drive.psi_pm, 40.0 * math.sqrt(2.0), 1.5e-4
    assert psi is not None
    counted = asked.design.v_max
    limit = min(0.9 * 48.0 / math.sqrt(3.0), counted)
    if limit < 0.999 * counted:
        assert numbers_of(words, "M1_CLOOP_LIMIT") == pytest.approx([limit, counted], rel=1e-3)
        assert price["voltage"] == pytest.approx(1.0 - limit / counted, rel=1e-6)
    reached = limit / (15 * psi)
    assert ("speed" in price) == (reached < fastest)
    if reached < fastest:
        assert numbers_of(words, "no field weakening") == pytest.approx(
            [limit, reached, fastest], rel=1e-3
        )
        assert price["speed"] == pytest.approx(1.0 - reached / fastest, rel=1e-6)
    volts = fastest * 15 * l_q * i_max
    rate = min(x.ki / x.kp for x in (asked.current_d, asked.current_q))
    assert price["voltage between the axes"] == pytest.approx(volts, rel=1e-6)
    expected = [i_max, volts, rate]
    assert numbers_of(words, "not decoupled") == pytest.approx(expected, rel=1e-3)


def test_what_mcat_makes_of_the_d_axis_is_that_of_one_frequency(tmp_path: Path) -> None:
    """ki = w^2 L_d and kp = 2 ksi w L_d - R at F0 and ksi of the q axis."""
    asked = asked_for(design_of(tmp_path, inductance_q="300 uH"))
    falls = NXP.shortfalls(asked, NXP.configure(asked))
    q, d, l_d, l_q, r_s = asked.current_q, asked.current_d, 1e-4, 1.5e-4, 0.05
    made = {"M1_D_KP_GAIN": (q.kp + r_s) * l_d / l_q - r_s, "M1_D_KI_GAIN": q.ki * l_d / l_q}
    wished = {"M1_D_KP_GAIN": d.kp, "M1_D_KI_GAIN": d.ki}
    price = {price.of: price.value for fall in falls for price in fall.prices}
    for name, value in made.items():
        if abs(value / wished[name] - 1.0) > 1e-3:
            assert price[name] == pytest.approx(value / wished[name] - 1.0, rel=1e-3)
        else:
            assert name not in price
    assert "M1_D_KI_GAIN" in price


def test_gains_that_integers_coarsen_are_said_with_what_runs(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path, loop="q_formats: auto"))
    assert asked.speed is not None
    asked = replace(asked, speed=replace(asked.speed, ki=1.3e-4 * asked.speed.ki))
    held = NXP.configure(asked)
    falls = NXP.shortfalls(asked, held)
    price = {price.of: price.value for fall in falls for price in fall.prices}
    for name, wish, has in (
        ("d axis", asked.current_d, held.current_d),
        ("q axis", asked.current_q, held.current_q),
        ("speed loop", asked.speed, held.speed),
    ):
        assert has is not None
        assert wish is not None
        worst = max(abs(has.kp / wish.kp - 1.0), abs(has.ki / wish.ki - 1.0))
        assert (f"gain of the {name}" in price) == (worst > 1e-3)
        if worst > 1e-3:
            assert price[f"gain of the {name}"] == pytest.approx(worst, rel=1e-6)
            found = numbers_of((fall.words for fall in falls), f"gains of the {name}")
            assert found == pytest.approx([has.kp, has.ki, wish.kp, wish.ki], rel=1e-4)
    assert price["gain of the speed loop"] > 1e-3


def test_without_inertia_the_speed_is_reached_in_a_second(tmp_path: Path) -> None:
    """No rate of the speed loop is known then: 5 Hz stands for it."""
    asked = asked_for(design_of(tmp_path))
    asked = replace(asked, speed=None, drive=replace(asked.drive, inertia=None, t_speed=None))
    own = NXP.configure(asked).own
    assert own["speedLoopIncUp"] == pytest.approx(2500.0)
    assert own["speedLoopCutOffFreq"] == pytest.approx(100.0)
    assert asked.drive.t_s is not None
    assert own["speedLoopSampleTime"] == pytest.approx(10.0 * asked.drive.t_s)
    assert own["sensorlessTrackObsrvF0"] == pytest.approx(40.0)
    assert "parametersJ" not in own
