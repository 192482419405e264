"""What a two-dimensional reference errs by over its domain, and the lines that divide the domain:
for people to see.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.field_weakening.form import SurfaceSamples, WeakeningReference, error_map
from dqforge.optimizer.operating_points.point_problem import Active

_COUNT = 56
_BORDER_POINTS = 200
_BEYOND = 1.04  # Multiple of the largest flux linkage at which the chart ends.


@dataclass(frozen=True, slots=True)
class DomainBorders:
    """Lines in the plane of available flux linkage in Wb and torque in N m.

    ``mtpa_flux`` and ``mtpa_torque``, shape (K,), are the least-loss currents, above which the
    field is weakened; ``flux`` and ``largest_torque``, shape (N,), the most torque that can be had.
    ``mtpv``, shape (N,), says where the voltage alone holds that torque.
    """

    mtpa_flux: FloatArray
    mtpa_torque: FloatArray
    flux: FloatArray
    largest_torque: FloatArray
    mtpv: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ErrorChart:
    """Errors of the float32 currents over available flux linkage in Wb and torque in N m,
    arrays of shape (N, N).

    The flux linkage varies along the first axis, the torque along the second up to the largest of
    its row. ``torque_error`` is relative to the largest torque of all, ``voltage_error`` to the
    voltage of the optimum, both signed fractions; where the optimum takes less than the least flux
    linkage, only too little is counted.
    """

    flux: FloatArray
    torque: FloatArray
    torque_error: FloatArray
    voltage_error: FloatArray
    borders: DomainBorders


def _samples(region: WeakeningRegion) -> SurfaceSamples:
    """Even grid up to the largest torque of each flux linkage, flux linkages along the first
    axis.
    """
    flux = np.linspace(region.flux_min, _BEYOND * region.flux_max, _COUNT)
    most = region.largest_torque(flux)
    torque = np.linspace(0.0, 1.0, _COUNT) * most[:, np.newaxis]
    spread, limits = (
        np.broadcast_to(row[:, np.newaxis], torque.shape).ravel() for row in (flux, most)
    )
    return SurfaceSamples(torque.astype(np.float32).ravel(), spread.astype(np.float32), limits)


def _borders(region: WeakeningRegion) -> DomainBorders:
    torque = np.linspace(0.0, region.torque_max, _BORDER_POINTS)
    taken = region.flux(*region.mtpa(torque))
    seen = taken >= region.flux_min
    flux = np.linspace(region.flux_min, _BEYOND * region.flux_max, _BORDER_POINTS)
    points = region.points(np.full(flux.size, 2.0 * region.torque_max), flux)
    return DomainBorders(
        taken[seen], torque[seen], flux, points.torque, points.active == Active.MTPV
    )


def error_chart(region: WeakeningRegion, reference: WeakeningReference) -> ErrorChart:
    """Errors of a reference over an even grid of its domain, without fused multiply-add."""
    samples = _samples(region)
    found = error_map(region, reference, samples)
    shape = (_COUNT, _COUNT)
    flux, torque = (
        values.astype(np.float64).reshape(shape) for values in (samples.flux, samples.torque)
    )
    # Where MTPA takes less than is available, that is what is aimed at.
    aim = np.minimum(region.flux(*region.mtpa(torque.ravel())), flux.ravel())
    excess = region.flux(found.i_d, found.i_q) / np.maximum(aim, 0.5 * region.flux_min) - 1.0
    excess = np.where(aim < region.flux_min, np.minimum(excess, 0.0), excess)
    return ErrorChart(
        flux=flux,
        torque=torque,
        torque_error=(found.torque / region.torque_max).reshape(shape),
        voltage_error=excess.reshape(shape),
        borders=_borders(region),
    )
