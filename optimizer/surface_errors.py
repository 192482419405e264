"""Enclosures of the errors of a two-dimensional reference on boxes of torque and excess flux linkage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.flux_surface import WeakeningRegion
from dqforge.optimizer.surface_enclosures import (
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
from dqforge.optimizer.surface_reference import WeakeningReference
from dqforge.optimizer.vector_balls import Balls, magnitude

_LEAST_FLUX = 0.3
"""Share of the least flux linkage below which a box is halved first: it reaches far beyond the domain."""

_SLACK = 1e-14


@dataclass(frozen=True, slots=True)
class Enclosed:
    """Bounds on each box, arrays of shape (N,); infinite where nothing is known yet.

    ``low`` and ``high`` in N m bound the torque made less t; ``excess`` (shape (2, N)) the squared flux linkage over
    the squared available one less 1, and likewise the squared current. ``centre`` (shape (3, N)) holds the three at the
    centres, nan where nothing is known; where the field is not weakened, that is at the least flux linkage that leaves
    it so. ``along`` says whether the errors bend more along the torque than along the flux linkage.
    """

    low: FloatArray
    high: FloatArray
    excess: FloatArray
    centre: FloatArray
    along: NDArray[np.bool_]


def _room(parts: Parts, boxes: Boxes, places: NDArray[np.intp] | slice) -> FloatArray:
    """What the rounding of the currents may add to a function of them."""
    room = magnitude(parts[1]) * boxes.rounding_d[places] + magnitude(parts[2]) * boxes.rounding_q[places]
    return np.asarray(room * (1.0 + _SLACK))


def enclose(region: WeakeningRegion, reference: WeakeningReference, boxes: Boxes) -> Enclosed:
    """Bounds of the errors on boxes: Taylor polynomials of second degree about the centres, with their remainders."""
    t, x = boxes.t, boxes.x
    here = currents(reference, boxes, Balls.exact(t.mid), Balls.exact(x.mid))
    exact = currents(reference, boxes, t, x)
    over = Currents(exact.d.widened(boxes.rounding_d), exact.q.widened(boxes.rounding_q), exact.available)
    known = resolved(region.machine, over.d.value, over.q.value)
    far = exact.available.value.lower() > _LEAST_FLUX * region.flux_min
    if boxes.weakens:
        known &= far
    low, high = (np.where(known, -sign * np.inf, sign * np.inf) for sign in (-1.0, 1.0))
    excess = np.where(known, -np.inf, np.inf) * np.ones((2, 1))
    centre = np.full((3, boxes.count), np.nan)
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
        both = [machine_parts(region.machine, formula, part.d.value, part.q.value) for part in (inner, outer)]
        torque, flux, current = (
            (composed(one, inner.d, inner.q), composed(two, outer.d, outer.q)) for one, two in zip(*both, strict=True)
        )
        rooms = [_room(parts, boxes, places) for parts in both[1]]
        ends = Bend(torque[0].value - t.mid[places], torque[0].t - 1.0, *_rest(torque[0])).range(torque[1], *half)
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
        settled = known[places]
        low[places] = np.where(settled, np.minimum(low[places], ends[0] - rooms[0]), -np.inf)
        high[places] = np.where(settled, np.maximum(high[places], ends[1] + rooms[0]), np.inf)
        tops = np.stack([top_flux, top_current / region.i_max**2]) * (1.0 + _SLACK) - 1.0 + 2.0 * _SLACK
        excess[:, places] = np.where(settled, np.maximum(excess[:, places], tops), np.inf)
        centre[:, places] = np.stack(
            [torque[0].value.mid - t.mid[places], at_centre - 1.0, current[0].value.mid / region.i_max**2 - 1.0]
        )
        for row, name in enumerate(("tt", "xx")):
            rate = magnitude(getattr(torque[1], name)) / region.torque_max + magnitude(getattr(ratio[1], name))
            bends[row, places] = np.where(settled, rate * half[row] ** 2, bends[row, places])
    return Enclosed(low, high, excess, centre, bends[0] >= bends[1])


def _rest(bend: Bend) -> tuple[object, ...]:
    return bend.x, bend.tt, bend.tx, bend.xx
