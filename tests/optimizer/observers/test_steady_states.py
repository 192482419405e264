"""Newton's way to the steady state of an observer, where a matrix on it is singular."""

from __future__ import annotations

import numpy as np
import pytest
from observed_runs import random_design

from dqforge.optimizer.observers.parts import newton_moves
from dqforge.optimizer.observers.solve import solve_observer


def test_a_singular_matrix_on_the_way_moves_its_own_drive_alone() -> None:
    slope = np.stack([np.diag([2.0, 4.0]), np.diag([2.0, 0.0]), np.full((2, 2), np.nan)])
    moves = newton_moves(slope, np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]))
    assert moves[:2] == pytest.approx(np.array([[0.5, 0.25], [0.5, 0.0]]))
    assert np.all(np.isnan(moves[2]))


def test_a_drive_whose_way_meets_a_singular_matrix_has_its_observer() -> None:
    """The fourteenth of the random machines on which Matsui's voltage model is tried."""
    generator = np.random.default_rng(1)
    for _ in range(14):
        design = random_design(generator, "matsui-voltage")
    position = solve_observer(design)[1]
    assert position is not None
    assert position.method.name == "matsui-voltage"
