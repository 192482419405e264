"""Controllers of the speed by rules and by neurons: what they are without training."""

from __future__ import annotations

import numpy as np
import pytest
from learned_speed import (
    HIDDEN,
    SpeedDrives,
    SpeedScales,
    bench,
    drives,
    fuzzy_change,
    linear_table,
    neural_change,
    odd_table,
    pi_change,
    run,
    sources,
)

from dqforge.optimizer.steps.step_arithmetic import EXACT

PI = (0.3, 0.9)


def test_rules_on_a_plane_are_pi() -> None:
    e, de = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 500))
    table = tuple(odd_table(linear_table(*PI)))
    assert fuzzy_change(EXACT, table, e, de) == pytest.approx(pi_change(EXACT, PI, e, de))
    beyond = fuzzy_change(EXACT, table, np.array([7.0]), np.array([-3.0]))
    assert beyond == pytest.approx(PI[0] - PI[1])


def test_neurons_that_hardly_bend_are_pi() -> None:
    e, de = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 500))
    small = 1e-3
    numbers = np.ravel([(1.0 / HIDDEN / small, small * PI[0], small * PI[1])] * HIDDEN)
    found = neural_change(EXACT, tuple(numbers), e, de)
    assert found == pytest.approx(pi_change(EXACT, PI, e, de), rel=1e-4, abs=1e-4)


def test_a_small_step_is_that_of_the_linear_loop() -> None:
    """Samples of torque behind a lag and of a shaft: the poles are those of the matrix."""
    plant = SpeedDrives(*(np.array([x]) for x in (0.08, 0.002, 0.01, 0.0, 1.0)))
    scales = SpeedScales(0.002, 400, 0.2, 0.02)
    k_i, k_p = 0.05 * scales.error, 0.8 * scales.change
    found = run(pi_change, np.array([k_i, k_p]), plant, scales)
    a = np.exp(-1.0)
    mean = 1.0 - a
    t = 0.002 / 0.08
    gain_i, gain_p = 0.05, 0.8
    x = np.array([0.0, 0.0, 0.0, 0.0])  # speed, torque, asked, last error
    area = 0.0
    for _ in range(400):
        e = 0.01 - x[0]
        asked = x[2] + gain_i * e + gain_p * (e - x[3])
        torque = asked + (x[1] - asked) * a
        x = np.array([x[0] + t * (asked + (x[1] - asked) * mean), torque, asked, e])
        area += 0.002 * abs(e)
    assert found.error[0] == pytest.approx(area / (0.5 * 0.01**2 * 0.08 + 0.01 * 0.002))


def test_first_gains_hold_the_drive_of_the_thesis() -> None:
    first, mechanical, delay, scales = bench()
    found = run(pi_change, np.array(first), drives(20, mechanical, delay, 0), scales)
    assert np.max(found.error) < 8.0
    assert np.max(found.overshoot) < 1.0


@pytest.mark.parametrize("change", [pi_change, fuzzy_change, neural_change])
def test_each_is_written_as_c(change: object) -> None:
    count = {pi_change: 2, fuzzy_change: 25, neural_change: 3 * HIDDEN}[change]  # type: ignore[index]
    text = sources(change, np.ones(count))["step.h"].decode()  # type: ignore[arg-type]
    assert text.count("static inline float speed_change") == 1
    assert text.count("speed_hyperbolic_tangent(inner") == (
        HIDDEN if change is neural_change else 0
    )
