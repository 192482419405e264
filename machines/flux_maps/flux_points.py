"""Points of a flux map as a file holds them, and the torque that it gives held against that of its
flux linkages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import complete_by_symmetry
from dqforge.machines.dq_machines.map_deviations import MapDeviations
from dqforge.machines.dq_machines.synchronous import CurrentRegion
from dqforge.machines.errors import InputError
from dqforge.machines.names import FluxScaling, FluxSymmetry, FluxTorque
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity


@dataclass(frozen=True, slots=True)
class FileTorque:
    """Torque that a file gives beside its flux linkages, in N m, shape (K,),
    NaN where it is unknown.
    """

    name: str
    values: FloatArray
    per_pole_pair: bool = False


@dataclass(frozen=True, slots=True)
class FileLoss:
    """Loss that a file gives beside its flux linkages, in W of the whole machine, shape (K,),
    NaN where it is unknown; in words where it is from.
    """

    name: str
    values: FloatArray


@dataclass(frozen=True, slots=True)
class TurningPoints:
    """Points over the rotor angle: all angles of the first pair of currents, of the second, ...

    Args:
        name: What the angle is called in the file.
        kind: 'electrical' or 'mechanical', '' where the name does not say.
        angle: Angles in rad as the file has them, ascending in even steps, shape (A,).
        stated: Whether the file says their unit.
        points: C pairs of currents with A angles each, arrays of shape (C A,).
    """

    name: str
    kind: Literal["", "electrical", "mechanical"]
    angle: FloatArray
    stated: bool
    points: FluxPoints


@dataclass(frozen=True, slots=True)
class FluxPoints:
    """Points of a flux map as a file holds them, in its own axes and scaling but in A and Wb,
    arrays of shape (K,).

    ``lines`` are the lines of a text that the points stand in, ``claimed`` is what its names say of
    the scaling, ``findings`` are sentences on what the reader did, ``others`` the further arrays of
    numbers that nobody used. Points closer than ``blur`` times the largest current are one.
    ``pole_pairs`` is what the file says of them, 0 where it does not; ``ignored`` is the torque
    that nobody wants compared; ``deviations`` are those that stand beside the points; ``turning``
    are the points over the rotor angle whose means these are.
    """

    source: str
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    torque: FileTorque | None = field(default=None, kw_only=True)
    lines: NDArray[np.intp] | None = field(default=None, kw_only=True)
    claimed: Literal["", "peak", "rms"] = field(default="", kw_only=True)
    findings: tuple[str, ...] = field(default=(), kw_only=True)
    others: tuple[str, ...] = field(default=(), kw_only=True)
    loss: FileLoss | None = field(default=None, kw_only=True)
    blur: float = field(default=0.0, kw_only=True)
    pole_pairs: int = field(default=0, kw_only=True)
    ignored: str = field(default="", kw_only=True)
    deviations: MapDeviations | None = field(default=None, kw_only=True)
    turning: TurningPoints | None = field(default=None, kw_only=True)


# Planes through points without any order and through grids with gaps, by thin-plate splines.

# Distance from every point over the largest current that is a gap, and the share of the region from
# which on gaps are told.
_FEWEST_SCATTERED = 16
_GRID_SIZES = (9, 81)
_FULL_PLANE = 0.95
_PARTIAL_GRID = 0.5
_MOST_GAPS = 50_000
_NEIGHBOURS = 64
_MUCH_OUTSIDE = 0.15
_FAR, _MUCH_FAR = 0.15, 0.05


def scattered_plane(points: FluxPoints) -> Plane:
    """Symmetric plane through scattered points or a grid with gaps; raises `InputError`."""
    i_d, i_q, psi = points.i_d, points.i_q, np.stack([points.psi_d, points.psi_q])
    if i_d.size < _FEWEST_SCATTERED:
        message = (
            f"{i_d.size} points that fill no grid are too few for a map; give at least "
            f"{_FEWEST_SCATTERED}"
        )
        raise InputError(message, source=points.source)
    if turned := bool(np.max(i_q) < -np.min(i_q)):
        i_q, psi = -i_q, psi * MIRROR[:, :, 0]
    end, other = float(np.max(i_q)), -float(np.min(i_q))
    whole = other >= _FULL_PLANE * end
    asymmetry = float(np.max(np.abs(psi[1, i_q == 0.0]), initial=0.0))
    if not whole:
        i_d, i_q, psi = _with_mirror_image(i_d, i_q, psi)
    axis_d, axis_q, own = _axes(i_d, i_q, min(end, other) if whole else end)
    check_begin(i_q[i_q >= 0.0], float(axis_q[-1] - axis_q[-2]), points.source)
    values, outside = _thin_plates(i_d, i_q, psi, axis_d, axis_q, own, points.source)
    if whole:
        known = ~(outside | outside[:, ::-1])
        asymmetry = 0.5 * float(
            np.max(np.abs(values - values[:, :, ::-1] * MIRROR)[:, known], initial=0.0)
        )
    size, way = f"{axis_d.size} x {axis_q.size} grid", "interpolated by thin-plate splines"
    gaps = f"gaps of the {size} {way}: {axis_d.size * axis_q.size - i_d.size}"
    first = gaps if own else f"scattered points: {points.i_d.size} {way} on a {size}"
    findings = (
        first,
        *halves_findings(whole, other > 0.0, turned, asymmetry, largest_magnitude(psi)),
    )
    if (share := float(np.mean(outside))) > _MUCH_OUTSIDE:
        beyond = (
            "of the nodes lie outside the convex hull of the points; the flux linkages there are "
            "extrapolated"
        )
        findings = (*findings, f"warning: {100.0 * share:.0f} % {beyond}")
    hull = CurrentRegion.hull(i_d, i_q).within(
        CurrentRegion.rectangle(axis_d[0], axis_d[-1], axis_q[-1])
    )
    if not own:
        findings = (*findings, *_gaps(i_d, i_q, axis_d, axis_q, hull))
    raw = (values[:, :, ::-1] * MIRROR if turned else values) if whole else None
    axis_q, psi_d, psi_q = complete_by_symmetry(axis_q, *values)
    return Plane(axis_d, axis_q, np.stack([psi_d, psi_q]), asymmetry, findings, hull=hull, raw=raw)


def _gaps(
    i_d: FloatArray, i_q: FloatArray, axis_d: FloatArray, axis_q: FloatArray, hull: CurrentRegion
) -> tuple[str, ...]:
    """A sentence on the part of the hull that lies far from every point of a full plane."""
    from scipy.spatial import cKDTree

    nodes = np.stack(np.meshgrid(axis_d, axis_q, indexing="ij"), axis=2).reshape(-1, 2)
    nodes = nodes[hull.contains(nodes[:, 0], nodes[:, 1])]
    far = _FAR * hull.size
    away = cKDTree(np.stack([i_d, i_q], axis=1)).query(nodes)[0]
    share = float(np.mean(away > far))
    if share <= _MUCH_FAR:
        return ()
    sentence = (
        f"warning: the points leave gaps: {100.0 * share:.0f} % of the region between them lies "
        f"further than {format_quantity(far, 'A', 3)} from every point, at most "
        f"{format_quantity(float(np.max(away)), 'A', 3)}; the flux linkages there follow from "
        "those around"
    )
    return (sentence,)


def _with_mirror_image(
    i_d: FloatArray, i_q: FloatArray, psi: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The half of the points with i_q >= 0 and its mirror image; at i_q = 0, psi_q is 0."""
    upper, lower = i_q >= 0.0, i_q > 0.0
    odd = np.where(i_q == 0.0, np.array([[1.0], [0.0]]), 1.0) * psi
    both = np.concatenate([odd[:, upper], odd[:, lower] * MIRROR[:, :, 0]], axis=1)
    return np.append(i_d[upper], i_d[lower]), np.append(i_q[upper], -i_q[lower]), both


def _axes(i_d: FloatArray, i_q: FloatArray, end: float) -> tuple[FloatArray, FloatArray, bool]:
    """Axes for the points of a full plane, and whether they are the points' own,
    of a grid with gaps.
    """
    own_d, own_q = np.unique(i_d), np.unique(i_q)
    nodes = own_d.size * own_q.size
    filled = i_d.size >= max(_PARTIAL_GRID * nodes, nodes - _MOST_GAPS)
    if filled and np.max(np.abs(own_q + own_q[::-1])) <= SAME * end:
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
    outside[~known] = hull.find_simplex(nodes[~known], tol=SAME) < 0
    return values, outside


# Planes of a flux map: full grids, half planes and their mirror images.
#
# A plane is a full rectangle that is symmetric in i_q. Files hold half planes and planes whose
# halves differ by measurement errors.

# Difference over the largest value below which two currents, or two flux linkages, are the same.
SAME = 1e-6
_NOTABLE_ASYMMETRY = 1e-3

# Signs of (psi_d, psi_q), shape (2, M, N), on the other side of i_q = 0.
MIRROR = np.array([1.0, -1.0])[:, np.newaxis, np.newaxis]


@dataclass(frozen=True, slots=True)
class Plane:
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


def half_of_points(points: FluxPoints, symmetry: FluxSymmetry) -> FluxPoints:
    """Points of one half with i_q = 0, mirrored to i_q >= 0."""
    sign = 1.0 if symmetry == "positive" else -1.0
    kept = sign * points.i_q >= 0.0
    i_d, i_q, psi_d, psi_q = (
        part[kept] for part in (points.i_d, points.i_q, points.psi_d, points.psi_q)
    )
    return FluxPoints(points.source, i_d, sign * i_q, psi_d, sign * psi_q)


def one_half(plane: Plane, symmetry: FluxSymmetry) -> Plane:
    """A whole plane whose other half is the mirror image of the wanted one."""
    assert plane.raw is not None
    psi = plane.raw if symmetry == "positive" else plane.raw[:, :, ::-1] * MIRROR
    upper = plane.i_q >= 0.0
    axis, values = plane.i_q[upper], psi[:, :, upper]
    if axis[0] > 0.0:
        axis, values = (
            np.append(-axis[::-1], axis),
            np.concatenate([values[:, :, ::-1] * MIRROR, values], axis=2),
        )
    i_q, psi_d, psi_q = complete_by_symmetry(axis, *values)
    side = "i_q > 0" if symmetry == "positive" else "i_q < 0"
    size = format_quantity(plane.asymmetry, "Wb", 3)
    done = (f"the half {side} was mirrored; it lies at most {size} from the mean of both",)
    return Plane(plane.i_d, i_q, np.stack([psi_d, psi_q]), plane.asymmetry, done, plane.hull)


def kept_apart(sentence: str) -> str:
    """What is said of the halves where the current references keep them apart."""
    return sentence.replace(
        "were averaged", "are kept for the current references and averaged for all else"
    )


def largest_magnitude(*values: FloatArray) -> float:
    """Largest magnitude of all values."""
    return max(float(np.max(np.abs(part))) for part in values)


def filled_grid(points: FluxPoints) -> Plane | None:
    """Grid of points that fill one, None if they do not."""
    i_d, rows = np.unique(points.i_d, return_inverse=True)
    i_q, columns = np.unique(points.i_q, return_inverse=True)
    if points.i_d.size != i_d.size * i_q.size:
        return None
    psi = np.empty((2, i_d.size, i_q.size))
    psi[:, rows, columns] = points.psi_d, points.psi_q
    return Plane(i_d, i_q, psi)


def symmetric_plane(grid: Plane, source: str) -> Plane:
    """Symmetric plane from a grid over a half plane, a whole one, or one with unequal halves.

    Raises `InputError`.
    """
    from scipy.interpolate import CubicSpline

    i_q, psi = grid.i_q, grid.psi
    if turned := bool(i_q[-1] < -i_q[0]):
        i_q, psi = -i_q[::-1], psi[:, :, ::-1] * MIRROR
    other = -float(i_q[0])
    along = CubicSpline(i_q, psi, axis=2)
    whole = bool(np.all(np.abs(i_q + i_q[::-1]) <= 0.25 * np.min(np.diff(i_q))))
    if whole:
        axis = np.clip(0.5 * (i_q - i_q[::-1]), -other, other)
        values = along(axis)
    else:
        axis, values = i_q[i_q >= 0.0], psi[:, :, i_q >= 0.0]
        check_begin(axis, float(axis[1] - axis[0]) if axis.size > 1 else 0.0, source)
    raw = (values[:, :, ::-1] * MIRROR if turned else values) if whole else None
    shared = axis[(axis >= 0.0) & (axis <= other)]
    asymmetry = 0.5 * float(np.max(np.abs(along(shared) - along(-shared) * MIRROR), initial=0.0))
    if not whole and axis[0] > 0.0:
        axis, values = (
            np.append(-axis[::-1], axis),
            np.concatenate([values[:, :, ::-1] * MIRROR, values], axis=2),
        )
    done = halves_findings(whole, other > 0.0, turned, asymmetry, largest_magnitude(psi))
    i_q, psi_d, psi_q = complete_by_symmetry(axis, *values)
    return Plane(grid.i_d, i_q, np.stack([psi_d, psi_q]), asymmetry, done, raw=raw)


def check_begin(upper: FloatArray, step: float, source: str) -> None:
    """Refuse a half plane whose points with i_q >= 0 begin more than a step away from 0."""
    begin = float(np.min(upper))
    if begin > step:
        raise InputError(
            f"the half plane begins at |i_q| = {begin:g} A (peak, d along the magnets); add points "
            "with i_q = 0",
            source=source,
        )


def halves_findings(
    whole: bool, unequal: bool, turned: bool, asymmetry: float, largest: float
) -> tuple[str, ...]:
    """What was done with the halves of the plane, in a sentence."""
    size, side = format_quantity(asymmetry, "Wb", 3), "i_q <= 0" if turned else "i_q >= 0"
    if whole:
        agree = (
            "they agree"
            if asymmetry <= SAME * largest
            else f"they lie at most {size} from their mean"
        )
        return (f"the halves i_q > 0 and i_q < 0 were averaged; {agree}",)
    about = (
        f"; it contradicts its mirror image by up to {size}"
        if asymmetry > _NOTABLE_ASYMMETRY * largest
        else ""
    )
    return (f"{'the larger half' if unequal else 'the half plane'} {side} was mirrored{about}",)


# The torque that a flux-map file gives, held against that of its flux linkages: the sharpest check
# of a declaration.
#
# With d and q in any frame fixed to the rotor T = 3/2 p (psi_d i_q - psi_q i_d) in peak values, so
# that the ratio of the two tells a wrong scaling, a wrong number of pole pairs, a wrong unit or a
# wrong sign.

# Product of two peak values over that of the same values in each scaling.
SQUARED: dict[FluxScaling, float] = {"peak": 1.0, "rms": 2.0, "power-invariant": 2.0 / 3.0}
_LARGEST = 0.03  # Deviation of the slope from 1, and misfit, from which on a map is refused.
_SHAFT_SLOPES = (0.9, 1.03)
_SHAFT_MISFIT, _SHAFT_OFFSET = 0.1, 0.25
_NEAR = 0.02
_NEAR_COUNT = 0.15
_FEWEST = 4
_MOST_PAIRS, _MOST_PARTS = 200, 12


@dataclass(frozen=True, slots=True)
class TorqueCheck:
    """How the torque of a file compares with that of its flux linkages.

    ``per_pair``: the torque is that of one pole pair, and no test of their number. ``slope`` is
    that of the least-squares line of the file's torque over the map's, through zero unless
    ``declared`` is 'shaft'; ``offset`` is where that line begins, in N m; ``misfit`` is the
    r.m.s. distance from it over the r.m.s. torque of the file; ``points`` is the number of
    points compared.
    """

    name: str
    declared: FluxTorque
    slope: float
    offset: float
    misfit: float
    points: int
    per_pair: bool = False

    @property
    def sentence(self) -> str:
        """The comparison for the user."""
        start = f", {self.offset:+.3g} N m at zero" if self.declared == "shaft" else ""
        kind = "shaft torque" if self.declared == "shaft" else "torque"
        return (
            f"the {kind} of the file ({self.name}) is {self.slope:.5f} times 3/2 p (psi_d i_q - "
            f"psi_q i_d){start}, r.m.s. misfit {100.0 * self.misfit:.2g} % over {self.points} "
            "points"
        ) + "; per pole pair, it does not depend on the number of pole pairs" * self.per_pair


def check_torque(
    points: FluxPoints, pole_pairs: int, scaling: FluxScaling, declared: FluxTorque = "air-gap"
) -> TorqueCheck | None:
    """Compare the torque of a file with its flux linkages.

    None where it gives none, or none but zero.

    Args:
        points: As the file holds them, in its own axes and scaling.
        pole_pairs: Of the machine.
        scaling: Of currents and flux linkages.
        declared: 'air-gap', 'shaft' (behind friction and iron loss), 'per-pole-pair', or 'ignore'.

    Raises:
        InputError: The two differ by more than 3 % (10 % below for a shaft torque); with the likely
            cause.
    """
    if points.torque is None or declared == "ignore":
        return None
    per_pair = points.torque.per_pole_pair or declared == "per-pole-pair"
    file = points.torque.values * (pole_pairs if per_pair else 1)
    of_map = (
        1.5
        * pole_pairs
        * SQUARED[scaling]
        * _cross(points.psi_d, points.psi_q, points.i_d, points.i_q)
    )
    known = np.isfinite(file) & np.isfinite(of_map)
    if np.count_nonzero(known) < _FEWEST or not np.any(of_map[known]) or not np.any(file[known]):
        return None
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # what overflows is no torque and agrees with none
        slope, offset, misfit = _line(of_map[known], file[known], through_zero=declared != "shaft")
    found = TorqueCheck(
        points.torque.name,
        declared,
        slope,
        offset,
        misfit,
        int(np.count_nonzero(known)),
        per_pair,
    )
    if not _agree(found, file[known]):
        raise InputError(_refusal(found, points, file, pole_pairs, scaling), source=points.source)
    return found


def _cross(psi_d: FloatArray, psi_q: FloatArray, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    return psi_d * i_q - psi_q * i_d


def _line(x: FloatArray, y: FloatArray, *, through_zero: bool = True) -> tuple[float, float, float]:
    """Slope, offset and relative r.m.s. misfit of the least-squares line of y over x."""
    if through_zero:
        slope, offset = float(np.sum(x * y) / np.sum(x * x)), 0.0
    else:
        centred = x - np.mean(x)
        slope = float(np.sum(centred * y) / np.sum(centred * centred))
        offset = float(np.mean(y)) - slope * float(np.mean(x))
    return slope, offset, math.sqrt(float(np.mean((y - slope * x - offset) ** 2) / np.mean(y * y)))


def _agree(found: TorqueCheck, file: FloatArray) -> bool:
    """Whether the line is that of the same machine."""
    if found.declared != "shaft":
        return abs(found.slope - 1.0) <= _LARGEST and found.misfit <= _LARGEST
    low, high = _SHAFT_SLOPES
    largest = float(np.max(np.abs(file)))
    small = abs(found.offset) <= _SHAFT_OFFSET * largest * math.sqrt(
        float(np.mean((file / largest) ** 2))
    )
    return low <= found.slope <= high and found.misfit <= _SHAFT_MISFIT and small


def _refusal(
    found: TorqueCheck, points: FluxPoints, file: FloatArray, pole_pairs: int, scaling: FluxScaling
) -> str:
    """What to say of a torque that is another one, with the likely causes."""
    about = (
        f"the torque of the file ({found.name}) is {found.slope:.4g} times 3/2 p (psi_d i_q - "
        f"psi_q i_d) with {pole_pairs} pole pairs and scaling {scaling}, misfit "
        f"{100.0 * found.misfit:.2g} %"
    )
    causes = list(_factors(found, pole_pairs, scaling)) if found.misfit <= 2.0 * _LARGEST else []
    causes += [
        cause
        for cause in _exchanges(points, file, pole_pairs * SQUARED[scaling])
        if cause not in causes
    ]
    if not causes:
        below = found.declared == "air-gap" and 0.85 <= found.slope < 1.0
        causes = ["a torque behind friction and iron loss: write torque: shaft"] if below else []
    rest = "check scaling, pole_pairs and the columns, or write torque: ignore"
    return f"{about}; likely {', or '.join(causes)}" if causes else f"{about}; {rest}"


def _near(value: float, wanted: float) -> bool:
    return abs(value / wanted - 1.0) <= _NEAR


def _factors(found: TorqueCheck, pole_pairs: int, scaling: FluxScaling) -> Iterator[str]:
    """Likely causes of a ratio between the two torques."""
    slope = abs(found.slope)
    if found.slope < 0.0:
        yield (
            "the opposite sign: the torque counts positive for a generator, or i_q and psi_q (i_d "
            "and psi_d) are both negated; negate the torque, or these two"
        )
    if _near(slope, 1.0) or slope == 0.0:
        return
    for name, squared in SQUARED.items():
        if name != scaling and _near(slope * SQUARED[scaling], squared):
            yield f"another scaling: write scaling: {name}"
    yield from _of_pole_pairs(slope, pole_pairs, per_pair=found.declared == "per-pole-pair")
    for power in (1e3, 1e-3, 1e6, 1e-6):
        if _near(slope, power):
            yield (
                f"a unit {power:g} times off: check current_unit, flux_unit and the unit of the "
                "torque"
            )
    for root, what in (
        (2.0, "r.m.s. and peak"),
        (1.5, "power-invariant and peak"),
        (3.0, "line-to-line and phase"),
    ):
        if _near(slope, math.sqrt(root)) or _near(slope, math.sqrt(1.0 / root)):
            yield (
                f"currents and flux linkages of different scaling ({what} values): convert one of "
                "them in the file"
            )


def _of_pole_pairs(slope: float, pole_pairs: int, *, per_pair: bool) -> Iterator[str]:
    """Likely causes of a ratio of whole numbers."""
    pairs = slope * pole_pairs
    count = round(pairs)
    if (
        1 <= count <= _MOST_PAIRS
        and count != pole_pairs
        and abs(pairs - count) <= min(_NEAR * pairs, _NEAR_COUNT)
    ):
        yield f"another number of pole pairs: write pole_pairs: {count}"
    if pole_pairs > 1 and not per_pair and _near(slope * pole_pairs, 1.0):
        yield "a torque per pole pair: write torque: per-pole-pair"
    if pole_pairs > 1 and per_pair and _near(slope, pole_pairs):
        yield "a torque of the whole machine: write torque: air-gap"
    for parts in range(2, _MOST_PARTS + 1):
        if _near(slope * parts, 1.0) and parts != pole_pairs:
            yield f"the torque of one {parts}th of the machine, as modelled: multiply it by {parts}"


def _exchanges(points: FluxPoints, file: FloatArray, factor: float) -> Iterator[str]:
    """Exchanges of arrays and signs under which the two torques agree."""
    i_d, i_q, psi_d, psi_q = points.i_d, points.i_q, points.psi_d, points.psi_q
    trials: list[tuple[str, FloatArray]] = [
        ("i_d and i_q (or psi_d and psi_q) are exchanged", _cross(psi_d, psi_q, i_q, i_d)),
        ("the sign of one current or flux linkage is wrong", _cross(psi_d, -psi_q, i_d, i_q)),
    ]
    turned = _transposed(points)
    if turned is not None:
        trials.append(
            ("rows and columns of the flux linkages are exchanged", _cross(psi_d, psi_q, *turned))
        )
        trials.append(("psi_d and psi_q are exchanged", _cross(psi_q, psi_d, *turned)))
    for cause, cross in trials:
        of_map = 1.5 * factor * cross
        known = np.isfinite(file) & np.isfinite(of_map)
        if np.any(of_map[known]):
            with np.errstate(over="ignore", invalid="ignore"):
                slope, _, misfit = _line(of_map[known], file[known])
            if misfit <= _LARGEST and abs(abs(slope) - 1.0) <= _LARGEST:
                yield cause


def _transposed(points: FluxPoints) -> tuple[FloatArray, FloatArray] | None:
    """Currents (i_d, i_q) with rows and columns exchanged, where the points
    are a square grid in order.
    """
    size = math.isqrt(points.i_d.size)
    if size * size != points.i_d.size:
        return None
    i_d, i_q = points.i_d.reshape(size, size), points.i_q.reshape(size, size)
    if np.ptp(i_d, axis=0).any() and np.ptp(i_d, axis=1).any():
        return None
    return i_d.T.ravel(), i_q.T.ravel()
