"""Flux maps at a magnet temperature between those of several maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError


def flux_map_of_maps(
    temperatures: FloatArray, maps: Sequence[FluxMap], temperature: float
) -> FluxMap:
    """Flux map at a magnet temperature between those of several maps, on the
    rectangle that all of them cover.

    Between two maps linear in the temperature, else by monotone cubics (PCHIP) through all. The
    nodes are those of the map with the finest axis, for each axis.

    Args:
        temperatures: Of the maps in any order, in degC, shape (n,), n >= 2.
        maps: One for each.
        temperature: At which the map is wanted, in degC.

    Raises:
        InputError: Less than two maps, a repeated temperature, one outside the range, or maps that
            cover no common rectangle.
    """
    from scipy.interpolate import PchipInterpolator

    if len(maps) < 2 or temperatures.shape != (len(maps),):
        raise InputError(
            f"{len(maps)} flux maps and {temperatures.size} temperatures; give two or more of both"
        )
    order = np.argsort(temperatures)
    known = temperatures[order]
    if not np.all(np.diff(known) > 0.0):
        raise InputError("two flux maps have the same magnet temperature; keep one of them")
    if not known[0] <= temperature <= known[-1]:
        raise InputError(
            f"the magnet temperature {temperature:g} degC lies outside those of the flux maps, "
            f"{known[0]:g} to {known[-1]:g} degC; add a map or change the temperature"
        )
    i_d, i_q = _common([part.i_d for part in maps]), _common([part.i_q for part in maps])
    psi = np.stack([np.stack(maps[index].flux(i_d[:, np.newaxis], i_q)) for index in order])
    if len(maps) == 2:
        share = (temperature - known[0]) / (known[1] - known[0])
        here = (1.0 - share) * psi[0] + share * psi[1]
    else:
        here = PchipInterpolator(known, psi, axis=0)(temperature)
    hull = None
    if any(part.hull is not None for part in maps):
        hull = maps[0].region
        for part in maps[1:]:
            hull = hull.within(part.region)
    return FluxMap(i_d, i_q, here[0], here[1], all(part.extrapolate for part in maps), hull)


def _common(axes: Sequence[FloatArray]) -> FloatArray:
    """Nodes of the finest axis on the range that all axes cover, with its ends."""
    low, high = max(float(axis[0]) for axis in axes), min(float(axis[-1]) for axis in axes)
    finest = min(axes, key=lambda axis: float(axis[-1] - axis[0]) / (axis.size - 1))
    near = 0.25 * float(np.min(np.diff(finest)))
    inner = finest[(finest > low + near) & (finest < high - near)]
    if inner.size < 2:
        raise InputError(
            f"the flux maps overlap only from {low:g} to {high:g} A in one current; give them "
            "equal ranges"
        )
    return np.concatenate([[low], inner, [high]])
