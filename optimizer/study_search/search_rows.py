"""The seam between a search and whoever computes its rows.

A search hands out one generation after the other: `ask` gives the inputs of all its rows at once,
`tell` takes their outcomes, in the order of the rows, whenever the last of them is in. In which
order they were computed therefore cannot matter. Row i of generation g is row g P + i of the study,
P rows per generation. A search is deterministic in its seed and its outcomes: one that was cut off
goes on after the finished generations have been asked for and told again, which computes no row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Axis
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.optimizer.study_results.acceptance import AcceptedRange, GoalColumn

PARTS = 4  # Parts of a generation, about: enough for the workers of one machine.


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """What became of the rows of one generation, in their order.

    Args:
        goals: What is made small, shape (n, G); anything where a row has no values.
        excess: How far each limit is broken, as a share of it, shape (n, L); at most 0 where it is
            kept.
        known: Whether a row has values, shape (n,).
    """

    goals: FloatArray
    excess: FloatArray
    known: NDArray[np.bool_]


class SearchRows(Protocol):
    """A search under way."""

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        """What it varies, in the order of the columns of its points."""
        ...

    @property
    def population(self) -> int:
        """Rows of each generation."""
        ...

    @property
    def generation(self) -> int:
        """Generations that have been told."""
        ...

    def ask(self) -> FloatArray:
        """Inputs of the next generation, shape (population, V): a number in the SI unit of its key
        for a range, the place of the step of its axis for others. The same until it is told.
        """
        ...

    def tell(self, outcomes: Outcomes) -> None:
        """What became of the rows of the generation asked for."""
        ...


def generation_batch(population: int, largest: int) -> int:
    """Rows of a part: a divisor of the population, so that no part lies in two generations; about
    a quarter of it and no more than ``largest``.

    Args:
        population: Rows of a generation.
        largest: Rows that a part may have by the kind of the study.
    """
    wish = max(min(population // PARTS, largest), 1)
    divisors = [size for size in range(wish, 0, -1) if population % size == 0]
    below = divisors[0]
    # A prime number of rows would make parts of one row each: better one part of all.
    return population if below * 16 < wish and population <= largest else below


def outcomes_of(
    goals: Sequence[GoalColumn],
    limits: Sequence[AcceptedRange],
    columns: Mapping[str, FloatArray | NDArray[np.int32]],
    states: NDArray[np.int8],
) -> Outcomes:
    """Outcomes of the rows of a generation from their columns.

    Args:
        goals: What is made small or large.
        limits: Limits of the study.
        columns: Columns of the rows by name, shape (n,).
        states: Places in `STATES`, shape (n,).
    """
    signed = [
        np.asarray(columns[each.column], dtype=np.float64) * (1.0 if each.minimise else -1.0)
        for each in goals
    ]
    broken = [_excess(each, np.asarray(columns[each.column], dtype=np.float64)) for each in limits]
    found = np.column_stack(signed)
    excess = np.column_stack(broken) if broken else np.zeros((states.size, 0))
    ended = np.isin(states, [STATES.index("ok"), STATES.index("limit")])
    known = ended & np.all(np.isfinite(found), axis=1) & np.all(np.isfinite(excess), axis=1)
    # A row may be beyond a limit that is none of the study's, such as the end of a table.
    elsewhere = (states == STATES.index("limit")) & ~np.any(excess > 0.0, axis=1)
    return Outcomes(found, excess, known & ~elsewhere)


def _excess(limit: AcceptedRange, values: FloatArray) -> FloatArray:
    """How far values lie beyond a limit, as a share of it; negative within."""
    bounds = [abs(bound) for bound in (limit.below, limit.above) if bound is not None]
    size = max([bound for bound in bounds if bound > 0.0], default=1.0)
    share = limit.excess(values) / size
    return np.asarray(np.where(limit.met(values), np.minimum(share, 0.0), share))


# What a search varies: ranges between their ends, steps in an order, and choices without one.

VariableKind = Literal["range", "steps", "choice"]


@dataclass(frozen=True, slots=True)
class SearchVariable:
    """One axis of a study as a search sees it.

    Args:
        keys: What varies, in step.
        kind: ``range``: any number from ``low`` to ``high``; ``steps``: one of ``count`` steps
            whose numbers ascend or descend; ``choice``: one of ``count`` without an order.
        low, high: Ends of a range in SI units.
        logarithmic: Whether equal ratios of a range count alike, not equal differences.
        count: Number of steps.
    """

    keys: tuple[str, ...]
    kind: VariableKind
    low: float = 0.0
    high: float = 0.0
    logarithmic: bool = False
    count: int = 0

    def value(self, share: FloatArray) -> FloatArray:
        """Numbers in SI units at shares of a range, any shape, or the places of steps as they
        are.
        """
        if self.kind != "range":
            return share
        if self.logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + (self.high - self.low) * share
        return np.clip(value, min(self.low, self.high), max(self.low, self.high))


def search_variables(axes: Sequence[Axis]) -> tuple[SearchVariable, ...]:
    """What a search varies, one variable per axis.

    Args:
        axes: Axes of the study.

    Raises:
        InputError: Nothing varies.
    """
    if not axes:
        raise InputError("search: nothing varies; write the keys to search over under vary")
    return tuple(_variable(axis) for axis in axes)


def _variable(axis: Axis) -> SearchVariable:
    count = len(axis.steps)
    numbers = np.array(axis.numbers, dtype=np.float64)
    if axis.continuous:
        low, high = float(numbers[0, 0]), float(numbers[-1, 0])
        return SearchVariable(axis.keys, "range", low, high, axis.spacing == "log")
    steps = np.diff(numbers[:, 0]) if axis.numbers else np.zeros(0)
    ordered = axis.numbers and (bool(np.all(steps > 0.0)) or bool(np.all(steps < 0.0)))
    return SearchVariable(axis.keys, "steps" if ordered else "choice", count=count)


def values_of(variables: Sequence[SearchVariable], points: FloatArray) -> FloatArray:
    """Points as rows have them, shape (n, V): numbers of ranges in SI units, places of steps.

    Args:
        variables: What varies.
        points: Shares of ranges from 0 to 1, and places of steps, shape (n, V).
    """
    columns = [each.value(points[:, place]) for place, each in enumerate(variables)]
    return np.column_stack(columns)


def drawn_points(
    variables: Sequence[SearchVariable], count: int, random: np.random.Generator
) -> FloatArray:
    """Points at random, shares of ranges and places of steps, shape (count, V).

    Args:
        variables: What varies.
        count: Number of points.
        random: Source of the numbers.
    """
    columns = [
        random.random(count)
        if each.kind == "range"
        else random.integers(0, each.count, count).astype(np.float64)
        for each in variables
    ]
    return np.column_stack(columns)
