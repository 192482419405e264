"""Columns of losses: of every alternative at a point the one that loses least, then means and
largest values over the points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.settings import AnyStrategy, LoadPoint
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import DriveBudget
from dqforge.optimizer.variant_steps.outputs import (
    LOSS_POWERS,
    LOSS_QUANTITIES,
    Output,
    PointOutput,
    word_index,
)

_EQUAL_LOSS = 1e-9  # Totals that differ by less count as equal: the first alternative is taken.


@dataclass(frozen=True, slots=True, eq=False)
class LossRows:
    """Losses of N rows: S strategies with M modulators at P points.

    Args:
        strategies, modulations, points: Labels.
        budget: Arrays of the shape (S, M, P, N).
        reached: Whether the currents make the torque, shape (S, M, P, N).
        weights: Of the points, shape (P,), with the sum 1.
    """

    strategies: tuple[AnyStrategy, ...]
    modulations: tuple[ModulationName, ...]
    points: tuple[LoadPoint, ...]
    budget: DriveBudget
    reached: BoolArray
    weights: FloatArray

    @property
    def count(self) -> int:
        """Number of rows N."""
        return int(self.reached.shape[-1])


@dataclass(frozen=True, slots=True, eq=False)
class LossColumns:
    """Columns by name, and how each row ended.

    Args:
        columns: Numbers (N,), or places in the words of a choice.
        obstacles: Why the best alternative of a point cannot be used, by row: empty where it can.
        missing: Rows that have no numbers at a point, shape (N,).
    """

    columns: dict[str, FloatArray | NDArray[np.int32]]
    obstacles: dict[int, str]
    missing: BoolArray


def mapped(budget: DriveBudget, change: Callable[[NDArray[Any]], NDArray[Any]]) -> DriveBudget:
    """A budget with every array changed alike.

    Args:
        budget: Arrays of one shape.
        change: What becomes of each.
    """
    columns: dict[str, Any] = {
        part.name: change(getattr(budget, part.name)) for part in fields(DriveBudget)
    }
    return DriveBudget(**columns)


def loss_columns(rows: LossRows, outputs: Sequence[Output]) -> LossColumns:
    """Columns of the outputs that are asked for.

    Args:
        rows: Losses of every alternative.
        outputs: Outputs of the step ``losses``.
    """
    best = _best(rows, "")
    columns: dict[str, FloatArray | NDArray[np.int32]] = {}
    for output in outputs:
        point = output.point
        if point is None:
            columns[output.name] = _over_points(rows, best, output.quantity)
        elif output.choices:
            columns[output.name] = _word(rows, _best(rows, point.modulation), point, output.choices)
        else:
            chosen = best if not point.modulation else _best(rows, point.modulation)
            columns[output.name] = _values(rows, chosen, point.quantity)[point.place]
    total = _values(rows, best, "total")
    return LossColumns(columns, _obstacles(rows, best), np.any(np.isnan(total), axis=0))


def _flat(values: NDArray[Any]) -> NDArray[Any]:
    """(S, M, P, N) as (S M, P, N)."""
    return values.reshape(-1, *values.shape[2:])


def _usable(rows: LossRows) -> BoolArray:
    return np.asarray(rows.reached & rows.budget.feasible)


def _best(rows: LossRows, modulation: str) -> IndexArray:
    """Flat place over strategies and modulators of the alternative that loses least, (P, N).

    Those that can be used within the tables of the device come first, then those that can be used,
    then those that have numbers at all; -1 where none has.
    """
    usable = _usable(rows)
    known = rows.reached & np.isfinite(rows.budget.total)
    if modulation:
        of_it = np.array([name == modulation for name in rows.modulations])[:, None, None]
        usable, known = usable & of_it, known & of_it
    found = np.full(rows.reached.shape[2:], -1, dtype=np.intp)
    for mask in (usable & rows.budget.within_tables, usable, known):
        total = _flat(np.where(mask, rows.budget.total, np.inf))
        least = np.min(total, axis=0)
        first = np.argmax(total <= least * (1.0 + _EQUAL_LOSS), axis=0)
        found = np.where((found < 0) & np.isfinite(least), first, found)
    return found


def _taken(values: NDArray[Any], place: IndexArray) -> NDArray[Any]:
    """Values (S, M, P, N) of the alternatives at places (P, N), of the first where none is."""
    taken: NDArray[Any] = np.take_along_axis(_flat(values), np.maximum(place, 0)[None], axis=0)[0]
    return taken


def _values(rows: LossRows, place: IndexArray, quantity: str) -> FloatArray:
    """A quantity of the chosen alternatives, (P, N), NaN where there is none."""
    if quantity not in LOSS_QUANTITIES:
        raise KeyError(quantity)
    taken = _taken(getattr(rows.budget, quantity), place)
    return np.where(place >= 0, taken, np.nan).astype(np.float64)


def _over_points(rows: LossRows, place: IndexArray, quantity: str) -> FloatArray:
    values = _values(rows, place, quantity)
    if quantity in LOSS_POWERS:
        return np.asarray(np.sum(rows.weights[:, None] * values, axis=0))
    return np.asarray(np.max(values, axis=0))


def _word(
    rows: LossRows, place: IndexArray, point: PointOutput, words: tuple[str, ...]
) -> NDArray[np.int32]:
    """Modulator or strategy that was chosen at a point, as its place in the words; -1 for none."""
    at = place[point.place]
    count = len(rows.modulations)
    own = at % count if point.quantity == "modulation" else at // count
    labels = rows.modulations if point.quantity == "modulation" else rows.strategies
    known = np.array([word_index(words, label) for label in labels], dtype=np.int32)
    return np.where(at >= 0, known[np.maximum(own, 0)], np.int32(-1)).astype(np.int32)


_OBSTACLES = (
    ("steady", "the junction or the winding finds no balance of heat"),
    ("linear", "the voltage is beyond the linear range of the modulator"),
    ("cool_enough", "the junction is hotter than the device permits"),
    ("within_tables", "beyond the ends of the tables of the device"),
)


def _obstacles(rows: LossRows, best: IndexArray) -> dict[int, str]:
    """What is wrong with rows at their first point without numbers, else at the first that is not
    fine.
    """
    fine = _taken(_usable(rows) & rows.budget.within_tables, best).astype(bool) & (best >= 0)
    found = {}
    for row in np.flatnonzero(~np.all(fine, axis=0)).tolist():
        none = best[:, row] < 0
        place = int(np.argmax(none)) if np.any(none) else int(np.argmin(fine[:, row]))
        found[row] = f"losses.points[{place}]: {_reason(rows, best, place, row)}"
    return found


def _reason(rows: LossRows, best: IndexArray, place: int, row: int) -> str:
    point = rows.points[place]
    if best[place, row] < 0:
        alternatives = "no alternative makes" if _several(rows) else "the drive cannot make"
        steady = rows.reached[:, :, place, row] & ~rows.budget.steady[:, :, place, row]
        if np.any(steady):
            return _OBSTACLES[0][1]
        return f"{alternatives} {point.torque:.4g} N m at {point.omega_m:.4g} rad/s"
    at = divmod(int(best[place, row]), len(rows.modulations))
    for name, words in _OBSTACLES:
        if not getattr(rows.budget, name)[(*at, place, row)]:
            return words
    return "the torque is not made"


def _several(rows: LossRows) -> bool:
    return len(rows.strategies) * len(rows.modulations) > 1
