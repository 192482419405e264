"""Known problems for a search, and how it is run over its generations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.exploration.study_search import (
    Outcomes,
    SearchRows,
    SearchVariable,
    open_search,
)

Judge = Callable[[FloatArray], Outcomes]


def free(goals: FloatArray) -> Outcomes:
    """Outcomes of goals (n, G) that no limit holds back."""
    known = np.ones(len(goals), dtype=np.bool_)
    return Outcomes(goals, np.zeros((len(goals), 0)), known)


def zdt1(points: FloatArray) -> Outcomes:
    """The first problem of Zitzler, Deb and Thiele (2000): the front is y = 1 - sqrt(x)."""
    far = 1.0 + 9.0 * np.mean(points[:, 1:], axis=1)
    one = points[:, 0]
    return free(np.column_stack([one, far * (1.0 - np.sqrt(one / far))]))


def ranges(count: int, low: float = 0.0, high: float = 1.0) -> tuple[SearchVariable, ...]:
    """Ranges alike."""
    return tuple(SearchVariable((f"key{k}",), "range", low, high) for k in range(count))


def opened(
    search: Search, variables: tuple[SearchVariable, ...], goals: int = 2, limits: int = 0
) -> SearchRows:
    """A search at its beginning."""
    return open_search(search, variables, goals, limits)


def searched(
    run: SearchRows, judge: Judge, generations: int
) -> tuple[list[FloatArray], list[Outcomes]]:
    """Points and outcomes of further generations."""
    points, outcomes = [], []
    for _ in range(generations):
        points.append(run.ask())
        outcomes.append(judge(points[-1]))
        run.tell(outcomes[-1])
    return points, outcomes
