"""The phase-locked loop against its own recursion: poles, lag, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers.pll import corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import EXACT


@pytest.mark.parametrize("damping", [0.4, 1.0, 1.7])
@pytest.mark.parametrize(("bandwidth", "t_s"), [(200.0, 1e-4), (900.0, 5e-4)])
def test_the_loop_has_its_poles_and_its_lag(damping: float, bandwidth: float, t_s: float) -> None:
    gains = pll_gains(bandwidth, damping, t_s)
    # Errors of angle and speed after a sample.
    loop = np.array(
        [[1.0 - gains.l_1, (1.0 - gains.l_1) * t_s], [-gains.l_2, 1.0 - gains.l_2 * t_s]]
    )
    wanted = np.exp(np.roots([1.0, 2.0 * damping * bandwidth, bandwidth**2]) * t_s)
    found = np.poly(np.linalg.eigvals(loop))
    np.testing.assert_allclose(found, np.poly(wanted), atol=1e-9)
    acceleration, theta, omega = 1500.0, np.zeros(1), np.zeros(1)
    for k in range(1, 4000):
        true = np.array([0.5 * acceleration * (k * t_s) ** 2])
        ahead = predicted(theta, t_s * omega, EXACT)
        error = EXACT.wrap(true - ahead)
        theta, omega = corrected(gains, ahead, omega, error, EXACT)
    # The speed of the loop is that of half a sample ago: the truth moves by its mean.
    assert EXACT.wrap(theta - true)[0] == pytest.approx(gains.lag(acceleration), rel=1e-6)
    assert gains.lag(acceleration) < 0.0


def test_the_usual_loop_is_600_rad_per_s_or_a_twentieth_of_the_sampling() -> None:
    assert pll_bandwidth(1e-5) == 600.0
    assert pll_bandwidth(1e-4) == pytest.approx(500.0)


def test_what_is_no_loop_is_refused() -> None:
    for values in ((0.0, 1.0, 1e-4), (100.0, 0.0, 1e-4), (100.0, 1.0, 0.0)):
        with pytest.raises(InputError, match="must be positive"):
            pll_gains(*values)
    with pytest.raises(NoSolutionError, match="write 5000 rad/s or less"):
        pll_gains(5001.0, 1.0, 1e-4)
    assert pll_gains(5000.0, 1.0, 1e-4).l_1 > 0.0
