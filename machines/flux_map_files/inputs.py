"""Flux maps from arrays in memory and from files, in the axes and the scaling
that their owner declares.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.names import FluxAxes, FluxFitName, FluxScaling

SOURCE = "flux map from arrays"
_MOST_BYTES = 256_000_000


_QUANTITIES = ("i_d", "i_q", "psi_d", "psi_q")


def make_flux_map(
    i_d: ArrayLike,
    i_q: ArrayLike,
    psi_d: ArrayLike,
    psi_q: ArrayLike,
    *,
    axes: FluxAxes = "magnet-d",
    scaling: FluxScaling = "peak",
    fit: FluxFitName = "auto",
    extrapolate: bool = False,
) -> FluxMap:
    """A flux map of arrays: a grid, or points in any order.

    Args:
        i_d, i_q: Currents in A: axes of shapes (M,) and (N,) of a grid, or the currents of each
            point, of the shape of psi_d. The half plane i_q >= 0 is enough, it is mirrored; a full
            plane is averaged with its mirror image.
        psi_d, psi_q: Flux linkages in Wb, shape (M, N) on a grid, else any one shape.
        axes: ``magnet-d`` with d along the magnets, or ``reluctance`` with the magnets on the
            negative q axis.
        scaling: Of currents and flux linkages: ``peak``, ``rms`` or ``power-invariant``.
        fit: ``interpolate``: a spline through the points; ``smooth``: a smooth co-energy near them;
            ``auto``: smooth where noise asks for it.
        extrapolate: Whether currents beyond the map may be used; results that use them are marked.

    Raises:
        InputError: The shapes do not fit, a number is not finite, or the points are no map of a
            machine.
    """
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map
    from dqforge.machines.flux_maps.flux_points import FluxPoints

    given = (i_d, i_q, psi_d, psi_q)
    values = [_numbers(part, name) for part, name in zip(given, _QUANTITIES, strict=True)]
    points = FluxPoints(SOURCE, *_points(*values))
    treatment = FluxTreatment(fit)
    return build_flux_map(
        points, axes=axes, scaling=scaling, extrapolate=extrapolate, treatment=treatment
    ).flux_map


def read_flux_map(
    file: str | Path,
    *,
    axes: FluxAxes = "magnet-d",
    scaling: FluxScaling | None = None,
    fit: FluxFitName = "auto",
    extrapolate: bool = False,
) -> FluxMap:
    """The flux map in a file of any layout that a design may name (docs/methods/flux-maps.md).

    Args:
        file: Text, spreadsheet, NPZ, MAT, HDF5, or what finite-element tools write.
        axes, fit, extrapolate: As for `make_flux_map`.
        scaling: Likewise; None takes what the names in the file say, else peak values.

    Raises:
        InputError: The file cannot be read, or is no map of a machine as it is declared.
    """
    from dqforge.machines.flux_map_files.files import read_flux_points
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map

    points = read_flux_points(read_regular_file(file, _MOST_BYTES), str(file))
    treatment = FluxTreatment(fit)
    return build_flux_map(
        points, axes=axes, scaling=scaling, extrapolate=extrapolate, treatment=treatment
    ).flux_map


def _numbers(values: ArrayLike, name: str) -> FloatArray:
    """An array of finite numbers."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: expected an array of numbers, got {type(values).__name__}"
        ) from None
    if array.size and not np.all(np.isfinite(array)):
        place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        raise InputError(
            f"{name}: the value at index {place} is {array[place]}; measure it or leave its row out"
        )
    return array


def _points(
    i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """All four at each point, shape (K,)."""
    if psi_d.shape != psi_q.shape:
        raise InputError(
            f"psi_d has the shape {psi_d.shape}, psi_q {psi_q.shape}; give both on the same points"
        )
    if i_d.ndim == i_q.ndim == 1 and psi_d.ndim == 2:
        if psi_d.shape != (i_d.size, i_q.size):
            hint = "; give psi_d.T and psi_q.T" if psi_d.shape == (i_q.size, i_d.size) else ""
            raise InputError(
                f"psi_d has the shape {psi_d.shape}, the axes i_d and i_q need "
                f"{(i_d.size, i_q.size)}{hint}"
            )
        i_d, i_q = np.meshgrid(i_d, i_q, indexing="ij")
    if not i_d.shape == i_q.shape == psi_d.shape:
        raise InputError(
            f"i_d, i_q and psi_d have the shapes {i_d.shape}, {i_q.shape} and {psi_d.shape}; give "
            "axes (M,) and (N,) with flux linkages (M, N), or four arrays of one shape"
        )
    return i_d.ravel(), i_q.ravel(), psi_d.ravel(), psi_q.ravel()
