"""Axes of a study as a search sees them."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Axis
from dqforge.optimizer.exploration.study_search import drawn_points, search_variables, values_of

RANGE = Axis(("f",), ((8e3,), (3e4,), (1e5,)), ((8e3,), (3e4,), (1e5,)), "log")
LISTED = Axis(("v",), ((400.0,), (500.0,)), ((400.0,), (500.0,)))
UNORDERED = Axis(("n",), ((3.0,), (1.0,), (2.0,)), ((3.0,), (1.0,), (2.0,)))
WORDS = Axis(("device",), (({"name": "a"},), ({"name": "b"},), ({"name": "c"},)))
TOGETHER = Axis(("a", "b"), ((1.0, 5.0), (2.0, 4.0)), ((1.0, 5.0), (2.0, 4.0)), "linear")


def test_ranges_lie_between_their_ends_steps_have_an_order_and_words_none() -> None:
    found = search_variables((RANGE, LISTED, UNORDERED, WORDS, TOGETHER))
    assert [each.kind for each in found] == ["range", "steps", "choice", "choice", "steps"]
    assert (found[0].low, found[0].high, found[0].logarithmic) == (8e3, 1e5, True)
    assert [each.count for each in found[1:]] == [2, 3, 3, 2]


def test_shares_become_numbers_and_places_stay() -> None:
    found = search_variables((RANGE, WORDS))
    points = np.array([[0.0, 2.0], [0.5, 0.0], [1.0, 1.0]])
    values = values_of(found, points)
    assert values[:, 0] == pytest.approx([8e3, np.sqrt(8e8), 1e5])
    assert values[0, 0] == 8e3
    assert values[2, 0] == 1e5
    assert np.array_equal(values[:, 1], points[:, 1])


def test_points_at_random_are_points_of_the_space() -> None:
    found = search_variables((RANGE, LISTED, WORDS))
    points = drawn_points(found, 400, np.random.default_rng(1))
    assert points.shape == (400, 3)
    assert np.all((points[:, 0] >= 0.0) & (points[:, 0] < 1.0))
    assert set(points[:, 1]) == {0.0, 1.0}
    assert set(points[:, 2]) == {0.0, 1.0, 2.0}


def test_a_search_needs_something_to_vary() -> None:
    with pytest.raises(InputError, match="search: nothing varies; write the keys"):
        search_variables(())
