"""Enclosures of the errors of a two-dimensional reference on boxes of
torque and excess flux linkage.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import (
    Balls,
    Rounded,
    Value,
    horner,
    magnitude,
    most,
    rounded,
)
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
    rounding,
    taylor,
)
from dqforge.optimizer.field_weakening.form import WeakeningReference, WeakeningRegion, in_double

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


# The plane of torque and excess flux linkage that a certificate covers, cut into boxes.

_FIRST = 16  # Parts of the torques and of the excess flux linkages to begin with.
STRIPS = 1024
_MARGIN = 1.01


@dataclass(frozen=True, slots=True)
class CertifiedDomain:
    """What the boxes have to cover: torques in N m on each segment, and flux linkages in Wb."""

    region: WeakeningRegion
    reference: WeakeningReference
    ends: FloatArray  # of the segments, from the least torque to the largest
    most_excess: float
    seam: float  # by so much rounding may move the decision whether the field is weakened
    overhang: float  # by so much in N m a torque may lie above the limit of its own flux linkage

    @classmethod
    def of(cls, region: WeakeningRegion, reference: WeakeningReference) -> CertifiedDomain:
        """Domain of a reference within a region, with room for the rounding at its seams."""
        flux = np.linspace(float(reference.flux_min), float(reference.flux_max), STRIPS + 1)
        lower, upper = limit_range(reference, flux[:-1], flux[1:])
        starts = np.append(reference.flux.starts.astype(np.float64)[1:], np.inf)
        end = float(np.max(upper))
        ends = np.unique(
            np.minimum(np.concatenate([[min(0.0, float(np.min(lower)))], starts]), end)
        )
        overhang = limit_decrease(reference)
        ends[-1] += overhang
        whole = cls(region, reference, ends, 0.0, 0.0, overhang)
        seam, largest = 0.0, -np.inf
        for segment in range(ends.size - 1):
            edges = np.linspace(ends[segment], ends[segment + 1], STRIPS + 1)
            boxes = boxes_between(
                segment, edges[:-1], edges[1:], np.zeros(STRIPS), np.zeros(STRIPS), weakens=False
            )
            seam = max(seam, float(np.max(rounding(reference, boxes)[2])))
            largest = max(
                largest, float(np.max(whole.flux_range(segment, edges[:-1], edges[1:])[1]))
            )
        excess = largest - float(reference.flux_min)
        return replace(
            whole, most_excess=max(excess * (1.0 + 1e-12), 0.0) + seam, seam=seam * _MARGIN
        )

    def flux_range(
        self, segment: int, low: FloatArray, high: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds of the flux linkage of the MTPA currents in Wb for torques in N m on a segment,
        shape (N,).
        """
        curve, t = self.reference.flux, Balls.between(low, high)
        row, start = [float(c) for c in curve.coefficients[segment]], float(curve.starts[segment])
        value, slope, _ = taylor(row, Balls.exact(t.mid) - start)
        bend = Balls.of(taylor(row, t - start)[2])
        return Bend(value, slope, 0, 0, 0, 0).range(
            Bend(0, 0, 0, bend, 0, 0), t.rad, np.zeros(t.rad.shape)
        )

    def clipped(self, boxes: Boxes) -> Boxes:
        """Boxes without those outside the domain, the others cut where they stick out of it."""
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        low, high = self.flux_range(boxes.segment, boxes.t_low, boxes.t_high)
        if not boxes.weakens:
            return boxes.chosen(low - self.seam <= largest)
        x_low = np.maximum(boxes.x_low, low - largest)
        x_high = np.minimum(boxes.x_high, high - least)
        a_low, a_high = np.maximum(low - x_high, least), np.minimum(high - x_low, largest)
        # One unit in the last place makes up for the rounding of these differences.
        slack = 4e-16 * (np.abs(low) + np.abs(high) + np.abs(boxes.x_high) + least)
        x_low, x_high, a_low, a_high = x_low - slack, x_high + slack, a_low - slack, a_high + slack
        inside = np.flatnonzero((x_low <= x_high) & (a_low <= a_high))
        top = limit_range(
            self.reference, np.maximum(a_low[inside], least), np.minimum(a_high[inside], largest)
        )[1]
        t_high = np.minimum(boxes.t_high[inside], top + self.overhang)
        kept = t_high >= boxes.t_low[inside]
        inside = inside[kept]
        return boxes.chosen(inside, t_high=t_high[kept], x_low=x_low[inside], x_high=x_high[inside])

    def available(self, boxes: Boxes) -> tuple[FloatArray, FloatArray]:
        """Bounds of the available flux linkage in Wb on boxes inside the domain, shape (N,)."""
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        low, high = self.flux_range(boxes.segment, boxes.t_low, boxes.t_high)
        if not boxes.weakens:
            return np.clip(low - self.seam, least, largest) * (1.0 - 1e-15), np.full(
                low.shape, largest
            )
        a_low, a_high = (
            np.clip(low - boxes.x_high, least, None),
            np.clip(high - boxes.x_low, None, largest),
        )
        return a_low * (1.0 - 1e-15), np.maximum(a_high, a_low) * (1.0 + 1e-15)

    def holds(self, boxes: Boxes) -> NDArray[np.bool_]:
        """Whether the centres of boxes lie in the domain, so that errors there are really made.

        Not proven.
        """
        if not boxes.weakens:
            return np.ones(boxes.count, dtype=np.bool_)
        t, x = 0.5 * (boxes.t_low + boxes.t_high), 0.5 * (boxes.x_low + boxes.x_high)
        flux = self.flux_range(boxes.segment, t, t)[0] - x
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        limit = limit_range(self.reference, *[np.clip(flux, least, largest)] * 2)[0]
        return np.asarray((x > 0.0) & (flux >= least) & (flux <= largest) & (t <= limit))

    def first(self) -> Iterator[Boxes]:
        """Boxes over the whole domain to begin with, with what rounding may add on them and inside
        them.
        """
        for segment, (start, end) in enumerate(pairwise(self.ends.tolist())):
            edges = np.linspace(start, end, _FIRST + 1)
            seam = np.full(_FIRST, self.seam)
            yield self.rounded(
                boxes_between(segment, edges[:-1], edges[1:], seam, seam, weakens=False)
            )
            across = np.linspace(0.0, max(self.most_excess, self.seam), _FIRST + 1)
            across[0] = -self.seam
            low_t, low_x = (part.ravel() for part in np.meshgrid(edges[:-1], across[:-1]))
            high_t, high_x = (part.ravel() for part in np.meshgrid(edges[1:], across[1:]))
            yield self.rounded(boxes_between(segment, low_t, high_t, low_x, high_x, weakens=True))

    def rounded(self, boxes: Boxes) -> Boxes:
        """Boxes with what rounding may add on them."""
        by_d, by_q, _ = rounding(self.reference, boxes)
        return replace(boxes, rounding_d=by_d, rounding_q=by_q)


def boxes_between(
    segment: int,
    t_low: FloatArray,
    t_high: FloatArray,
    x_low: FloatArray,
    x_high: FloatArray,
    *,
    weakens: bool,
) -> Boxes:
    """Boxes of one segment between bounds of the torque (N m) and of the excess flux (Wb)."""
    zero = np.zeros_like(t_low)
    return Boxes(segment, weakens, t_low, t_high, x_low, x_high, zero, zero)


def halved(boxes: Boxes, along: NDArray[np.bool_]) -> Boxes:
    """Both halves of each box, cut across the direction in which the errors bend more."""
    along = along | (not boxes.weakens)
    t_mid, x_mid = 0.5 * (boxes.t_low + boxes.t_high), 0.5 * (boxes.x_low + boxes.x_high)
    twice = np.concatenate([np.arange(boxes.count)] * 2)
    return boxes.chosen(
        twice,
        t_high=np.concatenate([np.where(along, t_mid, boxes.t_high), boxes.t_high]),
        t_low=np.concatenate([boxes.t_low, np.where(along, t_mid, boxes.t_low)]),
        x_high=np.concatenate([np.where(along, boxes.x_high, x_mid), boxes.x_high]),
        x_low=np.concatenate([boxes.x_low, np.where(along, boxes.x_low, x_mid)]),
    )


# Proven bounds of the torque limit of a two-dimensional reference.


def limit_range(
    reference: WeakeningReference, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds in N m of the rounded torque limit on intervals of the flux linkage in Wb
    in the domain, shape (N,).
    """
    curve = reference.limit
    above_least = Balls.between(low, high) - float(reference.flux_min)
    argument = rounded(above_least, Balls.exact(np.zeros(low.shape)))
    least, largest = np.full(low.shape, np.inf), np.full(low.shape, -np.inf)
    ends = [*(float(start) for start in curve.starts[1:]), np.inf]
    first, last = (
        argument.value.lower() - argument.error.upper(),
        argument.value.upper() + argument.error.upper(),
    )
    for segment, end in enumerate(ends):
        start = float(curve.starts[segment])
        places = np.flatnonzero(((last >= start) | (segment == 0)) & (first <= end))
        if places.size == 0:
            continue
        given = Rounded(argument.value.at(places), argument.error.at(places))
        row = [float(c) for c in curve.coefficients[segment]]
        value, slope, _ = taylor(row, Balls.exact(given.value.mid) - start)
        over = Balls.of(taylor(row, given.value - start)[2])
        error = horner(curve.starts, curve.coefficients, segment, given).error.upper()
        here, whole = Bend(value, slope, 0, 0, 0, 0), Bend(0, 0, 0, over, 0, 0)
        bottom, top = here.range(whole, given.value.rad, np.zeros(places.size))
        least[places] = np.minimum(least[places], bottom - error)
        largest[places] = np.maximum(largest[places], top + error)
    return least, largest


def limit_decrease(reference: WeakeningReference, strips: int = 1024) -> float:
    """Bound in N m of what the rounded torque limit can lose where the flux linkage rises.

    It should never.
    """
    curve, span = reference.limit, float(reference.flux_max) - float(reference.flux_min)
    ends = np.append(
        curve.starts.astype(np.float64), max(span, float(curve.starts[-1])) * (1.0 + 1e-6)
    )
    total, before, rounding = 0.0, -np.inf, 0.0
    for segment, (start, end) in enumerate(pairwise(ends.tolist())):
        edges = np.linspace(start, end, strips + 1)
        given = Balls.between(edges[:-1], edges[1:])
        row = [float(c) for c in curve.coefficients[segment]]
        slope = Balls.of(taylor(row, given - start, 1)[1])
        steep = np.broadcast_to(np.maximum(-slope.lower(), 0.0), (strips,))
        total += float(np.sum(steep * np.diff(edges))) * (1.0 + 1e-12)
        error = horner(
            curve.starts, curve.coefficients, segment, Rounded(given, Balls.exact(np.zeros(strips)))
        )
        rounding = max(rounding, float(np.max(error.error.upper())))
        first, last = (
            Balls.of(taylor(row, Balls.exact(np.array([at])) - start, 0)[0]) for at in (start, end)
        )
        total += max(before - float(first.lower()[0]), 0.0)
        before = float(last.upper()[0])
    return total + 2.0 * rounding


def limit_room(
    reference: WeakeningReference, available: Bend, over: Bend, places: NDArray[np.intp]
) -> tuple[NDArray[np.intp], Bend, Bend, FloatArray]:
    """Torque limit as a function on boxes, at the centres and over them,
    where one segment of it serves.

    ``available`` and ``over`` are the available flux linkage in Wb likewise, ``places`` the boxes
    that matter. Returned are the boxes that one segment serves, the functions in N m, and bounds of
    the rounding, shape (M,).
    """
    curve, least = reference.limit, float(reference.flux_min)
    flux, most_flux = over.value.at(places), float(reference.flux_max)
    low, high = np.clip(flux.lower(), least, most_flux), np.clip(flux.upper(), least, most_flux)
    argument = rounded(Balls.between(low, high) - least, Balls.exact(np.zeros(low.shape)))
    reach = argument.error.upper()
    starts = curve.starts[1:].astype(np.float64)
    first = np.searchsorted(starts, argument.value.lower() - reach, side="right")
    segment = np.searchsorted(starts, argument.value.upper() + reach, side="right")
    served = np.flatnonzero(first == segment)
    values, bends, errors = [], [], []
    order = []
    for number in range(curve.starts.size):
        mine = served[segment[served] == number]
        if mine.size == 0:
            continue
        row, start = [float(c) for c in curve.coefficients[number]], float(curve.starts[number])
        at, all_over = (part.at(places[mine]) for part in (available, over))
        value, slope, _ = taylor(row, at.value - least - start)
        _, wide_slope, bend = taylor(row, all_over.value - least - start)
        values.append(_through(value, slope, at))
        bends.append(_bent(wide_slope, bend, all_over))
        given = Rounded(argument.value.at(mine), argument.error.at(mine))
        errors.append(horner(curve.starts, curve.coefficients, number, given).error.upper())
        order.append(mine)
    if not order:
        empty = Balls.exact(np.zeros(0))
        nothing = Bend(empty, empty, empty, empty, empty, empty)
        return places[:0], nothing, nothing, np.zeros(0)
    return places[np.concatenate(order)], _joined(values), _joined(bends), np.concatenate(errors)


def _through(value: Value, slope: Value, inner: Bend) -> Bend:
    like = inner.value
    return Bend(*(_wide(part, like) for part in (value, slope * inner.t, slope * inner.x, 0, 0, 0)))


def _bent(slope: Value, bend: Value, inner: Bend) -> Bend:
    like = inner.value
    second = (
        bend * inner.t * inner.t + slope * inner.tt,
        bend * inner.t * inner.x + slope * inner.tx,
        bend * inner.x * inner.x + slope * inner.xx,
    )
    return Bend(*(_wide(part, like) for part in (0, 0, 0, *second)))


def _wide(value: Value, like: Balls) -> Balls:
    """Balls of the same shape as others."""
    balls = Balls.of(value)
    return Balls(
        np.broadcast_to(balls.mid, like.mid.shape), np.broadcast_to(balls.rad, like.mid.shape)
    )


def _joined(parts: list[Bend]) -> Bend:
    names = [field.name for field in fields(Bend)]
    columns = ([getattr(part, name) for part in parts] for name in names)
    return Bend(
        *(
            Balls(np.concatenate([b.mid for b in column]), np.concatenate([b.rad for b in column]))
            for column in columns
        )
    )


# Proven bounds of the largest torque that can be had within current and voltage.

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
