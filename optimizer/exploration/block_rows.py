"""Rows of a block while they are computed: columns that fill, and how each row ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.errors import DqforgeError, NoSolutionError
from dqforge.optimizer.exploration.row_block import STATES, RowState
from dqforge.optimizer.variant_steps.outputs import Output

Column = FloatArray | NDArray[np.int32]

# What a row is called that ends in two ways.
_RANK: Mapping[RowState, int] = {
    "ok": 0,
    "limit": 1,
    "no-solution": 2,
    "refused": 3,
    "crashed": 4,
}


def state_of(error: DqforgeError) -> RowState:
    """How a row ends that is refused with an error.

    Args:
        error: As the single command would print it.
    """
    return "no-solution" if isinstance(error, NoSolutionError) else "refused"


@dataclass(slots=True)
class BlockRows:
    """Columns of N rows by the name of the output, NaN (-1 for choices) until they are filled.

    Args:
        count: Number of rows N.
        outputs: What is asked for.
    """

    count: int
    outputs: Sequence[Output]
    columns: dict[str, Column] = field(init=False)
    states: NDArray[np.int8] = field(init=False)
    messages: list[str] = field(init=False)

    def __post_init__(self) -> None:
        """Start with nothing."""
        self.columns = {
            output.name: np.full(self.count, -1, dtype=np.int32)
            if output.choices
            else np.full(self.count, np.nan)
            for output in self.outputs
        }
        self.states = np.full(self.count, STATES.index("ok"), dtype=np.int8)
        self.messages = [""] * self.count

    def put(self, rows: IndexArray, found: Mapping[str, ArrayLike]) -> None:
        """Fill columns of some rows; what nobody asked for is left out."""
        for name, values in found.items():
            if name in self.columns:
                self.columns[name][rows] = values

    def end(self, row: int, state: RowState, message: str) -> None:
        """Say how a row ended; of several ways the worst, of equal ones the first."""
        if _RANK[state] > _RANK[STATES[self.states[row]]]:
            self.states[row] = STATES.index(state)
            self.messages[row] = message

    def refuse(self, rows: IndexArray, error: DqforgeError) -> None:
        """End rows with what the single command would print."""
        state, message = state_of(error), str(error)
        for row in rows.tolist():
            self.end(row, state, message)

    def plain(self) -> dict[str, Column]:
        """The columns with one NaN and one zero: the same bytes wherever they were computed."""
        return {name: one_kind(values) for name, values in self.columns.items()}


def one_kind(values: Column) -> Column:
    """Numbers with positive quiet NaN and without negative zero; choices as they are.

    Args:
        values: A column.
    """
    if values.dtype != np.float64:
        return values
    return np.where(np.isnan(values), np.nan, values + 0.0)
