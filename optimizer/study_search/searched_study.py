"""The rows of a study that a search chooses: one generation after the other."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.exploration.study import Search
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import ColumnSpec, Inputs, RowBlock, chosen_inputs
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.optimizer.study_results.acceptance import (
    AcceptedRange,
    GoalColumn,
    bound_column,
    goal_columns,
)
from dqforge.optimizer.study_search.open_search import open_search
from dqforge.optimizer.study_search.search_rows import (
    Outcomes,
    SearchRows,
    generation_batch,
    outcomes_of,
    search_variables,
)


@dataclass(frozen=True, slots=True, eq=False)
class GenerationRows:
    """Rows of one generation (a `RowSource`), at their places in the study.

    Args:
        plan: How rows are computed.
        batch: Rows per part.
        start: Index of the first row of the generation.
        points: What the search chose for its rows, shape (P, axes).
    """

    plan: StudyPlan
    batch: int
    start: int
    points: FloatArray

    def __reduce__(self) -> tuple[object, ...]:
        """Travel with the plan in one piece: whoever knows it has its steps already."""
        return _arrived, (pickle.dumps(self.plan), self.batch, self.start, self.points)

    @property
    def count(self) -> int:
        """Rows of the whole study."""
        return self.plan.count

    @property
    def size(self) -> int:
        """Rows of the generation."""
        return len(self.points)

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block."""
        return self.plan.columns

    def inputs(self, first: int, end: int) -> Inputs:
        """What goes into rows first to end - 1 of the study, by key.

        Args:
            first, end: Range of rows of this generation.
        """
        return chosen_inputs(self.plan.study, self.points[first - self.start : end - self.start])

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Keys of rows first to end - 1 of the study, shape (n, 16).

        Args:
            first, end: Range of rows of this generation.
        """
        return self.plan.keys_of(self.inputs(first, end))

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1 of the study, computed.

        Args:
            first, end: Range of rows of this generation.
        """
        return self.plan.rows_of(self.inputs(first, end), first, end - first)


def _arrived(packed: bytes, batch: int, start: int, points: FloatArray) -> GenerationRows:
    return GenerationRows(_plan(packed), batch, start, points)


@lru_cache(maxsize=1)
def _plan(packed: bytes) -> StudyPlan:
    """The plan of the study that this process computes, with what is known of its steps."""
    found: StudyPlan = pickle.loads(packed)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class SearchedStudy:
    """A study with a search.

    Args:
        plan: How its rows are computed.
        search: What its file says of the search.
    """

    plan: StudyPlan
    search: Search

    @property
    def batch(self) -> int:
        """Rows per part; no part lies in two generations."""
        return generation_batch(self.search.population, self.plan.batch)

    @property
    def parts_of_generation(self) -> int:
        """Number of parts of a generation."""
        return self.search.population // self.batch

    def begun(self) -> SearchRows:
        """The search before its first generation.

        Raises:
            InputError: The method does not suit the study, or its library is not installed.
        """
        study = self.plan.study
        variables = search_variables(study.axes)
        return open_search(self.search, variables, len(study.goals), len(study.limits))

    def generation(self, number: int, points: FloatArray) -> GenerationRows:
        """Rows of a generation.

        Args:
            number: Of the generation, from 0.
            points: What the search chose, shape (P, axes).
        """
        return GenerationRows(self.plan, self.batch, number * self.search.population, points)

    @property
    def _goals(self) -> tuple[GoalColumn, ...]:
        return goal_columns(self.plan.study)

    @property
    def _limits(self) -> tuple[AcceptedRange, ...]:
        return tuple(bound_column(bound, self.plan.base) for bound in self.plan.study.limits)

    @property
    def judged_columns(self) -> tuple[str, ...]:
        """Columns that the outcomes of rows follow from."""
        names = [goal.column for goal in self._goals] + [limit.column for limit in self._limits]
        return tuple(dict.fromkeys(names))

    def outcomes(
        self, columns: Mapping[str, FloatArray | NDArray[np.int32]], states: NDArray[np.int8]
    ) -> Outcomes:
        """What a search is told of a generation.

        Args:
            columns: `judged_columns` of its rows in their order, shape (P,).
            states: Places in `STATES`, shape (P,).
        """
        return outcomes_of(self._goals, self._limits, columns, states)
