"""When a step that changes with the speed makes a quadratic form smaller, by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from dqforge.optimizer.speed_box import step_contracts


@pytest.mark.parametrize(("error", "whole"), [(0.29, True), (0.31, False)])
@pytest.mark.parametrize("gain", [0.7, -0.7])
def test_one_state_shrinks_until_gain_and_error_are_one(
    gain: float, error: float, whole: bool
) -> None:
    one = np.ones((1, 1))
    found = step_contracts(one, one, gain * np.ones((1, 1, 1)), error * one)
    assert found.corners
    assert found.whole == whole
    # a form that is four times as large behind the step lets half of the gain through
    assert not step_contracts(one, 4.0 * one, gain * np.ones((1, 1, 1)), 0.0 * one).corners
    assert step_contracts(4.0 * one, one, 2.0 * gain * np.ones((1, 1, 1)), 0.0 * one).whole


def test_no_step_within_the_errors_grows_where_it_is_claimed() -> None:
    """Steps by chance between forms of other size; those well beyond the claim do grow."""
    rng = np.random.default_rng(8)
    claimed = 0
    for _ in range(60):
        loop = rng.normal(size=(3, 4))
        after = solve_discrete_lyapunov(0.3 * rng.normal(size=(3, 3)), np.eye(3))
        before = loop.T @ after @ loop * rng.uniform(1.0, 1.6) + 0.3 * np.eye(4)
        errors = rng.uniform(0.0, 0.08, (2, 3))
        found = step_contracts(before, after, loop[np.newaxis], errors)
        fall = before - loop.T @ after @ loop
        assert found.corners == bool(np.linalg.eigvalsh(fall).min() > 0.0)
        if found.whole:
            claimed += 1
            for sign in rng.choice([-1.0, 1.0], (40, 2, 3)):
                other = loop.copy()
                other[:2, :3] += sign * errors
                assert np.linalg.eigvalsh(before - other.T @ after @ other).min() > 0.0
    assert 5 < claimed < 60


@pytest.mark.parametrize(("away", "whole"), [(-2e-5, True), (-5e-6, False), (5e-6, False)])
def test_a_claim_keeps_a_reserve_for_rounding(away: float, whole: bool) -> None:
    """(0.7 + e)^2 - 0.49 over what the step falls by, against one."""
    one, gain = np.ones((1, 1)), 0.7
    error = np.sqrt(gain**2 + (1.0 - gain**2) * (1.0 + away)) - gain
    found = step_contracts(one, one, gain * np.ones((1, 1, 1)), error * one)
    assert found.whole == whole
