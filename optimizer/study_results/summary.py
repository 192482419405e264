"""Everything that the rows of a study say together, from its parts one after the other.

One part is in memory at a time; what is kept of the others does not grow with their number, but for
the front. The same parts in the same order give the same digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.optimizer.study_results.acceptance import AcceptanceTally, AcceptedRange, StudyRows
from dqforge.optimizer.study_results.fronts import Front, empty_front, front_of
from dqforge.optimizer.study_results.histograms import Histogram, empty_histogram
from dqforge.optimizer.study_results.sensitivities import (
    BinnedOutput,
    Sensitivities,
    binned_output,
    sensitivities,
)
from dqforge.optimizer.study_results.sobol_indices import SaltelliSums


@dataclass(frozen=True, slots=True)
class GoalColumn:
    """An output that is made small, or large where ``minimise`` is not set."""

    column: str
    minimise: bool = True


@dataclass(frozen=True, slots=True)
class StudyQuestion:
    """What is asked of the rows together, by the names of their columns.

    Args:
        accept: What is accepted.
        goals: Goals of the front; none for no front.
        inputs: Columns told of a worst row.
        drawn: Inputs that are drawn.
        sensitivity: Outputs whose sensitivity to them is asked for.
        spread: Outputs that have a histogram.
        saltelli: Whether rows are those of `dqforge.optimizer.exploration.saltelli_design`, for
            first-order and total sensitivities. Then shares count the two independent samples
            alone: the others repeat all of their inputs but one.
    """

    accept: tuple[AcceptedRange, ...] = ()
    goals: tuple[GoalColumn, ...] = ()
    inputs: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()
    sensitivity: tuple[str, ...] = ()
    spread: tuple[str, ...] = ()
    saltelli: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that are needed, each once."""
        names = [each.column for each in self.accept] + [each.column for each in self.goals]
        drawn = self.drawn if self.sensitivity else ()
        return tuple(dict.fromkeys([*self.inputs, *drawn, *names, *self.sensitivity, *self.spread]))


@dataclass(frozen=True, slots=True)
class StudySummary:
    """What the rows say together.

    Args:
        question: What was asked.
        rows: All rows.
        acceptance: Shares, worst rows, rows by how they ended.
        front: The front of the rows in state ``ok``; None where no goal was asked for.
        sensitivities: Of each output asked for, in that order.
        spread: Histograms of outputs, in the order asked for.
    """

    question: StudyQuestion
    rows: int
    acceptance: AcceptanceTally
    front: Front | None
    sensitivities: tuple[Sensitivities, ...]
    spread: tuple[Histogram, ...]


def summarise(question: StudyQuestion, parts: Iterable[StudyRows]) -> StudySummary:
    """Go through the parts of a study once.

    Args:
        question: What is asked; a part holds `StudyQuestion.columns`.
        parts: Parts in their order.
    """
    rows = 0
    acceptance = AcceptanceTally(question.accept, question.inputs)
    front = empty_front(len(question.goals)) if question.goals else None
    binned: dict[str, BinnedOutput] = {}
    sums = {name: SaltelliSums(len(question.drawn)) for name in question.sensitivity}
    spread = {name: empty_histogram() for name in question.spread}
    for part in parts:
        counted = _independent(question, part)
        acceptance = acceptance.plus(part, counted)
        if front is not None:
            front = front.plus(_front_of_part(question.goals, part))
        _add_sensitivities(question, part, counted, binned, sums)
        for name in question.spread:
            spread[name] = spread[name].plus(_numbers(part, name)[counted])
        rows += part.states.size
    return StudySummary(
        question,
        rows,
        acceptance,
        front,
        _sensitivities(question, binned, sums),
        tuple(spread.values()),
    )


def _numbers(part: StudyRows, name: str) -> FloatArray:
    return np.asarray(part.columns[name], dtype=np.float64)


def _independent(question: StudyQuestion, part: StudyRows) -> BoolArray:
    """Rows that were drawn independently of each other."""
    size = part.states.size
    if not question.saltelli:
        return np.ones(size, dtype=np.bool_)
    return np.asarray((part.first + np.arange(size)) % (len(question.drawn) + 2) < 2)


def _front_of_part(goals: Sequence[GoalColumn], part: StudyRows) -> Front:
    fine = np.flatnonzero(part.states == STATES.index("ok"))
    index: NDArray[np.int64] = part.first + fine.astype(np.int64)
    signed = [
        _numbers(part, goal.column)[fine] * (1.0 if goal.minimise else -1.0) for goal in goals
    ]
    return front_of(index, np.column_stack(signed))


def _add_sensitivities(
    question: StudyQuestion,
    part: StudyRows,
    counted: BoolArray,
    binned: dict[str, BinnedOutput],
    sums: dict[str, SaltelliSums],
) -> None:
    """Add a part to the sums of every output; the bins' edges are those of the first part."""
    if not question.sensitivity or not question.drawn:
        return
    inputs = np.column_stack([_numbers(part, name)[counted] for name in question.drawn])
    for name in question.sensitivity:
        values = _numbers(part, name)
        if question.saltelli:
            sums[name] = sums[name].plus(values)
        if name not in binned:
            binned[name] = binned_output(inputs, values[counted])
        binned[name] = binned[name].plus(inputs, values[counted])


def _sensitivities(
    question: StudyQuestion, binned: dict[str, BinnedOutput], sums: dict[str, SaltelliSums]
) -> tuple[Sensitivities, ...]:
    found = []
    for name, bins in binned.items():
        by_bins = sensitivities(name, question.drawn, bins)
        if question.saltelli:
            indices = sums[name].indices()
            # Columns of the design stand in alphabetical order.
            places = [sorted(question.drawn).index(each) for each in question.drawn]
            by_bins = by_bins.designed(indices.first[places], indices.total[places])
        found.append(by_bins)
    return tuple(found)
