"""The observer with its correction: outside the loop, mirrored, silent where it knows nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from learned_drives import learned_observer

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import LEARNED_OBSERVERS, ObserverMethodName
from dqforge.machines.plants.scenario import DriveMotion, drive_motion, plants
from dqforge.optimizer.learned_correction.correction_frame import outside
from dqforge.optimizer.observers.methods import flux
from dqforge.optimizer.observers.parts import observe, steady_observer
from dqforge.optimizer.steps.step_arithmetic import EXACT

# Training a network takes some seconds: the rules by default, both in the campaign.
EVERY = pytest.mark.parametrize(
    "method",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name == "neural"))
        for name in LEARNED_OBSERVERS
    ],
)
WARM = {"r_s": 0.3, "psi_pm": -0.04}


def _motion(
    method: ObserverMethodName, shares: FloatArray, errors: dict[str, float]
) -> DriveMotion:
    observer = learned_observer(method)
    omega = np.broadcast_to(shares * observer.omega_max, (3000, len(shares)))
    current = np.full(len(shares), -0.5 + 3.0j)
    return drive_motion(observer.machine, observer.t_s, omega, current, errors)


@pytest.mark.slow
@EVERY
def test_the_loop_does_not_feel_the_correction(method: ObserverMethodName) -> None:
    """Speed, flux and the angle before the correction are those of the flux observer."""
    observer, motion = learned_observer(method), _motion(method, np.array([0.1, 0.3, -0.3]), WARM)
    bare = observe(flux.METHOD, observer.gains.flux, motion)
    whole = observe(observer.method, observer.gains, motion)
    np.testing.assert_allclose(whole.omega_e, bare.omega_e, atol=1e-6)
    added = EXACT.wrap(whole.theta_e - bare.theta_e)
    assert np.all(np.abs(added[-1]) > 1e-3)
    assert np.max(np.abs(added)) <= observer.gains.frame.limit
    assert np.max(np.abs(np.diff(added, axis=0))) < 0.01  # a filter stands before it


@EVERY
def test_the_simulated_angle_is_the_judged_one_with_its_correction(
    method: ObserverMethodName,
) -> None:
    observer, shares = learned_observer(method), np.array([0.1, 0.2, 0.5])
    motion = _motion(method, shares, WARM)
    end = motion.i_d[-1] + 1j * motion.i_q[-1]
    found = steady_observer(
        observer.method, observer.gains, observer.t_s, plants(observer.machine, WARM, 3), end,
        shares * observer.omega_max,
    )  # fmt: skip
    seen = observe(observer.method, observer.gains, motion).angle_error(motion)[-1]
    assert found.found.all()
    np.testing.assert_allclose(found.theta_error, seen, atol=1e-4)


@EVERY
def test_backwards_is_the_mirror_of_forwards(method: ObserverMethodName) -> None:
    """Speed, q current and angle with the other sign: the correction, too."""
    observer = learned_observer(method)
    omega = np.tile(np.array([1.0, -1.0]) * 0.15 * observer.omega_max, (2500, 1))
    current = np.array([-0.6 + 3.0j, -0.6 - 3.0j])
    motion = drive_motion(observer.machine, observer.t_s, omega, current, WARM)
    errors = observe(observer.method, observer.gains, motion).angle_error(motion)[-1]
    assert errors[0] == pytest.approx(-errors[1], abs=1e-9)
    bare = observe(flux.METHOD, observer.gains.flux, motion).angle_error(motion)[-1]
    assert abs(errors[0] - bare[0]) > 0.01  # it acts


@EVERY
def test_nothing_is_corrected_outside_of_what_was_trained(method: ObserverMethodName) -> None:
    """Below the least speed, above the largest, beyond the largest current, and at standstill: the
    angle is that of the flux observer, and the state says so.
    """
    observer = learned_observer(method)
    omega = np.tile(np.array([0.02, 1.15, 0.3, 0.0]) * observer.omega_max, (600, 1))
    current = 1j * np.array([1.0, 1.0, 8.0, 1.0])
    motion = drive_motion(observer.machine, observer.t_s, omega, current)
    bare = observe(flux.METHOD, observer.gains.flux, motion)
    whole = observe(observer.method, observer.gains, motion)
    np.testing.assert_allclose(np.exp(1j * whole.theta_e), np.exp(1j * bare.theta_e), atol=1e-9)


def test_the_first_input_that_lies_outside_says_why() -> None:
    inside = [np.zeros(1)] * 6
    assert outside(tuple(inside), EXACT)[0] == 0.0
    for k, why in ((0, 2.0), (1, 1.0), (2, 1.0), (3, 1.0), (4, 1.0), (5, 2.0)):
        for bad in (1.001, -1.001, np.nan, np.inf):
            x = [*inside]
            x[k] = np.array([bad])
            assert outside(tuple(x), EXACT)[0] == why
    assert outside(tuple([np.full(1, np.nan)] * 6), EXACT)[0] == 1.0


@pytest.mark.slow
@EVERY
def test_the_share_of_hits_is_counted(method: ObserverMethodName) -> None:
    """Settled inside it goes to one; an angle that the loop has yet to find lies outside."""
    observer = learned_observer(method)
    motion = _motion(method, np.array([0.3]), {})
    state = observer.method.start(motion.theta_e[0] + 1.0, motion.omega_e[0])
    hits, why = [], []
    for k in range(2000):
        v = (motion.v_alpha[k], motion.v_beta[k])
        i = (motion.i_alpha[k], motion.i_beta[k])
        state = observer.method.step(observer.gains, state, v, i, EXACT)
        hits.append(float(state.scalars[1][0]))
        why.append(float(state.scalars[2][0]))
    assert why[1] != 0.0
    assert hits[5] < 0.1
    assert hits[-1] > 0.95
    assert why[-1] == 0.0


@pytest.mark.slow
@EVERY
def test_not_a_number_leaves_the_correction_finite(method: ObserverMethodName) -> None:
    observer = learned_observer(method)
    motion = _motion(method, np.array([0.3]), WARM)
    bad = replace(motion, v_alpha=motion.v_alpha.copy())
    bad.v_alpha[1500] = np.nan
    state = observer.method.start(motion.theta_e[0], motion.omega_e[0])
    for k in range(2000):
        v, i = (bad.v_alpha[k], bad.v_beta[k]), (bad.i_alpha[k], bad.i_beta[k])
        with np.errstate(all="ignore"):
            state = observer.method.step(observer.gains, state, v, i, EXACT)
    assert np.isfinite(state.scalars[0]).all()
    assert np.abs(state.scalars[0]) < 1e-2  # it fades, for nothing is known any more
    assert state.scalars[2] == 1.0
