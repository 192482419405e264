"""Points of a flux map that are given repeatedly: their means are taken,
and how much they scatter is told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:  # the points' own module merges them
    from dqforge.machines.flux_maps.flux_points import FluxPoints


_SAME = 1e-6

# Distance of a repeated point from the mean over the largest flux linkage that is no scatter any
# more.
_WORST_SCATTER = 0.05
_MOST_NAMED = 8


@dataclass(frozen=True, slots=True)
class Merged:
    """Points of which no two have the same currents, the number that was merged,
    and how their flux linkages scatter.

    ``scatter`` is the standard deviation of one measurement in Wb, over all repeated points;
    0 without any.
    """

    points: FluxPoints
    repeated: int
    scatter: float
    findings: tuple[str, ...]


def merge_repeats(points: FluxPoints) -> Merged:
    """Points with equal currents made one, equal currents equal to the last digit.

    Raises:
        InputError: Repeated points differ by more than measurements do: something else than the
            currents tells them apart.
    """
    largest = max(float(np.max(np.abs(points.i_d))), float(np.max(np.abs(points.i_q))))
    if points.blur:
        return _merge_near(points, points.blur * largest)
    tolerance = _SAME * largest
    rows, i_d = _labels(points.i_d, tolerance)
    columns, i_q = _labels(points.i_q, tolerance)
    cells, inverse, counts = np.unique(
        rows * i_q.size + columns, return_inverse=True, return_counts=True
    )
    given = np.stack([points.psi_d, points.psi_q])
    psi = np.stack([np.bincount(inverse, part) / counts for part in given])
    away = np.max(np.abs(given - psi[:, inverse]), axis=0)
    repeated = points.i_d.size - cells.size
    first = np.full(cells.size, points.i_d.size)
    np.minimum.at(first, inverse, np.arange(points.i_d.size))
    single = replace(
        points,
        i_d=i_d[cells // i_q.size],
        i_q=i_q[cells % i_q.size],
        psi_d=psi[0],
        psi_q=psi[1],
        torque=None,
        lines=None if points.lines is None else points.lines[first],
    )
    if repeated == 0:
        return Merged(single, 0, 0.0, ())
    worst = int(np.argmax(away))
    largest = float(np.max(np.abs(given)))
    where = f"i_d = {points.i_d[worst]:g} A, i_q = {points.i_q[worst]:g} A"
    if away[worst] > _WORST_SCATTER * largest:
        raise _contradiction(points, int(counts[inverse[worst]]), where, float(away[worst]), worst)
    scatter = float(np.sqrt(np.sum((given - psi[:, inverse]) ** 2) / (2 * repeated)))
    findings = f"{repeated} points are given repeatedly and were merged"
    if away[worst] > _SAME * largest:
        size, most = (format_quantity(value, "Wb", 3) for value in (scatter, float(away[worst])))
        findings = (
            f"{repeated} points repeat others and their means are taken: a single one scatters by "
            f"{size} (standard deviation), at most {most} from the mean, at {where} of the file"
        )
    return Merged(single, repeated, scatter, (findings,))


def _merge_near(points: FluxPoints, width: float) -> Merged:
    """Points in one square of a width in A made one, with the means of currents and flux linkages:
    the same operating point at other speeds.
    """
    given = np.stack([points.i_d, points.i_q, points.psi_d, points.psi_q])
    squares = np.round(given[:2] / width)
    _, inverse, counts = np.unique(squares, axis=1, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(inverse, part) / counts for part in given])
    away = np.max(np.abs(given[2:] - means[2:, inverse]), axis=0)
    largest, worst = float(np.max(np.abs(given[2:]))), int(np.argmax(away))
    if away[worst] > _WORST_SCATTER * largest:
        where = f"i_d = {points.i_d[worst]:g} A, i_q = {points.i_q[worst]:g} A"
        raise _contradiction(points, int(counts[inverse[worst]]), where, float(away[worst]), worst)
    first = np.full(counts.size, points.i_d.size)
    np.minimum.at(first, inverse, np.arange(points.i_d.size))
    single = replace(
        points,
        i_d=means[0],
        i_q=means[1],
        psi_d=means[2],
        psi_q=means[3],
        torque=None,
        lines=None if points.lines is None else points.lines[first],
    )
    repeated = points.i_d.size - counts.size
    sentence = (
        f"{points.i_d.size} operating points lie at {counts.size} currents further than "
        f"{format_quantity(width, 'A', 2)} apart; means are taken of the others"
    )
    return Merged(single, repeated, 0.0, (sentence,) if repeated else ())


def _contradiction(
    points: FluxPoints, count: int, where: str, away: float, worst: int
) -> InputError:
    others = (
        f" (columns of the file beside: {', '.join(points.others[:8])})" if points.others else ""
    )
    return InputError(
        f"the point {where} of the file is given {count} times, with flux linkages up to "
        f"{format_quantity(away, 'Wb', 3)} from their mean: more than scatter{others}; name what "
        "tells them apart, columns: {angle: NAME}, {temperature: NAME} or {speed: NAME}, or keep "
        "one of them",
        source=points.source,
        line=None if points.lines is None else int(points.lines[worst]),
    )


def _labels(values: FloatArray, tolerance: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Group of equal values that each value belongs to, shape (K,), and the mean of each group,
    ascending.
    """
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    new = np.diff(ascending) > tolerance
    starts, ends = np.flatnonzero(np.append(True, new)), np.flatnonzero(np.append(new, True))
    groups = np.append(0, np.cumsum(new))
    if np.max(ascending[ends] - ascending[starts]) > 10.0 * tolerance:
        # So many values that each touches the next: steps of the tolerance tell them apart.
        groups = np.unique(np.round((ascending - ascending[0]) / tolerance), return_inverse=True)[1]
    means = np.bincount(groups, ascending) / np.bincount(groups)
    labels = np.empty(values.size, dtype=np.intp)
    labels[order] = groups
    return labels, np.where(np.abs(means) <= tolerance, 0.0, means)
