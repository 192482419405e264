"""moteus: what a design becomes, and the loops that run."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drives import IPM, RELUCTANCE
from firmware_asked import SCOOTER, TWO_PI, asked_of, numbers_of, random_asked, scooter
from firmware_loops import assert_current_loops_hold
from saturated import ArctanMachine

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, Shortfall, judge
from dqforge.optimizer.firmware.moteus_format import configuration, pwm_rate
from dqforge.optimizer.firmware.targets.moteus import MOTEUS, _inductance_slope, _inductances_words

configure, profile, shortfalls = MOTEUS.configure, MOTEUS.profile, MOTEUS.shortfalls


def test_the_scooter() -> None:
    held = configure(scooter())
    own = held.own
    assert own["motor.poles"] == 30
    assert own["motor.Kv"] == pytest.approx(60.0, rel=1e-6)
    assert own["servo.pid_dq_hz"] == 1000.0
    assert own["servo.pwm_rate_hz"] == 20000
    assert held.current_q is not None
    assert held.current_q.kp == pytest.approx(TWO_PI * 1000.0 * 1e-4)
    assert held.current_q.ki == pytest.approx(TWO_PI * 1000.0 * 0.05)
    assert held.drive.psi_pm == pytest.approx(SCOOTER.psi_pm, rel=1e-6)


def test_the_loops_of_the_scooter() -> None:
    asked = scooter()
    held = configure(asked)
    loops = profile(held)
    assert loops.current.d.t_s == pytest.approx(50e-6)
    assert loops.current.d.tracking * loops.current.d.t_s == pytest.approx(1.0)
    assert loops.current.order == "d-first"
    assert loops.current.voltage_share == pytest.approx(1.0 - 2.0 * 0.6e-6 * 2.0 * 20e3)
    judged = judge(loops, asked.drive)
    assert judged.current_q is not None
    # Pole cancelled, one period of delay and half a one of holding: 90 deg less 1.5 T w, and the
    # half period that the backward rule of the integral gives back.
    assert judged.current_q.phase_margin == pytest.approx(
        0.5 * math.pi - 1.5 * 50e-6 * TWO_PI * 1000.0, abs=0.05
    )
    assert judged.speed is not None
    assert judged.speed.stable
    assert loops.speed is not None
    assert loops.speed.feedback.kind == "pll"
    assert loops.speed.feedback.ki == pytest.approx(0.25 * loops.speed.feedback.kp**2)


def test_speed_gains_are_those_of_position_and_its_rate() -> None:
    """kd in N m per rev/s and kp in N m per revolution, by hand."""
    asked = scooter()
    assert asked.speed is not None
    own = configure(asked).own
    constant = 1.5 * 15 * SCOOTER.psi_pm
    assert own["servo.pid_position.kd"] == pytest.approx(asked.speed.kp * constant * TWO_PI)
    assert own["servo.pid_position.kp"] == pytest.approx(
        asked.speed.ki * constant * TWO_PI, rel=1e-6
    )


def test_the_lag_of_the_position_ends_where_the_current_does() -> None:
    """kp times it is the largest torque: the integral of the speed loop is clamped there."""
    held = configure(scooter())
    own, constant = held.own, 1.5 * 15 * SCOOTER.psi_pm
    lag = float(own["servo.max_position_slip"]) * float(own["servo.pid_position.kp"])
    assert lag == pytest.approx(constant * SCOOTER.i_max, rel=1e-5)
    loops = profile(held)
    assert loops.speed is not None
    assert loops.speed.pi.anti_windup == "clamp"
    free = {key: float(value) for key, value in own.items() if key != "servo.max_position_slip"}
    loose = profile(configuration("drive", free)).speed
    assert loose is not None
    assert loose.pi.anti_windup == "none"


def test_a_wish_for_the_filter_is_its_bandwidth() -> None:
    asked = replace(scooter(), pll=PiGains(800.0, 160000.0))
    loops = profile(configure(asked))
    assert loops.speed is not None
    assert loops.speed.feedback.kp == pytest.approx(800.0, rel=1e-3)


@pytest.mark.parametrize(
    ("wished", "rate", "period"),
    [(8e3, 15000, 1 / 15e3), (20001.0, 20000, 5e-5), (40e3, 40000, 5e-5), (1e5, 60000, 1 / 3e4)],
)
def test_rates_are_those_that_the_firmware_runs(wished: float, rate: int, period: float) -> None:
    asked = asked_of(SCOOTER, f_sw=wished)
    assert pwm_rate(wished) == rate
    held = configure(asked)
    assert held.drive.f_sw == rate
    assert held.drive.t_s == pytest.approx(period)
    words = " ".join(found.words for found in shortfalls(asked, held))
    assert ("switching frequency" in words) == (wished != 40e3 and abs(wished / rate - 1) > 1e-3)


def test_the_slope_of_the_d_inductance_is_that_of_the_chord() -> None:
    """Of a machine whose chord inductance is a straight line the slope is found."""
    slope, l_d = -2e-6, 1e-3

    class Straight(ArctanMachine):
        @property
        def l_d(self) -> float:
            return l_d

        def flux(self, i_d: Any, i_q: Any, lib: Any = np) -> tuple[Any, Any]:
            return self.psi_m + (l_d + slope * i_d) * i_d, 2e-3 * lib.asarray(i_q)

    held = configure(asked_of(Straight(), v_dc=500.0))
    assert held.own["motor.inductance_d_scale"] == pytest.approx(slope, rel=1e-6)
    assert "along -d a slope of -2 uH/A" in _inductances_words(held)


def test_a_machine_without_saturation_has_no_slope() -> None:
    assert configure(asked_of(IPM, v_dc=400.0)).own["motor.inductance_d_scale"] == 0.0


def test_saturation_is_fitted_and_its_error_told() -> None:
    machine = ArctanMachine()
    asked = asked_of(machine, v_dc=500.0)
    held = configure(asked)
    cutoff = float(held.own["motor.rotation_current_cutoff_A"])
    assert 0.0 <= cutoff < machine.i_max
    found = shortfalls(asked, held)
    assert any("a logarithm beyond" in entry.words for entry in found)
    prices = {price.of: price for entry in found for price in entry.prices}
    assert prices["phase margin (q) at i_max"].unit == "rad"
    assert prices["phase margin (q) at i_max"].value >= 0.5235
    assert prices["copper loss"].value > 0.0
    # Inductances at i_max in q by differences of the flux; the slope in uH/A.
    step, limit = 1e-3, machine.i_max
    d = [machine.flux(np.array([x]), np.array([limit]))[0][0] for x in (-step, step)]
    q = [machine.flux(np.zeros(1), np.array([limit + x]))[1][0] for x in (-step, step)]
    micro = [1e6 * float(pair[1] - pair[0]) / (2.0 * step) for pair in (d, q)]
    numbers = numbers_in(found, "one q inductance for all currents")
    own = [1e6 * machine.l_d, 1e6 * machine.l_q]
    assert numbers[:5] == pytest.approx([limit, *micro, *own], rel=2e-3)


@pytest.mark.parametrize("asked", list(random_asked(6, seed=3)))
def test_loops_of_any_machine_hold(asked: Asked) -> None:
    assert_current_loops_hold(MOTEUS, asked)


def test_machines_without_magnets_are_refused() -> None:
    with pytest.raises(InputError, match=r"machine\.magnet_flux: moteus"):
        configure(asked_of(RELUCTANCE))


def test_more_poles_than_a_byte_holds_are_refused() -> None:
    with pytest.raises(InputError, match=r"machine\.pole_pairs: moteus holds at most"):
        configure(asked_of(replace(SCOOTER, pole_pairs=128)))


def test_a_configuration_that_says_too_little_has_no_loops() -> None:
    with pytest.raises(InputError, match="one of them is missing"):
        profile(configuration("drive", {"motor.poles": 14}))


def test_older_firmware_states_its_gains() -> None:
    numbers = {"servo.pid_dq.kp": 0.1, "servo.pid_dq.ki": 50.0, "servo.pwm_rate_hz": 30000}
    held = configuration("drive", numbers)
    assert held.current_d == held.current_q == PiGains(0.1, 50.0)
    assert profile(held).current.q.ki == 50.0
    both = configuration("drive", {**numbers, "servo.pid_q.kp": 0.2})
    assert both.current_q == PiGains(0.2, 50.0)


def test_gains_edited_by_hand_are_told() -> None:
    held = configuration(
        "drive",
        {
            "servo.pid_dq.kp": 0.1,
            "servo.pid_dq.ki": 90.0,
            "motor.resistance_ohm": 0.05,
            "motor.inductance_d_H": 1e-4,
        },
    )
    assert any("servo.pid_dq.ki 90 is not R/L kp = 50" in words for words in held.contradictions)


def test_feedforward_of_the_resistance_is_told_with_its_overshoot() -> None:
    numbers = {**configure(scooter()).own, "servo.current_feedforward": 1.0}
    held = configuration("drive", {key: float(value) for key, value in numbers.items()})
    # a = 2 pi 1000 L/R = 12.6; the excess is a^(-(a + 1)/(a - 1)).
    assert any("overshoots by 5.1%" in words for words in held.conventions)


def test_a_bandwidth_above_that_of_the_tool_is_remarked_upon_and_is_no_contradiction() -> None:
    held = configure(scooter())
    assert held.contradictions == ()
    assert any("above 1/30 of the control's 20000 Hz" in words for words in held.conventions)


def test_the_slope_of_the_inductance_has_the_least_largest_error_up_to_i_max() -> None:
    """psi_d = psi_pm + L i + c i^3: of c i^2 the line through zero that is as far off at -I as
    between has the slope -2 (sqrt(2) - 1) c I.
    """
    size, bend, most = 1e-4, 2e-9, 40.0
    machine: Any = SimpleNamespace(
        psi_pm=0.01,
        l_d=size,
        known=lambda i_d, _: np.full(i_d.shape, fill_value=True),
        flux=lambda i_d, i_q: (0.01 + size * i_d + bend * i_d**3, size * i_q),
    )
    drive: Any = SimpleNamespace(i_max=most)
    slope = _inductance_slope(machine, drive)
    assert slope == pytest.approx(-2.0 * (math.sqrt(2.0) - 1.0) * bend * most, rel=2e-3)


def numbers_in(found: tuple[Shortfall, ...], words: str) -> list[float]:
    """The numbers of the sentence that has these words."""
    return numbers_of((entry.words for entry in found), words)


def test_what_no_d_current_costs_is_found_along_the_circle() -> None:
    """Torque at i_max and copper for the same torque, against scans of angle and size."""
    machine = replace(SCOOTER, l_q=4.1e-4)
    asked = asked_of(machine)
    found = shortfalls(asked, configure(asked))
    i_max = machine.i_max
    size, angle = np.linspace(0.5, 1.0, 1001)[:, None] * i_max, np.linspace(0.0, 1.2, 1201)
    most = np.max(machine.torque(-size * np.sin(angle), size * np.cos(angle)), axis=1)
    plain = 1.5 * 15 * machine.psi_pm * i_max
    least = 1.5 * 0.05 * float(np.interp(plain, most, size[:, 0])) ** 2
    loss, best = 1.5 * 0.05 * i_max**2, float(most[-1])
    less = 100.0 * (1.0 - plain / best)
    assert less > 1.0
    expected = [plain, i_max, best, less, plain, loss, least]
    assert numbers_in(found, "no d current below") == pytest.approx(expected, rel=5e-3)
    prices = {price.of: price.value for entry in found for price in entry.prices}
    assert prices["torque"] == pytest.approx(best - plain, rel=1e-2)
    assert prices["copper loss"] == pytest.approx(loss - least, rel=1e-2)
    operation = replace(asked.design.operation, strategy="id0")
    still = replace(asked, design=replace(asked.design, operation=operation))
    assert not any("no d current" in one.words for one in shortfalls(still, configure(still)))


def test_margins_and_gains_in_words_are_those_of_the_loops_that_run() -> None:
    """Too fast a wish for two inductances: four gains, two margins, two crossovers."""
    asked = asked_of(replace(SCOOTER, l_q=1.7e-4), crossover=TWO_PI * 6000.0)
    held = configure(asked)
    judged = judge(profile(held), asked.drive)
    found = shortfalls(asked, held)
    hertz = float(held.own["servo.pid_dq_hz"])
    assert hertz < 5900.0
    expected = [hertz]
    for inductance in (1e-4, 1.7e-4):
        expected += [TWO_PI * hertz * inductance, TWO_PI * hertz * 0.05]
        expected += [TWO_PI * 6000.0 * inductance, TWO_PI * 6000.0 * 0.05]
    loops = judged.current_d, judged.current_q
    for loop in loops:
        assert loop is not None
        expected += [math.degrees(loop.phase_margin), loop.crossover / TWO_PI]
    assert numbers_in(found, "is the only setting") == pytest.approx(expected, rel=2e-3)
    prices = [price.value for entry in found for price in entry.prices if "margin" in price.of]
    assert prices == [loop.phase_margin for loop in loops if loop is not None]
    same = asked_of(replace(SCOOTER, l_q=1.7e-4), crossover=TWO_PI * hertz)
    assert not any("is the only setting" in one.words for one in shortfalls(same, configure(same)))


@pytest.mark.parametrize(("which", "share"), [("kp", 1.002), ("kp", 0.998), ("ki", 1.002)])
def test_gains_a_thousandth_apart_are_told(which: str, share: float) -> None:
    asked = scooter()
    held = configure(asked)
    assert held.current_q is not None
    own = getattr(held.current_q, which)
    near, far = (
        replace(held.current_q, **{which: own * (1.0 + part * (share - 1.0))})
        for part in (0.4, 1.0)
    )
    told = [
        any("is the only" in one.words for one in shortfalls(replace(asked, current_q=wish), held))
        for wish in (near, far)
    ]
    assert told == [False, True]


@pytest.mark.parametrize("wished", [32e3, 40e3])
def test_every_rate_that_is_not_that_of_the_design_is_told(wished: float) -> None:
    """Above 30 kHz every second period has a control step: periods in us before and after."""
    asked = asked_of(SCOOTER, f_sw=wished, speed=PiGains(0.05, 0.3), ratio=6)
    drive = replace(asked.drive, f_sw=1.01 * wished, t_s=1.0 / wished, t_speed=6.0 / wished)
    asked = replace(asked, drive=drive)
    own = pwm_rate(1.01 * wished)
    found = numbers_in(shortfalls(asked, configure(asked)), "runs at its own rates")
    assert found == pytest.approx([1e6 / wished, 2e6 / own, 6e6 / wished, 2e6 / own], rel=1e-5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motor_position.sources.0.pll_filter_hz": 2003.0}, "the control's 20000 Hz"),
        ({"motor_position.sources.0.pll_filter_hz": 2001.0}, ""),
        ({"servo.voltage_mode_control": 1}, "currents become voltages"),
        ({"servo.pid_position.ki": 2.0, "servo.pid_position.ilimit": 3.0}, "ki 2 with ilimit 3"),
        ({"servo.pid_position.ki": 2.0, "servo.pid_position.ilimit": 0.0}, ""),
        ({"servo.pid_position.ki": 0.0, "servo.pid_position.ilimit": 3.0}, ""),
        ({"servo.pid_dq.kp": 0.5}, "pid_dq.kp 0.5 stands beside servo.pid_dq_hz 1000"),
    ],
)
def test_what_does_not_fit_together_is_told(changes: dict[str, float], words: str) -> None:
    numbers = {key: float(value) for key, value in configure(scooter()).own.items()}
    held = configuration("drive", numbers | changes)
    assert [words in text for text in held.contradictions] == [True] * bool(words)


@pytest.mark.parametrize(("ki", "told"), [(50.9, False), (49.1, False), (51.1, True), (48.9, True)])
def test_an_integral_two_percent_beside_resistance_and_inductance_is_told(
    ki: float, *, told: bool
) -> None:
    held = configuration(
        "drive",
        {
            "servo.pid_dq.kp": 0.1,
            "servo.pid_dq.ki": ki,
            "motor.resistance_ohm": 0.05,
            "motor.inductance_d_H": 1e-4,
        },
    )
    assert bool(held.contradictions) == told


@pytest.mark.parametrize(("hertz", "told"), [(667.0, False), (669.0, True)])
def test_a_bandwidth_up_to_a_thirtieth_of_the_control_is_not_remarked_upon(
    hertz: float, *, told: bool
) -> None:
    numbers = {key: float(value) for key, value in configure(scooter()).own.items()}
    held = configuration("drive", numbers | {"servo.pid_dq_hz": hertz})
    assert any("above 1/30" in words for words in held.conventions) == told
