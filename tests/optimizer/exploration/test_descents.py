"""Descents for one goal, side by side."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from search_problems import opened, ranges, searched

from dqforge.machines.arrays import FloatArray
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.exploration.study_search import Outcomes

SEARCH = Search("nlopt", 4, 70, 5)
BEST = np.array([0.3, -1.2, 0.7])


def loss(points: FloatArray) -> FloatArray:
    bowl = np.sum((points - BEST) ** 2, axis=1)
    return np.asarray(bowl + 0.1 * (1.0 - np.cos(3.0 * (points[:, 0] - 0.3))))


def judged(points: FloatArray) -> Outcomes:
    """The sum is to be at least 1; where the first number is beyond 1.9 there are no values."""
    excess = 1.0 - np.sum(points, axis=1, keepdims=True)
    known = np.abs(points[:, 0]) < 1.9
    return Outcomes(np.where(known, loss(points), np.nan)[:, np.newaxis], excess, known)


def best(points: list[FloatArray], outcomes: list[Outcomes]) -> tuple[float, FloatArray]:
    every = np.concatenate(points)
    goals = np.concatenate([each.goals[:, 0] for each in outcomes])
    fine = np.concatenate([each.known & (each.excess[:, 0] <= 1e-9) for each in outcomes])
    place = int(np.argmin(np.where(fine, goals, np.inf)))
    return float(goals[place]), every[place]


def test_the_least_within_a_limit_is_found() -> None:
    run = opened(SEARCH, ranges(3, -2.0, 2.0), 1, 1)
    found, point = best(*searched(run, judged, 70))
    expected = minimize(
        lambda x: loss(x[np.newaxis])[0],
        [1.0, 0.0, 0.0],
        constraints={"type": "ineq", "fun": lambda x: np.sum(x) - 1.0},
    )
    assert found == pytest.approx(expected.fun, abs=1e-4)
    assert point == pytest.approx(expected.x, abs=0.01)


def test_rows_of_a_generation_belong_to_descents_of_their_own() -> None:
    run = opened(SEARCH, ranges(3, -2.0, 2.0), 1, 1)
    first = run.ask()
    assert first.shape == (4, 3)
    assert len(np.unique(first, axis=0)) == 4
    assert np.array_equal(run.ask(), first)


def test_a_descent_at_its_end_begins_again_elsewhere() -> None:
    run = opened(Search("nlopt", 2, 90, 5), ranges(1, -2.0, 2.0), 1, 0)

    def bowl(points: FloatArray) -> Outcomes:
        goals = (points - 0.4) ** 2
        return Outcomes(goals, np.zeros((len(goals), 0)), np.ones(len(goals), np.bool_))

    points, _ = searched(run, bowl, 90)
    ways = np.concatenate(points, axis=1)[0]
    assert np.min(np.abs(ways - 0.4)) < 1e-3
    late = np.abs(np.diff(ways[-40:]))
    assert np.max(late) > 0.05


def test_the_way_is_the_same_again_and_after_a_break() -> None:
    variables = ranges(3, -2.0, 2.0)
    points, outcomes = searched(opened(SEARCH, variables, 1, 1), judged, 30)
    again = opened(SEARCH, variables, 1, 1)
    for known in outcomes[:17]:
        again.tell(known)
    for generation in range(17, 30):
        assert np.array_equal(again.ask(), points[generation])
        again.tell(outcomes[generation])
    other, _ = searched(opened(Search("nlopt", 4, 70, 6), variables, 1, 1), judged, 2)
    assert not np.array_equal(other[0], points[0])


def test_a_generation_without_any_values_ends_nothing() -> None:
    run = opened(SEARCH, ranges(2), 1, 1)

    def nothing(points: FloatArray) -> Outcomes:
        lost = np.full((len(points), 1), np.nan)
        return Outcomes(lost, lost, np.zeros(len(points), np.bool_))

    points, _ = searched(run, nothing, 12)
    every = np.concatenate(points)
    assert np.all((every >= 0.0) & (every <= 1.0))
