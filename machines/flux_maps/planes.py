"""Planes of a flux map: full grids, half planes and their mirror images.

A plane is a full rectangle that is symmetric in i_q. Files hold half planes and planes whose
halves differ by measurement errors.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import complete_by_symmetry
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.names import FluxSymmetry
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

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
