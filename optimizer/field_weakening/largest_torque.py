"""Proven bounds of the largest torque that can be had within current and voltage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball_arrays import Balls
from dqforge.optimizer.field_weakening.enclosures import formulas, machine_parts, resolved
from dqforge.optimizer.field_weakening.form import WeakeningRegion

_SOLVED = 800
_NODES = 40_001

# Share by which the points that prove the least of the largest torque stay within the limits.
_SAFE = 1.5e-5

# Share of the largest torque within which its bounds from above and from below are close enough.
_INTERVALS = 200
_GRID = 32
_HALVINGS = 5
_ENOUGH = 1e-5
_WIDER = 1.0 + 1e-11  # Squares overlap by that much, so that rounding leaves nothing between them.

# Share of a limit within which a point counts as on it: it guides the choice of multipliers alone.
_ACTIVE = 1e-4


@dataclass(frozen=True, slots=True)
class LargestTorque:
    """Bounds of the largest torque in N m within the current limit and an
    available flux linkage a in Wb.

    It rises with a. From below: points ``flux`` (ascending) at which currents were found that make
    ``torque`` within both limits. From above: on each interval between ``edges`` the Lagrangian
    bound ``constant`` + ``slope`` a^2, or ``floor`` where that is higher; the last of them holds
    for any larger flux linkage, too.
    """

    flux: FloatArray
    torque: FloatArray
    edges: FloatArray
    constant: FloatArray
    slope: FloatArray
    floor: FloatArray

    def least(self, flux: FloatArray) -> FloatArray:
        """What can be had for certain, at any shape of flux linkages."""
        place = np.searchsorted(self.flux, flux, side="right") - 1
        return np.where(place >= 0, self.torque[np.maximum(place, 0)], -np.inf)

    def largest(self, flux: FloatArray) -> FloatArray:
        """What cannot be exceeded, at any shape of flux linkages within the domain."""
        place = np.clip(np.searchsorted(self.edges, flux) - 1, 0, self.edges.size - 2)
        size = np.abs(self.constant[place]) + self.slope[place] * flux * flux
        bound = self.constant[place] + self.slope[place] * flux * flux + 1e-14 * size
        return np.asarray(np.maximum(bound, self.floor[place]))


def _from_below(region: WeakeningRegion, levels: FloatArray) -> FloatArray:
    """Torque in N m that is proven to be within reach at ascending flux linkages in Wb,
    shape (N,).
    """
    safe = WeakeningRegion(
        region.machine,
        region.i_max * (1.0 - _SAFE),
        region.flux_min,
        region.flux_max,
        region.torque_max,
    )
    solved = levels[0] + (levels[-1] - levels[0]) * np.linspace(0.0, 1.0, _SOLVED) ** 2
    points = safe.points(np.full(_SOLVED, 2.0 * region.torque_max), solved * (1.0 - _SAFE))
    i_d, i_q = (Balls.exact(np.interp(levels, solved, part)) for part in (points.i_d, points.i_q))
    torque, flux, current = (np.full(levels.size, value) for value in (np.inf, -np.inf, -np.inf))
    for places, formula in formulas(region.machine, i_d, i_q):
        parts = machine_parts(region.machine, formula, i_d.at(places), i_q.at(places))
        torque[places] = np.minimum(torque[places], parts[0][0].lower())
        flux[places] = np.maximum(flux[places], parts[1][0].upper())
        current[places] = np.maximum(current[places], parts[2][0].upper())
    within = (flux <= levels * levels * (1.0 - 1e-12)) & (
        current <= region.i_max**2 * (1.0 - 1e-12)
    )
    return np.maximum.accumulate(np.where(within & np.isfinite(torque), torque, -np.inf))


def _multipliers(region: WeakeningRegion, flux: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Torque per squared flux linkage and per squared current at the solved optima.

    Any that are not negative serve.
    """
    points = region.points(np.full(flux.size, 2.0 * region.torque_max), flux)
    jet, k = region.machine.jet(points.i_d, points.i_q), 1.5 * region.machine.pole_pairs
    by_d = k * (jet.l_dd * points.i_q - jet.psi_q - jet.l_qd * points.i_d)
    by_q = k * (jet.psi_d + jet.l_dq * points.i_q - jet.l_qq * points.i_d)
    flux_d, flux_q = (
        jet.psi_d * jet.l_dd + jet.psi_q * jet.l_qd,
        jet.psi_d * jet.l_dq + jet.psi_q * jet.l_qq,
    )
    in_flux = np.hypot(jet.psi_d, jet.psi_q) > (1.0 - _ACTIVE) * flux
    in_current = np.hypot(points.i_d, points.i_q) > (1.0 - _ACTIVE) * region.i_max
    found = np.zeros((2, flux.size))
    for place in range(flux.size):
        rows = (
            np.array([[flux_d[place], flux_q[place]], [points.i_d[place], points.i_q[place]]]) * 2.0
        )
        active = np.flatnonzero([in_flux[place], in_current[place]])
        gradient = np.array([by_d[place], by_q[place]])
        found[active, place] = np.linalg.lstsq(rows[active].T, gradient, rcond=None)[0]
    found = np.maximum(found, 0.0)
    return found[0], found[1]


@dataclass(frozen=True, slots=True)
class _Squares:
    """Torque, squared flux linkage and squared current on squares of the plane of currents.

    ``mid`` and ``rad`` are balls of the values and gradients at the centres and of the Hessians
    over the squares, shape (3, 6, N); ``owner`` is the square that each belongs to, of which there
    is one for each cell of a flux map. ``unknown`` marks squares that touch too many cells.
    """

    owner: NDArray[np.intp]
    mid: FloatArray
    rad: FloatArray
    half: float
    unknown: NDArray[np.bool_]

    @classmethod
    def of(cls, machine: Machine, i_d: FloatArray, i_q: FloatArray, half: float) -> _Squares:
        half *= _WIDER
        wide = Balls.between(i_d - half, i_d + half), Balls.between(i_q - half, i_q + half)
        unknown = ~resolved(machine, *wide)
        owners: list[NDArray[np.intp]] = [np.zeros(0, dtype=np.intp)]
        mids: list[FloatArray] = [np.zeros((3, 6, 0))]
        rads: list[FloatArray] = [np.zeros((3, 6, 0))]
        for places, formula in formulas(machine, *wide):
            owner = np.arange(i_d.size)[places]
            here = machine_parts(machine, formula, Balls.exact(i_d[owner]), Balls.exact(i_q[owner]))
            over = machine_parts(machine, formula, wide[0].at(owner), wide[1].at(owner))
            parts = [
                Balls.of(part)
                for one, two in zip(here, over, strict=True)
                for part in (*one[:3], *two[3:])
            ]
            owners.append(owner)
            for sink, name in ((mids, "mid"), (rads, "rad")):
                rows = [np.broadcast_to(getattr(part, name), owner.shape) for part in parts]
                sink.append(np.stack(rows).reshape(3, 6, -1))
        mid, rad = np.concatenate(mids, axis=2), np.concatenate(rads, axis=2)
        return cls(np.concatenate(owners), mid, rad, half, unknown)

    def highest(self, weights: FloatArray) -> FloatArray:
        """Upper bounds of a weighted sum of the three functions on each square,
        weights of shape (3,); shape (N,).
        """
        mid, rad = (
            np.tensordot(factor, part, 1)
            for factor, part in ((weights, self.mid), (abs(weights), self.rad))
        )
        rad += np.tensordot(abs(weights), np.abs(self.mid), 1) * 2.0**-49
        slopes, square = np.abs(mid[1:3]) + rad[1:3], self.half**2
        bends = np.maximum(mid[[3, 5]] + rad[[3, 5]], 0.0)
        rise = (
            slopes.sum(axis=0) * self.half
            + (np.abs(mid[4]) + rad[4] + 0.5 * bends.sum(axis=0)) * square
        )
        return np.asarray(mid[0] + (rad[0] + rise) * _WIDER + np.abs(mid[0]) * 2.0**-50)


@dataclass(frozen=True, slots=True)
class _Lagrangian:
    """What bounds the largest torque on each interval of the flux linkage, arrays of K intervals.

    ``weights`` of torque, squared flux linkage and squared current, shape (K, 3); ``enough`` is a
    bound that needs no refinement. Squares with a squared flux linkage above ``ceiling`` or a
    torque below ``floor`` do not count.
    """

    weights: FloatArray
    enough: FloatArray
    ceiling: FloatArray
    floor: FloatArray

    def largest(self, region: WeakeningRegion) -> FloatArray | None:
        """Upper bounds of its largest value within the current limit, shape (K,)."""
        axis = region.i_max * (2.0 * np.arange(_GRID) + 1.0 - _GRID) / _GRID
        i_d, i_q = (part.ravel() for part in np.meshgrid(axis, axis))
        half, found = region.i_max / _GRID, np.full(self.floor.size, -np.inf)
        for step in range(_HALVINGS + 1):
            near = np.hypot(*(np.maximum(np.abs(part) - half, 0.0) for part in (i_d, i_q)))
            inside = near <= region.i_max * (1.0 + 1e-9)
            i_d, i_q = i_d[inside], i_q[inside]
            squares = _Squares.of(region.machine, i_d, i_q, half)
            open_ones = squares.unknown
            if step == _HALVINGS and np.any(open_ones):
                return None
            least_flux, most_torque = (
                -squares.highest(np.array([0.0, -1.0, 0.0])),
                squares.highest(np.eye(3)[0]),
            )
            for place in range(found.size):
                allowed = (least_flux <= self.ceiling[place]) & (most_torque > self.floor[place])
                bound = squares.highest(self.weights[place])
                high = allowed & (bound > self.enough[place]) & (step < _HALVINGS)
                open_ones[squares.owner[high]] = True
                found[place] = np.max(bound[allowed & ~high], initial=found[place])
            half *= 0.5
            i_d, i_q = (
                (part[open_ones][:, np.newaxis] + half * np.array(signs)).ravel()
                for part, signs in ((i_d, (-1.0, -1.0, 1.0, 1.0)), (i_q, (-1.0, 1.0, -1.0, 1.0)))
            )
        return found


def largest_torque(region: WeakeningRegion) -> LargestTorque | None:
    """Enclose the largest torque at every available flux linkage of a region.

    From above by weak duality: no current within both limits makes more than the largest T - lambda
    (|psi|^2 - a^2) - mu (|i|^2 - i_max^2), which is bounded on squares of the whole plane of
    currents; squares in which the flux linkage or the current is beyond its limit, or which make
    too little torque, are left out (S. Boyd, L. Vandenberghe, "Convex Optimization", 2004, section
    5.2). Any multipliers serve; those of the solved optima are nearly the best ones.

    Returns:
        None where the points of a flux map lie so close that squares of currents
        touch too many of its cells.
    """
    share = np.linspace(0.0, 1.0, _NODES)
    levels = region.flux_min + (region.flux_max - region.flux_min) * share
    # Single precision may put both ends a little outside.
    levels[0], levels[-1] = region.flux_min * (1.0 - 1e-7), region.flux_max * (1.0 + 1e-7)
    # The last interval holds however much flux linkage is available.
    steps = np.append(np.linspace(0.0, 1.0, _INTERVALS) ** 2, 2.0)
    edges = region.flux_min + (region.flux_max - region.flux_min) * steps
    edges[0] = levels[0]
    ceiling = np.append(edges[1:-1] ** 2 * (1.0 + 1e-12), np.inf)
    torque = _from_below(region, levels)
    slope, by_current = _multipliers(region, 0.5 * (edges[1:] + edges[:-1]))
    slope[-1] = 0.0
    floor, aim = (
        np.maximum(
            torque[np.minimum(np.searchsorted(levels, ends * (1.0 - 1e-12)), _NODES - 1)], 0.0
        )
        for ends in (edges[:-1], edges[1:])
    )
    weights = np.stack([np.ones(_INTERVALS), -slope, -by_current], axis=1)
    offset = by_current * region.i_max**2
    enough = aim - slope * edges[1:] ** 2 - offset + _ENOUGH * region.torque_max
    constant = _Lagrangian(weights, enough, ceiling, floor).largest(region)
    if constant is None:
        return None
    constant = constant + offset + 1e-14 * (np.abs(constant) + offset)
    return LargestTorque(levels, torque, edges, constant, slope, floor)
