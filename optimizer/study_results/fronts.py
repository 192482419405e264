"""Pareto fronts: rows that no other row beats in every goal.

A row beats another that is nowhere better and somewhere worse. Of rows with equal goals the one
with the lowest index stays, so that a front does not depend on the order in which parts arrive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.records import dataclass

_BLOCK = 512  # Rows that are held against a front at a time: of the order of a front's own size.


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """A front of rows, ascending by index.

    Args:
        index: Indices of the rows in the study, int64 (n,).
        goals: What is made small, shape (n, G); a goal that is to be large stands with its sign
            turned.
    """

    index: NDArray[np.int64]
    goals: FloatArray

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.index.size)

    def plus(self, other: Front) -> Front:
        """The front of both fronts: that of all rows which either came from."""
        index = np.concatenate([self.index, other.index])
        return front_of(index, np.concatenate([self.goals, other.goals]))


def empty_front(goals: int) -> Front:
    """A front of no rows.

    Args:
        goals: Number of goals G.
    """
    return Front(np.empty(0, dtype=np.int64), np.empty((0, goals)))


def front_of(index: NDArray[np.int64], goals: FloatArray) -> Front:
    """The front of rows; those with a goal that is no number are out.

    Args:
        index: Indices of the rows, shape (n,), each once.
        goals: What is made small, shape (n, G).
    """
    index, goals = np.asarray(index, dtype=np.int64), np.asarray(goals, dtype=np.float64)
    known = ~np.any(np.isnan(goals), axis=1)
    index, goals = index[known], goals[known] + 0.0  # -0 counts as 0
    if not index.size:
        return empty_front(goals.shape[1])
    # By the first goal, then the next, then the index: whoever beats a row stands before it.
    order = np.lexsort((index, *goals.T[::-1]))
    sorted_goals = goals[order]
    kept = _by_steps(sorted_goals) if goals.shape[1] <= 2 else _by_blocks(sorted_goals)
    chosen = order[kept]
    by_index = chosen[np.argsort(index[chosen])]
    return Front(index[by_index], goals[by_index])


def _by_steps(goals: FloatArray) -> IndexArray:
    """Places of the front among sorted rows with one or two goals: each step down of the last."""
    if goals.shape[1] == 1:
        return np.zeros(1, dtype=np.intp)
    last = goals[:, 1]
    before = np.concatenate([[np.inf], np.minimum.accumulate(last)[:-1]])
    steps = last < before
    steps[0] = True  # even if its last goal is infinite
    return np.flatnonzero(steps)


def _by_blocks(goals: FloatArray) -> IndexArray:
    """Places of the front among sorted rows with any goals.

    A block of rows is held against the front of all rows before it, then in itself; later rows beat
    no earlier one, so that what has come in stays.
    """
    front = np.empty((0, goals.shape[1]))
    kept: list[IndexArray] = []
    for start in range(0, len(goals), _BLOCK):
        rows = goals[start : start + _BLOCK]
        places = np.flatnonzero(~_beaten(rows, front))
        rest = rows[places]
        # Among equals the first one stays: only rows before it count.
        covered = np.all(rest[:, np.newaxis] <= rest[np.newaxis], axis=2)
        alone = ~np.any(np.triu(covered, 1), axis=0)
        kept.append(start + places[alone])
        front = np.concatenate([front, rest[alone]])
    return np.concatenate(kept)


def _beaten(rows: FloatArray, front: FloatArray) -> NDArray[np.bool_]:
    """Whether a row of the front is at most each row in every goal, shape (rows,).

    The front goes by in pieces: most rows are beaten by its beginning.
    """
    beaten = np.zeros(len(rows), dtype=np.bool_)
    for start in range(0, len(front), _BLOCK):
        open_rows = np.flatnonzero(~beaten)
        if not open_rows.size:
            break
        piece = front[start : start + _BLOCK]
        under = piece[:, np.newaxis, 0] <= rows[open_rows, 0]
        for goal in range(1, rows.shape[1]):
            under &= piece[:, np.newaxis, goal] <= rows[open_rows, goal]
        beaten[open_rows] = np.any(under, axis=0)
    return beaten
