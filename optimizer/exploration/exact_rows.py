"""One row, or several that share a design, by the exact path: the steps that are asked for, each
as the single command computes it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from dqforge.machines.arrays import IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.variant_steps.asked_steps import STEPS, Asked
from dqforge.optimizer.variant_steps.exact_steps import ExactSteps, GainsLeftOutError, Numbers
from dqforge.optimizer.variant_steps.loss_columns import LossColumns, LossRows, loss_columns
from dqforge.optimizer.variant_steps.loss_rows import of_comparison, of_table
from dqforge.optimizer.variant_steps.outputs import FIT_PATHS, Step


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
