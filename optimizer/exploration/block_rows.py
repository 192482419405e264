"""Rows of a block while they are computed: columns that fill, and how each row ended."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.optimizer.exploration.row_block import STATES, RowState
from dqforge.optimizer.variant_steps.exact_steps import ExactSteps, GainsLeftOutError, Numbers
from dqforge.optimizer.variant_steps.outputs import (
    FIT_PATHS,
    STEPS,
    Asked,
    LossColumns,
    LossRows,
    Output,
    Step,
    loss_columns,
)
from dqforge.optimizer.variant_steps.variation import of_comparison, of_table

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


# One row, or several that share a design, by the exact path: the steps that are asked for, each
# as the single command computes it.


def exact_step(
    steps: ExactSteps, asked: Asked, block: BlockRows, rows: IndexArray, step: Step, design: Design
) -> None:
    """Compute a step of a design and fill it in for all rows that share what it depends on.

    Args:
        steps: The steps, with what is known already.
        asked: What the study asks for.
        block: Filled; rows that are refused end there.
        rows: The rows.
        step: The step.
        design: Their design.
    """
    try:
        if step == "losses":
            put_losses(block, rows, exact_losses(steps, asked, design))
        else:
            block.put(rows, _numbers(steps, step, design))
    except GainsLeftOutError as error:
        if asked.gains_named:
            block.refuse(rows, error)
    except DqforgeError as error:
        block.refuse(rows, error)


def exact_row(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    row: int,
    design: Design,
    only: Collection[Step] = STEPS,
) -> None:
    """Compute the steps of one row.

    Args:
        steps, asked, block: As in `exact_step`.
        row: Its place in the block.
        design: Its design.
        only: Steps that are still missing.
    """
    for step in asked.steps:
        if step in only:
            exact_step(steps, asked, block, np.array([row]), step, design)


def _numbers(steps: ExactSteps, step: Step, design: Design) -> Numbers:
    if step == "limit":
        return steps.limit(design)
    if step == "fit":
        return {**steps.fit(design), "fit.path": FIT_PATHS.index("exact")}
    if step == "current-loops":
        return steps.current_loops(design)
    return steps.all_loops(design)


def exact_losses(steps: ExactSteps, asked: Asked, design: Design) -> LossColumns:
    """Columns of losses of one design.

    Args:
        steps, asked: As in `exact_step`.
        design: The design.

    Raises:
        DqforgeError: It names no points, or they are refused.
    """
    return loss_columns(_loss_rows(steps, design), asked.of_step("losses"))


def _loss_rows(steps: ExactSteps, design: Design) -> LossRows:
    losses = design.losses
    if losses is None or not losses.points:
        raise InputError("losses: this variant names no operating points")
    table = steps.loss_table(design)
    if table is None:
        return of_comparison(steps.losses(design))
    place = steps.grid.frequencies.index(design.inverter.f_sw)
    return of_table(table, losses, np.array([place]))


def table_losses(
    steps: ExactSteps, asked: Asked, design: Design, frequencies: Sequence[float]
) -> LossColumns | None:
    """Columns of losses of N rows that differ in carrier frequency alone, None where there is no
    table of them.

    Args:
        steps, asked: As in `exact_step`.
        design: The design of one of them.
        frequencies: Their carrier frequencies in Hz.
    """
    known = {value: place for place, value in enumerate(steps.grid.frequencies)}
    losses = design.losses
    if losses is None or not all(value in known for value in frequencies):
        return None
    table = steps.loss_table(design)
    if table is None:
        return None
    places = np.array([known[value] for value in frequencies], dtype=np.intp)
    rows = of_table(table, losses, places)
    return loss_columns(rows, asked.of_step("losses"))


def put_losses(block: BlockRows, rows: IndexArray, found: LossColumns) -> None:
    """Fill in losses, and end rows whose points are not all fine.

    Args:
        block: Filled.
        rows: The rows.
        found: Columns of as many rows, or of one that they share.
    """
    block.put(rows, found.columns)
    shared = found.missing.size == 1
    for place, row in enumerate(rows.tolist()):
        at = 0 if shared else place
        obstacle = found.obstacles.get(at)
        if obstacle is not None:
            block.end(row, "no-solution" if found.missing[at] else "limit", obstacle)
