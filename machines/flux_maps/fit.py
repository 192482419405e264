"""Whether a flux map is interpolated or smoothed, and the smoothed map on its
grid with the price of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.flux_maps.checks import energy_misfit
from dqforge.machines.flux_maps.co_energy import CoEnergy
from dqforge.machines.flux_maps.evidence import (
    MOST_PLACES,
    NOISE_LIMIT,
    NOTABLE_CURL,
    FluxFit,
    places,
)
from dqforge.machines.flux_maps.noise import FluxNoise, inductance_noise
from dqforge.machines.flux_maps.smoothing import outliers, smooth_co_energy
from dqforge.machines.names import FluxFitName
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

_FINE_GRID = 20_000


_LEAST_NODES = 40


@dataclass(frozen=True, slots=True, eq=False)
class FluxData:
    """What there is to fit: a plain grid and the points behind it.

    ``i_d``, ``i_q`` are its axes in A, ``psi`` its flux linkages (2, M, N) in Wb. ``at_d``,
    ``at_q`` and ``values`` are the points, shapes (K,), (K,), (2, K), with their ``noise``, None
    where nothing but a fit shows it. ``is_grid``: the points are the nodes. ``hull`` is where
    scattered points lie, None for those of a grid.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi: FloatArray
    at_d: FloatArray
    at_q: FloatArray
    values: FloatArray
    noise: FluxNoise | None
    is_grid: bool
    hull: CurrentRegion | None = None


def _judged(data: FluxData) -> tuple[FloatArray, FloatArray]:
    """Where a plain spline must have positive definite inductances: nodes and middles of cells,
    or the points.
    """
    if not data.is_grid:
        return data.at_d, data.at_q
    axes = [data.i_d, data.i_q]
    if data.psi[0].size <= _FINE_GRID:
        axes = [np.sort(np.append(axis, 0.5 * (axis[1:] + axis[:-1]))) for axis in axes]
    i_d, i_q = np.meshgrid(*axes, indexing="ij")
    return i_d.ravel(), i_q.ravel()


def _faults(data: FluxData) -> tuple[tuple[tuple[float, float], ...], int]:
    """Middles of the cells where a plain spline is not admissible, the first of them,
    and how many there are.
    """
    i_d, i_q = _judged(data)
    jet = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1]).jet(i_d, i_q)
    mutual = 0.5 * (jet.l_dq + jet.l_qd)
    bad = (jet.l_dd <= 0.0) | (jet.l_qq <= 0.0) | (jet.l_dd * jet.l_qq <= mutual**2)
    if not np.any(bad):
        return (), 0
    rows = np.clip(np.searchsorted(data.i_d, i_d[bad], side="right") - 1, 0, data.i_d.size - 2)
    columns = np.clip(np.searchsorted(data.i_q, i_q[bad], side="right") - 1, 0, data.i_q.size - 2)
    cells = np.unique(np.stack([rows, columns], axis=1), axis=0)
    middle = [0.5 * (axis[1:] + axis[:-1]) for axis in (data.i_d, data.i_q)]
    named = tuple(
        (float(middle[0][row]), float(middle[1][column])) for row, column in cells[:MOST_PLACES]
    )
    return named, cells.shape[0]


def _fine(axis: FloatArray) -> FloatArray:
    """An axis with each step divided evenly, so that cubics through its nodes follow the smooth
    map.
    """
    parts = -(-_LEAST_NODES // (axis.size - 1))
    if parts == 1:
        return axis
    share = np.arange(parts) / parts
    inner = (axis[:-1, np.newaxis] + share * np.diff(axis)[:, np.newaxis]).ravel()
    return np.append(inner, axis[-1])


def _refuse_outliers(data: FluxData, off: NDArray[np.bool_], fit: CoEnergy, source: str) -> None:
    """Name all points that are no noise."""
    if not np.any(off):
        return
    which = np.flatnonzero(off)
    named = tuple((float(data.at_d[k]), float(data.at_q[k])) for k in which[:MOST_PLACES])
    apart = np.abs(data.values - fit.flux_at(data.at_d, data.at_q))[:, which]
    raise InputError(
        f"{which.size} points lie far from the smooth map through the others, by up to "
        f"{format_quantity(float(np.max(apart)), 'Wb', 3)}: {places(named, which.size)} (peak, d "
        "along the magnets); measure them again, or remove them from the file",
        source=source,
    )


def _priced(data: FluxData, fit: CoEnergy, found: FluxFit) -> FluxFit:
    """The fit with what smoothing changes against the plain spline at the points."""
    plain = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1])
    apart = fit.flux_at(data.at_d, data.at_q) - np.stack(plain.flux(data.at_d, data.at_q))
    torque = 1.5 * (apart[0] * data.at_q - apart[1] * data.at_d)
    rms, largest = np.sqrt(np.mean(apart**2, axis=1)), np.max(np.abs(apart), axis=1)
    return replace(
        found,
        residual_rms=(float(rms[0]), float(rms[1])),
        residual_largest=(float(largest[0]), float(largest[1])),
        torque_rms=float(np.sqrt(np.mean(torque**2))),
        torque_largest=float(np.max(np.abs(torque))),
        freedom=fit.freedom,
    )


def fit_flux(
    data: FluxData, wanted: FluxFitName, source: str, *, even: bool = True
) -> tuple[FluxMap, FluxFit]:
    """The map through the points, or the smooth one near them, as ``wanted``.

    Not marked for extrapolation.

    Raises:
        InputError: Points that lie far from all others, or data that no machine has.
    """
    plain = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1])
    faults, count = _faults(data)
    noise = data.noise
    try:
        if noise is None and wanted != "interpolate":
            noise = smooth_co_energy(
                data.at_d, data.at_q, data.values, None, even=even, positive=False
            ).noise
        share = 0.0 if noise is None else _inductance_noise(data, noise)
        curl = 0.0 if data.hull is None else energy_misfit(replace(plain, hull=data.hull))
        sound = count == 0 and share <= NOISE_LIMIT and curl <= NOTABLE_CURL
        if wanted == "interpolate" or (wanted == "auto" and sound):
            return plain, FluxFit(wanted, "interpolate", noise, share, faults, count, curl=curl)
        off, found = outliers(data.at_d, data.at_q, data.values, data.noise, even=even)
    except (NoSolutionError, np.linalg.LinAlgError) as error:
        raise InputError(f"the flux map cannot be smoothed: {error}", source=source) from None
    _refuse_outliers(data, off, found, source)
    i_d, i_q = _fine(data.i_d), _fine(data.i_q)
    if found.d.even and i_d[0] < 0.0 < i_d[-1]:
        i_d = np.union1d(i_d[np.abs(i_d) > 1e-9 * i_d[-1]], [0.0])
    psi = found.flux(i_d, i_q)
    if found.d.even:
        psi[0, i_d == 0.0] = 0.0  # to the last digit, too, so that there are no magnets
    used = FluxFit(wanted, "smooth", found.noise, share, faults, count, curl=curl)
    return FluxMap(i_d, i_q, psi[0], psi[1]), _priced(data, found, used)


def _inductance_noise(data: FluxData, noise: FluxNoise) -> float:
    """Noise of the incremental inductances of a plain spline over their mean.

    Scattered points have a mean step.
    """
    share = inductance_noise(noise, data.i_d, data.i_q, data.psi)
    return share if data.is_grid else share * float(np.sqrt(data.at_d.size / data.psi[0].size))
