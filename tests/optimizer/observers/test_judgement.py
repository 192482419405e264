"""The judgement of an observer: each cause at each load solved alone, and put together by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM
from scipy.linalg import solve_discrete_lyapunov

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.scenario import Plants
from dqforge.optimizer.observers.judgement import (
    ANGLE_LIMIT,
    SPEED_LIMIT,
    judge,
    judge_at,
    judge_loads,
)
from dqforge.optimizer.observers.methods.registry import method_named
from dqforge.optimizer.observers.parts import (
    Disturbances,
    Load,
    ObserverTuning,
    SteadyObserver,
    steady_observer,
)

T_S, OMEGA_MAX = 1e-4, 2500.0
METHOD = method_named("extended-emf")
GAINS = METHOD.design(IPM, ObserverTuning(600.0, 200.0, 1.0), T_S, OMEGA_MAX)
LOADS = (
    Load(-60.0, 80.0, 350e-6, 592e-6, 0.1049),
    Load(-20.0, -150.0, 340e-6, 560e-6, 0.101),
)
DISTURBANCES = Disturbances(
    1.4,
    0.7,
    100.0,
    4000.0,
    r_s=(-0.3, 0.2),
    l_d=0.1,
    l_q=(-0.02, 0.08),
    psi_pm=0.05,
    lost=2.0,
    lost_least=-0.5,
    loads=LOADS,
)
OMEGA = np.array([150.0, 500.0, 2000.0])
NAMES = ("r_s", "l_d", "l_q", "psi_pm")


def solved(
    load: Load, factor: dict[str, float], lost: float = 0.0, acceleration: float = 0.0
) -> SteadyObserver:
    true = {"r_s": IPM.r_s, "l_d": load.l_d, "l_q": load.l_q, "psi_pm": load.psi_pm}
    ones = np.ones(OMEGA.size)
    plant = Plants(*(true[name] * factor.get(name, 1.0) * ones for name in NAMES))
    current = np.full(OMEGA.size, complex(load.i_d, load.i_q))
    return steady_observer(METHOD, GAINS, T_S, plant, current, OMEGA, acceleration, lost)


def worse(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.where(np.abs(one) >= np.abs(other), one, other)


def by_hand(load: Load) -> tuple[dict[str, FloatArray], dict[str, FloatArray], SteadyObserver]:
    exact = solved(load, {})
    sides = {
        name: [solved(load, {name: 1.0 + error}) for error in DISTURBANCES.limits(name)]
        for name in NAMES
    }
    sides["dead_time"] = [solved(load, {}, lost) for lost in (2.0, -0.5)]
    angle, speed = {"exact_data": exact.theta_error}, {"exact_data": exact.omega_error}
    for name, (low, high) in sides.items():
        angle[name] = worse(
            high.theta_error - exact.theta_error, low.theta_error - exact.theta_error
        )
        speed[name] = worse(
            high.omega_error - exact.omega_error, low.omega_error - exact.omega_error
        )
    return angle, speed, exact


def test_errors_at_a_load_are_those_of_each_cause_alone() -> None:
    judged, lag = judge_loads(METHOD, GAINS, T_S, IPM, DISTURBANCES, OMEGA)
    for load, found in zip(LOADS, judged, strict=True):
        angle, speed, exact = by_hand(load)
        assert set(found.bias) == set(found.speed_bias) == set(angle)
        for name, expected in angle.items():
            np.testing.assert_allclose(found.bias[name], expected, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(found.speed_bias[name], speed[name], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.noise, exact.angle_noise(1.4, 0.7), rtol=1e-6)
        steady = np.sqrt(found.noise**2 + sum(part**2 for part in angle.values()))
        np.testing.assert_allclose(found.steady, steady, rtol=1e-6)
        slip = np.sqrt(sum(part**2 for part in speed.values()))
        np.testing.assert_allclose(found.speed_total, slip, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.poles, exact.poles)
    ramp = solved(LOADS[0], {}, acceleration=4000.0).theta_error - solved(LOADS[0], {}).theta_error
    np.testing.assert_allclose(lag, ramp, rtol=1e-6)


def test_the_worst_load_counts_at_each_speed() -> None:
    judged, lag = judge_loads(METHOD, GAINS, T_S, IPM, DISTURBANCES, OMEGA)
    found = judge_at(METHOD, GAINS, T_S, IPM, DISTURBANCES, OMEGA)
    steady = np.array([part.steady for part in judged])
    np.testing.assert_array_equal(found.load, np.argmax(steady, axis=0))
    np.testing.assert_array_equal(found.steady, np.max(steady, axis=0))
    slips = np.array([part.speed_total for part in judged])
    np.testing.assert_array_equal(found.speed_total, np.max(slips, axis=0))
    np.testing.assert_allclose(found.total, np.hypot(found.steady, lag))
    for place, load in enumerate(found.load):
        assert found.noise[place] == judged[load].noise[place]
        assert found.bias["r_s"][place] == judged[load].bias["r_s"][place]
        slip = int(np.argmax(slips[:, place]))
        assert found.speed_bias["r_s"][place] == judged[slip].speed_bias["r_s"][place]
        np.testing.assert_array_equal(found.poles[place], judged[load].poles[place])
    assert found.radius == pytest.approx(np.max(np.abs(found.poles), axis=1))


def test_the_range_is_the_longest_run_of_speeds_within_both_limits() -> None:
    fewer = replace(DISTURBANCES, l_q=0.02, psi_pm=0.01, lost=0.5, acceleration=1500.0)
    found = judge(METHOD, GAINS, T_S, IPM, fewer, OMEGA_MAX)
    assert found.omega[0] == pytest.approx(2.5)
    assert found.omega[-1] == pytest.approx(0.8 / T_S)
    assert OMEGA_MAX in found.omega
    for values, low, high in (
        (found.total, found.omega_low, found.omega_high),
        (found.steady, found.steady_low, found.steady_high),
    ):
        holds = (values <= ANGLE_LIMIT) & (found.speed_total <= SPEED_LIMIT * found.omega)
        runs, start = [], None
        for place, good in enumerate([*holds, False]):
            if good and start is None:
                start = place
            if not good and start is not None:
                runs.append((start, place - 1))
                start = None
        first, last = max(runs, key=lambda run: run[1] - run[0])
        assert (low, high) == (found.omega[first], found.omega[last])
    nothing = replace(DISTURBANCES, i_noise=1e4)
    assert np.isnan(judge_at(METHOD, GAINS, T_S, IPM, nothing, OMEGA).omega_low)


def test_the_angle_under_noise_is_that_of_the_lyapunov_equation() -> None:
    found = solved(LOADS[0], {})
    noise = found.angle_noise(1.4, 0.7)
    for place in range(OMEGA.size):
        drive = 1.96 * found.by_current[place] @ found.by_current[place].T
        drive += 0.49 * found.by_voltage[place] @ found.by_voltage[place].T
        covariance = solve_discrete_lyapunov(found.jacobian[place], drive)
        assert noise[place] == pytest.approx(np.sqrt(covariance[-2, -2]), rel=1e-9)
    faster = replace(found, jacobian=1.2 * found.jacobian / np.abs(found.poles[:, :1, None]))
    assert np.isinf(faster.angle_noise(1.4, 0.7)).all()
