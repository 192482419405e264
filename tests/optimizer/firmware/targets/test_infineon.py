"""Infineon's motor-ctrl-lib: its own rules, the table of flux linkages, and the loops."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from firmware_asked import SCOOTER, asked_of, numbers_of, random_asked, scooter
from saturated import ArctanMachine

from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import judge
from dqforge.optimizer.firmware.infineon_format import (
    TABLE,
    as_printed,
    configuration,
    flux_table,
    shortfalls,
)
from dqforge.optimizer.firmware.targets.infineon import configure, profile

# The motor of the library's own defaults, as numbers.
DEFAULTS: dict[str, Any] = {
    "params.motor.P": 14,
    "params.motor.lq": 28e-6,
    "params.motor.ld": 23e-6,
    "params.motor.lam": 1.9e-3,
    "params.motor.r": 11e-3,
    "params.motor.i_peak": 100.0,
    "params.motor.w_max.elec": 12600.0 * 1.5 * math.pi / 30.0 * 7.0,
    "params.sys.samp.fs0": 100e3,
    "params.sys.samp.fpwm_fs0_ratio": 2,
    "params.sys.vdc_nom": 32.0,
    "params.mech.inertia": 6.25e-4,
    "params.mech.viscous": 1.4e-3,
    "params.ctrl.curr.bw": 2.0 * math.pi * 1500.0,
    "params.ctrl.curr.ff_coef": 1.0,
    "params.ctrl.speed.bw": 2.0 * math.pi * 10.0,
    "params.obs.pll.w0": 2.0 * math.pi * 500.0,
    "params.filt.spd_ar_en": "En",
    "params.filt.spd_ar_wp[0]": 2.0 * math.pi * 10.0,
    "params.filt.spd_ar_wp[1]": 2.0 * math.pi * 10e3,
    "params.filt.spd_ar_wz[0]": 2.0 * math.pi * 3e3,
    "params.filt.spd_ar_wz[1]": 2.0 * math.pi * 10e3,
}


def test_the_librarys_own_gains() -> None:
    found = configuration("defaults", DEFAULTS)
    bandwidth = 2.0 * math.pi * 1500.0
    assert found.current_q == PiGains(bandwidth * 28e-6, bandwidth * 11e-3)
    assert found.current_d == PiGains(bandwidth * 23e-6, bandwidth * 11e-3)
    # Per electrical rad/s: (8/3)/(P^2 lam) J bw; an error of 1 rad/s mechanical is P/2 of them.
    per_electrical = (8.0 / 3.0) / (14.0**2 * 1.9e-3) * 2.0 * math.pi * 10.0
    assert found.speed is not None
    assert found.speed.kp == pytest.approx(7.0 * per_electrical * 6.25e-4, rel=1e-12)
    assert found.speed.ki == pytest.approx(7.0 * per_electrical * 1.4e-3, rel=1e-12)
    # So that the open loop crosses over at bw: torque constant times kp is J bw.
    assert found.speed.kp * 1.5 * 7.0 * 1.9e-3 == pytest.approx(6.25e-4 * 2.0 * math.pi * 10.0)
    assert found.drive.f_sw == 200e3


def test_the_filter_on_the_speed_of_the_defaults_is_named() -> None:
    """Its pole at 10 Hz lies at the bandwidth of the speed loop: 45 deg less."""
    found = configuration("defaults", DEFAULTS)
    words = " ".join(found.contradictions)
    assert "spd_ar_en" in words
    assert "takes 45 deg" in words
    loops = profile(found)
    assert loops.speed is not None
    lag = 1.0 / (2.0 * math.pi * 10.0) - 1.0 / (2.0 * math.pi * 3e3)
    assert loops.speed.pi.filter_time == pytest.approx(lag)
    judged = judge(loops, found.drive)
    without = judge(
        profile(configuration("defaults", DEFAULTS | {"params.filt.spd_ar_en": "Dis"})), found.drive
    )
    assert judged.speed is not None
    assert without.speed is not None
    assert math.degrees(without.speed.phase_margin - judged.speed.phase_margin) > 35.0


def test_gains_are_held_as_asked() -> None:
    for asked in random_asked(60):
        found = configure(asked)
        assert found.current_d is not None
        assert found.current_q is not None
        pairs = [(found.current_d, asked.current_d), (found.current_q, asked.current_q)]
        if asked.speed is None:
            assert found.speed is None
        else:
            assert found.speed is not None
            pairs.append((found.speed, asked.speed))
        for has, wanted in pairs:
            assert has.kp == pytest.approx(wanted.kp, rel=1e-6)
            assert has.ki == pytest.approx(wanted.ki, rel=1e-6)
        numbers = [value for value in found.own.values() if isinstance(value, float)]
        assert numbers == [as_printed(value) for value in numbers]


def test_the_loops_are_those_of_the_library() -> None:
    found = configure(scooter())
    loops = profile(found)
    current = loops.current
    assert (current.order, current.cross, current.back_emf) == ("axes", True, True)
    assert current.q.anti_windup == "back-calculation"
    assert current.q.tracking == pytest.approx(20e3)
    assert current.q.filter_time == 0.0
    assert loops.speed is not None
    assert loops.speed.pi.t_s == pytest.approx(1.0 / 20e3)
    assert loops.speed.feedback.whole
    rate = 2.0 * math.pi * 500.0
    assert loops.speed.feedback.kp == pytest.approx(rate, rel=1e-5)
    assert loops.speed.feedback.ki == pytest.approx(0.5 * rate * rate, rel=1e-5)
    judged = judge(loops, scooter().drive)
    assert judged.speed is not None
    assert judged.speed.stable
    assert math.degrees(judged.speed.phase_margin) > 55.0


def test_another_loop_for_the_speed_is_held() -> None:
    asked = replace(scooter(), pll=PiGains(1200.0, 3.6e5))
    loops = profile(configure(asked))
    assert loops.speed is not None
    assert loops.speed.feedback.kp == pytest.approx(1200.0, rel=1e-6)
    assert loops.speed.feedback.ki == pytest.approx(3.6e5, rel=1e-6)


def test_the_shunt_is_written_where_it_is_known() -> None:
    asked = scooter()
    assert "params.sys.analog.shunt.res" not in configure(asked).own
    sensing = CurrentSensing(shunt=0.5e-3, gain=20.0, reference=3.3)
    inverter = replace(asked.design.inverter, current_sensing=sensing)
    known = replace(asked, design=replace(asked.design, inverter=inverter))
    assert configure(known).own["params.sys.analog.shunt.res"] == 0.5e-3


def test_filters_of_the_currents_are_part_of_the_loops() -> None:
    slow = configuration("x", DEFAULTS | {"params.sys.analog.filt.w0_i_ph": 50e3})
    assert profile(slow).current.q.filter_time == pytest.approx(1.0 / 50e3 - 1.0 / 100e3)
    fast = configuration("x", DEFAULTS | {"params.sys.analog.filt.w0_i_ph": 250e3})
    assert any("unstable" in words for words in fast.contradictions)


def test_the_table_is_the_flux_of_the_machine() -> None:
    """Against most torque per ampere by brute force: every point, and the lines between them."""
    machine = ArctanMachine(inertia=0.01)
    asked = asked_of(machine, v_dc=300.0)
    table = flux_table(asked.design)
    assert table.flux.shape == (128,)
    assert table.flux[0] == pytest.approx(machine.psi_pm, rel=1e-6)
    amplitude = np.linspace(1.0, 120.0, 400)[:, np.newaxis]
    angle = np.linspace(-0.5 * np.pi, 0.0, 4001)
    i_d, i_q = amplitude * np.sin(angle), amplitude * np.cos(angle)
    torque = machine.torque(i_d, i_q)
    best = np.argmax(torque, axis=1)
    rows = np.arange(400)
    flux = np.hypot(*machine.flux(i_d[rows, best], i_q[rows, best]))
    at = np.interp(torque[rows, best], np.linspace(0.0, table.most, 128), table.flux)
    assert table.most == pytest.approx(float(torque[-1, best[-1]]), rel=1e-6)
    # The optimum is flat in torque, so the angle of the brute force is coarse: 0.4 mrad.
    np.testing.assert_allclose(at, flux, rtol=5e-4)
    assert 0.0 < table.error < 3e-5 * float(table.flux[-1])


def test_lines_shifted_by_half_err_by_half() -> None:
    asked = asked_of(SCOOTER)
    table = flux_table(asked.design)
    torque = np.linspace(0.0, table.most, 127 * 64 + 1)
    i_q = torque / (1.5 * 15 * SCOOTER.psi_pm)
    exact = np.hypot(SCOOTER.psi_pm, SCOOTER.l_q * i_q)
    grid = np.linspace(0.0, table.most, 128)
    on_points = np.hypot(SCOOTER.psi_pm, SCOOTER.l_q * grid / (1.5 * 15 * SCOOTER.psi_pm))
    ours = np.max(np.abs(np.interp(torque, grid, table.flux) - exact)[64:])
    plain = np.max(np.abs(np.interp(torque, grid, on_points) - exact)[64:])
    assert ours < 0.7 * plain
    assert ours <= table.error * 1.1


def test_what_the_library_does_not_hold_has_a_price() -> None:
    asked = asked_of(ArctanMachine(inertia=0.01), v_dc=300.0, speed=PiGains(1.0, 5.0), f_sw=20e3)
    found = shortfalls(asked, configure(asked))
    prices = {price.of: price.value for entry in found for price in entry.prices}
    assert 1e-3 < prices["torque"] < 0.5
    assert prices["copper loss"] > prices["torque"]
    assert prices["integral gain of the speed by the library's own rule"] == -1.0
    assert prices["period of the speed controller"] == pytest.approx(-0.95e-3, rel=1e-3)
    assert prices["flux linkage"] > 0.0
    assert prices["flux linkage of the library's own table"] > 100.0 * prices["flux linkage"]
    words = " ".join(entry.words for entry in found)
    assert "mtpa_lut" in words


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"psi_pm": 0.0}, "machine.magnet_flux"),
        ({"inertia": None}, "machine.inertia"),
        ({"l_q": None}, "machine.inductance_q"),
        ({"v_dc": None}, "inverter.v_dc"),
        ({"r_s": 1e35}, "machine.resistance"),
    ],
)
def test_designs_that_say_too_little_are_refused_by_key(change: dict[str, Any], key: str) -> None:
    asked = scooter()
    with pytest.raises(InputError) as refused:
        configure(replace(asked, drive=replace(asked.drive, **change)))
    assert str(refused.value).startswith(key)


def test_magnitudes_that_are_none_are_not_computed_with() -> None:
    own = DEFAULTS | {"params.sys.samp.fs0": -1.0, "params.motor.lam": 0.0}
    found = configuration("x", own)
    assert (found.drive.t_s, found.drive.psi_pm, found.speed) == (None, None, None)
    asked = replace(scooter(), current_q=PiGains(0.5, 0.0))
    assert any("bw r" in entry.words for entry in shortfalls(asked, configure(asked)))


def test_parameters_without_currents_have_no_loops() -> None:
    own = {name: value for name, value in DEFAULTS.items() if "curr" not in name}
    with pytest.raises(InputError, match=r"ctrl\.curr\.bw"):
        profile(configuration("x", own))


def test_contradictions_name_both_numbers() -> None:
    own = DEFAULTS | {
        "params.motor.P": 13,
        "params.motor.v_nom": 32.0,
        "params.mech.viscous": 0.0,
        "params.ctrl.curr.kp.q": 0.5,
    }
    words = " ".join(configuration("x", own).contradictions)
    for part in ("P 13", "v_nom 32 V", "edited by hand", "w_max"):
        assert part in words
    integral = configuration("x", DEFAULTS | {"params.mech.viscous": 0.0}).contradictions
    assert any("integral gain of the speed controller is 0" in text for text in integral)
    assert TABLE not in own


@pytest.mark.parametrize("ratio", [1, 2])
@pytest.mark.parametrize("fastest", [None, 60.0, 900.0])
@pytest.mark.parametrize("pll", [None, PiGains(500.0, 1.1e5)])
def test_every_parameter_is_that_of_its_rule(
    ratio: int, fastest: float | None, pll: PiGains | None
) -> None:
    machine = replace(SCOOTER, l_q=1.7e-4, omega_m_max=fastest)
    asked = asked_of(machine, speed=PiGains(0.7, 9.0))
    t_s = ratio / 20e3
    asked = replace(asked, pll=pll, drive=replace(asked.drive, t_s=t_s))
    own = {name.removeprefix("params."): value for name, value in configure(asked).own.items()}
    v_max, i_max, psi, r_s = 48.0 / math.sqrt(3.0), machine.i_max, machine.psi_pm, 0.05
    free = v_max / psi
    most = free if fastest is None else 15 * fastest
    rated, rate = min(most, free), 20e3 / ratio
    bandwidth = asked.current_q.kp / 1.7e-4
    tracked = min(2.0 * math.pi * 500.0, 0.2 / t_s)
    kp, ki = (tracked, 0.5 * tracked**2) if pll is None else (pll.kp, pll.ki)
    expected = {
        "motor.r": r_s,
        "ctrl.align.voltage": 0.5 * r_s * i_max,
        "motor.lq": 1.7e-4,
        "motor.ld": 1e-4,
        "motor.lam": psi,
        "motor.i_peak": i_max,
        "motor.i_cont": i_max,
        "motor.id_max": i_max,
        "sys.cmd.i_max": i_max,
        "sys.rate_lim.i_cmd": i_max * rate,
        "ctrl.curr.i_cmd_thresh": 0.2 * i_max,
        "ctrl.curr.i_cmd_hyst": 0.02 * i_max,
        "ctrl.six_pulse_inj.i_peak": 0.5 * i_max,
        "ctrl.high_freq_inj.i_qd_r_peak.d": 0.2 * i_max,
        "motor.w_nom.elec": rated,
        "motor.w_max.elec": most,
        "sys.cmd.w_max.mech": most / 15,
        "sys.rate_lim.w_cmd.elec": most,
        "obs.pll.w_max.elec": 1.5 * most,
        "obs.w_thresh.elec": 0.1 * rated,
        "obs.w_hyst.elec": 0.01 * rated,
        "ctrl.volt.w_thresh.elec": 0.01 * rated,
        "ctrl.volt.w_hyst.elec": 0.001 * rated,
        "ctrl.curr.bw": bandwidth,
        "ctrl.curr.ff_coef": 1.0,
        "ctrl.flux_weaken.bw": 0.2 * bandwidth,
        "motor.v_nom": v_max,
        "sys.vdc_nom": 48.0,
        "sys.samp.fs0": rate,
        "sys.analog.filt.w0_i_ph": rate,
        "sys.analog.filt.w0_v_ph": rate,
        "motor.P": 30,
        "sys.samp.fpwm_fs0_ratio": ratio,
        "mech.friction": 0.0,
        "mech.inertia": 0.02,
        "ctrl.curr.kp.q": asked.current_q.kp,
        "ctrl.curr.kp.d": asked.current_d.kp,
        "ctrl.curr.ki.q": asked.current_q.ki,
        "ctrl.curr.ki.d": asked.current_d.ki,
        "obs.pll.w0": kp,
        "obs.pll.kp": kp / psi,
        "obs.pll.ki": ki / psi,
        "ctrl.speed.bw": 0.7 * 1.5 * 15 * psi / 0.02,
        "ctrl.speed.kp": 0.7 / 15,
        "ctrl.speed.ki": 9.0 / 15,
    }
    for name, value in expected.items():
        assert own[name] == pytest.approx(value, rel=1e-6), name


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"params.motor.v_nom": 1.009 * 32.0 / math.sqrt(3.0)}, ""),
        ({"params.motor.v_nom": 1.011 * 32.0 / math.sqrt(3.0)}, "v_nom"),
        ({"params.motor.w_nom.elec": 1.009 * DEFAULTS["params.motor.w_max.elec"]}, ""),
        ({"params.motor.w_nom.elec": 1.011 * DEFAULTS["params.motor.w_max.elec"]}, "w_nom"),
        ({"params.ctrl.curr.kp.q": 1.009 * 2.0 * math.pi * 1500.0 * 28e-6}, ""),
        ({"params.ctrl.curr.kp.q": 1.011 * 2.0 * math.pi * 1500.0 * 28e-6}, "edited by hand"),
        ({"params.motor.P": 15}, "motor.P 15"),
    ],
)
def test_what_just_holds_is_no_contradiction(changed: dict[str, float], words: str) -> None:
    plain = set(configuration("x", DEFAULTS).contradictions)
    more = configuration("x", DEFAULTS | changed).contradictions
    told = [text for text in more if text not in plain]
    assert bool(told) == bool(words)
    assert not words or any(words in text for text in told)


def test_numbers_of_what_does_not_fit_are_those_of_physics() -> None:
    """Voltage of the magnets, phases and filter, each worked out by hand."""
    most, v_max = DEFAULTS["params.motor.w_max.elec"], 32.0 / math.sqrt(3.0)
    found = configuration(
        "x",
        DEFAULTS
        | {
            "params.motor.v_nom": 20.0,
            "params.motor.w_nom.elec": 15000.0,
            "params.ctrl.curr.kp.q": 0.5,
            "params.sys.analog.filt.w0_i_ph": 150e3,
        },
    ).contradictions
    expected = [most, 1.9e-3, most * 1.9e-3, 32.0, v_max, v_max / 1.9e-3]
    assert numbers_of(found, "without field weakening") == pytest.approx(expected, rel=1e-3)
    assert numbers_of(found, "v_nom 20 V")[:1] == [20.0]
    assert numbers_of(found, "v_nom 20 V")[-1] == pytest.approx(v_max, rel=1e-3)
    assert numbers_of(found, "w_nom") == pytest.approx([15000.0, most], rel=1e-3)
    by_hand = [0.5, 0.5 / 28e-6, 2.0 * math.pi * 1500.0]
    assert numbers_of(found, "edited by hand") == pytest.approx(by_hand, rel=1e-3)
    assert numbers_of(found, "overshooting") == pytest.approx([150e3, 100e3, 1.5])
    lag = 1.0 / (20.0 * math.pi) - 1.0 / (6e3 * math.pi)
    degrees = round(math.degrees(math.atan(20.0 * math.pi * lag)))
    expected = [1.0 / lag, 20.0 * math.pi, degrees]
    assert numbers_of(found, "spd_ar_en") == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"params.sys.analog.filt.w0_i_ph": 100.9e3}, ""),
        ({"params.sys.analog.filt.w0_i_ph": 101.1e3}, "overshooting"),
        ({"params.sys.analog.filt.w0_i_ph": 199e3}, "overshooting"),
        ({"params.sys.analog.filt.w0_i_ph": 200e3}, "unstable"),
        ({"params.filt.spd_ar_wp[0]": 5.05 * 20.0 * math.pi}, ""),
        ({"params.filt.spd_ar_wp[0]": 4.8 * 20.0 * math.pi}, "takes 12 deg"),
    ],
)
def test_filters_are_told_from_their_limits_on(changed: dict[str, float], words: str) -> None:
    """A filter of the currents above fs0, and from twice fs0; one of the speed below 5 bw."""
    quick = {"params.filt.spd_ar_wz[0]": 1e9, "params.filt.spd_ar_wp[0]": 1e9}
    told = configuration("x", DEFAULTS | quick | changed).contradictions
    told = tuple(text for text in told if "w0_i_ph" in text or "spd_ar" in text)
    assert len(told) == bool(words)
    assert not words or words in told[0]


@pytest.mark.parametrize("viscous", [0.0, 2e-3])
def test_the_librarys_own_gains_are_priced_beside_those_asked_for(viscous: float) -> None:
    """bw r for the currents; bw B over the torque constant for the speed, which then sinks by
    1/kp per ampere.
    """
    machine = replace(SCOOTER, friction=viscous)
    asked = asked_of(machine, speed=PiGains(0.7, 9.0))
    asked = replace(asked, current_q=replace(asked.current_q, ki=2.0 * asked.current_q.ki))
    found = shortfalls(asked, configure(asked))
    prices = {price.of: price.value for entry in found for price in entry.prices}
    words = [entry.words for entry in found]
    assert prices["q integral gain of the library's own rule"] == pytest.approx(-0.5, rel=1e-6)
    ki = asked.current_q.ki
    assert numbers_of(words, "bw r") == pytest.approx([0.5 * ki, ki], rel=1e-3)
    bandwidth = 0.7 * 1.5 * 15 * machine.psi_pm / 0.02
    own = bandwidth * viscous / (1.5 * 15 * machine.psi_pm)
    price = prices["integral gain of the speed by the library's own rule"]
    assert price == pytest.approx(own / 9.0 - 1.0, rel=1e-6)
    expected = [own, 9.0, 1.0 / 0.7]
    assert numbers_of(words, "the speed sinks by") == pytest.approx(expected, rel=5e-3)


def test_what_the_table_misses_is_said_as_shares_of_the_largest_flux() -> None:
    asked = asked_of(ArctanMachine(inertia=0.01), v_dc=300.0)
    table = flux_table(asked.design)
    found = numbers_of(
        (entry.words for entry in shortfalls(asked, configure(asked))), "joined by lines"
    )
    shares = [100.0 * part / table.flux[-1] for part in (table.error, table.of_constants)]
    assert found == pytest.approx([table.flux.size, table.error, *shares], rel=0.05)
