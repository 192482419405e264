"""Enclosures of the errors of a two-dimensional reference on boxes of
torque and excess flux linkage.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball_arrays import Balls, magnitude, most
from dqforge.optimizer.field_weakening.border_curves import in_double
from dqforge.optimizer.field_weakening.enclosures import (
    Bend,
    Boxes,
    Currents,
    Parts,
    composed,
    currents,
    formulas,
    inverse_square,
    machine_parts,
    resolved,
)
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.field_weakening.form import WeakeningReference
from dqforge.optimizer.field_weakening.limit_bounds import limit_room

# Share of the least flux linkage below which a box is halved first: it reaches far beyond the
# domain.
_LEAST_FLUX = 0.3
_SLACK = 1e-14


@dataclass(frozen=True, slots=True)
class Enclosed:
    """Bounds on each box, arrays of shape (N,); infinite where nothing is known yet.

    ``low`` and ``high`` in N m bound the torque made less t; ``excess`` (shape (2, N)) the squared
    flux linkage over the squared available one less 1, and likewise the squared current. ``centre``
    (shape (3, N)) holds the three at the centres, nan where nothing is known; where the field is
    not weakened, that is at the least flux linkage that leaves it so. ``room`` (shape (3, N)) is
    what of the bounds is owed to rounding. ``rise`` bounds in A^2/Wb how the squared current may
    rise with the available flux linkage. ``along`` says whether the errors bend more along the
    torque than along the flux linkage.
    """

    low: FloatArray
    high: FloatArray
    excess: FloatArray
    centre: FloatArray
    room: FloatArray
    rise: FloatArray
    along: NDArray[np.bool_]


def _room(parts: Parts, boxes: Boxes, places: NDArray[np.intp] | slice) -> FloatArray:
    """What the rounding of the currents may add to a function of them."""
    room = (
        magnitude(parts[1]) * boxes.rounding_d[places]
        + magnitude(parts[2]) * boxes.rounding_q[places]
    )
    return np.asarray(room * (1.0 + _SLACK))


@dataclass(frozen=True, slots=True)
class _Held:
    """Boxes some of which reach beyond the torque limit: available flux linkage at
    their centres and over them.
    """

    at_centre: Bend
    over: Bend
    half: tuple[FloatArray, FloatArray]
    t: Balls

    def highest(
        self, reference: WeakeningReference, inner: Bend, outer: Bend, overhang: float
    ) -> FloatArray:
        """Upper bounds of a function on the part of each box within the limit.

        Infinite where there is none.

        With any m >= 0 it is at most its sum with m (L(a) - t), which is not negative there: with
        the m that leaves no slope along the torque or along the excess, the slope beyond the limit
        costs nothing.
        """
        top = np.full(self.t.mid.shape, np.inf)
        least = np.maximum(self.over.value.lower() - float(reference.flux_min), 0.0)
        beyond = np.flatnonzero(in_double(reference.limit, least) < self.t.upper())
        where, room, bends, error = limit_room(reference, self.at_centre, self.over, beyond)
        if where.size == 0:
            return top
        t, one = self.t.at(where), Balls.exact(np.ones(where.size))
        room = Bend(room.value - t.mid + (error + overhang), room.t - one, room.x, 0, 0, 0)
        inner, outer = inner.at(where), outer.at(where)
        half = self.half[0][where], self.half[1][where]
        for slope, other in ((inner.t, room.t), (inner.x, room.x)):
            with np.errstate(divide="ignore", invalid="ignore"):
                weight = np.nan_to_num(
                    np.maximum(-Balls.of(slope).mid / other.mid, 0.0), posinf=0.0
                )
            found = _raised(inner, room, weight).range(_raised(outer, bends, weight), *half)[1]
            top[where] = np.fmin(top[where], found)
        return top


def _raised(one: Bend, other: Bend, weight: FloatArray) -> Bend:
    """The first function and a multiple of the second one."""
    parts = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(Bend))
    return Bend(
        *(
            first + (second * weight if isinstance(second, Balls) else second)
            for first, second in parts
        )
    )


def enclose(
    region: WeakeningRegion, reference: WeakeningReference, boxes: Boxes, overhang: float = 0.0
) -> Enclosed:
    """Bounds of the errors on boxes: Taylor polynomials of second degree about the centres,
    with their remainders.

    The current is bounded for torques up to ``overhang`` N m above the limit,
    the others on the whole boxes.
    """
    t, x = boxes.t, boxes.x
    here = currents(reference, boxes, Balls.exact(t.mid), Balls.exact(x.mid))
    exact = currents(reference, boxes, t, x)
    over = Currents(
        exact.d.widened(boxes.rounding_d), exact.q.widened(boxes.rounding_q), exact.available
    )
    known = resolved(region.machine, over.d.value, over.q.value)
    far = exact.available.value.lower() > _LEAST_FLUX * region.flux_min
    if boxes.weakens:
        known &= far
    low, high = (np.where(known, -sign * np.inf, sign * np.inf) for sign in (-1.0, 1.0))
    excess = np.where(known, -np.inf, np.inf) * np.ones((2, 1))
    centre = np.full((3, boxes.count), np.nan)
    room = np.zeros((3, boxes.count))
    rise = np.where(known, 0.0, np.inf)
    # Where nothing is known, what counts is how far the currents reach.
    reach = [
        (magnitude(getattr(over.d, name)) + magnitude(getattr(over.q, name))) * part.rad
        for name, part in (("t", t), ("x", x))
    ]
    bends = np.stack([np.broadcast_to(part, boxes.t_low.shape) for part in reach])
    least = float(reference.flux_min)
    for places, formula in formulas(region.machine, over.d.value, over.q.value):
        half = t.rad[places], x.rad[places]
        inner, outer = here.at(places), over.at(places)
        both = [
            machine_parts(region.machine, formula, part.d.value, part.q.value)
            for part in (inner, outer)
        ]
        torque, flux, current = (
            (composed(one, inner.d, inner.q), composed(two, outer.d, outer.q))
            for one, two in zip(*both, strict=True)
        )
        rooms = [_room(parts, boxes, places) for parts in both[1]]
        ends = Bend(torque[0].value - t.mid[places], torque[0].t - 1.0, *_rest(torque[0])).range(
            torque[1], *half
        )
        shares = [inverse_square(part.available) for part in (inner, outer)]
        ratio = [part.times(share) for part, share in zip(flux, shares, strict=True)]
        top_flux = ratio[0].range(ratio[1], *half)[1] + rooms[1] * magnitude(shares[1].value)
        at_centre = ratio[0].value.mid
        if not boxes.weakens:
            plain = flux[0].range(flux[1], *half)[1] + rooms[1]
            plain, plain_centre = plain / least**2 * (1.0 + _SLACK), flux[0].value.mid / least**2
            top_flux = np.where(far[places], np.minimum(top_flux, plain), plain)
            at_centre = np.where(far[places], np.minimum(at_centre, plain_centre), plain_centre)
        top_current = current[0].range(current[1], *half)[1] + rooms[2]
        if boxes.weakens:
            held = _Held(here.available.at(places), over.available.at(places), half, t.at(places))
            top_current = np.minimum(
                top_current, held.highest(reference, *current, overhang) + rooms[2]
            )
        settled = known[places]
        low[places] = np.where(settled, np.minimum(low[places], ends[0] - rooms[0]), -np.inf)
        high[places] = np.where(settled, np.maximum(high[places], ends[1] + rooms[0]), np.inf)
        tops = (
            np.stack([top_flux, top_current / region.i_max**2]) * (1.0 + _SLACK)
            - 1.0
            + 2.0 * _SLACK
        )
        excess[:, places] = np.where(settled, np.maximum(excess[:, places], tops), np.inf)
        rising = np.maximum(most(-Balls.of(current[1].x)), 0.0)
        rise[places] = np.where(settled, np.maximum(rise[places], rising), np.inf)
        owed = np.stack(
            [rooms[0], rooms[1] * magnitude(shares[1].value), rooms[2] / region.i_max**2]
        )
        room[:, places] = np.where(settled, np.maximum(room[:, places], owed), room[:, places])
        centre[:, places] = np.stack(
            [
                torque[0].value.mid - t.mid[places],
                at_centre - 1.0,
                current[0].value.mid / region.i_max**2 - 1.0,
            ]
        )
        for row, name in enumerate(("tt", "xx")):
            rate = magnitude(getattr(torque[1], name)) / region.torque_max + magnitude(
                getattr(ratio[1], name)
            )
            bends[row, places] = np.where(settled, rate * half[row] ** 2, bends[row, places])
    return Enclosed(low, high, excess, centre, room, rise, bends[0] >= bends[1])


def _rest(bend: Bend) -> tuple[object, ...]:
    return bend.x, bend.tt, bend.tx, bend.xx
