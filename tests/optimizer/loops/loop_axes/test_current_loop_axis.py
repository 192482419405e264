"""Current loops of many machines against each by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentLoopMethod
from dqforge.optimizer.loops.loop_axes import given_current_loops, tuned_current_loops
from dqforge.optimizer.loops.loop_gains import analyse_current_loop, tune_current_loop

COUNT = 24
METHODS: tuple[CurrentLoopMethod, ...] = (
    "magnitude-optimum",
    "symmetrical-optimum",
    "bandwidth",
    "damping",
    "ti",
    "nxp-mcat",
)
NUMBERS = ("crossover", "phase_margin", "gain_margin", "delay_margin", "max_sensitivity")


def windings(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """R, L and t_s of machines of all sizes."""
    g = np.random.default_rng(seed)
    r_s = 10.0 ** g.uniform(-2.5, 0.7, COUNT)
    return r_s, r_s * 10.0 ** g.uniform(-3.3, -1.5, COUNT), 10.0 ** g.uniform(-4.6, -3.6, COUNT)


@pytest.mark.parametrize("method", METHODS)
def test_gains_and_margins_are_those_of_single_loops(method: CurrentLoopMethod) -> None:
    r_s, inductance, t_s = windings(1)
    settings = CurrentLoopSettings(method=method, bandwidth=1500.0)
    found = tuned_current_loops(r_s, inductance, t_s, settings)
    accepted = 0
    for k in range(COUNT):
        try:
            single = tune_current_loop(r_s[k], inductance[k], t_s[k], settings)
        except NoSolutionError:
            assert not found.holds[k]
            continue
        assert found.holds[k]
        assert (found.kp[k], found.ki[k]) == (single.kp, single.ki)
        for name in NUMBERS:
            assert getattr(found.margins, name)[k] == getattr(single, name), name
        accepted += 1
    assert accepted >= COUNT // 3


def test_each_row_may_have_its_own_settings() -> None:
    r_s, inductance, t_s = windings(2)
    rules = [
        CurrentLoopSettings(method="bandwidth", bandwidth=300.0 * (1.0 + k)) for k in range(COUNT)
    ]
    found = tuned_current_loops(r_s, inductance, t_s, rules)
    np.testing.assert_allclose(found.kp, inductance * 300.0 * (1.0 + np.arange(COUNT)), rtol=1e-15)


def test_rows_that_a_single_loop_would_be_refused_for_are_marked() -> None:
    slow = CurrentLoopSettings(method="damping", bandwidth=1.0)  # kp = 2 xi w L - R is negative
    late = CurrentLoopSettings(method="bandwidth", bandwidth=8000.0)
    searched = CurrentLoopSettings(method="optimised")
    far = CurrentLoopSettings(method="given", kp=1e-6, ki=1e-6)
    found = tuned_current_loops(2.35, 1.7e-3, 2e-4, [slow, late, searched, far])
    np.testing.assert_array_equal(found.holds, False)
    np.testing.assert_array_equal(np.isnan(found.kp), [True, False, True, False])
    np.testing.assert_array_equal(np.isnan(found.margins.max_sensitivity), np.isnan(found.kp))
    for rule in (slow, late, far):
        with pytest.raises(NoSolutionError):
            tune_current_loop(2.35, 1.7e-3, 2e-4, rule)


def test_the_phase_margin_asked_for_decides() -> None:
    settings = CurrentLoopSettings(method="bandwidth", bandwidth=1500.0)
    loop = tuned_current_loops(0.4, 2e-3, 1e-4, settings)
    margin = float(loop.margins.phase_margin[0])
    for factor, held in ((0.999, True), (1.001, False)):
        asked = replace(settings, min_phase_margin=factor * margin)
        assert tuned_current_loops(0.4, 2e-3, 1e-4, asked).holds[0] == held


def test_one_header_on_many_machines() -> None:
    """Fixed gains; another link voltage scales the loop gain."""
    r_s, inductance, t_s = 0.4, np.array([1.6e-3, 2e-3, 2.4e-3]), 1e-4
    gain = np.array([1.1, 1.0, 0.9])
    found = given_current_loops(r_s, inductance, t_s, 5.0, 1000.0, gain)
    for k in range(3):
        # L di/dt = g v - R i is the winding L/g, R/g with the gain 1.
        single = analyse_current_loop(
            r_s / gain[k], inductance[k] / gain[k], t_s, 5.0, 1000.0, respond=False
        )
        for name in NUMBERS:
            wanted = getattr(single, name)
            assert getattr(found.margins, name)[k] == pytest.approx(wanted, rel=1e-13), name
    assert np.all(np.diff(found.margins.crossover) < 0.0)
