"""Rows that were computed together, computed once more one by one: how far the two are apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dqforge.optimizer.exploration.block_rows import Column
from dqforge.optimizer.variant_steps.outputs import Output

EVERY = 1000  # Of every so many rows of a study one is computed by both paths.


def audited_rows(first: int, end: int) -> range:
    """Rows first to end - 1 that both paths compute.

    Args:
        first, end: Rows of a block.
    """
    return range(first + (-first) % EVERY, end, EVERY)


def deviations(
    outputs: Sequence[Output],
    row: int,
    batch: Mapping[str, Column],
    single: Mapping[str, Column],
) -> dict[str, float]:
    """Relative deviation of every number of a row from the single path's, by output.

    A number that only one of the two paths has deviates infinitely; so does another choice. What
    says which path was taken is no number of the design.

    Args:
        outputs: What was asked for.
        row: Place of the row in ``batch``.
        batch: Columns of the block.
        single: Columns of the row alone.
    """
    return {
        output.name: _apart(float(batch[output.name][row]), float(single[output.name][0]))
        for output in outputs
        if output.name != "fit.path"
    }


def _apart(batch: float, single: float) -> float:
    if batch == single or (np.isnan(batch) and np.isnan(single)):
        return 0.0
    if not (np.isfinite(batch) and np.isfinite(single)):
        return float("inf")
    return abs(batch - single) / max(abs(single), abs(batch))


def largest(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Largest deviations of several rows, by output in the order of the first.

    Args:
        found: Deviations of each row.
    """
    names = found[0] if found else ()
    return {name: max(each[name] for each in found) for name in names}
