"""Flux maps from points in any order: grids or scattered points become a map, with all that
was found and done on the way.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import CurrentRegion, torque_from_flux
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.checks import (
    MeasuredLoss,
    check_holes,
    check_map,
    check_points,
    energy_misfit,
)
from dqforge.machines.flux_maps.evidence import (
    FluxAsymmetry,
    FluxFit,
    FluxNoise,
    noise_of_grid,
    noise_of_repeats,
)
from dqforge.machines.flux_maps.fit import FluxData, fit_flux
from dqforge.machines.flux_maps.flux_points import (
    SAME,
    FluxPoints,
    Plane,
    TorqueCheck,
    check_torque,
    filled_grid,
    half_of_points,
    kept_apart,
    largest_magnitude,
    one_half,
    scattered_plane,
    symmetric_plane,
)
from dqforge.machines.flux_maps.rotor_angle import ripple_of
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
        message = f"symmetry: {symmetry} needs points of both halves, i_q > 0 and i_q < 0; omit it"
        raise InputError(message, source=source)
    peak = converted(points, axes, known)
    noise = _noise_of_repeats(peak) or noise
    whole = _Given(plane, turned, noise, is_grid)
    given = _chosen(whole, symmetry)
    zero = _zero_current(given.plane.i_d, source)
    flux_map, used = _fitted(given, given.plane.psi, treatment.fit, source, extrapolate=extrapolate)
    flux_map, turned_said = _with_ripple(flux_map, points, axes, known, pole_pairs, torque, angle)
    halves = None
    if plane.raw is not None:
        halves = _fitted(whole, plane.raw, used.used, source, extrapolate=extrapolate, even=False)[
            0
        ]
        halves = replace(halves, ripple=flux_map.ripple)
    findings = (
        *points.findings,
        *said,
        *conversion_findings(axes, known),
        *merged.findings,
        *(() if compared is None else (compared.sentence,)),
        *((f"the frame was turned by {np.degrees(angle):.4g} deg (electrical)",) if angle else ()),
        *(map(kept_apart, given.plane.findings) if symmetry == "keep" else given.plane.findings),
        *zero,
        *turned_said,
        *check_map(flux_map, source, expected_psi_pm),
    )
    torques = torque_from_flux(1, single.psi_d, single.psi_q, single.i_d, single.i_q)
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


def _with_ripple(
    flux_map: FluxMap,
    points: FluxPoints,
    axes: FluxAxes,
    scaling: FluxScaling,
    pole_pairs: int | None,
    torque: FluxTorque,
    angle: float,
) -> tuple[FluxMap, tuple[str, ...]]:
    """The map with what its points over the rotor angle have beside their means, and sentences."""
    turning = points.turning
    if turning is None or pole_pairs is None:
        return flux_map, ()
    if angle:
        said = "warning: the ripple over the rotor angle is not used with a frame_angle"
        return flux_map, (said,)
    own = turning.points
    ripple, found = ripple_of(
        replace(turning, points=converted(own, axes, scaling)),
        pole_pairs,
        per_pole_pair=torque == "per-pole-pair"
        or (own.torque is not None and own.torque.per_pole_pair),
        reluctance=axes == "reluctance",
    )
    return replace(flux_map, ripple=ripple), found


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
        raise InputError(f"{ends} and omits zero current; add points there", source=source)
    return (f"{ends}; the flux linkages at i_d = 0 are extrapolated",)


# Points of a flux map that are given repeatedly: their means are taken,
# and how much they scatter is told.

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
        "distinguishes them, columns: {angle: NAME}, {temperature: NAME} or {speed: NAME}, or keep "
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


# How much torque the asymmetry of a flux map is, and the turned frame that removes it.
#
# An angle sensor that is misaligned by an angle gives currents and flux linkages turned by it,
# which makes a machine with equal halves look asymmetric; what no turn removes is the machine's or
# the measurement's own.

_WIDEST = np.radians(20.0)


_ANGLES = 3601


_RADII, _DIRECTIONS = np.linspace(0.1, 0.85, 12), 72


def in_turned_frame(
    angle: float, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Vectors in a frame that is turned by ``angle`` rad, from those in the old one."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * first + sine * second, cosine * second - sine * first


def turned_flux(
    whole: FluxMap, angle: float, i_d: FloatArray, i_q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Flux linkages in Wb at currents in A, all in a frame turned by ``angle``
    rad from that of the map.
    """
    return in_turned_frame(angle, *whole.flux(*in_turned_frame(-angle, i_d, i_q)))


def _test_points(whole: FluxMap) -> tuple[FloatArray, FloatArray]:
    """Currents in A inside the data whatever the turn: rings about zero current, i_q >= 0,
    shape (K,).
    """
    reach = min(float(whole.i_q[-1]), max(-float(whole.i_d[0]), float(whole.i_d[-1])))
    direction = np.linspace(0.0, np.pi, _DIRECTIONS)
    i_d = (reach * _RADII[:, np.newaxis] * np.cos(direction)).ravel()
    i_q = (reach * _RADII[:, np.newaxis] * np.sin(direction)).ravel()
    room = 0.1 * reach
    kept = (i_d >= whole.i_d[0] + min(room, -float(whole.i_d[0]))) & (
        i_d <= whole.i_d[-1] - min(room, float(whole.i_d[-1]))
    )
    return i_d[kept], i_q[kept]


def _apart(whole: FluxMap, angle: float, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Half the distances of mirrored points in a turned frame, in Wb, shape (2, K)."""
    upper, lower = turned_flux(whole, angle, i_d, i_q), turned_flux(whole, angle, i_d, -i_q)
    return 0.5 * np.stack([upper[0] - lower[0], upper[1] + lower[1]])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=0))))


def frame_angle(whole: FluxMap) -> float:
    """Turn in rad (electrical) within +-20 deg that makes the halves of a
    map the best mirror images.
    """
    from scipy.optimize import minimize_scalar

    i_d, i_q = _test_points(whole)
    coarse = np.linspace(-_WIDEST, _WIDEST, 41)
    sizes = [_rms(_apart(whole, float(angle), i_d, i_q)) for angle in coarse]
    best, step = float(coarse[int(np.argmin(sizes))]), float(coarse[1] - coarse[0])
    found = minimize_scalar(
        lambda angle: _rms(_apart(whole, float(angle), i_d, i_q)) ** 2,
        bounds=(best - step, best + step),
        method="bounded",
        options={"xatol": 1e-7},
    )
    return float(found.x)


def asymmetry_of(
    whole: FluxMap,
    averaged: FluxMap,
    pole_pairs: int,
    current: float,
    current_name: str,
    symmetry: FluxSymmetry,
) -> FluxAsymmetry:
    """Asymmetry of a map over the whole plane that nobody averaged, in torque and in flux linkage.

    Args:
        whole, averaged: The map as measured, and its symmetric part.
        pole_pairs: Number p.
        current, current_name: Amplitude in A (peak) where the torques are compared, and what it is
            called.
        symmetry: What is done about it.
    """
    direction = np.linspace(0.0, np.pi, _ANGLES)
    i_d, i_q = current * np.cos(direction), current * np.sin(direction)
    inside = averaged.inside(i_d, i_q)
    i_d, i_q = (i_d[inside], i_q[inside]) if np.any(inside) else (i_d, i_q)
    best = int(np.argmax(torque_from_flux(pole_pairs, *averaged.flux(i_d, i_q), i_d, i_q)))
    angle = frame_angle(whole)

    def torques(turn: float) -> tuple[float, float, float]:
        upper = torque_from_flux(pole_pairs, *turned_flux(whole, turn, i_d, i_q), i_d, i_q)
        lower = -torque_from_flux(pole_pairs, *turned_flux(whole, turn, i_d, -i_q), i_d, -i_q)
        return float(upper[best]), float(lower[best]), float(np.max(np.abs(upper - lower)))

    grid_d, grid_q = np.meshgrid(whole.i_d, whole.i_q[whole.i_q >= 0.0], indexing="ij")
    largest = float(np.max(np.abs(_apart(whole, 0.0, grid_d.ravel(), grid_q.ravel()))))
    points = _test_points(whole)
    (positive, negative, most), left = torques(0.0), torques(angle)
    return FluxAsymmetry(
        symmetry=symmetry,
        current=current,
        current_name=current_name,
        positive=positive,
        negative=negative,
        torque_most=most,
        largest=largest,
        rms=_rms(_apart(whole, 0.0, *points)),
        angle=angle,
        rms_left=_rms(_apart(whole, angle, *points)),
        torque_left=left[0] - left[1],
        torque_most_left=left[2],
    )


# Slips among the currents of a flux map: a value far beyond all others of its axis,
# named with its line.

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


# Axes and scaling of the points of a flux map: what a file means, and what was done about it.

_TO_PEAK: dict[FluxScaling, float] = {
    "peak": 1.0,
    "rms": math.sqrt(2.0),
    "power-invariant": math.sqrt(2.0 / 3.0),
}


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


def scaling_of_points(
    points: FluxPoints, given: FluxScaling | None
) -> tuple[FluxScaling, tuple[str, ...]]:
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


def conversion_findings(axes: FluxAxes, scaling: FluxScaling) -> tuple[str, ...]:
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
