"""Many loops at once against one at a time, against python-control, and against plain scans."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.optimize import brentq

from dqforge.optimizer.loops.pi_methods import (
    DriveVariants,
    LoopBatch,
    PlantBatch,
    batch_margins,
    close_loops,
    current_plants,
    peak_sensitivities,
    speed_plants,
)
from dqforge.optimizer.loops.plants import current_loop, speed_loop
from dqforge.optimizer.sampled_systems import loop_margins

if TYPE_CHECKING:
    import control

FloatArray = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
T_S = 1e-4
COUNT = 40


def random_currents(seed: int = 1) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Resistance, inductance, kp and ki of stable loops with crossovers from
    0.03 to 0.4 rad per sample.
    """
    generator = np.random.default_rng(seed)
    r_s, inductance = generator.uniform(0.01, 2.0, COUNT), 10.0 ** generator.uniform(-4, -2, COUNT)
    kp = 10.0 ** generator.uniform(2.6, 3.6, COUNT) * inductance
    return r_s, inductance, kp, kp * 10.0 ** generator.uniform(1.0, 2.8, COUNT)


def random_speeds(
    seed: int, filter_time: float, ratio: int
) -> tuple[PlantBatch, DriveVariants, FloatArray, FloatArray]:
    generator = np.random.default_rng(seed)
    one = np.ones(COUNT)
    drive = DriveVariants(
        2.35 * generator.uniform(0.7, 1.3, COUNT),
        1.7e-3 * generator.uniform(0.7, 1.3, COUNT),
        10.0 ** generator.uniform(-4, -2, COUNT),
        one,
        one,
        0.0 * one,
    )
    kp = 10.0 ** generator.uniform(1.3, 2.2, COUNT) * drive.inertia
    plants = speed_plants(drive, 4e-5, T_S, (2.9, 4000.0), ratio, filter_time)
    return plants, drive, kp, kp * 10.0 ** generator.uniform(0.0, 1.2, COUNT)


def assert_like_single(batch: LoopBatch, singles: list[object]) -> None:
    found = batch_margins(batch)
    expected = [loop_margins(single) for single in singles]  # type: ignore[arg-type]
    for name in ("crossover", "phase_margin", "gain_margin", "delay_margin", "max_sensitivity"):
        one_by_one = np.array([getattr(margins, name) for margins in expected])
        np.testing.assert_allclose(getattr(found, name), one_by_one, rtol=1e-7, err_msg=name)


def test_current_loops_at_once_have_the_margins_of_each() -> None:
    r_s, inductance, kp, ki = (values[:12] for values in random_currents())
    batch = close_loops(current_plants(r_s, inductance, T_S, np.ones(12)), kp, ki)
    assert np.all(batch.radius < 1.0)
    singles = [current_loop(r_s[k], inductance[k], T_S, kp[k], ki[k]).open_loop for k in range(12)]
    assert_like_single(batch, list(singles))


@pytest.mark.parametrize("filter_time", [0.0, 1e-3])
def test_speed_loops_at_once_have_the_margins_of_each(filter_time: float) -> None:
    plants, drive, kp, ki = random_speeds(2, filter_time, 10)
    chosen = np.arange(8)
    batch = close_loops(plants.some(chosen), kp[:8], ki[:8])
    singles = [
        speed_loop(
            (drive.r_s[k], drive.l_q[k]),
            (drive.inertia[k], 4e-5),
            T_S,
            (2.9, 4000.0),
            10,
            (kp[k], ki[k]),
            filter_time,
        ).loop
        for k in chosen
    ]
    assert_like_single(batch, [single.open_loop for single in singles])
    poles = [abs(single.closed.poles[0]) for single in singles]
    np.testing.assert_allclose(batch.radius, poles, rtol=1e-9)


def reference_current_loop(
    r_s: float, inductance: float, kp: float, ki: float
) -> control.StateSpace:
    """PI, one sample of computation and the sampled winding, as python-control puts them
    together.
    """
    import control

    winding = control.c2d(
        control.ss([[-r_s / inductance]], [[1.0 / inductance]], [[1.0]], [[0.0]]), T_S
    )
    delay = control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], T_S)
    pi = control.ss([[1.0]], [[ki * T_S]], [[1.0]], [[kp + ki * T_S]], T_S)
    return control.series(pi, delay, winding)


def assert_like_control(batch: LoopBatch, loops: list[control.StateSpace]) -> None:
    import control

    found = batch_margins(batch)
    for row, loop in enumerate(loops):
        poles = np.linalg.eigvals(loop.A - loop.B @ loop.C / (1.0 + loop.D[0, 0]))
        expected = np.sort(np.abs(poles))[::-1]
        np.testing.assert_allclose(
            np.sort(np.abs(batch.closed_poles[row]))[::-1], expected, rtol=1e-6, atol=1e-8
        )
        gain, _, _, turn, crossing, _ = control.stability_margins(loop, method="poly")
        if np.isfinite(gain) and turn < np.pi / T_S * (1.0 - 1e-6):
            turn = polished(partial(imaginary, loop), turn)
            assert found.gain_margin[row] == pytest.approx(-1.0 / at(loop, turn).real, rel=1e-6)
        crossing = polished(partial(excess_gain, loop), crossing)
        assert found.crossover[row] == pytest.approx(crossing, rel=1e-6)
        assert found.phase_margin[row] == pytest.approx(np.angle(-at(loop, crossing)), rel=1e-6)
        scan = np.geomspace(crossing / 20.0, np.pi / T_S, 500)
        nearest = scan[np.argmin([abs(1.0 + at(loop, omega)) for omega in scan])]
        distance = min(
            abs(1.0 + at(loop, omega)) for omega in nearest * np.linspace(0.985, 1.015, 301)
        )
        assert found.max_sensitivity[row] == pytest.approx(1.0 / distance, rel=1e-6)


def at(loop: control.StateSpace, omega: float) -> complex:
    return complex(loop(np.exp(1j * omega * T_S)))


def imaginary(loop: control.StateSpace, omega: float) -> float:
    return at(loop, omega).imag


def excess_gain(loop: control.StateSpace, omega: float) -> float:
    return abs(at(loop, omega)) - 1.0


def polished(function: Callable[[float], float], omega: float) -> float:
    """Root of a function near what python-control finds from polynomials, whose digits it lacks."""
    return float(
        brentq(
            function, 0.999 * omega, min(1.001 * omega, np.pi / T_S), xtol=1e-14 * omega, rtol=1e-13
        )
    )


@pytest.mark.slow
def test_current_loops_of_random_drives_agree_with_python_control() -> None:
    r_s, inductance, kp, ki = random_currents(3)
    batch = close_loops(current_plants(r_s, inductance, T_S, np.ones(COUNT)), kp, ki)
    rows = zip(r_s, inductance, kp, ki, strict=True)
    assert_like_control(batch, [reference_current_loop(*row) for row in rows])


@pytest.mark.slow
def test_speed_loops_of_random_drives_agree_with_python_control() -> None:
    """Both controllers at one rate, with a wrong torque constant, dc link and
    feedforward of the back-EMF.
    """
    import control

    generator = np.random.default_rng(4)
    count, current_gains = 25, (2.9, 4000.0)
    drive = DriveVariants(
        2.35 * generator.uniform(0.7, 1.3, count),
        1.7e-3 * generator.uniform(0.7, 1.3, count),
        10.0 ** generator.uniform(-4, -3, count),
        generator.uniform(0.9, 1.1, count),
        generator.uniform(0.9, 1.1, count),
        generator.uniform(-5e-3, 5e-3, count),
    )
    kp = generator.uniform(500.0, 900.0, count) * drive.inertia
    ki = kp * generator.uniform(5.0, 50.0, count)
    loops = []
    for k in range(count):
        a = [
            [-drive.r_s[k] / drive.l_q[k], -drive.back_emf[k] / drive.l_q[k]],
            [drive.torque_factor[k] / drive.inertia[k], -4e-5 / drive.inertia[k]],
        ]
        plant = control.c2d(
            control.ss(a, [[drive.gain[k] / drive.l_q[k]], [0.0]], np.eye(2), np.zeros((2, 1))), T_S
        )
        delay = control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], T_S)
        pi = control.ss(
            [[1.0]],
            [[current_gains[1] * T_S]],
            [[1.0]],
            [[current_gains[0] + current_gains[1] * T_S]],
            T_S,
        )
        forward = control.series(pi, delay, plant)
        closed = control.ss(forward.A - forward.B @ forward.C[:1], forward.B, forward.C[1:], 0, T_S)
        outer = control.ss([[1.0]], [[ki[k] * T_S]], [[1.0]], [[kp[k] + ki[k] * T_S]], T_S)
        loops.append(control.series(outer, closed))
    assert_like_control(
        close_loops(speed_plants(drive, 4e-5, T_S, current_gains, 1), kp, ki), loops
    )


def test_largest_sensitivity_is_that_of_a_fine_scan() -> None:
    r_s, inductance, kp, ki = random_currents(5)
    batch = close_loops(current_plants(r_s, inductance, T_S, np.ones(COUNT)), kp, ki)
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 200_000))
    found = peak_sensitivities(batch)
    for k in range(0, COUNT, 5):
        phi = np.exp(-r_s[k] * T_S / inductance[k])
        loop = (kp[k] + ki[k] * T_S * z / (z - 1.0)) / z * (1.0 - phi) / r_s[k] / (z - phi)
        scanned = float(np.max(1.0 / np.abs(1.0 + loop)))
        assert scanned * (1.0 - 1e-12) <= found[k] <= scanned * (1.0 + 1e-6)


def test_unstable_loops_have_no_finite_sensitivity() -> None:
    one = np.ones(2)
    batch = close_loops(
        current_plants(0.1 * one, 1e-3 * one, T_S, one), np.array([1.0, 30.0]), 100.0
    )
    assert (batch.radius < 1.0).tolist() == [True, False]
    assert np.isfinite(peak_sensitivities(batch)).tolist() == [True, False]


def test_resistance_may_be_zero_or_negative() -> None:
    """R -> 0 is the integrator t_s/L; a negative one gives a growing mode exp(-R t_s/L)."""
    r_s = np.array([0.0, 1e-9, -0.5])
    plants = current_plants(r_s, np.full(3, 1e-3), T_S, np.ones(3))
    np.testing.assert_allclose(plants.a[:2, 0, 1], T_S / 1e-3, rtol=1e-9)
    assert plants.a[2, 0, 0] == pytest.approx(np.exp(0.05))
    assert plants.a[2, 0, 1] == pytest.approx((1.0 - np.exp(0.05)) / -0.5)
