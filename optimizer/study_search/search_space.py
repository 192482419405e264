"""What a search varies: ranges between their ends, steps in an order, and choices without one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Axis
from dqforge.machines.records import dataclass

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
