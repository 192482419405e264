"""Losses of rows from what was computed for many modulators and frequencies at once, for one
design, or for many machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.optimizer.variant_steps.loss_columns import LossRows, mapped
from dqforge.optimizer.variant_steps.loss_tables import LossTable


def point_weights(points: Sequence[LoadPoint]) -> FloatArray:
    """Weights of points with the sum 1.

    Args:
        points: Operating points with their own weights.
    """
    given = np.array([point.weight for point in points])
    return np.asarray(given / np.sum(given))


def of_comparison(found: LossComparison) -> LossRows:
    """One row from the comparison of one design.

    Args:
        found: Losses (S, M, P).
    """
    return LossRows(
        found.strategies,
        found.modulations,
        found.points,
        mapped(found.budget, lambda values: values[..., None]),
        found.reached[..., None],
        point_weights(found.points),
    )


def of_table(table: LossTable, losses: LossSettings, places: IndexArray) -> LossRows:
    """N rows that differ in carrier frequency alone.

    Args:
        table: Losses (S, M, F, P) with every modulator and frequency of the study.
        losses: Points, strategies and modulators of the rows.
        places: Places of their frequencies in the table, shape (N,).
    """
    known = table.modulations
    names = np.array([known.index(name) for name in losses.modulations], dtype=np.intp)

    def chosen(values: NDArray[Any]) -> NDArray[Any]:
        picked = values[:, names][:, :, places]
        return np.swapaxes(picked, -1, -2)

    return LossRows(
        losses.strategies,
        losses.modulations,
        losses.points,
        mapped(table.budget, chosen),
        chosen(table.reached),
        point_weights(losses.points),
    )
