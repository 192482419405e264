"""Flux maps over the rotor angle: their means make the map, what they have beside these becomes
Fourier series in the electrical angle.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import MOST_ORDERS, FluxMap, FluxRipple, swing
from dqforge.machines.dq_machines.map_deviations import LEAST_POINTS, axis_of
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray
from dqforge.machines.flux_maps.coordinates import Parts, unit_of
from dqforge.machines.flux_maps.flux_points import SAME, FileTorque, FluxPoints, TurningPoints
from dqforge.machines.flux_maps.map_names import per_pole_pair
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

_CLOSED = 0.02  # Difference over the ripple below which the last angle is the first one again.
_FEWEST = 6  # Angles that most pairs of currents have where the angle is a coordinate.
_UNEVEN = 0.01  # Distance of an angle from even steps over a step that is no rounding.
_SECTOR = math.pi / 3.0  # Electrical angle after which a machine of three equal phases repeats.
_NEAR = 0.05  # Distance of a period from a multiple of it, over a step of the angle.
_KEPT = 0.01  # Smallest order over the largest that is kept.
_TOLD = 0.2  # Misfit of torque and flux linkages, or of the mirror image, that is a warning.


class Turning(NamedTuple):
    """Quantities by name over pairs of currents and angles, shape (C, A); angles (A,) in rad."""

    parts: Parts
    angle: FloatArray


def cells_of(i_d: FloatArray, i_q: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Number of the pair of currents that each point has, shape (K,), and
    how often each pair occurs.
    """
    tolerance = max(SAME * float(np.max(np.abs([i_d, i_q]), initial=0.0)), 1e-300)
    keys = np.stack([np.round(i_d / tolerance), np.round(i_q / tolerance)], axis=1) + 0.0
    order = np.lexsort(keys.T)
    new = np.any(np.diff(keys[order], axis=0) != 0.0, axis=1)
    labels = np.empty(i_d.size, dtype=np.intp)
    labels[order] = np.append(0, np.cumsum(new))
    return labels, np.bincount(labels)


def averaged(
    parts: Parts, lines: NDArray[np.intp] | None, findings: tuple[str, ...], source: str
) -> tuple[Parts, NDArray[np.intp] | None, tuple[str, ...], Turning | None]:
    """Means over the angle of each pair of currents, how much flux linkages and torque change with
    it, and the points over it.

    Where most pairs have fewer than 6 angles these are no coordinate, and only means are made.

    Raises:
        InputError: A pair of currents lacks an angle of the others, or the angles are uneven.
    """
    angle = parts["angle"]
    rest = {name: part for name, part in parts.items() if name != "angle"}
    labels, counts = cells_of(parts["i_d"], parts["i_q"])
    if counts.max() < 2 or float(np.ptp(angle)) == 0.0:
        return rest, lines, findings, None
    order = np.lexsort([angle, labels])
    starts = np.append(0, np.cumsum(counts)[:-1])
    turning = None
    if np.median(counts) >= _FEWEST:
        _check_counts(parts, lines, order, starts, counts, source)
        table = angle[order].reshape(counts.size, -1)
        _check_angles(table, parts, order, starts, source)
        turning = Turning(
            {name: part[order].reshape(table.shape) for name, part in rest.items()}, table[0]
        )
    weights = _weights(rest, order, counts)
    total = np.add.reduceat(weights, starts)
    means = {
        name: np.add.reduceat(part[order] * weights, starts) / total for name, part in rest.items()
    }
    ripple = {
        name: np.maximum.reduceat(part[order], starts) - np.minimum.reduceat(part[order], starts)
        for name, part in rest.items()
    }
    flux = max(float(np.nanmax(ripple[name])) for name in ("psi_d", "psi_q"))
    often = (
        f"{counts.min()}" if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"
    )
    sentence = (
        f"averaged over {often} rotor angles; the flux linkages change by up to "
        f"{format_quantity(flux, 'Wb', 3)}"
    )
    if "torque" in ripple and np.any(np.isfinite(ripple["torque"])):
        worst = int(np.nanargmax(ripple["torque"]))
        sentence += (
            f", the torque by up to {format_quantity(float(ripple['torque'][worst]), 'N m', 3)} "
            f"(peak to peak) at i_d = {means['i_d'][worst]:g} A, i_q = {means['i_q'][worst]:g} A"
        )
    first = None if lines is None else np.minimum.reduceat(lines[order], starts)
    return means, first, (*findings, sentence), turning


def _weights(parts: Parts, order: NDArray[np.intp], counts: NDArray[np.intp]) -> FloatArray:
    """Weights of the sorted points: halves at both ends where the last angle
    repeats the first one's values.
    """
    weights = np.ones(order.size)
    if counts.min() != counts.max() or counts[0] < 3:
        return weights
    table = np.stack([parts[name][order].reshape(counts.size, -1) for name in ("psi_d", "psi_q")])
    gap = float(np.nanmax(np.abs(table[:, :, -1] - table[:, :, 0])))
    if gap <= _CLOSED * float(np.nanmax(np.ptp(table, axis=2))):
        ends = weights.reshape(counts.size, -1)
        ends[:, 0] = ends[:, -1] = 0.5
    return weights


def _check_counts(
    parts: Parts,
    lines: NDArray[np.intp] | None,
    order: NDArray[np.intp],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
    source: str,
) -> None:
    """Refuse a pair of currents with another number of angles than most."""
    most = int(np.bincount(counts).argmax())
    if np.all(counts == most):
        return
    cell = int(np.argmax(counts != most))
    first = order[starts[cell]]
    raise InputError(
        f"{counts[cell]} rotor angles at i_d = {parts['i_d'][first]:g} A, i_q = "
        f"{parts['i_q'][first]:g} A, elsewhere {most}; compute every angle once at each point",
        source=source,
        line=None if lines is None else int(lines[first]),
    )


def _check_angles(
    table: FloatArray,
    parts: Parts,
    order: NDArray[np.intp],
    starts: NDArray[np.intp],
    source: str,
) -> None:
    """Refuse angles, shape (C, A), that differ between pairs of currents or make uneven steps."""
    steps = np.diff(table[0])
    step = float(np.mean(steps))
    apart = np.max(np.abs(table - table[0]), axis=1)
    if np.any(apart > _UNEVEN * step):
        first = order[starts[int(np.argmax(apart))]]
        raise InputError(
            f"the rotor angles at i_d = {parts['i_d'][first]:g} A, i_q = {parts['i_q'][first]:g} A "
            "are not those of the first point; compute the same angles at each point",
            source=source,
        )
    if np.any(np.abs(steps - step) > _UNEVEN * step):
        place = int(np.argmax(np.abs(steps - step)))
        raise InputError(
            f"the rotor angles are not evenly spaced: {math.degrees(steps[place]):.4g} deg after "
            f"{math.degrees(table[0][place]):.4g} deg, {math.degrees(step):.4g} deg on average; "
            "save even steps over a whole period",
            source=source,
        )


def turning_points(
    turning: Turning, chosen: Mapping[str, NamedArray], source: str
) -> TurningPoints:
    """What `averaged` found over the angle, with what the names in the file say."""
    array, parts = chosen["angle"], turning.parts
    i_d, i_q, psi_d, psi_q = (parts[name].ravel() for name in ("i_d", "i_q", "psi_d", "psi_q"))
    torque = None
    if "torque" in parts and "torque" in chosen and np.all(np.isfinite(parts["torque"])):
        given = chosen["torque"]
        torque = FileTorque(
            given.path, parts["torque"].ravel(), per_pole_pair(f"{given.name} {given.unit}")
        )
    points = FluxPoints(source, i_d, i_q, psi_d, psi_q, torque=torque)
    kind = _kind(f"{array.name} {array.unit}")
    stated = unit_of(array, "angle", source) != ""
    return TurningPoints(array.name, kind, turning.angle, stated, points)


def _kind(name: str) -> Literal["", "electrical", "mechanical"]:
    """Which angle a name with its unit says."""
    if re.search(r"mech|(?:theta|θ|angle)_?m(?![a-z])", name, re.IGNORECASE):
        return "mechanical"
    electrical = r"elec|(?:theta|θ|angle)_?el?(?![a-z])|(?<![a-z])el(?![a-z])|edeg|radel"
    return "electrical" if re.search(electrical, name, re.IGNORECASE) else ""


@dataclass(frozen=True, slots=True, eq=False)
class _Waves:
    """Harmonics of order k = 2 pi m / period on a grid of currents: cosine and sine of psi_d, psi_q
    (H, 2, 2, M, N), and of dW'/dtheta (H, 2, M, N).
    """

    i_d: FloatArray
    i_q: FloatArray
    orders: FloatArray
    psi: FloatArray
    turning: FloatArray


def ripple_of(
    turning: TurningPoints, pole_pairs: int, *, per_pole_pair: bool, reluctance: bool
) -> tuple[FluxRipple | None, tuple[str, ...]]:
    """Ripple of a map from its points over the rotor angle, None where it cannot be used, and
    sentences on it.

    The derivative of the co-energy by the angle is what the torque of the file has beyond
    3/2 (psi_d i_q - psi_q i_d) per pole pair; without a torque it is the path integral of the
    derivative of the flux linkages by the angle, which knows no cogging.

    Args:
        turning: The points, in peak values with d along the magnets.
        pole_pairs: Of the machine.
        per_pole_pair: Whether the torque is that of one pole pair.
        reluctance: Whether the file had the magnets on the negative q axis: its angle is 90 deg
            (electrical) ahead.

    Raises:
        InputError: The angles cover no whole multiple of 60 deg (electrical), or more than a turn.
    """
    points, count = turning.points, turning.angle.size
    grid = _grid(points, count)
    if grid is None:
        said = "warning: the ripple over the rotor angle is not used: it needs currents on a grid"
        return None, (f"{said} of at least 4 x 4 points, of both signs of i_q or from 0 on",)
    i_d, i_q, place = grid
    shape = i_d.size, i_q.size, count
    values = np.stack([points.psi_d, points.psi_q]).reshape(2, -1, count)[:, place]
    psi = values.reshape(2, *shape)
    torque = None
    if points.torque is not None:
        torque = points.torque.values.reshape(-1, count)[place].reshape(shape)
        torque = torque if per_pole_pair else torque / pole_pairs
    turning, degrees = _within_turn(turning, pole_pairs)
    trials: list[tuple[str, _Waves, _Agreement | None]] = []
    for kind, factor in (("electrical", 1), ("mechanical", pole_pairs)):
        if turning.kind not in ("", kind) or (pole_pairs == 1 and trials):
            continue
        used = _whole_period(turning.angle, factor)
        if used is None:
            continue
        theta = factor * turning.angle[:used] - (0.5 * math.pi if reluctance else 0.0)
        waves = _waves(i_d, i_q, theta, psi[..., :used])
        agreement = None if torque is None else _compared(waves, torque[..., :used], theta)
        trials.append((kind, waves, agreement))
    if not trials:
        kinds = turning.kind or "electrical"
        factor = pole_pairs if kinds == "mechanical" else 1
        span = math.degrees(factor * (turning.angle[-1] - turning.angle[0]))
        raise InputError(
            f"the rotor angles ({turning.name}) span {span:.4g} deg (electrical), no whole "
            "multiple of 60 deg with or without the last one; save a whole period, and name the "
            "angle theta_el or theta_mech",
            source=points.source,
        )
    # Read as another angle, flux linkages would give p times the torque ripple, or 1/p of it.
    kind, waves, agreement = min(
        trials, key=lambda one: 0.0 if one[2] is None else abs(math.log(max(one[2].slope, 1e-9)))
    )
    told = _told(turning, kind, waves, agreement, pole_pairs, guessed=len(trials) > 1)
    waves = waves if agreement is None else agreement.waves
    kept, said = _strongest(waves)
    mirrored, about = _both_halves(kept)
    maps = [
        [FluxMap(mirrored.i_d, mirrored.i_q, *mirrored.psi[k, part]) for part in (0, 1)]
        for k in range(mirrored.orders.size)
    ]
    ripple = FluxRipple(
        tuple(map(float, mirrored.orders)),
        2.0 * math.pi / float(waves.orders[0]),
        tuple(part[0] for part in maps),
        tuple(part[1] for part in maps),
        tuple(FluxMap(mirrored.i_d, mirrored.i_q, *part) for part in mirrored.turning),
    )
    return ripple, (*degrees, told, said, *about)


def _grid(points: FluxPoints, count: int) -> tuple[FloatArray, FloatArray, NDArray[np.intp]] | None:
    """Axes in A of a grid of both halves of i_q or one, and the pair of currents of each node;
    None where there is no such grid.
    """
    at_d, at_q = points.i_d[::count], points.i_q[::count]
    width = SAME * float(max(np.max(np.abs(at_d)), np.max(np.abs(at_q))))
    (i_d, row), (i_q, column) = axis_of(at_d, width), axis_of(at_q, width)
    if at_d.size != i_d.size * i_q.size or np.unique(row * i_q.size + column).size != at_d.size:
        return None
    place = np.empty((i_d.size, i_q.size), dtype=np.intp)
    place[row, column] = np.arange(at_d.size)
    i_q = np.where(np.abs(i_q) <= width, 0.0, i_q)
    if np.max(np.abs(i_q + i_q[::-1])) > width:
        # Of unequal halves the larger one counts; the other follows by symmetry.
        kept = i_q >= 0.0 if i_q[-1] >= -i_q[0] else i_q <= 0.0
        i_q, place = i_q[kept], place[:, kept]
    if min(i_d.size, i_q.size) < LEAST_POINTS:
        return None
    return i_d, i_q, place.ravel()


def _within_turn(turning: TurningPoints, pole_pairs: int) -> tuple[TurningPoints, tuple[str, ...]]:
    """The points with angles of at most a turn of the shaft: an angle without a unit that would be
    more in radians is in degrees, as a sentence says.
    """
    span = float(turning.angle[-1] - turning.angle[0])
    most = 2.0 * math.pi * (1 if turning.kind == "mechanical" else pole_pairs) * (1.0 + _NEAR)
    if span <= most:
        return turning, ()
    if not turning.stated and math.radians(span) <= most:
        said = f"{turning.name} has no unit and was read in degrees: radians would be"
        return replace(turning, angle=np.radians(turning.angle)), (
            f"{said} {span / (2.0 * math.pi):.3g} turns",
        )
    raise InputError(
        f"the rotor angles ({turning.name}) span {math.degrees(span):.4g} deg, more than a turn of "
        "the shaft; name their unit, as in theta_el [deg]",
        source=turning.points.source,
    )


def _whole_period(angle: FloatArray, factor: int) -> int | None:
    """How many of the angles make a whole multiple of 60 deg (electrical), None where none do."""
    step = factor * (angle[-1] - angle[0]) / (angle.size - 1)
    for used in (angle.size, angle.size - 1):
        turns = round(used * step / _SECTOR)
        if turns >= 1 and abs(used * step - turns * _SECTOR) <= _NEAR * step:
            return used
    return None


def _series(values: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orders (H,), and cosine and sine (H, 2, ...) of values (..., A) over a period of angles."""
    period = theta.size * (theta[-1] - theta[0]) / (theta.size - 1)
    sectors = round(period / _SECTOR)
    orders = 6.0 / sectors * np.arange(1, (theta.size - 1) // 2 + 1)
    turns = np.outer(orders, theta)
    waves = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    return orders, 2.0 / theta.size * np.moveaxis(
        np.tensordot(values, waves, (-1, -1)), (-2, -1), (0, 1)
    )


def _waves(i_d: FloatArray, i_q: FloatArray, theta: FloatArray, psi: FloatArray) -> _Waves:
    """Harmonics of flux linkages (2, M, N, A) in Wb, with the torque that follows from them."""
    orders, found = _series(psi, theta)
    # By the angle a cosine becomes a negative sine.
    slopes = orders[:, None, None, None, None] * np.stack([found[:, 1], -found[:, 0]], axis=1)
    return _Waves(i_d, i_q, orders, found, 1.5 * _path_integral(i_d, i_q, slopes))


def _path_integral(i_d: FloatArray, i_q: FloatArray, slopes: FloatArray) -> FloatArray:
    """Integral of a vector field (..., 2, M, N) from zero current, mean of d first and q first."""
    from scipy.interpolate import make_interp_spline

    def integral(axis: FloatArray, values: FloatArray, place: int) -> FloatArray:
        whole = make_interp_spline(axis, values, k=3, axis=place).antiderivative()
        return np.asarray(whole(axis) - np.expand_dims(whole(0.0), place))

    def at_zero(axis: FloatArray, values: FloatArray, place: int) -> FloatArray:
        return np.expand_dims(make_interp_spline(axis, values, k=3, axis=place)(0.0), place)

    last = slopes.ndim - 2
    along_d, along_q = slopes[..., 0, :, :], slopes[..., 1, :, :]
    over_d, over_q = integral(i_d, along_d, last - 1), integral(i_q, along_q, last)
    first = at_zero(i_q, over_d, last) + over_q
    second = at_zero(i_d, over_q, last - 1) + over_d
    return 0.5 * (first + second)


class _Agreement(NamedTuple):
    """Harmonics with the torque of the file, and how the one by the flux linkages compares with it:
    slope and relative misfit of what depends on the currents, and cogging in N m per pole pair.
    """

    waves: _Waves
    slope: float
    misfit: float
    cogging: float


def _compared(waves: _Waves, torque: FloatArray, theta: FloatArray) -> _Agreement:
    """Harmonics with dW'/dtheta from a torque (M, N, A) per pole pair in N m."""
    found = _series(torque, theta)[1]
    psi = waves.psi
    found = found - 1.5 * (psi[:, :, 0] * waves.i_q - psi[:, :, 1] * waves.i_d[:, None])
    node = int(np.argmin(np.abs(waves.i_d))), int(np.argmin(np.abs(waves.i_q)))
    cogging = found[:, :, node[0], node[1]]
    beside = found - cogging[..., None, None]
    own = waves.turning - waves.turning[:, :, node[0], node[1]][..., None, None]
    square = float(np.sum(own * own))
    slope = float(np.sum(own * beside)) / square if square > 0.0 else 1.0
    whole = float(np.sum(found * found))
    misfit = math.sqrt(float(np.sum((beside - own) ** 2)) / whole) if whole > 0.0 else 0.0
    largest = swing(waves.orders, 2.0 * math.pi / float(waves.orders[0]), cogging[..., None])
    made = _Waves(waves.i_d, waves.i_q, waves.orders, psi, found)
    return _Agreement(made, slope, misfit, float(largest[0]))


def _told(
    turning: TurningPoints,
    kind: str,
    waves: _Waves,
    agreement: _Agreement | None,
    pole_pairs: int,
    *,
    guessed: bool,
) -> str:
    """What the angle is taken for, and how torque and flux linkages agree."""
    span = 360.0 / float(waves.orders[0])
    why = ""
    if guessed:
        why = (
            ", as the torque shows" if agreement is not None else ", name it theta_el or theta_mech"
        )
    about = f"rotor angle ({turning.name}) taken as {kind}{why}: {span:.4g} deg (electrical)"
    if agreement is None:
        return f"{about}; without a torque its ripple follows from the flux linkages, less cogging"
    warning = "warning: " if agreement.misfit > _TOLD else ""
    return (
        f"{warning}{about}; beside 3/2 p (psi_d i_q - psi_q i_d) the torque's ripple lies "
        f"{_percent(agreement.misfit)} (r.m.s.) from the derivative of the co-energy by the "
        f"angle, cogging {format_quantity(pole_pairs * agreement.cogging, 'N m', 3)} peak to peak"
    )


def _percent(share: float) -> str:
    return "less than 0.01 %" if share < 1e-4 else f"{100.0 * share:.2g} %"


def _strongest(waves: _Waves) -> tuple[_Waves, str]:
    """The orders that make the ripple, and a sentence on them."""
    flux = np.max(np.abs(waves.psi), axis=(1, 2, 3, 4))
    torque = np.max(np.abs(_torque_of(waves)), axis=(1, 2, 3))
    weight = np.maximum(
        flux / max(float(flux.max()), 1e-300), torque / max(float(torque.max()), 1e-300)
    )
    kept = np.zeros(weight.size, dtype=bool)
    kept[np.argsort(-weight, kind="stable")[:MOST_ORDERS]] = True
    kept &= weight >= _KEPT
    kept[0] |= not np.any(kept)
    square = np.sum(_torque_of(waves) ** 2, axis=(1, 2, 3))
    left = float(np.sum(square[~kept])) / max(float(np.sum(square)), 1e-300)
    orders = ", ".join(f"{order:g}" for order in waves.orders[kept])
    said = (
        f"ripple over the angle: orders {orders} per electrical turn kept, "
        f"{_percent(math.sqrt(left))} (r.m.s.) of the torque's left out"
    )
    return _Waves(
        waves.i_d, waves.i_q, waves.orders[kept], waves.psi[kept], waves.turning[kept]
    ), said


def _torque_of(waves: _Waves) -> FloatArray:
    """Torque per pole pair in N m of each order, cosine and sine, (H, 2, M, N)."""
    cross = waves.psi[:, :, 0] * waves.i_q - waves.psi[:, :, 1] * waves.i_d[:, None]
    return 1.5 * cross + waves.turning


# A machine and its mirror image about an axis at the angle theta_0 are one: at -i_q and
# 2 theta_0 - theta, psi_d is the same, psi_q and the torque are the negative.
_MIRROR = np.array([1.0, -1.0, -1.0])


def _both_halves(waves: _Waves) -> tuple[_Waves, tuple[str, ...]]:
    """Harmonics over both halves of i_q: those of a half plane are mirrored, about the angle at
    which those at the least i_q are most like their mirror image.
    """
    i_q = waves.i_q
    if i_q[0] < 0.0 < i_q[-1]:
        return waves, ()
    least = int(np.argmin(np.abs(i_q)))
    values = np.concatenate([waves.psi, waves.turning[:, :, None]], axis=2)  # (H, 2, 3, M, N)
    edge = values[..., least]
    size = np.sum(edge * edge, axis=(0, 1, 3))
    scale = np.where(size > 0.0, size, 1.0)[:, None]

    def apart(theta: float) -> float:
        gap = (edge - _turned(edge, waves.orders, theta) * _MIRROR[:, None]) / np.sqrt(scale)
        return 0.25 * float(np.sum(gap * gap)) / 3.0

    trials = np.arange(720) * (math.pi / float(waves.orders[0]) / 720)
    found = np.array([apart(float(theta)) for theta in trials])
    best = 0.0 if found[0] <= 1e-6 + float(found.min()) else float(trials[int(np.argmin(found))])
    image = _turned(values, waves.orders, best) * _MIRROR[:, None, None]
    if i_q[least] == 0.0:
        values[..., least] = 0.5 * (values[..., least] + image[..., least])
    keep = np.arange(i_q.size) != least if i_q[least] == 0.0 else np.ones(i_q.size, dtype=bool)
    parts = [(i_q, values), (-i_q[keep][::-1], image[..., keep][..., ::-1])]
    parts = parts if i_q[0] < 0.0 else parts[::-1]
    axis = np.concatenate([part[0] for part in parts])
    whole = np.concatenate([part[1] for part in parts], axis=-1)
    misfit = math.sqrt(apart(best))
    said = f"its half plane was mirrored about the angle {math.degrees(best):.4g} deg (electrical)"
    if misfit > _TOLD:
        said = f"warning: {said}, which at i_q = 0 does not fit ({100.0 * misfit:.2g} %)"
    made = _Waves(waves.i_d, axis, waves.orders, whole[:, :, :2], whole[:, :, 2])
    return made, (said,)


def _turned(values: FloatArray, orders: FloatArray, theta: float) -> FloatArray:
    """Cosine and sine (H, 2, ...) of the same waves over 2 theta_0 less the angle."""
    shape = (-1, *(1,) * (values.ndim - 2))
    c, s = (f(2.0 * orders * theta).reshape(shape) for f in (np.cos, np.sin))
    return np.stack([c * values[:, 0] + s * values[:, 1], s * values[:, 0] - c * values[:, 1]], 1)
