"""Voltages shortened in integers, reciprocals, and the speed loop, against real arithmetic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.design import catalogue
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.fixed_control.shortening import inverse_root, longest, reciprocal, shortened
from dqforge.optimizer.fixed_control.transforms import (
    Pi,
    SpeedLoop,
    code_load_turn,
    speed_loop,
    speed_loop_gains,
)
from dqforge.optimizer.steps.code_vectors import AlphaBeta
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers

WIDTHS = (16, 32)


@dataclass(slots=True)
class Unclamped(Integers):
    """Arithmetic in which known limits must change nothing: the emitted C has none there."""

    def known(self, a: CodeArray, low: int, high: int) -> CodeArray:
        """The numbers, which lie within the limits."""
        assert np.all((a >= low) & (a <= high)), (low, high, np.min(a), np.max(a))
        return a


@pytest.mark.parametrize("width", WIDTHS)
def test_reciprocals_are_right_to_a_code(width: int) -> None:
    generator = np.random.default_rng(1)
    ends = 2 ** (width - 2), 2 ** (width - 1)
    m = np.arange(*ends) if width == 16 else generator.integers(*ends, 100_000)
    found = reciprocal(Unclamped(), width, m)
    assert np.max(np.abs(found - 2.0 ** (2 * width - 3) / m)) < 1.1
    s = generator.integers(2 ** (2 * width - 3), 2 ** (2 * width - 1), 100_000)
    s[:2] = 2 ** (2 * width - 3), 2 ** (2 * width - 1) - 1
    root = inverse_root(Unclamped(), width, s)
    assert np.max(np.abs(root - 2.0 ** (2 * width - 2) / np.sqrt(s.astype(float)))) < 2.5


@pytest.mark.parametrize("size", [0.01, 0.3, 1.0, 3.0, 30.0, 3000.0])
@pytest.mark.parametrize("width", WIDTHS)
def test_voltages_are_shortened_along_their_direction(width: int, size: float) -> None:
    """Within three codes of the exact vector and two across it, however long it was."""
    generator, count, top = np.random.default_rng(2), 40_000, 2 ** (width - 1) - 1
    asked = np.rint(generator.uniform(-1.0, 1.0, (2, count)) * size * top).astype(np.int64)
    limit = np.rint(generator.uniform(0.05, 1.0, count) * longest(width)).astype(np.int64)
    found = shortened(Integers(), width, asked[0], asked[1], limit)
    length = np.maximum(np.hypot(*asked.astype(float)), 1.0)
    share = np.minimum(1.0, limit / length)
    gaps = found.x - share * asked[0], found.y - share * asked[1]
    assert np.max(np.hypot(*gaps)) < 3.0
    assert np.max(np.abs(gaps[0] * (asked[1] / length) - gaps[1] * (asked[0] / length))) < 2.0
    inside = length <= limit
    assert np.array_equal(found.x[inside], asked[0][inside])
    assert np.array_equal(found.y[inside], asked[1][inside])
    assert max(np.max(np.abs(found.x)), np.max(np.abs(found.y))) <= top


def test_the_load_angle_is_that_of_power_and_reactive_power() -> None:
    generator, top = np.random.default_rng(3), 32_767
    angle, lag = generator.uniform(-np.pi, np.pi, (2, 20_000))
    v, i = generator.uniform(0.2, 0.9, (2, 20_000)) * top

    def vector(length: NDArray[np.float64], at: NDArray[np.float64]) -> AlphaBeta[CodeArray]:
        parts = length * np.cos(at), length * np.sin(at)
        return AlphaBeta(*(np.rint(part).astype(np.int64) for part in parts))

    turn = code_load_turn(Integers(), 16, vector(v, angle), vector(i, angle - lag))
    found = np.arctan2(turn.y.astype(float), turn.x.astype(float))
    folded = np.where(np.cos(lag) < 0.0, lag - np.pi, lag)
    folded = (folded + np.pi) % (2.0 * np.pi) - np.pi
    expected = np.clip(folded, -np.pi / 6.0, np.pi / 6.0)
    clear = np.abs(np.cos(lag)) > 1e-3  # beyond it, rounding says whether power flows in or out
    assert np.max(np.abs(found - expected)[clear]) < 1e-3
    assert np.max(np.abs(found)) < np.pi / 6.0 + 1e-4


@pytest.mark.parametrize(("length", "known"), [(100, False), (200, True), (400, True)])
def test_little_power_has_no_load_angle(length: int, known: bool) -> None:
    """Below 2^15, half of full scale, the product of both vectors says nothing."""
    lag = np.array([0.3])
    v = AlphaBeta(np.array([length]), np.array([0]))
    i = AlphaBeta(*(np.rint(length * part(-lag)).astype(np.int64) for part in (np.cos, np.sin)))
    turn = code_load_turn(Integers(), 16, v, i)
    found = np.arctan2(turn.y.astype(float), turn.x.astype(float))
    assert found == pytest.approx(lag if known else 0.0, abs=5e-3)


def thesis(width: int) -> FixedControlFit:
    design = catalogue.load("paper001-pmsm-bench")
    gains = solve_gains(design)
    loops = (gains.i_d, gains.i_q, gains.speed)
    return fit_control(design, loops, gains.observer, width, torque_max=2.0)


@pytest.mark.parametrize("width", WIDTHS)
def test_speed_loop_follows_a_real_one(width: int) -> None:
    """Filter, ratio, limit and back-calculation over 600 samples of noise on steps."""
    control = thesis(width).control
    assert control.speed is not None
    pi, top, o = control.speed["parallel"], float(control.top), Integers()
    generator = np.random.default_rng(4)
    zero, gains = np.zeros(20, dtype=np.int64), speed_loop_gains(control)
    state = SpeedLoop(Pi(zero), zero, zero, zero, zero)
    share = control.speed_filter.realised / 2.0 ** (width - 2)
    kp, ki, back = (
        gain.realised / 2.0**bits
        for gain, bits in ((pi.kp, 0), (pi.ki, pi.fraction), (pi.tracking, pi.fraction))
    )
    speed, integral, torque = np.zeros(20), np.zeros(20), np.zeros(20)
    limited = 0
    for k in range(600):
        step = 0.2 * top * ((k // 150) % 2)
        noise = generator.uniform(-0.01, 0.01, (2, 20)) * top
        omega, wanted = np.rint(noise + np.array([[0.0], [step]])).astype(np.int64)
        given = speed_loop(o, width, gains, state, omega, wanted)
        assert np.array_equal(given, state.torque)
        found = state.omega_m
        speed = speed + share * (omega - speed)
        if k % control.ratio == 0:
            error = wanted - found  # of the integers, so that roundings do not add up
            present = integral + ki * error
            asked = kp * error + present
            torque = np.clip(asked, -control.torque_max, control.torque_max)
            integral = present + back * (torque - asked)
            limited += int(np.sum(torque != asked))
        assert np.max(np.abs(found - speed)) < 1.0
        assert np.max(np.abs(state.torque - torque)) < 1e-3 * top
    assert 0 < limited < 600 * 20
    assert np.max(np.abs(state.torque)) <= control.torque_max


def test_dead_bands_have_units() -> None:
    fit = thesis(16)
    ampere, _, speed, _ = fit.control.one_code
    assert fit.physical_band("i_q") == fit.dead_bands["i_q"].largest * ampere
    assert fit.physical_band("speed") == fit.dead_bands["speed"].largest * speed
    assert fit.filter_band >= speed
    assert fit.observer_band is not None
    assert fit.observer_band >= speed
