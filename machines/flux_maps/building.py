"""Points of flux maps: their axes and scaling are converted, and grids or scattered
points become a flux map.

A flux map lies on a full rectangle that is symmetric in i_q. Files hold half planes, planes whose
halves differ by measurement errors, grids with gaps and points without any order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import FluxMap, complete_by_symmetry
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.asymmetry import in_turned_frame, turned_flux
from dqforge.machines.flux_maps.checks import check_holes, check_map, check_points, energy_misfit
from dqforge.machines.flux_maps.evidence import FluxFit
from dqforge.machines.flux_maps.fit import FluxData, fit_flux
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.noise import FluxNoise, noise_of_grid, noise_of_repeats
from dqforge.machines.flux_maps.outliers import check_outliers
from dqforge.machines.flux_maps.repeated_points import merge_repeats
from dqforge.machines.flux_maps.torque_check import TorqueCheck, check_torque
from dqforge.machines.names import FluxAxes, FluxFitName, FluxScaling, FluxSymmetry, FluxTorque
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:  # the points' own module calls these checks
    from dqforge.machines.flux_maps.flux_points import FluxPoints


_TO_PEAK: dict[FluxScaling, float] = {
    "peak": 1.0,
    "rms": math.sqrt(2.0),
    "power-invariant": math.sqrt(2.0 / 3.0),
}


_SAME = 1e-6

"""Difference over the largest value below which two currents, or two flux linkages,
are the same."""


MOST_NODES = 500_000

"""Points of a map, a half plane with its mirror image."""


_FEWEST_SCATTERED = 16


_GRID_SIZES = (9, 81)


_FULL_PLANE = 0.95


_PARTIAL_GRID = 0.5


_MOST_GAPS = 50_000


_NEIGHBOURS = 64


_WORST_ASYMMETRY = 0.25


_NOTABLE_ASYMMETRY = 1e-3


_MUCH_OUTSIDE = 0.15


_MIRROR = np.array([1.0, -1.0])[:, np.newaxis, np.newaxis]

"""Signs of (psi_d, psi_q), shape (2, M, N), on the other side of i_q = 0."""


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
    where only one is known.
    """

    flux_map: FluxMap
    findings: tuple[str, ...]
    energy_misfit: float
    asymmetry: float
    fit: FluxFit
    whole: FluxMap | None
    scatter: float = 0.0
    torque: TorqueCheck | None = None


@dataclass(frozen=True, slots=True)
class _Plane:
    """Flux linkages (2, M, N) on ascending axes (M,) and (N,), the asymmetry of what they
    come from, and sentences.

    ``raw`` are those of a whole plane that nobody averaged, None for the others.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi: FloatArray
    asymmetry: float = 0.0
    findings: tuple[str, ...] = ()
    hull: CurrentRegion | None = None
    raw: FloatArray | None = None


def converted(points: FluxPoints, axes: FluxAxes, scaling: FluxScaling) -> FluxPoints:
    """Points with the d axis along the magnets and in peak values, from the axes
    and the scaling of a file.
    """
    factor = _TO_PEAK[scaling]
    i_d, i_q, psi_d, psi_q = (
        factor * part for part in (points.i_d, points.i_q, points.psi_d, points.psi_q)
    )
    if axes == "reluctance":
        i_d, i_q, psi_d, psi_q = -i_q, i_d, -psi_q, psi_d
    return replace(points, i_d=i_d, i_q=i_q, psi_d=psi_d, psi_q=psi_q)


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

    Parameters
    ----------
    points:
        Points as in the file, shape (K,).
    axes, scaling:
        Convention of the file; without a scaling that which the names say, else peak values.
    extrapolate:
        Whether the map may be used beyond its grid.
    expected_psi_pm:
        Flux linkage of the magnets in Wb (peak), if known from elsewhere;
        the scaling is checked with it.
    pole_pairs:
        Of the machine; a torque in the file is held against that of its flux linkages with it.
    torque:
        What the torque of the file is: 'air-gap', 'shaft', 'per-pole-pair', or 'ignore'.
    treatment:
        How the points become a map.

    Raises
    ------
    InputError
        The points do not make a map, or not that of a machine; see also
        `check_points` and `check_map`.
    """
    source, angle, symmetry = points.source, treatment.frame_angle, treatment.symmetry
    _check_size(points.i_d.size, source)
    check_holes(points)
    check_outliers(points)
    merged = merge_repeats(points)
    check_points(merged.points, axes)
    known, said = _scaling(points, scaling)
    compared = None if pole_pairs is None else check_torque(points, pole_pairs, known, torque)
    single = converted(merged.points, axes, known)
    plane, noise, is_grid = _plane(single, angle)
    turned = _turned(single, angle)
    if plane.asymmetry > _WORST_ASYMMETRY * _largest(single.psi_d, single.psi_q):
        raise _unequal_halves(plane, turned, treatment, source)
    _check_size(plane.psi[0].size, source)
    if plane.raw is None and symmetry != "average":
        message = (
            f"symmetry: {symmetry} needs points of both halves, i_q > 0 and i_q < 0; leave it out"
        )
        raise InputError(message, source=source)
    noise = _noise_of_repeats(converted(points, axes, known)) or noise
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
        *_conversion(axes, known),
        *merged.findings,
        *(() if compared is None else (compared.sentence,)),
        *((f"the frame was turned by {np.degrees(angle):.4g} deg (electrical)",) if angle else ()),
        *(map(_kept, given.plane.findings) if symmetry == "keep" else given.plane.findings),
        *zero,
        *check_map(flux_map, source, expected_psi_pm),
    )
    misfit = energy_misfit(flux_map)
    return FluxMapReading(
        flux_map, findings, misfit, plane.asymmetry, used, halves, merged.scatter, compared
    )


@dataclass(frozen=True, slots=True)
class _Given:
    """What is fitted: a plane, the points behind it in its frame, their noise,
    and whether they fill a grid.
    """

    plane: _Plane
    points: FluxPoints
    noise: FluxNoise | None
    is_grid: bool


def _unequal_halves(
    plane: _Plane, points: FluxPoints, treatment: FluxTreatment, source: str
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
    plane, points = _one_half(whole.plane, symmetry), _half_of(whole.points, symmetry)
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


def _refuse_single_points(plane: _Plane, points: FluxPoints, source: str) -> None:
    """Name the points that make the halves differ, where these are few."""
    try:
        fit_flux(_data(plane, plane.psi, points, None, is_grid=False), "smooth", source)
    except InputError as error:
        if "points lie far" in error.message:
            raise


def _plane(points: FluxPoints, angle: float) -> tuple[_Plane, FluxNoise | None, bool]:
    """Symmetric plane through points in a frame turned by ``angle`` rad, their noise,
    and whether they fill a grid.
    """
    grid = _filled_grid(points)
    if grid is None:
        return _scattered(_turned(points, angle)), None, False
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
    return _symmetric(grid, points.source), noise, True


def _turned(points: FluxPoints, angle: float) -> FluxPoints:
    """Points in a frame turned by ``angle`` rad."""
    if not angle:
        return points
    i_d, i_q = in_turned_frame(angle, points.i_d, points.i_q)
    psi_d, psi_q = in_turned_frame(angle, points.psi_d, points.psi_q)
    return FluxPoints(points.source, i_d, i_q, psi_d, psi_q)


def _noise_of_repeats(points: FluxPoints) -> FluxNoise | None:
    """Noise that repeated points show, None where there are too few."""
    tolerance = _SAME * _largest(points.i_d, points.i_q)
    return noise_of_repeats(
        points.i_d, points.i_q, np.stack([points.psi_d, points.psi_q]), tolerance
    )


def _half_of(points: FluxPoints, symmetry: FluxSymmetry) -> FluxPoints:
    """Points of one half with i_q = 0, mirrored to i_q >= 0."""
    sign = 1.0 if symmetry == "positive" else -1.0
    kept = sign * points.i_q >= 0.0
    i_d, i_q, psi_d, psi_q = (
        part[kept] for part in (points.i_d, points.i_q, points.psi_d, points.psi_q)
    )
    return FluxPoints(points.source, i_d, sign * i_q, psi_d, sign * psi_q)


def _one_half(plane: _Plane, symmetry: FluxSymmetry) -> _Plane:
    """A whole plane whose other half is the mirror image of the wanted one."""
    assert plane.raw is not None
    psi = plane.raw if symmetry == "positive" else plane.raw[:, :, ::-1] * _MIRROR
    upper = plane.i_q >= 0.0
    axis, values = plane.i_q[upper], psi[:, :, upper]
    if axis[0] > 0.0:
        axis, values = (
            np.append(-axis[::-1], axis),
            np.concatenate([values[:, :, ::-1] * _MIRROR, values], axis=2),
        )
    i_q, psi_d, psi_q = complete_by_symmetry(axis, *values)
    side = "i_q > 0" if symmetry == "positive" else "i_q < 0"
    size = format_quantity(plane.asymmetry, "Wb", 3)
    done = (f"the half {side} was mirrored; it lies at most {size} from the mean of both",)
    return _Plane(plane.i_d, i_q, np.stack([psi_d, psi_q]), plane.asymmetry, done, plane.hull)


def _kept(sentence: str) -> str:
    """What is said of the halves where the current references keep them apart."""
    return sentence.replace(
        "were averaged", "are kept for the current references and averaged for all else"
    )


def _data(
    plane: _Plane, psi: FloatArray, points: FluxPoints, noise: FluxNoise | None, *, is_grid: bool
) -> FluxData:
    """What a fit needs to know of a plane."""
    values = np.stack([points.psi_d, points.psi_q])
    return FluxData(
        plane.i_d, plane.i_q, psi, points.i_d, points.i_q, values, noise, is_grid=is_grid
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


def _scaling(points: FluxPoints, given: FluxScaling | None) -> tuple[FluxScaling, tuple[str, ...]]:
    """Scaling of points, by what is given and what their names say, and a sentence
    where only the names say it.
    """
    if not points.claimed or points.claimed == given:
        return given or "peak", ()
    if given is not None:
        raise InputError(
            f"the names in the file say {points.claimed} values, which is not scaling: {given}; "
            f"write scaling: {points.claimed}, or correct the names",
            source=points.source,
        )
    return points.claimed, (
        f"currents and flux linkages are {points.claimed} values, as the names in the file say",
    )


def _conversion(axes: FluxAxes, scaling: FluxScaling) -> tuple[str, ...]:
    """What the conversion did, in sentences."""
    turned = (
        (
            "the axes were turned so that d lies along the magnets (i_d = -i_q and i_q = i_d of "
            "the file)"
        ),
    )
    scaled = (
        (
            f"currents and flux linkages were multiplied by {_TO_PEAK[scaling]:.4f} ({scaling} to "
            "peak)"
        ),
    )
    return (turned if axes == "reluctance" else ()) + (scaled if scaling != "peak" else ())


def _largest(*values: FloatArray) -> float:
    return max(float(np.max(np.abs(part))) for part in values)


def _filled_grid(points: FluxPoints) -> _Plane | None:
    """Grid of points that fill one, None if they do not."""
    i_d, rows = np.unique(points.i_d, return_inverse=True)
    i_q, columns = np.unique(points.i_q, return_inverse=True)
    if points.i_d.size != i_d.size * i_q.size:
        return None
    psi = np.empty((2, i_d.size, i_q.size))
    psi[:, rows, columns] = points.psi_d, points.psi_q
    return _Plane(i_d, i_q, psi)


def _symmetric(grid: _Plane, source: str) -> _Plane:
    """Symmetric plane from a grid over a half plane, a whole one, or one with unequal halves.

    Raises `InputError`.
    """
    from scipy.interpolate import CubicSpline

    i_q, psi = grid.i_q, grid.psi
    if turned := bool(i_q[-1] < -i_q[0]):
        i_q, psi = -i_q[::-1], psi[:, :, ::-1] * _MIRROR
    other = -float(i_q[0])
    along = CubicSpline(i_q, psi, axis=2)
    whole = bool(np.all(np.abs(i_q + i_q[::-1]) <= 0.25 * np.min(np.diff(i_q))))
    if whole:
        axis = np.clip(0.5 * (i_q - i_q[::-1]), -other, other)
        values = along(axis)
    else:
        axis, values = i_q[i_q >= 0.0], psi[:, :, i_q >= 0.0]
        _check_begin(axis, float(axis[1] - axis[0]) if axis.size > 1 else 0.0, source)
    raw = (values[:, :, ::-1] * _MIRROR if turned else values) if whole else None
    shared = axis[(axis >= 0.0) & (axis <= other)]
    asymmetry = 0.5 * float(np.max(np.abs(along(shared) - along(-shared) * _MIRROR), initial=0.0))
    if not whole and axis[0] > 0.0:
        axis, values = (
            np.append(-axis[::-1], axis),
            np.concatenate([values[:, :, ::-1] * _MIRROR, values], axis=2),
        )
    done = _halves(whole, other > 0.0, turned, asymmetry, _largest(psi))
    i_q, psi_d, psi_q = complete_by_symmetry(axis, *values)
    return _Plane(grid.i_d, i_q, np.stack([psi_d, psi_q]), asymmetry, done, raw=raw)


def _check_begin(upper: FloatArray, step: float, source: str) -> None:
    """Refuse a half plane whose points with i_q >= 0 begin more than a step away from 0."""
    begin = float(np.min(upper))
    if begin > step:
        raise InputError(
            f"the half plane begins at |i_q| = {begin:g} A (peak, d along the magnets); add points "
            "with i_q = 0",
            source=source,
        )


def _halves(
    whole: bool, unequal: bool, turned: bool, asymmetry: float, largest: float
) -> tuple[str, ...]:
    """What was done with the halves of the plane, in a sentence."""
    size, side = format_quantity(asymmetry, "Wb", 3), "i_q <= 0" if turned else "i_q >= 0"
    if whole:
        agree = (
            "they agree"
            if asymmetry <= _SAME * largest
            else f"they lie at most {size} from their mean"
        )
        return (f"the halves i_q > 0 and i_q < 0 were averaged; {agree}",)
    about = (
        f"; it contradicts its mirror image by up to {size}"
        if asymmetry > _NOTABLE_ASYMMETRY * largest
        else ""
    )
    return (f"{'the larger half' if unequal else 'the half plane'} {side} was mirrored{about}",)


def _scattered(points: FluxPoints) -> _Plane:
    """Symmetric plane through scattered points or a grid with gaps; raises `InputError`."""
    i_d, i_q, psi = points.i_d, points.i_q, np.stack([points.psi_d, points.psi_q])
    if i_d.size < _FEWEST_SCATTERED:
        message = (
            f"{i_d.size} points that fill no grid are too few for a map; give at least "
            f"{_FEWEST_SCATTERED}"
        )
        raise InputError(message, source=points.source)
    if turned := bool(np.max(i_q) < -np.min(i_q)):
        i_q, psi = -i_q, psi * _MIRROR[:, :, 0]
    end, other = float(np.max(i_q)), -float(np.min(i_q))
    whole = other >= _FULL_PLANE * end
    asymmetry = float(np.max(np.abs(psi[1, i_q == 0.0]), initial=0.0))
    if not whole:
        i_d, i_q, psi = _with_mirror_image(i_d, i_q, psi)
    axis_d, axis_q, own = _axes(i_d, i_q, min(end, other) if whole else end)
    _check_begin(i_q[i_q >= 0.0], float(axis_q[-1] - axis_q[-2]), points.source)
    values, outside = _thin_plates(i_d, i_q, psi, axis_d, axis_q, own, points.source)
    if whole:
        known = ~(outside | outside[:, ::-1])
        asymmetry = 0.5 * float(
            np.max(np.abs(values - values[:, :, ::-1] * _MIRROR)[:, known], initial=0.0)
        )
    size, way = f"{axis_d.size} x {axis_q.size} grid", "interpolated by thin-plate splines"
    gaps = f"gaps of the {size} {way}: {axis_d.size * axis_q.size - i_d.size}"
    first = gaps if own else f"scattered points: {points.i_d.size} {way} on a {size}"
    findings = (first, *_halves(whole, other > 0.0, turned, asymmetry, _largest(psi)))
    if (share := float(np.mean(outside))) > _MUCH_OUTSIDE:
        beyond = (
            "of the nodes lie outside the convex hull of the points; the flux linkages there are "
            "extrapolated"
        )
        findings = (*findings, f"warning: {100.0 * share:.0f} % {beyond}")
    raw = (values[:, :, ::-1] * _MIRROR if turned else values) if whole else None
    axis_q, psi_d, psi_q = complete_by_symmetry(axis_q, *values)
    hull = CurrentRegion.hull(i_d, i_q).within(
        CurrentRegion.rectangle(axis_d[0], axis_d[-1], axis_q[-1])
    )
    return _Plane(axis_d, axis_q, np.stack([psi_d, psi_q]), asymmetry, findings, hull=hull, raw=raw)


def _with_mirror_image(
    i_d: FloatArray, i_q: FloatArray, psi: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The half of the points with i_q >= 0 and its mirror image; at i_q = 0, psi_q is 0."""
    upper, lower = i_q >= 0.0, i_q > 0.0
    odd = np.where(i_q == 0.0, np.array([[1.0], [0.0]]), 1.0) * psi
    both = np.concatenate([odd[:, upper], odd[:, lower] * _MIRROR[:, :, 0]], axis=1)
    return np.append(i_d[upper], i_d[lower]), np.append(i_q[upper], -i_q[lower]), both


def _axes(i_d: FloatArray, i_q: FloatArray, end: float) -> tuple[FloatArray, FloatArray, bool]:
    """Axes for the points of a full plane, and whether they are the points' own,
    of a grid with gaps.
    """
    own_d, own_q = np.unique(i_d), np.unique(i_q)
    nodes = own_d.size * own_q.size
    filled = i_d.size >= max(_PARTIAL_GRID * nodes, nodes - _MOST_GAPS)
    if filled and np.max(np.abs(own_q + own_q[::-1])) <= _SAME * end:
        return own_d, own_q, True
    count = int(np.clip(np.rint(np.sqrt(i_d.size)), *_GRID_SIZES))
    # An odd number of i_q has a node at 0.
    return np.linspace(np.min(i_d), np.max(i_d), count), np.linspace(-end, end, count | 1), False


def _thin_plates(
    i_d: FloatArray,
    i_q: FloatArray,
    psi: FloatArray,
    axis_d: FloatArray,
    axis_q: FloatArray,
    own: bool,
    source: str,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Flux linkages (2, M, N) on a grid through points of a full plane, and which
    nodes lie outside their hull.

    ``own``: the points lie on nodes, and the others are the gaps.
    """
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import ConvexHull, Delaunay, QhullError

    scale = np.array([np.ptp(i_d), np.ptp(i_q)])
    at = np.stack([i_d, i_q], axis=1) / scale
    nodes = np.stack(np.meshgrid(axis_d, axis_q, indexing="ij"), axis=2) / scale
    known = np.zeros(nodes.shape[:2], dtype=bool)
    values = np.empty((2, *known.shape))
    if own:
        place = np.searchsorted(axis_d, i_d), np.searchsorted(axis_q, i_q)
        values[:, *place], known[place] = psi, True
    try:
        hull = Delaunay(at[ConvexHull(at).vertices])
        spline = RBFInterpolator(at, psi.T, neighbors=min(_NEIGHBOURS, at.shape[0]), degree=1)
        values[:, ~known] = spline(nodes[~known]).T
    except (QhullError, np.linalg.LinAlgError):
        message = "the points lie on a line or too close together; spread them over i_d and i_q"
        raise InputError(message, source=source) from None
    outside = ~known
    outside[~known] = hull.find_simplex(nodes[~known], tol=_SAME) < 0
    return values, outside


def _zero_current(i_d: FloatArray, source: str) -> tuple[str, ...]:
    """Refuse an axis of i_d that stays more than a step away from 0; say when it is less."""
    gap, step = (i_d[0], i_d[1] - i_d[0]) if i_d[0] > 0.0 else (-i_d[-1], i_d[-1] - i_d[-2])
    if gap <= 0.0:
        return ()
    ends = f"i_d (peak, d along the magnets) runs from {i_d[0]:g} to {i_d[-1]:g} A"
    if gap > step * (1.0 + _SAME):
        raise InputError(f"{ends} and leaves out zero current; add points there", source=source)
    return (f"{ends}; the flux linkages at i_d = 0 are extrapolated",)


def flux_map_of_maps(
    temperatures: FloatArray, maps: Sequence[FluxMap], temperature: float
) -> FluxMap:
    """Flux map at a magnet temperature between those of several maps, on the
    rectangle that all of them cover.

    Between two maps linear in the temperature, else by monotone cubics (PCHIP) through all. The
    nodes are those of the map with the finest axis, for each axis.

    Parameters
    ----------
    temperatures:
        Of the maps in any order, in degC, shape (n,), n >= 2.
    maps:
        One for each.
    temperature:
        At which the map is wanted, in degC.

    Raises
    ------
    InputError
        Less than two maps, a repeated temperature, one outside the range,
        or maps that cover no common rectangle.
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
