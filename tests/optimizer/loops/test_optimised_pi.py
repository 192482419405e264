"""Optimised PI gains: against brute force, against the named methods at equal M_s,
and over boxes.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    PerUnitBases,
    SpeedLoopSettings,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.loops.loop_gains import (
    current_step_response,
    tune_current_loop,
    tune_speed_loop,
)
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    PlantBatch,
    close_loops,
    current_plants,
    peak_sensitivities,
)

T_S = 1e-4


def winding(r_s: float, inductance: float) -> PlantBatch:
    return current_plants(np.array([r_s]), np.array([inductance]), T_S, np.ones(1))


@pytest.mark.thinned
@pytest.mark.parametrize("bound", [1.2, 1.6, 2.0])
@pytest.mark.parametrize(("r_s", "inductance"), [(2.35, 1.7e-3), (0.0, 1e-3), (20.0, 1e-3)])
def test_no_pair_on_a_fine_grid_has_more_integral_gain(
    r_s: float, inductance: float, bound: float
) -> None:
    kp, ki = optimised_pi(
        winding(r_s, inductance),
        bound,
        pi_scale(inductance, r_s, 1.5 * T_S),
        "control.current_loop",
    )
    assert peak_sensitivities(close_loops(winding(r_s, inductance), kp, ki))[0] == pytest.approx(
        bound, rel=1e-6
    )
    all_kp, all_ki = (
        values.ravel()
        for values in np.meshgrid(
            np.geomspace(0.01, 3.0, 120) * kp, np.geomspace(0.8, 1.5, 40) * ki
        )
    )
    count = all_kp.size
    batch = close_loops(
        current_plants(np.full(count, r_s), np.full(count, inductance), T_S, np.ones(count)),
        all_kp,
        all_ki,
    )
    sensitivity = np.max(np.abs(batch.sensitivity(np.geomspace(10.0, np.pi / T_S, 400))), axis=1)
    kept = (batch.radius < 1.0) & (sensitivity <= bound)
    assert kept.any()
    assert np.max(all_ki[kept]) <= 1.0005 * ki


def absolute_error(r_s: float, inductance: float, gains: tuple[float, float]) -> float:
    """Integral of |i| in A s after 1 V at the winding, from the simulated response."""
    asked = CurrentLoopSettings(method="given", kp=gains[0], ki=gains[1], min_phase_margin=0.0)
    loop = tune_current_loop(r_s, inductance, T_S, asked)
    response = current_step_response(r_s, inductance, loop, 0.5)
    return float(np.sum(np.abs(response.disturbance)) * T_S)


@pytest.mark.parametrize(
    ("named", "most"),
    [
        (CurrentLoopSettings(method="bandwidth", bandwidth=1800.0), 0.75),
        # Near the least absolute error, which the search for the least signed one misses
        # by 2 % at this M_s of 1.29.
        (CurrentLoopSettings(method="damping", bandwidth=1200.0), 1.02),
        (CurrentLoopSettings(method="magnitude-optimum"), 0.75),
        (CurrentLoopSettings(method="symmetrical-optimum", spread=2.6), 0.98),
    ],
)
def test_it_beats_every_named_method_of_the_same_sensitivity(
    named: CurrentLoopSettings, most: float
) -> None:
    """Less integrated error (1/ki), and mostly less of its absolute value,
    after a step of the voltage.
    """
    r_s, inductance = 0.4, 2e-3
    before = tune_current_loop(r_s, inductance, T_S, named)
    asked = CurrentLoopSettings(method="optimised", max_sensitivity=before.max_sensitivity)
    after = tune_current_loop(r_s, inductance, T_S, asked)
    assert after.max_sensitivity == pytest.approx(before.max_sensitivity, rel=1e-6)
    assert after.ki > 1.01 * before.ki
    errors = [absolute_error(r_s, inductance, (loop.kp, loop.ki)) for loop in (before, after)]
    assert errors[1] < most * errors[0]


@pytest.mark.parametrize(("bound", "surplus"), [(1.3, 1.12), (1.6, 1.16), (2.0, 1.25)])
def test_the_integral_of_the_error_is_its_inverse_gain_and_nearly_the_absolute_one(
    bound: float, surplus: float
) -> None:
    r_s, inductance = 0.4, 2e-3
    loop = tune_current_loop(
        r_s, inductance, T_S, CurrentLoopSettings(method="optimised", max_sensitivity=bound)
    )
    response = current_step_response(r_s, inductance, loop, 0.2)
    assert np.sum(response.disturbance) * T_S == pytest.approx(1.0 / loop.ki, rel=1e-6)
    assert 1.0 <= absolute_error(r_s, inductance, (loop.kp, loop.ki)) * loop.ki + 1e-9 <= surplus


def test_speed_loop_beats_the_symmetrical_optimum_of_the_same_sensitivity(
    bench001: LinearMachine,
) -> None:
    current = CurrentLoopSettings(method="optimised")
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 2e-4, current)
    bases = PerUnitBases(1.0, 1.0, 1.0, 1.0)
    settings = ControlSettings(2e-4, current, SpeedLoopSettings(spread=4.0), None, bases)
    named = tune_speed_loop(bench001, q_axis, settings)
    asked = SpeedLoopSettings(method="optimised", max_sensitivity=named.max_sensitivity)
    found = tune_speed_loop(bench001, q_axis, replace(settings, speed_loop=asked))
    assert found.max_sensitivity == pytest.approx(named.max_sensitivity, rel=1e-6)
    assert found.ki > 1.02 * named.ki


def test_every_corner_and_every_point_inside_a_box_keeps_the_bound() -> None:
    r_s, inductance, bound = 2.35, 1.7e-3, 1.5
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

    def plants(at: np.ndarray) -> PlantBatch:
        changed = 1.0 + at * (0.3, 0.25, 0.1)
        return current_plants(r_s * changed[:, 0], inductance * changed[:, 1], T_S, changed[:, 2])

    gains = optimised_pi(
        plants(corners), bound, pi_scale(inductance, r_s, 1.5 * T_S), "control.current_loop"
    )
    at_corners = peak_sensitivities(close_loops(plants(corners), *gains))
    assert np.max(at_corners) == pytest.approx(bound, rel=2e-6)
    inside = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 3))
    assert np.max(peak_sensitivities(close_loops(plants(inside), *gains))) <= bound * (1.0 + 2e-6)
    # More integral gain at any kp breaks a corner.
    for factor in np.geomspace(0.5, 2.0, 41):
        assert (
            np.max(
                peak_sensitivities(
                    close_loops(plants(corners), gains[0] * factor, gains[1] * 1.002)
                )
            )
            > bound
        )
    alone = optimised_pi(
        winding(r_s, inductance),
        bound,
        pi_scale(inductance, r_s, 1.5 * T_S),
        "control.current_loop",
    )
    assert gains[1] < alone[1]


def test_gains_are_the_same_every_time() -> None:
    calls = [
        optimised_pi(winding(0.5, 1e-3), 1.6, pi_scale(1e-3, 0.5, 1.5 * T_S), "key")
        for _ in range(2)
    ]
    assert calls[0] == calls[1]


def test_a_box_that_no_gains_hold_is_refused() -> None:
    """A voltage gain of either sign cannot be stabilised by one controller."""
    plants = current_plants(np.ones(2), np.full(2, 1e-3), T_S, np.array([1.0, -1.0]))
    with pytest.raises(
        NoSolutionError, match=r"control\.speed_loop: no gains keep M_s within 1\.6"
    ):
        optimised_pi(plants, 1.6, pi_scale(1e-3, 1.0, 1.5 * T_S), "control.speed_loop")


@pytest.mark.slow
def test_too_small_a_phase_margin_says_which_bound_holds() -> None:
    asked = CurrentLoopSettings(method="optimised", max_sensitivity=2.0, min_phase_margin=0.9)
    with pytest.raises(
        NoSolutionError, match=r"holds from control\.current_loop\.max_sensitivity = "
    ) as refusal:
        tune_current_loop(0.4, 2e-3, T_S, asked)
    bound = float(str(refusal.value).split("max_sensitivity = ")[1].split()[0])
    assert (
        tune_current_loop(0.4, 2e-3, T_S, replace(asked, max_sensitivity=bound)).phase_margin >= 0.9
    )
    with pytest.raises(NoSolutionError):
        tune_current_loop(0.4, 2e-3, T_S, replace(asked, max_sensitivity=1.02 * bound))
