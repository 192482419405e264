"""Nodes of a mesh of exact operating points: least currents over torque, and over the flux linkage
that is left.

Rows crowd where the currents move much with the torque, and columns divide the way of the currents
evenly, so that all cells are of a size in the plane of the currents: what a bilinear cell errs by
goes with the square of that size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.exact import WeakeningRegion

# Points on the way of the currents, whose lengths decide where nodes lie.
_FINE_ROWS, _FINE_COLUMNS = 161, 33

# Levels of the flux linkage at which the largest torque is looked up, and steps from there.
_LEVELS = 257
_HALVINGS = 20
_LEAST_FLUX = 1e-9  # of the largest one
Currents = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class Nodes:
    """Torques of the rows in N m, shape (K + 1,), and currents in A, shape (K + 1, N + 1)."""

    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def _lengths(currents: Currents) -> FloatArray:
    """Length of the way to each point along the last axis, in A, beginning with 0."""
    steps = np.hypot(*(np.diff(part, axis=-1) for part in currents))
    start = np.zeros((*steps.shape[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)


def _even(way: FloatArray, at: FloatArray, cells: int) -> FloatArray:
    """Arguments that divide a way evenly, shape (cells + 1,)."""
    if way[-1] <= 0.0:
        return np.linspace(at[0], at[-1], cells + 1)
    # A little of the argument itself keeps nodes apart where the currents rest.
    mixed = way / way[-1] + 1e-3 * (at - at[0]) / (at[-1] - at[0])
    return np.asarray(np.interp(np.linspace(0.0, mixed[-1], cells + 1), mixed, at))


def line_nodes(currents: Callable[[FloatArray], Currents], end: float, rows: int) -> Nodes:
    """Nodes of one column: currents that a torque alone decides.

    Args:
        currents: (i_d, i_q) in A of torques in N m, shape (N,).
        end: Largest torque in N m.
        rows: Cells along the torque.
    """
    # Crowded at the start, where currents may rise like a root.
    fine = end * np.linspace(0.0, 1.0, _FINE_ROWS) ** 3
    torque = _even(_lengths(currents(fine)), fine, rows)
    i_d, i_q = currents(torque)
    return Nodes(torque, i_d[:, np.newaxis], i_q[:, np.newaxis])


def _least_flux(
    region: WeakeningRegion, torque: FloatArray, taken: FloatArray, halvings: int
) -> FloatArray:
    """Least flux linkage in Wb within which torques in N m can be had, shape (N,); not below that
    of the domain, not above ``taken``, that of the least currents.
    """
    levels = np.linspace(region.flux_min, region.flux_max, _LEVELS)
    most = np.maximum.accumulate(region.largest_torque(levels))
    place = np.minimum(np.searchsorted(most, torque), _LEVELS - 1)
    low, high = levels[np.maximum(place - 1, 0)], levels[place]
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        reached = region.largest_torque(middle) >= torque
        low, high = np.where(reached, low, middle), np.where(reached, middle, high)
    return np.minimum(high, taken)


@dataclass(frozen=True, slots=True)
class RowWays:
    """How far the currents of both ends of the rows move along the torque, up to the corner of the
    domain and beyond it: arrays of torques in N m, and of lengths in A.
    """

    torque: tuple[FloatArray, ...]
    length: tuple[FloatArray, ...]


def row_ways(region: WeakeningRegion, end: float) -> RowWays:
    """Ways up to the largest torque at the least flux linkage, where the ends of the rows turn a
    corner, and from there to ``end`` in N m.
    """
    corner = float(region.largest_torque(np.array([region.flux_min]))[0])
    share = np.linspace(0.0, 1.0, _FINE_ROWS)
    parts = [end * share**3]
    if corner < 0.999 * end:
        parts = [corner * share**3, corner + (end - corner) * (0.5 - 0.5 * np.cos(np.pi * share))]
    return RowWays(tuple(parts), tuple(_way(region, torque) for torque in parts))


def _rows(ways: RowWays, rows: int) -> FloatArray:
    """Torques of the rows in N m; one of them is that of the corner."""
    parts = len(ways.length)
    total = sum(float(way[-1]) for way in ways.length)
    first = rows if parts == 1 else round(rows * float(ways.length[0][-1]) / total)
    first = min(max(first, 1), rows - parts + 1)
    pairs = zip(ways.length, ways.torque, [first, rows - first], strict=False)
    nodes = [_even(way, at, cells) for way, at, cells in pairs]
    return np.concatenate([nodes[0], *(part[1:] for part in nodes[1:])])


def _way(region: WeakeningRegion, torque: FloatArray) -> FloatArray:
    least = region.mtpa(torque)
    taken = region.flux(*least)
    levels = _least_flux(region, torque, taken, 3)[:, np.newaxis]
    end = [part[:, 0] for part in _points(region, torque, levels)]
    return np.asarray(_lengths(least) + _lengths((end[0], end[1])))


def mesh_nodes(region: WeakeningRegion, ways: RowWays, shape: tuple[int, int]) -> Nodes:
    """Nodes over torque and flux linkage.

    Args:
        region: Domain of torque and flux linkage.
        ways: Its ways along the torque.
        shape: Cells along the torque, and along the flux linkage.
    """
    rows, columns = shape
    torque = _rows(ways, rows)
    taken = region.flux(*region.mtpa(torque))
    least = _least_flux(region, torque, taken, _HALVINGS)
    share = np.linspace(0.0, 1.0, _FINE_COLUMNS)
    fine = taken[:, np.newaxis] + (least - taken)[:, np.newaxis] * share
    across = _lengths(_points(region, torque, fine))
    even = np.array([_even(way, share, columns) for way in across])
    flux = taken[:, np.newaxis] + (least - taken)[:, np.newaxis] * even
    return Nodes(torque, *_points(region, torque, flux))


def _points(region: WeakeningRegion, torque: FloatArray, flux: FloatArray) -> Currents:
    """Least currents in A for the torques of rows within flux linkages, shape (K + 1, M)."""
    spread = np.broadcast_to(torque[:, np.newaxis], flux.shape)
    # A flux linkage that the least current just takes must not seem to be too little for it,
    # and without torque a machine without magnets takes none.
    levels = np.maximum(flux * (1.0 + 1e-12), _LEAST_FLUX * region.flux_max)
    found = region.points(spread.ravel(), levels.ravel())
    return found.i_d.reshape(flux.shape), found.i_q.reshape(flux.shape)
