"""Rows of a block that share everything but numbers of a linear drive, computed together as far as
formulas for many machines go; the others one design at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.block_rows import (
    BlockRows,
    exact_row,
    exact_step,
    put_losses,
    table_losses,
)
from dqforge.optimizer.variant_steps.exact_steps import ExactSteps
from dqforge.optimizer.variant_steps.outputs import Asked, Step
from dqforge.optimizer.variant_steps.variation import BATCH_STEPS, BatchRows, Variation

_CARRIER = "inverter.f_sw"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Rows that differ in numbers alone.

    Args:
        rows: Their places in the block, shape (N,).
        numbers: Values of the keys that vary in SI units, arrays of shape (N,).
        design: The design of one of them by its place in the group.
        variation: How the numbers change the design; None where that is not known: then every row
            is made by itself.
    """

    rows: IndexArray
    numbers: Mapping[str, FloatArray]
    design: Callable[[int], Design]
    variation: Variation | None


def fill_group(steps: ExactSteps, asked: Asked, block: BlockRows, group: Group) -> None:
    """Compute all outputs of the rows of a group.

    Args:
        steps: The exact steps, with what is known already.
        asked: What the study asks for.
        block: Filled.
        group: The rows.
    """
    if group.variation is None:
        for place in range(group.rows.size):
            _fill_row(steps, asked, block, group, place, asked.steps)
        return
    again: dict[int, set[Step]] = {}
    for step in asked.steps:
        missed = _fill_step(steps, asked, block, group, group.variation, step)
        for place in np.flatnonzero(missed).tolist():
            again.setdefault(place, set()).add(step)
    for place, missing in sorted(again.items()):
        _fill_row(steps, asked, block, group, place, missing)


def _fill_row(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    group: Group,
    place: int,
    only: Collection[Step],
) -> None:
    """One row by the exact path, refused where its design is."""
    row = int(group.rows[place])
    steps.work.designs += 1
    try:
        design = group.design(place)
    except DqforgeError as error:
        block.refuse(np.array([row]), error)
        return
    exact_row(steps, asked, block, row, design, only)


def _fill_step(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    group: Group,
    variation: Variation,
    step: Step,
) -> BoolArray:
    """Fill in a step for all rows at once; returns those that are still missing, shape (N,)."""
    every = np.ones(group.rows.size, dtype=np.bool_)
    keys = variation.keys_of(partial(steps.key, step))
    if not keys:
        exact_step(steps, asked, block, group.rows, step, variation.base)
        return ~every
    columns = variation.columns(group.numbers)
    names = {name for key in keys for name, _ in variation.effects[key].factors}
    if step == "losses" and names == {_CARRIER}:
        found = table_losses(steps, asked, variation.base, columns[_CARRIER].tolist())
        if found is None:
            return every
        put_losses(block, group.rows, found)
        return ~every
    compute = BATCH_STEPS.get(step)
    if compute is None:
        return every
    rows = BatchRows(variation.base, columns, asked)
    filled = compute(rows)
    if filled is None:
        return every
    steps.work.batches += 1
    block.put(group.rows[filled.done], filled.taken())
    for place, message in filled.obstacles.items():
        block.end(int(group.rows[place]), "limit", message)
    return ~filled.done


def goes_together(steps: ExactSteps, asked: Asked, variation: Variation, count: int) -> bool:
    """Whether rows of a variation are computed together in every step that is asked for.

    Args:
        steps, asked: As in `fill_group`.
        variation: How numbers change the design.
        count: Rows to try it with, between the ends of the numbers.
    """
    share = np.linspace(0.0, 1.0, count)
    for step in asked.steps:
        keys = variation.keys_of(partial(steps.key, step))
        names = {name for key in keys for name, _ in variation.effects[key].factors}
        if not keys or (step == "losses" and names == {_CARRIER}):
            continue
        columns = variation.between(share)
        compute = BATCH_STEPS.get(step)
        rows = BatchRows(variation.base, columns, asked)
        if compute is None or compute(rows) is None:
            return False
    return True
