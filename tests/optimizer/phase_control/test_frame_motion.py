"""Frames of the control against the matrices of paper 002."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from phase_loops import PSI, harmonic_shape

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frame_transforms import (
    amplitude_factor,
    frame_rates,
    transform,
)
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.judged_box import frame_motion, shape_at
from dqforge.optimizer.phase_control.phase_controller import PhaseShape

Drawn = Literal["dqx", "dqy"]

SHAPE = harmonic_shape(3600)
THETA = np.linspace(-3.0, 9.0, 41)


def test_nodes_of_one_row_serve_three_equal_phases() -> None:
    value, slope = shape_at(SHAPE, THETA)
    lag = THETA - np.arange(3)[:, np.newaxis] * 2.0 * np.pi / 3.0
    orders = ((1, 1.0), (3, 0.12), (5, 0.03), (7, 0.01))
    exact = -PSI * sum(share * np.sin(h * lag) for h, share in orders)
    steep = -PSI * sum(h * share * np.cos(h * lag) for h, share in orders)
    np.testing.assert_allclose(value, exact, atol=2e-6)
    np.testing.assert_allclose(slope, steep, atol=2e-3)


def test_three_rows_over_two_turns_are_read_at_their_own_angle() -> None:
    flux = np.array([[1.0, 3.0, 2.0, 6.0], [0.0, 1.0, 0.0, -1.0], [4.0, 4.0, 4.0, 4.0]])
    value, slope = shape_at(PhaseShape(flux, turns=2), np.array([np.pi / 2.0, 3.5 * np.pi]))
    np.testing.assert_allclose(value, [[2.0, 3.5], [0.5, -0.5], [4.0, 4.0]])
    np.testing.assert_allclose(slope, np.array([[2.0, -5.0], [1.0, 1.0], [0.0, 0.0]]) / np.pi)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_axes_factors_and_rates_are_those_of_paper_002(frame: Drawn) -> None:
    motion = frame_motion(frame, SHAPE, THETA)
    value, slope = (part / (1.2 * PSI) for part in shape_at(SHAPE, THETA))
    ours = motion.axes @ np.stack([_upright(theta) for theta in THETA])
    theirs = transform(frame, THETA, value)
    np.testing.assert_allclose(ours[:, 1], theirs[:, 1], atol=1e-12)
    np.testing.assert_allclose(  # d and 0y of the paper's reflection may point the other way
        np.abs(np.sum(ours * theirs, axis=2)), 1.0, atol=1e-12
    )
    ratio = motion.factor[:, 1] / amplitude_factor(frame, value)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    rates = frame_rates(THETA, value, slope)
    growth = rates.growth_x if frame == "dqx" else rates.growth_y
    np.testing.assert_allclose(motion.growth[:, 1], growth, atol=1e-12)
    np.testing.assert_allclose(motion.turning[:, 2], 1.0 + rates.theta_x, atol=1e-12)
    lift = 0.0 if frame == "dqx" else np.abs(rates.theta_y)
    np.testing.assert_allclose(np.hypot(*motion.turning[:, :2].T), lift, atol=1e-12)


def _upright(theta: float) -> FloatArray:
    """From the phases to the rotor's d, q, 0, power-invariant."""
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]
    return np.asarray(turn @ clarke_matrix(power_invariant=True))


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_the_axes_turn_as_they_say(frame: Drawn) -> None:
    small = 1e-6
    before, at, after = (
        frame_motion(frame, SHAPE, THETA + 1e-4 + move) for move in (-small, 0.0, small)
    )

    def in_stator(axes: FloatArray, move: float) -> FloatArray:
        # A vector of the rotor's d, q, 0 seen from the stator, for each angle.
        return np.stack(
            [
                row @ _upright(theta + 1e-4 + move) @ clarke_matrix(power_invariant=True).T
                for row, theta in zip(axes, THETA, strict=True)
            ]
        )

    turning = in_stator(at.turning[:, np.newaxis], 0.0)
    slope = (in_stator(after.axes, small) - in_stator(before.axes, -small)) / (2.0 * small)
    np.testing.assert_allclose(slope, np.cross(turning, in_stator(at.axes, 0.0)), atol=1e-6)
