"""Configuration of ST's MCSDK for a design, what it cannot hold, and the loops that it runs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from firmware_asked import numbers_of
from random_st_drives import base_design, random_asked, value

from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import OwnValue, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, drive_values, judge
from dqforge.optimizer.firmware.st_scales import joined, st_configuration
from dqforge.optimizer.firmware.targets.st import ST, locus_of

# A motor in a project of Workbench 6.1 (dronectl/g431-mcsdk): macros of its three headers.
PROJECT: dict[str, OwnValue] = {
    "POLE_PAIR_NUM": 2,
    "RS": 0.35,
    "LS": 0.0006,
    "MOTOR_VOLTAGE_CONSTANT": 4.0,
    "NOMINAL_CURRENT": 870,
    "IQMAX": 870,
    "RSHUNT": 0.003,
    "AMPLIFICATION_GAIN": 9.14,
    "NOMINAL_BUS_VOLTAGE_V": 24,
    "VBUS_PARTITIONING_FACTOR": 0.09625565501973242,
    "MAX_APPLICATION_SPEED_RPM": 4000,
    "PWM_FREQUENCY": 20000,
    "REGULATION_EXECUTION_RATE": 1,
    "F1": 16384,
    "F2": 1024,
    "GAIN1": -24217,
    "GAIN2": 26260,
    "PLL_KP_GAIN": 213,
    "PLL_KI_GAIN": 8,
    "PLL_KPDIV": 16384,
    "PLL_KIDIV": 65535,
    "STO_FIFO_DEPTH_UNIT": 64,
    "OBS_MINIMUM_SPEED_RPM": 1440,
    "PID_TORQUE_KP_DEFAULT": 2312,
    "PID_TORQUE_KI_DEFAULT": 2158,
    "PID_FLUX_KP_DEFAULT": 2312,
    "PID_FLUX_KI_DEFAULT": 2158,
    "TF_KPDIV": 128,
    "TF_KIDIV": 4096,
    "SPEED_LOOP_FREQUENCY_HZ": 1000,
    "PID_SPEED_KP_DEFAULT": 3144,
    "PID_SPEED_KI_DEFAULT": 141,
    "SP_KPDIV": 1024,
    "SP_KIDIV": 16384,
}


def asked(design: Design) -> Asked:
    gains = PiGains(1.0, 100.0)
    return Asked(design, drive_values(design), gains, gains, PiGains(0.1, 1.0))


def test_a_project_in_engineering_units() -> None:
    found = st_configuration("motor", PROJECT)
    drive = found.drive
    assert drive.i_max == pytest.approx(870 / 32768 * 60.1750)  # 1.65 V over 3 mOhm 9.14
    assert drive.psi_pm == pytest.approx(4.0 * math.sqrt(2 / 3) / (1000 * math.pi / 30) / 2)
    assert (drive.l_d, drive.l_q, drive.t_s, drive.t_speed) == (0.0006, 0.0006, 5e-5, 1e-3)
    assert found.contradictions == ()
    assert found.speed is not None
    # 3144/1024 counts per 0.1 Hz
    assert found.speed.kp == pytest.approx(3144 / 1024 * 60.175 / 32768 / (0.2 * math.pi), rel=1e-4)


def test_its_loops() -> None:
    found = st_configuration("motor", PROJECT)
    loops = ST.profile(found)
    assert loops.current.order == "d-first"
    assert ST.profile(replace(found, version="5")).current.order == "vector"
    assert (loops.current.q.rule, loops.current.delay) == ("integral-first", 1.0)
    assert loops.current.q.limit == pytest.approx(24.0 / math.sqrt(3.0))
    assert loops.speed is not None
    feedback = loops.speed.feedback
    assert (feedback.kind, feedback.averaged, feedback.whole) == ("pll", 64, True)
    # at 1440 of 4000 rpm the back-EMF has 0.3 of full scale
    assert feedback.kp == pytest.approx(
        213 / 16384 * 0.36 * 32767 / 1.2 * 2 * math.pi / 65536 * 20e3, rel=1e-12
    )
    assert loops.observer is not None
    assert loops.observer.rate is not None
    assert 1e4 < loops.observer.rate < 1e5
    assert loops.reference == "id-zero"
    judged = judge(loops, found.drive)
    assert judged.current_q is not None
    # Workbench says 6000 rad/s
    assert judged.current_q.crossover == pytest.approx(6003.3 * 1.1547, rel=0.03)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"PID_TORQUE_KI_DEFAULT": 4000}, "PID_TORQUE_KI_DEFAULT 4000 is not R/(L f)"),
        ({"TF_KIDIV": 4000}, "TF_KIDIV 4000 is no power of two"),
        ({"NOMINAL_CURRENT_A": 80.0}, "beyond the full scale of the current measurement, 60.18 A"),
        ({"GAIN2": 13000}, "GAIN2 13000 is not Workbench's 26248"),
        ({"LS": 3e-6, "RS": 0.0018}, "C5 of the observer is"),
    ],
)
def test_contradictions_are_named(change: dict[str, OwnValue], words: str) -> None:
    found = st_configuration("motor", PROJECT | change)
    assert any(words in sentence for sentence in found.contradictions), found.contradictions
    assert not any("\n" in sentence for sentence in found.contradictions)
    if "C5" in words:
        *_, whole, factor, _, wraps = numbers_of(found.contradictions, words)
        assert factor == PROJECT["F1"]
        assert abs(whole) > 32767
        assert -32768 <= wraps < 32768
        assert (whole - wraps) % 65536 == 0.0


def test_rounded_inputs_are_no_contradiction() -> None:
    """One count more or less, and a gain of the amplifier within its printed digits."""
    changes: tuple[dict[str, OwnValue], ...] = (
        {"PID_TORQUE_KI_DEFAULT": 2159},
        {"AMPLIFICATION_GAIN": 9.1356},
        {"GAIN2": 26248},
    )
    for change in changes:
        assert st_configuration("motor", PROJECT | change).contradictions == ()


def test_a_table_with_steps_is_named_and_ours_is_not() -> None:
    published: dict[str, OwnValue] = {
        "IQMAX": 23687,
        "SEGDIV": 2921,
        "ANGC": "{-1412,-2572,-4576,-5200,-5564,-10551,-12664,-15567}",
        "OFST": "{0,105,463,632,764,3012,4162,5997}",
    }
    (words,) = st_configuration("", published).contradictions
    assert "step by up to 25 counts" in words
    assert "off by 261 counts" in words
    # Of 1.65 V over 1 mOhm times 10 a count is 5 mA.
    scaled = published | {"RSHUNT": 0.001, "AMPLIFICATION_GAIN": 10.0}
    (words,) = [text for text in st_configuration("", scaled).contradictions if "ANGC" in text]
    assert numbers_of([words], "")[-1] == pytest.approx(261 * 165.0 / 32768, rel=6e-3)
    for wish in random_asked(3, 5, tables=3):
        found = ST.configure(wish)
        assert "ANGC" in found.own
        assert not any("ANGC" in sentence for sentence in found.contradictions)


def test_files_of_one_drive_count_together() -> None:
    names = list(PROJECT)
    parts = [st_configuration("", {name: PROJECT[name] for name in names[k::3]}) for k in range(3)]
    assert all(part.current_q is None for part in parts)
    whole = joined(parts)
    assert whole.own == PROJECT
    assert whole.current_q == st_configuration("motor", PROJECT).current_q


def test_gains_that_are_asked_for_come_back_within_their_integers() -> None:
    for wish in random_asked(60, 11):
        found = ST.configure(wish)
        for one, other in ((wish.current_d, found.current_d), (wish.current_q, found.current_q)):
            assert other is not None
            assert other.kp == pytest.approx(one.kp, rel=2e-3)
            assert other.ki == pytest.approx(one.ki, rel=3e-2)
        assert found.current_q is not None
        assert ST.profile(found).current.q.kp == found.current_q.kp
        assert all(abs(value(found, name)) <= 65536 for name in found.own if "GAIN" in name)
        assert not any("wraps" in words for words in found.contradictions)


def test_the_table_is_as_good_as_it_says() -> None:
    """Copper loss and currents of a table, worked out again at every count."""
    (wish,) = random_asked(1, 5, tables=1)
    found = ST.configure(wish)
    (table,) = [short for short in ST.shortfalls(wish, found) if "segments" in short.words]
    prices = {price.of: price.value for price in table.prices}
    slopes = [int(x) for x in str(found.own["ANGC"]).strip("{}").split(",")]
    offsets = [int(x) for x in str(found.own["OFST"]).strip("{}").split(",")]
    width = int(value(found, "SEGDIV"))
    full = 1.65 / (value(found, "RSHUNT") * value(found, "AMPLIFICATION_GAIN"))
    machine, locus = wish.design.machine, locus_of(wish)
    count = int(locus.i_q[-1] * 32768 / full)
    worst, loss = 0.0, 0.0
    for i_q in range(count + 1):
        part = min(i_q // width, 7)
        i_d = ((slopes[part] * i_q) >> 15) + offsets[part]
        best = np.interp(i_q * full / 32768, [0.0, *locus.i_q], [0.0, *locus.i_d])
        worst = max(worst, abs(i_d * full / 32768 - best))
        torque = machine.torque(np.array([i_d * full / 32768]), np.array([i_q * full / 32768]))[0]
        if i_q >= (count + 1) // 20 and torque <= locus.torque[-1]:
            least = np.interp(torque, locus.torque, locus.current)
            loss = max(loss, (i_d**2 + i_q**2) * (full / 32768) ** 2 / least**2 - 1.0)
    assert prices["d current"] == pytest.approx(worst, rel=2e-2)
    assert prices["copper loss"] == pytest.approx(loss, rel=5e-2, abs=1e-5)
    assert prices["d current"] * 32768 / full < 3.0
    counts, amperes, percent = numbers_of([table.words], "")
    assert counts == pytest.approx(worst * 32768 / full, rel=3e-2, abs=0.06)
    assert amperes == pytest.approx(worst, rel=2e-2, abs=6e-4)
    assert percent == pytest.approx(100.0 * prices["copper loss"], rel=1e-2)
    loops = ST.profile(found)
    assert loops.reference == "table"
    assert loops.table[-1][0] == pytest.approx(found.own["IQMAX_A"], rel=1e-3)
    assert all(
        first[0] < second[0] for first, second in zip(loops.table, loops.table[1:], strict=False)
    )


def test_what_is_missing_or_does_not_fit_is_told_with_its_key() -> None:
    base = base_design()
    silent = replace(base, inverter=replace(base.inverter, current_sensing=None))
    with pytest.raises(InputError, match=r"^inverter.current_sensing: .* write current_sensing"):
        ST.configure(asked(silent))
    small = CurrentSensing(1.0, 20.0, 3.3)
    with pytest.raises(InputError, match="below the current limit of"):
        ST.configure(asked(replace(base, inverter=replace(base.inverter, current_sensing=small))))
    uneven = replace(base, control=replace(base.control, t_s=0.7 / base.inverter.f_sw))
    with pytest.raises(InputError, match=r"^control.sampling_frequency: "):
        ST.configure(asked(uneven))
    huge = Asked(base, drive_values(base), PiGains(1e6, 1.0), PiGains(1e6, 1.0))
    with pytest.raises(InputError, match=r"^control.current_loop: a gain .* choose a slower loop"):
        ST.configure(huge)
    with pytest.raises(InputError, match="does not describe its current loops fully"):
        ST.profile(st_configuration("", {"POLE_PAIR_NUM": 2}))


def test_carriers_beyond_16_bits_are_scaled() -> None:
    base = base_design()
    fast = replace(
        base,
        inverter=replace(base.inverter, f_sw=100e3),
        control=replace(base.control, t_s=1e-5),
    )
    assert ST.configure(asked(fast)).own["PWM_FREQ_SCALING"] == 2


@pytest.mark.parametrize(("dead_time", "ns"), [(None, 0), (800e-9, 800)])
def test_a_dead_time_is_in_nanoseconds_and_none_is_nothing(
    dead_time: float | None, ns: int
) -> None:
    base = base_design()
    unknown: Any = dead_time
    design = replace(base, inverter=replace(base.inverter, dead_time=unknown))
    assert ST.configure(asked(design)).own["SW_DEADTIME_NS"] == ns


def test_shortfalls_have_prices_in_numbers() -> None:
    """Of each kind that occurs the numbers of the sentence are those of wish and configuration."""
    met = set()
    for wish in random_asked(20, 7):
        found = ST.configure(wish)
        for short in ST.shortfalls(wish, found):
            assert short.prices
            assert all(math.isfinite(price.value) for price in short.prices)
            assert "\n" not in short.words
            numbers, (price, *_) = numbers_of([short.words], ""), short.prices
            made, wanted = found.drive.t_speed, wish.drive.t_speed
            if "one inductance" in short.words:
                met.add("inductance")
                l_d, l_q = wish.drive.l_d, wish.drive.l_q
                assert l_d is not None
                assert l_q is not None
                assert numbers == pytest.approx([l_q, l_d], rel=1e-3)
                assert price.value == pytest.approx(l_q / l_d - 1.0)
            elif "in steps of" in short.words:
                met.add("steps")
                assert numbers == [0.1, 6.0]
                assert price.value == pytest.approx(0.2 * math.pi)
            elif "a part of its timer" in short.words:
                met.add("timer")
                assert made is not None
                assert wanted is not None
                assert numbers == pytest.approx([1.0 / made, 2000.0, 1.0 / wanted], rel=1e-4)
                assert price.value == pytest.approx(made - wanted)
            elif "as noisy" in short.words:
                met.add("noise")
                assert numbers[0] == value(found, "PLL_KP_GAIN")
                assert numbers[2] == pytest.approx(numbers[0] / numbers[1], rel=0.05)
                assert price.value == pytest.approx(numbers[0] / numbers[1] - 1.0)
                assert price.value > 0.01
            elif "rounded to integers" in short.words:
                met.add("rounding")
                assert price.value == pytest.approx(numbers[0] / numbers[1] - 1.0, abs=2e-3)
                assert abs(price.value) > 1e-3
    assert met == {"inductance", "steps", "timer", "noise", "rounding"}
