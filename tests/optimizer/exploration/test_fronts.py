"""Pareto fronts, against a comparison of every row with every other."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.exploration.acceptance import Front, empty_front, front_of


def by_force(index: np.ndarray, goals: FloatArray) -> list[int]:
    """Indices of rows that no other row beats; of equal ones the lowest."""
    kept = []
    for row in range(len(goals)):
        under = np.all(goals <= goals[row], axis=1)
        better = under & np.any(goals < goals[row], axis=1)
        earlier = under & np.all(goals == goals[row], axis=1) & (index < index[row])
        if not np.any(better | earlier):
            kept.append(int(index[row]))
    return sorted(kept)


def random_rows(case: int) -> tuple[np.ndarray, FloatArray]:
    random = np.random.default_rng(case)
    count, goals = int(random.integers(0, 150)), int(random.integers(1, 5))
    if case % 2:  # few values, so that many rows are equal
        values = random.integers(0, random.integers(2, 12), (count, goals)).astype(float)
    else:
        values = random.standard_normal((count, goals))
    if count and case % 5 == 0:
        values[random.integers(count), random.integers(goals)] = np.inf
    return random.permutation(count) + 1000, values


@pytest.mark.parametrize("case", range(120))
def test_the_front_is_what_no_row_beats(case: int) -> None:
    index, goals = random_rows(case)
    found = front_of(index, goals)
    assert found.index.tolist() == by_force(index, goals)
    for place, row in zip(found.index, found.goals, strict=True):
        assert np.array_equal(goals[index == place][0], row)


@pytest.mark.parametrize("case", range(0, 120, 7))
def test_fronts_of_parts_merge_to_the_front_of_all_in_any_order(case: int) -> None:
    index, goals = random_rows(case)
    whole = front_of(index, goals)
    parts = [
        front_of(index[rows], goals[rows]) for rows in np.array_split(np.arange(index.size), 7)
    ]
    for order in (range(7), reversed(range(7)), (3, 0, 6, 1, 5, 2, 4)):
        merged = empty_front(goals.shape[1])
        for place in order:
            merged = merged.plus(parts[place])
        assert np.array_equal(merged.index, whole.index)
        assert np.array_equal(merged.goals, whole.goals)


def test_of_equal_rows_the_lowest_index_stays() -> None:
    goals = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [-0.0, 3.0], [0.0, 3.0]])
    assert front_of(np.array([9, 4, 7, 6, 5]), goals).index.tolist() == [4, 5]
    three = np.column_stack([goals, np.ones(5)])
    assert front_of(np.array([9, 4, 7, 6, 5]), three).index.tolist() == [4, 5]


def test_rows_without_a_goal_are_out() -> None:
    goals = np.array([[np.nan, 0.0], [2.0, np.nan], [1.0, 1.0]])
    assert front_of(np.arange(3), goals).index.tolist() == [2]
    assert front_of(np.arange(2), goals[:2]).count == 0


@pytest.mark.parametrize("goals", [2, 3])
def test_a_front_that_holds_every_row_comes_out_whole(goals: int) -> None:
    random = np.random.default_rng(3)
    vectors = np.abs(random.standard_normal((3000, goals)))
    sphere = -vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    assert front_of(np.arange(3000), sphere).count == 3000


def test_a_hundred_thousand_rows_are_held_against_the_front_and_not_against_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Comparisons are counted: by brute force they would be 1e10."""
    compared = []
    from dqforge.optimizer.exploration import acceptance as fronts

    plain = fronts._beaten

    def counting(rows: FloatArray, front: FloatArray) -> np.ndarray:
        compared.append(len(rows) * len(front))
        return plain(rows, front)

    monkeypatch.setattr(fronts, "_beaten", counting)
    goals = np.random.default_rng(5).random((100_000, 3))
    found = front_of(np.arange(100_000), goals)
    assert isinstance(found, Front)
    assert 50 < found.count < 300
    assert sum(compared) < 4e7


def test_rows_that_differ_in_their_last_digits_are_equal() -> None:
    """The first of them stays, whichever way the rounding fell; a real difference counts."""
    goals = np.array([[1.0, 3.0], [1.0 * (1.0 - 1e-15), 3.0 * (1.0 + 1e-15)], [2.0, 1.0]])
    assert front_of(np.arange(3), goals).index.tolist() == [0, 2]
    assert front_of(np.arange(3), goals[:, ::-1]).index.tolist() == [0, 2]
    goals[1] = [1.0 - 1e-9, 3.0 + 1e-9]
    assert front_of(np.arange(3), goals).index.tolist() == [0, 1, 2]
    huge = np.array([[np.inf, 1.0], [1e300, 2.0], [1e-300, 3.0]])
    assert front_of(np.arange(3), huge).index.tolist() == [0, 1, 2]
