"""Proven bounds of the torque limit of a two-dimensional reference."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.certificates.ball import Value
from dqforge.optimizer.certificates.ball_arrays import Balls
from dqforge.optimizer.certificates.rounding import Rounded, horner, rounded
from dqforge.optimizer.field_weakening.enclosures import Bend, taylor
from dqforge.optimizer.field_weakening.form import WeakeningReference


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
