"""Slips among the currents of a flux map: a value far beyond all others of its axis,
named with its line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:  # the points' own module calls these checks
    from dqforge.machines.flux_maps.flux_points import FluxPoints


_MOST_OUTLIERS = 3
_FEWEST = 8
_FAR = 3.0  # Distance to the others over their span from which on a value is none of them.
_STEPS = 1.5

# Points that share a current on a grid, from which on one that stands alone beyond the others is a
# slip.
_USUAL = 4


def check_outliers(points: FluxPoints) -> None:
    """Refuse points of which one has a current that belongs to no axis.

    Raises:
        InputError: With the line of the point in its file, or its number where the file has no
            lines.
    """
    for name, values in (("i_d", points.i_d), ("i_q", points.i_q)):
        worst = _outlier(values)
        if worst is None:
            continue
        rest = np.delete(values, worst)
        number = "" if points.lines is not None else f" of point {worst + 1}"
        raise InputError(
            f"{name} = {values[worst]:g} A{number} lies far from all others, which run from "
            f"{np.min(rest):g} to {np.max(rest):g} A (psi_d "
            f"{format_quantity(float(points.psi_d[worst]), 'Wb')} there); correct that point or "
            "remove it",
            source=points.source,
            line=None if points.lines is None else int(points.lines[worst]),
        )


def _outlier(values: FloatArray) -> int | None:
    """Place of a current far beyond all others, None if there is none."""
    if values.size < _FEWEST:
        return None
    order = np.argsort(values, kind="stable")
    for ascending in (values[order], -values[order[::-1]]):
        place = order if ascending[0] == values[order[0]] else order[::-1]
        if (found := _beyond(ascending)) is not None:
            return int(place[found])
    return None


def _beyond(ascending: FloatArray) -> int | None:
    """First of a few values at the end of an ascending row that lie far beyond the rest."""
    for count in range(1, _MOST_OUTLIERS + 1):
        rest = ascending[:-count]
        gap, span = float(ascending[-count] - rest[-1]), float(rest[-1] - rest[0])
        if gap > _FAR * span > 0.0:
            return ascending.size - count
    axis, counts = np.unique(ascending, return_counts=True)
    if (
        axis.size < _USUAL
        or counts[-1] > 1
        or np.median(counts[:-1]) < _USUAL
        or np.min(counts[:-1]) < _USUAL
    ):
        return None
    steps = np.diff(axis)
    return ascending.size - 1 if steps[-1] > _STEPS * np.max(steps[:-1]) else None
