"""Loops of a firmware against the same recursion run step by step, and against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    PiController,
    PiRule,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import _rate, judge, least_damping
from dqforge.optimizer.loops.loop_gains import analyse_current_loop

# 48 V, 60 rpm/V (line to line, peak), 100 mOhm and 200 uH line to line, 15 pole pairs, 40 A rms.
PAIRS, R, L = 15, 0.05, 1e-4
PSI = 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * PAIRS * 60.0)
INERTIA = 2e-3
SCOOTER = DriveValues(PAIRS, R, L, L, PSI, INERTIA, 0.0, 40.0 * math.sqrt(2.0))
T_C, T_N = 50e-6, 1e-3
CURRENT = CurrentLoops(
    PiController(2e3 * math.pi * L, 2e3 * math.pi * R, T_C),
    PiController(2e3 * math.pi * L, 2e3 * math.pi * R, T_C),
    back_emf=True,
)


def profile(feedback: SpeedEstimate, omega: float = 194.0, **changes: Any) -> LoopProfile:
    """The scooter's loops with a speed loop that crosses over near ``omega`` rad/s."""
    constant = 1.5 * PAIRS * PSI
    kp = omega * INERTIA / constant
    speed = SpeedController(PiController(kp, kp * omega / 8.0, T_N), feedback)
    return LoopProfile("vesc", "test", replace(CURRENT, **changes), speed)


class Pi:
    """A PI as its rule reads, sample by sample."""

    def __init__(self, pi: PiController) -> None:
        self.pi, self.integral, self.before, self.measured = pi, 0.0, 0.0, 0.0

    def step(self, reference: float, measured: float) -> float:
        share = self.pi.t_s / (self.pi.t_s + self.pi.filter_time)
        self.measured += share * (measured - self.measured)
        error, step = reference - self.measured, self.pi.ki * self.pi.t_s
        if self.pi.rule == "integral-first":
            self.integral += step * error
            return self.pi.kp * error + self.integral
        if self.pi.rule == "integral-last":
            output = self.pi.kp * error + self.integral
            self.integral += step * error
            return output
        self.integral += 0.5 * step * (error + self.before)
        self.before = error
        return self.pi.kp * error + self.integral


class Speed:
    """The estimate of the speed, sample by sample, of the mechanical angle."""

    def __init__(self, feedback: SpeedEstimate) -> None:
        self.own, self.angle, self.value = feedback, 0.0, 0.0
        self.past = [0.0] * (feedback.samples + 1)
        self.shown, self.shown_before = 0.0, [0.0] * feedback.averaged

    def step(self, angle: float, omega: float) -> float:
        own = self.own
        if own.kind == "ideal":
            self.value = omega
        elif own.kind == "pll":
            error = angle - self.angle
            self.value += own.ki * error * own.t_s
            self.angle += (self.value + own.kp * error) * own.t_s
            made = self.value + own.kp * error if own.whole else self.value
            self.shown += own.t_s / (own.t_s + own.filter_time) * (made - self.shown)
        else:
            self.past = [angle, *self.past[:-1]]
            if own.kind == "difference":
                self.value = (angle - self.past[-1]) / (own.samples * own.t_s)
            else:
                change = (angle - self.past[1]) / own.t_s
                self.value += own.t_s / (own.t_s + own.filter_time) * (change - self.value)
        shown = self.shown if own.kind == "pll" else self.value
        self.shown_before = [shown, *self.shown_before[:-1]]
        return sum(self.shown_before) / own.averaged


def free_response(made: LoopProfile, steps: int) -> np.ndarray:
    """Speed in rad/s at every sample of the speed controller after a kick, references zero."""
    assert made.speed is not None
    constant = PAIRS * PSI
    coupling = 0.0 if made.current.back_emf else constant
    flow = np.zeros((4, 4))
    flow[0] = [-R / L, -coupling / L, 0.0, 1.0 / L]
    flow[1, 0], flow[2, 1] = 1.5 * constant / INERTIA, 1.0
    delay, t_c = made.current.delay, made.current.q.t_s
    whole = int(delay)
    early, late = expm(flow * (delay - whole) * t_c), expm(flow * (1.0 - delay + whole) * t_c)
    ratio, every = round(made.speed.pi.t_s / t_c), round(made.speed.feedback.t_s / t_c)
    measured = 0.0
    inner, outer, estimate = Pi(made.current.q), Pi(made.speed.pi), Speed(made.speed.feedback)
    x, waiting, found, wanted = np.array([1.0, 1.0, 0.0]), [0.0] * (whole + 1), [], 0.0
    for k in range(steps * ratio):
        if k % every == 0:
            measured = estimate.step(x[2], x[1])
        if k % ratio == 0:
            wanted = outer.step(0.0, measured)
            found.append(x[1])
        waiting = [inner.step(wanted, x[0]), *waiting]
        x = (early @ np.append(x, waiting[whole + 1]))[:3]
        x = (late @ np.append(x, waiting[whole]))[:3]
    return np.array(found)


def slowest(samples: np.ndarray) -> complex:
    """The pole of the two slowest that a long response shows last."""
    tail = samples[-40:] / np.max(np.abs(samples[-40:]))
    matrix = np.column_stack([tail[1:-1], tail[:-2]])
    a, b = np.linalg.lstsq(matrix, tail[2:], rcond=None)[0]
    roots = np.roots([1.0, -a, -b])
    return complex(roots[np.argmax(np.abs(roots))])


STRUCTURES = {
    "pll": profile(SpeedEstimate("pll", T_C, 2000.0, 1e6)),
    "slow pll": profile(SpeedEstimate("pll", T_C, 2000.0, 30000.0)),
    "pll at the speed's rate": profile(SpeedEstimate("pll", T_N, 900.0, 90000.0), 60.0),
    "ideal": profile(SpeedEstimate("ideal", T_C)),
    "averaged": profile(SpeedEstimate("ideal", 2.0 * T_C, averaged=34)),
    "averaged a little": profile(SpeedEstimate("difference", T_C, samples=2, averaged=7)),
    "averaged over whole periods": profile(SpeedEstimate("ideal", 2.0 * T_C, averaged=20)),
    "whole pll": profile(SpeedEstimate("pll", T_C, 2000.0, 30000.0, whole=True)),
    "everything": profile(
        SpeedEstimate("pll", 4.0 * T_C, 900.0, 2e5, filter_time=1e-3, averaged=6, whole=True)
    ),
    "difference": profile(SpeedEstimate("difference", 5.0 * T_C, samples=7)),
    "low-pass": profile(SpeedEstimate("low-pass", T_C, filter_time=2e-3), delay=0.0),
    "half a period": profile(SpeedEstimate("low-pass", T_N, filter_time=1e-3), delay=0.5),
    "one and a half": profile(SpeedEstimate("ideal", T_C), 300.0, delay=1.5, back_emf=False),
    "filtered current": profile(
        SpeedEstimate("ideal", T_C),
        400.0,
        q=replace(CURRENT.q, filter_time=3e-4, kp=0.1, rule="trapezoid"),
    ),
}


# One of each estimate of the speed, and a filter of the current.
QUICK = ("slow pll", "averaged a little", "everything", "low-pass", "filtered current")


@pytest.mark.thinned
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in STRUCTURES],
)
def test_the_slowest_pole_is_that_of_the_recursion_itself(name: str) -> None:
    made = STRUCTURES[name]
    judged = judge(made, SCOOTER).speed
    assert judged is not None
    radius = abs(judged.poles[0])
    steps = int(np.clip(np.log(1e-9) / np.log(radius), 120, 900)) if radius < 1.0 else 900
    pole = slowest(free_response(made, steps))
    assert abs(abs(pole) - radius) < 2e-4
    assert judged.stable == (radius < 1.0)


@pytest.mark.parametrize("name", ["pll", "half a period", "one and a half", "difference"])
def test_the_gain_margin_is_where_the_recursion_begins_to_grow(name: str) -> None:
    made = STRUCTURES[name]
    judged = judge(made, SCOOTER).speed
    assert judged is not None
    speed = made.speed
    assert speed is not None

    def grows(factor: float) -> bool:
        louder = replace(speed.pi, kp=speed.pi.kp * factor, ki=speed.pi.ki * factor)
        samples = np.abs(free_response(replace(made, speed=replace(speed, pi=louder)), 400))
        return bool(np.max(samples[-40:]) > np.max(samples[-200:-160]))

    assert not grows(0.97 * judged.gain_margin)
    assert grows(1.03 * judged.gain_margin)


@pytest.mark.parametrize("rule", ["integral-first", "trapezoid", "integral-last"])
def test_each_rule_has_the_poles_of_its_own_recursion(rule: PiRule) -> None:
    pi = replace(CURRENT.q, rule=rule, ki=40.0 * CURRENT.q.ki)
    judged = judge(replace(STRUCTURES["ideal"], current=replace(CURRENT, q=pi)), SCOOTER).current_q
    assert judged is not None
    decay = math.exp(-R / L * T_C)
    gain, step = (1.0 - decay) / R, pi.ki * T_C
    share = {"integral-first": 1.0, "trapezoid": 0.5, "integral-last": 0.0}[rule]
    # z (z - phi)(z - 1) + g (kp (z - 1) + ki T (share z + 1 - share))
    polynomial = np.array([1.0, -1.0 - decay, decay, 0.0])
    polynomial[2:] += gain * np.array([pi.kp + share * step, (1.0 - share) * step - pi.kp])
    expected = np.sort(np.abs(np.roots(polynomial)))
    assert np.sort(np.abs(judged.poles)) == pytest.approx(expected, abs=1e-9)


def test_the_neutral_structure_has_the_margins_of_the_neutral_loop() -> None:
    judged = judge(STRUCTURES["ideal"], SCOOTER).current_d
    neutral = analyse_current_loop(R, L, T_C, CURRENT.d.kp, CURRENT.d.ki)
    assert judged is not None
    assert judged.phase_margin == pytest.approx(neutral.phase_margin, rel=1e-9)
    assert judged.crossover == pytest.approx(neutral.crossover, rel=1e-9)
    assert judged.max_sensitivity == pytest.approx(neutral.max_sensitivity, rel=1e-9)


def test_bandwidth_and_damping_are_those_of_a_first_order_loop_without_delay() -> None:
    # Deadbeat up to a factor: kp of an integrating plant without delay makes one pole at 1 - c.
    pi = PiController(0.2 * L / T_C, 1e-9, T_C)
    made = replace(STRUCTURES["ideal"], current=replace(CURRENT, q=pi, delay=0.0))
    judged = judge(made, replace(SCOOTER, r_s=1e-9)).current_q
    assert judged is not None
    # |c/(z - 1 + c)|^2 = 1/2: cos(w T) = (c^2 + 2 - 2 c - 2 c^2 + ...)/...
    c = 0.2
    cosine = (1.0 + (1.0 - c) ** 2 - 2.0 * c**2) / (2.0 * (1.0 - c))
    assert judged.bandwidth == pytest.approx(math.acos(cosine) / T_C, rel=1e-6)
    assert judged.damping == 1.0
    assert least_damping(np.exp(np.array([-0.3 + 0.4j, -0.3 - 0.4j, -5.0 + 0.0j]))) == (
        pytest.approx(0.6)
    )


def test_the_default_pll_of_vesc_makes_a_fast_speed_loop_unstable() -> None:
    ideal = judge(STRUCTURES["ideal"], SCOOTER).speed
    slow, right = judge(STRUCTURES["slow pll"], SCOOTER), judge(STRUCTURES["pll"], SCOOTER)
    assert ideal is not None
    assert slow.speed is not None
    assert right.speed is not None
    assert math.degrees(ideal.phase_margin) == pytest.approx(76.0, abs=0.5)
    assert not slow.speed.stable
    assert slow.pll_poles is not None
    assert slow.pll_poles[0].real == pytest.approx(-15.1, abs=0.05)
    assert any("has a pole at 15.1 rad/s, below" in text for text in slow.remarks)
    assert any("speed loop is unstable as vesc runs it" in text for text in slow.remarks)
    assert right.speed.stable
    assert math.degrees(right.speed.phase_margin) > 50.0
    assert right.remarks == ()


def test_what_a_profile_or_a_machine_does_not_say_is_said() -> None:
    nothing = judge(STRUCTURES["pll"], replace(SCOOTER, inertia=None, r_s=None))
    assert nothing.current_q is None
    assert nothing.speed is None
    assert nothing.remarks == (
        "no current loop is evaluated: resistance or inductance is not known",
        "the speed loop is not evaluated: resistance, inertia not known",
    )
    observed = replace(STRUCTURES["pll"], observer=FluxObserver("its observer"))
    assert "own lag is not in the margins" in judge(observed, SCOOTER).remarks[0]


def test_rates_are_said_in_both_units() -> None:
    assert _rate(20.0 * math.pi) == "62.83 rad/s (10 Hz)"
