"""Flux maps from points in any order: grids or scattered points become a map, with all that
was found and done on the way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.asymmetry import in_turned_frame, turned_flux
from dqforge.machines.flux_maps.checks import check_holes, check_map, check_points, energy_misfit
from dqforge.machines.flux_maps.conversion import conversion_findings, converted, scaling_of_points
from dqforge.machines.flux_maps.evidence import FluxFit
from dqforge.machines.flux_maps.fit import FluxData, fit_flux
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.loss_check import MeasuredLoss
from dqforge.machines.flux_maps.noise import FluxNoise, noise_of_grid, noise_of_repeats
from dqforge.machines.flux_maps.outliers import check_outliers
from dqforge.machines.flux_maps.planes import (
    SAME,
    Plane,
    filled_grid,
    half_of_points,
    kept_apart,
    largest_magnitude,
    one_half,
    symmetric_plane,
)
from dqforge.machines.flux_maps.repeated_points import merge_repeats
from dqforge.machines.flux_maps.scattered_points import scattered_plane
from dqforge.machines.flux_maps.torque_check import TorqueCheck, check_torque
from dqforge.machines.names import FluxAxes, FluxFitName, FluxScaling, FluxSymmetry, FluxTorque
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

MOST_NODES = 500_000  # Points of a map, a half plane with its mirror image.
_WORST_ASYMMETRY = 0.25


@dataclass(frozen=True, slots=True)
class FluxTreatment:
    """How points become a map.

    ``fit``: the map goes through the points, is smoothed, or is smoothed where noise or faults ask
    for it. ``symmetry``: both halves make the map (``average``, and ``keep``, whose halves are in
    `FluxMapReading.whole`), or one. ``frame_angle`` is the turn of the file's frame in rad
    (electrical).
    """

    fit: FluxFitName = "auto"
    symmetry: FluxSymmetry = "average"
    frame_angle: float = 0.0


PLAIN = FluxTreatment()


@dataclass(frozen=True, slots=True)
class FluxMapReading:
    """A flux map with what was found and done on the way.

    ``findings`` are sentences for the user. ``energy_misfit`` is the r.m.s. difference of the two
    mutual inductances over the r.m.s. of the diagonal ones. ``asymmetry`` is the largest distance
    in Wb between the given flux linkages and their symmetric part, half the difference between
    mirrored points. ``scatter`` is the standard deviation in Wb of repeated points, 0 without any.
    ``torque`` compares the torque that the file gives, None where it gives none. ``fit`` says
    whether the points were smoothed, and ``whole`` is the map over both halves as they are, None
    where only one is known. ``most`` is the largest torque per pole pair in N m that the points
    themselves have, and their largest current in A; ``loss`` is what the file gives beside.
    """

    flux_map: FluxMap
    findings: tuple[str, ...]
    energy_misfit: float
    asymmetry: float
    fit: FluxFit
    whole: FluxMap | None
    scatter: float = 0.0
    torque: TorqueCheck | None = None
    most: tuple[float, float] = (0.0, 0.0)
    loss: MeasuredLoss | None = None


def build_flux_map(
    points: FluxPoints,
    *,
    axes: FluxAxes = "magnet-d",
    scaling: FluxScaling | None = None,
    extrapolate: bool = False,
    expected_psi_pm: float | None = None,
    pole_pairs: int | None = None,
    torque: FluxTorque = "air-gap",
    treatment: FluxTreatment = PLAIN,
) -> FluxMapReading:
    """Flux map through points in any order, once they are found sound.

    Points that fill a grid are its nodes. Others are interpolated by thin-plate splines: on their
    own grid where they are at least half of one, else on a regular grid over their bounding box.
    Half planes are mirrored, full planes averaged with their mirror image; of a plane with unequal
    halves the larger one counts.

    Args:
        points: Points as in the file, shape (K,).
        axes, scaling: Convention of the file; without a scaling that which the names say, else peak
            values.
        extrapolate: Whether the map may be used beyond its grid.
        expected_psi_pm: Flux linkage of the magnets in Wb (peak), if known from elsewhere; the
            scaling is checked with it.
        pole_pairs: Of the machine; a torque in the file is held against that of its flux linkages
            with it.
        torque: What the torque of the file is: 'air-gap', 'shaft', 'per-pole-pair', or 'ignore'.
        treatment: How the points become a map.

    Raises:
        InputError: The points do not make a map, or not that of a machine; see also `check_points`
            and `check_map`.
    """
    source, angle, symmetry = points.source, treatment.frame_angle, treatment.symmetry
    _check_size(points.i_d.size, source)
    check_holes(points)
    check_outliers(points)
    merged = merge_repeats(points)
    check_points(merged.points, axes)
    known, said = scaling_of_points(points, scaling)
    if pole_pairs is not None and points.pole_pairs not in (0, pole_pairs):
        raise InputError(
            f"the file states {points.pole_pairs} pole pairs, the design has {pole_pairs}; correct "
            "one of them",
            source=source,
        )
    compared = None if pole_pairs is None else check_torque(points, pole_pairs, known, torque)
    single = converted(merged.points, axes, known)
    plane, noise, is_grid = _plane(single, angle)
    turned = _turned(single, angle)
    if plane.asymmetry > _WORST_ASYMMETRY * largest_magnitude(single.psi_d, single.psi_q):
        raise _unequal_halves(plane, turned, treatment, source)
    _check_size(plane.psi[0].size, source)
    if plane.raw is None and symmetry != "average":
        message = (
            f"symmetry: {symmetry} needs points of both halves, i_q > 0 and i_q < 0; leave it out"
        )
        raise InputError(message, source=source)
    peak = converted(points, axes, known)
    noise = _noise_of_repeats(peak) or noise
    whole = _Given(plane, turned, noise, is_grid)
    given = _chosen(whole, symmetry)
    zero = _zero_current(given.plane.i_d, source)
    flux_map, used = _fitted(given, given.plane.psi, treatment.fit, source, extrapolate=extrapolate)
    halves = None
    if plane.raw is not None:
        halves = _fitted(whole, plane.raw, used.used, source, extrapolate=extrapolate, even=False)[
            0
        ]
    findings = (
        *points.findings,
        *said,
        *conversion_findings(axes, known),
        *merged.findings,
        *(() if compared is None else (compared.sentence,)),
        *((f"the frame was turned by {np.degrees(angle):.4g} deg (electrical)",) if angle else ()),
        *(map(kept_apart, given.plane.findings) if symmetry == "keep" else given.plane.findings),
        *zero,
        *check_map(flux_map, source, expected_psi_pm),
    )
    torques = 1.5 * (single.psi_d * single.i_q - single.psi_q * single.i_d)
    return FluxMapReading(
        flux_map,
        findings,
        energy_misfit(flux_map),
        plane.asymmetry,
        used,
        halves,
        merged.scatter,
        compared,
        (float(np.max(np.abs(torques))), float(np.max(np.hypot(single.i_d, single.i_q)))),
        None
        if points.loss is None
        else MeasuredLoss(points.loss.name, points.loss.values, peak.i_d, peak.i_q),
    )


@dataclass(frozen=True, slots=True)
class _Given:
    """What is fitted: a plane, the points behind it in its frame, their noise,
    and whether they fill a grid.
    """

    plane: Plane
    points: FluxPoints
    noise: FluxNoise | None
    is_grid: bool


def _unequal_halves(
    plane: Plane, points: FluxPoints, treatment: FluxTreatment, source: str
) -> InputError:
    """What to say of halves that are no mirror images; where few points make them differ,
    these are named instead.
    """
    if treatment.fit != "interpolate":
        _refuse_single_points(plane, points, source)
    return InputError(
        "the halves i_q > 0 and i_q < 0 are no mirror images: they lie "
        f"{format_quantity(plane.asymmetry, 'Wb')} from their mean; psi_d must be even and psi_q "
        "odd in i_q (d along the magnets), check the signs",
        source=source,
    )


def _chosen(whole: _Given, symmetry: FluxSymmetry) -> _Given:
    """The half that is wanted, completed by its mirror image; both where none is."""
    if symmetry not in ("positive", "negative"):
        return whole
    plane, points = one_half(whole.plane, symmetry), half_of_points(whole.points, symmetry)
    if plane.hull is not None:
        plane = replace(plane, hull=plane.hull.within(CurrentRegion.hull(points.i_d, points.i_q)))
    return replace(whole, plane=plane, points=points)


def _fitted(
    given: _Given,
    psi: FloatArray,
    fit: FluxFitName,
    source: str,
    *,
    extrapolate: bool,
    even: bool = True,
) -> tuple[FluxMap, FluxFit]:
    """Flux map of flux linkages in Wb, shape (2, M, N), on the axes of a plane,
    and how it was made.
    """
    try:
        data = _data(given.plane, psi, given.points, given.noise, is_grid=given.is_grid)
        found, used = fit_flux(data, fit, source, even=even)
        return FluxMap(
            found.i_d, found.i_q, found.psi_d, found.psi_q, extrapolate, given.plane.hull
        ), used
    except InputError as error:
        raise InputError(error.message, source=source) from None


def _refuse_single_points(plane: Plane, points: FluxPoints, source: str) -> None:
    """Name the points that make the halves differ, where these are few."""
    try:
        fit_flux(_data(plane, plane.psi, points, None, is_grid=False), "smooth", source)
    except InputError as error:
        if "points lie far" in error.message:
            raise


def _plane(points: FluxPoints, angle: float) -> tuple[Plane, FluxNoise | None, bool]:
    """Symmetric plane through points in a frame turned by ``angle`` rad, their noise,
    and whether they fill a grid.
    """
    grid = filled_grid(points)
    if grid is None:
        return scattered_plane(_turned(points, angle)), None, False
    noise = noise_of_grid(grid.i_d, grid.i_q, grid.psi)
    if angle:
        nodes = np.meshgrid(grid.i_d, grid.i_q, indexing="ij")
        turned_psi = turned_flux(
            FluxMap(grid.i_d, grid.i_q, grid.psi[0], grid.psi[1]), angle, nodes[0], nodes[1]
        )
        grid = replace(grid, psi=np.stack(turned_psi))
        if grid.i_q[0] >= 0.0 or grid.i_q[-1] <= 0.0:
            raise InputError(
                "frame_angle needs points of both halves, i_q > 0 and i_q < 0", source=points.source
            )
    return symmetric_plane(grid, points.source), noise, True


def _turned(points: FluxPoints, angle: float) -> FluxPoints:
    """Points in a frame turned by ``angle`` rad."""
    if not angle:
        return points
    i_d, i_q = in_turned_frame(angle, points.i_d, points.i_q)
    psi_d, psi_q = in_turned_frame(angle, points.psi_d, points.psi_q)
    return FluxPoints(points.source, i_d, i_q, psi_d, psi_q)


def _noise_of_repeats(points: FluxPoints) -> FluxNoise | None:
    """Noise that repeated points show, None where there are too few."""
    tolerance = SAME * largest_magnitude(points.i_d, points.i_q)
    return noise_of_repeats(
        points.i_d, points.i_q, np.stack([points.psi_d, points.psi_q]), tolerance
    )


def _data(
    plane: Plane, psi: FloatArray, points: FluxPoints, noise: FluxNoise | None, *, is_grid: bool
) -> FluxData:
    """What a fit needs to know of a plane."""
    values = np.stack([points.psi_d, points.psi_q])
    # A grid with gaps shows what its points have, scattered ones what the spline makes between.
    scattered = not np.isin(points.i_d, plane.i_d).all()
    return FluxData(
        plane.i_d,
        plane.i_q,
        psi,
        points.i_d,
        points.i_q,
        values,
        noise,
        is_grid=is_grid,
        hull=plane.hull if scattered else None,
    )


def _check_size(nodes: int, source: str) -> None:
    """Refuse maps whose splines would take more than a gigabyte: 256 bytes a node,
    twice while they are made.
    """
    if nodes > MOST_NODES:
        message = (
            f"the map has {nodes} points over both halves of i_q, at most {MOST_NODES} can be used"
        )
        raise InputError(f"{message}; save a coarser one", source=source)


def _zero_current(i_d: FloatArray, source: str) -> tuple[str, ...]:
    """Refuse an axis of i_d that stays more than a step away from 0; say when it is less."""
    gap, step = (i_d[0], i_d[1] - i_d[0]) if i_d[0] > 0.0 else (-i_d[-1], i_d[-1] - i_d[-2])
    if gap <= 0.0:
        return ()
    ends = f"i_d (peak, d along the magnets) runs from {i_d[0]:g} to {i_d[-1]:g} A"
    if gap > step * (1.0 + SAME):
        raise InputError(f"{ends} and leaves out zero current; add points there", source=source)
    return (f"{ends}; the flux linkages at i_d = 0 are extrapolated",)
