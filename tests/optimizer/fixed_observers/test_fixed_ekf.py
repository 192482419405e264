"""The Kalman filter in integers: one sample of it against the filter in double precision."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_observers.fixed_ekf import (
    LIMIT,
    METHOD,
    P_BITS,
    FixedEkf,
    _sound,
    design,
)
from dqforge.optimizer.fixed_observers.fixed_observer_fit import observer_reaches
from dqforge.optimizer.fixed_observers.kit import ONE, Scales, TrackedState
from dqforge.optimizer.observers.methods.ekf import (
    EkfGains,
    _ekf_predicted,
    ekf,
    ekf_gains,
    ekf_step,
)
from dqforge.optimizer.observers.parts import ObserverState
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers
from dqforge.optimizer.steps.step_arithmetic import EXACT

SALIENT = LinearMachine(
    pole_pairs=3, r_s=0.9, l_d=9e-3, l_q=21e-3, psi_pm=0.31, i_max=9.0, omega_m_max=300.0
)
SCALES = Scales(current=14.0, voltage=330.0, speed=1100.0, t_s=1.25e-4, machine=SALIENT)
FULL = np.array([SCALES.current, SCALES.current, SCALES.speed, 4.0])
ROWS, COLUMNS = np.triu_indices(4)
COUNT = 400


@cache
def gains() -> EkfGains:
    return ekf_gains(ekf(SALIENT, SCALES.t_s, 3e-4, 4e6, 2e-2, omega_max=900.0))


@cache
def fixed() -> FixedEkf:
    return design(gains(), SCALES)


def in_reals(state: TrackedState[CodeArray]) -> ObserverState:
    current = np.array(state.words[:2]) * (SCALES.current / ONE)
    size = FULL[ROWS] * FULL[COLUMNS] * 2.0**-P_BITS
    covariance = np.array(state.words[2:], dtype=np.float64) * size[:, None]
    angle, speed = state.theta * (2.0 * math.pi / 2**32), state.omega * (SCALES.speed / ONE)
    return ObserverState((), angle, speed, True, (*current, *covariance))


def in_volts(v: Pair[CodeArray]) -> Pair[FloatArray]:
    return Pair(*(part * (SCALES.voltage / ONE) for part in v))


def in_amperes(i: Pair[CodeArray]) -> Pair[FloatArray]:
    return Pair(*(part * (SCALES.current / ONE) for part in i))


def drawn(near: float) -> tuple[TrackedState[CodeArray], Pair[CodeArray]]:
    """States with any covariance of so many thousandths of full scale, and voltages."""
    generator = np.random.default_rng(7)
    own = generator.standard_normal((COUNT, 4, 4)) * np.array([4.0, 6.0, 20.0, 50.0])[:, None]
    full = (1e-3 * near) ** 2 * own @ np.swapaxes(own, 1, 2)
    upper = np.rint(full[:, ROWS, COLUMNS] * 2.0**P_BITS).astype(np.int64)
    parts = np.array([0.7, 0.7, 0.8, 0.6, 0.6])[:, None] * generator.uniform(-1.0, 1.0, (5, COUNT))
    i_d, i_q, omega, *v = np.rint(parts * ONE).astype(np.int64)
    theta = generator.integers(0, 2**32, COUNT)
    return TrackedState(theta, omega, (i_d, i_q, *upper.T)), Pair(*v)


def seen(state: TrackedState[CodeArray], v: Pair[CodeArray], away: float) -> Pair[CodeArray]:
    """Currents beside those that the filter in reals foretells, in codes."""
    current, _, theta = _ekf_predicted(gains(), in_reals(state), in_volts(v), EXACT)
    noise = away * np.random.default_rng(8).standard_normal((2, COUNT, 2)) @ [1.0, 1j]
    found = (current.d + 1j * current.q + noise[0]) * np.exp(1j * np.asarray(theta))
    codes = np.rint(found / SCALES.current * ONE)
    return Pair(codes.real.astype(np.int64), codes.imag.astype(np.int64))


@pytest.mark.parametrize(("near", "away", "within"), [(0.3, 0.1, 1.0), (1.0, 0.3, 15.0)])
def test_a_sample_is_that_of_the_filter_in_reals(near: float, away: float, within: float) -> None:
    """Angle, speed, currents, and every entry of the covariance beside its two variances."""
    state, v = drawn(near)
    i = seen(state, v, away)
    found = in_reals(METHOD.step(Integers(), fixed(), state, v, i))
    exact = ekf_step(gains(), in_reals(state), in_volts(v), in_amperes(i), EXACT)
    turn = np.exp(1j * found.theta_e) - np.exp(1j * exact.theta_e)
    assert np.max(np.abs(turn)) < within * 3e-7
    assert np.max(np.abs(found.omega_e - exact.omega_e)) < within * 2e-7 * SCALES.speed
    own, other = np.array(found.scalars), np.array(exact.scalars)
    assert np.max(np.abs(own - other)[:2]) < within * 1e-7 * SCALES.current
    size = np.sqrt(other[2:][ROWS == COLUMNS])
    assert np.max(np.abs(own - other)[2:] / (size[ROWS] * size[COLUMNS])) < within * 3e-5
    limited = np.abs(exact.omega_e) == gains().omega_max
    assert np.any(limited) == (near == 1.0)


def test_a_first_sample_and_one_without_a_covariance_begin_with_that_of_the_start() -> None:
    state, v = drawn(0.3)
    i = seen(state, v, 0.1)
    words = list(state.words)
    words[2 + 7] = np.full(COUNT, -(2**52))  # variance of the speed
    broken = replace(state, words=tuple(words))
    begun = METHOD.step(Integers(), fixed(), broken, v, i)
    for found, start in (
        (METHOD.begin(Integers(), fixed(), state, v, i), replace(in_reals(state), started=False)),
        (begun, replace(in_reals(state), theta_e=in_reals(begun).theta_e, started=False)),
    ):
        exact = ekf_step(gains(), start, in_volts(v), in_amperes(i), EXACT)
        scalars = in_reals(replace(found, words=tuple(np.broadcast_arrays(*found.words)))).scalars
        own, other = np.array(scalars), np.array(exact.scalars)
        size = np.sqrt(other[2:][ROWS == COLUMNS])
        assert np.max(np.abs(own - other)[2:] / (size[ROWS] * size[COLUMNS])) < 1e-9
        assert np.max(np.abs(own - other)[:2]) < 1e-7 * SCALES.current
        assert np.array_equal(found.omega, state.omega)
    _, _, foretold = _ekf_predicted(gains(), in_reals(state), in_volts(v), EXACT)
    assert np.max(np.abs(np.exp(1j * in_reals(begun).theta_e) - np.exp(1j * foretold))) < 1e-7


def test_a_covariance_is_sound_up_to_the_limits_of_each_entry() -> None:
    """Twice the square of full scale; for the speed that of its limit besides that of the start,
    for the angle ten radians squared.
    """
    own = gains()
    speed = (own.omega_max**2 + own.p_omega) / SCALES.speed**2
    most = np.array([2.0, 2.0, speed, 10.0 / 16.0]) * 2.0**P_BITS
    for n, m in zip(ROWS, COLUMNS, strict=True):
        high = most[n] if n == m else 2.0 * 2.0**P_BITS
        low = 0.0 if n == m else -high
        for end, inward in ((high, -1), (low, 1)):
            tried = int(end) + np.array([2, -2]) * inward
            p = [[np.full(2, 5 if a == b else 0) for a in range(4)] for b in range(4)]
            p[n][m] = p[m][n] = tried
            assert np.array_equal(_sound(Integers(), fixed(), p), [True, False])


def test_noise_that_its_words_do_not_hold_is_refused() -> None:
    own, square = gains(), SCALES.current**2
    least = 2.0**-28 * square
    assert design(replace(own, r=1.001 * least), SCALES).r == pytest.approx(2**26, rel=2e-3)
    with pytest.raises(NoSolutionError, match="the noise of the current is too small"):
        design(replace(own, r=0.999 * least), SCALES)
    assert design(replace(own, q_i=1.999 * square), SCALES).q_i <= LIMIT
    with pytest.raises(NoSolutionError, match="noise of a current is beyond its word"):
        design(replace(own, q_i=2.001 * square), SCALES)


def test_no_quantity_leaves_its_word() -> None:
    reaches = observer_reaches(METHOD, fixed(), 16)
    assert all(reach.fits for reach in reaches)
    assert max(reach.share for reach in reaches) > 0.5
