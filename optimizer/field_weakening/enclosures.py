"""A two-dimensional reference on many boxes of torque and excess flux linkage at once,
in ball arithmetic.

Torque t and excess flux linkage x = delta are independent of each other here: in these two the
currents are plain polynomials, and the available flux linkage is a = p(t) - x. Every function comes
with its first and second derivatives, at the centre of each box and over all of it, which makes a
Taylor polynomial with its remainder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import (
    Balls,
    Jet,
    JetFunction,
    Rounded,
    Value,
    bicubic,
    exact,
    horner,
    magnitude,
    most,
    product,
    rounded,
    rounded_sum,
    torque_parts,
)
from dqforge.optimizer.field_weakening.form import SingleSurface, WeakeningReference

# Cells of a flux map that one box may touch; of wider ones nothing is known until they are halved.
MOST_CELLS = 9
_SLACK = 1e-14  # Share that makes up for the rounding of the few sums in `Bend.range`.


@dataclass(frozen=True, slots=True)
class Bend:
    """A function of torque and excess flux linkage with its derivatives.

    Balls, or 0 where it vanishes.
    """

    value: Value
    t: Value
    x: Value
    tt: Value
    tx: Value
    xx: Value

    def at(self, places: Any) -> Bend:
        """The function on some of the boxes."""
        parts = (getattr(self, field.name) for field in fields(self))
        return Bend(*(part.at(places) if isinstance(part, Balls) else part for part in parts))

    def times(self, other: Bend) -> Bend:
        """Product."""
        return Bend(
            self.value * other.value,
            self.value * other.t + self.t * other.value,
            self.value * other.x + self.x * other.value,
            self.value * other.tt + self.t * other.t * 2 + self.tt * other.value,
            self.value * other.tx + self.t * other.x + self.x * other.t + self.tx * other.value,
            self.value * other.xx + self.x * other.x * 2 + self.xx * other.value,
        )

    def widened(self, radius: FloatArray) -> Bend:
        """The value with a larger radius, the derivatives as they are."""
        return Bend(self.value.widened(radius), self.t, self.x, self.tt, self.tx, self.xx)

    def range(
        self, over: Bend, half_t: FloatArray, half_x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds on boxes about whose centres this is the function.

        ``over`` encloses it on all of them.
        """
        high, low = most(self.value), -most(-self.value)
        straight = (
            magnitude(self.t) * half_t
            + magnitude(self.x) * half_x
            + magnitude(over.tx) * half_t * half_x
        )
        squares = (over.tt, 0.5 * half_t * half_t), (over.xx, 0.5 * half_x * half_x)
        up = straight + sum(np.maximum(most(bend), 0.0) * square for bend, square in squares)
        down = straight + sum(np.maximum(most(-bend), 0.0) * square for bend, square in squares)
        return low - down - (np.abs(low) + down) * _SLACK, high + up + (np.abs(high) + up) * _SLACK


@dataclass(frozen=True, slots=True)
class Boxes:
    """Boxes of torques in N m by excess flux linkages in Wb on one segment, arrays of shape (N,).

    ``rounding_d`` and ``rounding_q`` are what rounding may add to the currents there, in A. Where
    the field is not weakened, ``weakens`` is false and the excess flux linkage is one number.
    """

    segment: int
    weakens: bool
    t_low: FloatArray
    t_high: FloatArray
    x_low: FloatArray
    x_high: FloatArray
    rounding_d: FloatArray
    rounding_q: FloatArray

    @property
    def count(self) -> int:
        """Number of boxes."""
        return self.t_low.size

    @property
    def t(self) -> Balls:
        """Torques."""
        return Balls.between(self.t_low, self.t_high)

    @property
    def x(self) -> Balls:
        """Excess flux linkages."""
        return Balls.between(self.x_low, self.x_high)

    def chosen(self, places: Any, **changes: FloatArray) -> Boxes:
        """Some of the boxes, perhaps with other borders."""
        names = ("t_low", "t_high", "x_low", "x_high", "rounding_d", "rounding_q")
        parts = {
            name: changes[name] if name in changes else getattr(self, name)[places]
            for name in names
        }
        return Boxes(self.segment, self.weakens, **parts)


def taylor(row: Sequence[Value], x: Value, order: int = 2) -> list[Value]:
    """Value and derivatives up to an order of a polynomial with rising coefficients,
    by repeated synthetic division.
    """
    found: list[Value] = [row[-1], 0, 0]
    for coefficient in row[-2::-1]:
        for power in range(min(order, 2), 0, -1):
            found[power] = found[power] * x + found[power - 1]
        found[0] = found[0] * x + coefficient
    found[2] = found[2] * 2
    return found[: order + 1]


def _surface(surface: SingleSurface, x: Balls, y: Balls) -> Bend:
    """Polynomial in two variables.

    The first one runs with the torque, the second one with the excess.
    """
    rows = [taylor([float(c) for c in row], x) for row in surface.rows]
    value, by_y, by_yy = taylor([row[0] for row in rows], y)
    by_x, by_xy = taylor([row[1] for row in rows], y, 1)
    (by_xx,) = taylor([row[2] for row in rows], y, 0)
    return Bend(_as_balls(value, x), by_x, by_y, by_xx, by_xy, by_yy)


def _as_balls(value: Value, like: Balls) -> Balls:
    """The value of a polynomial that may be constant or zero, as balls."""
    return value if isinstance(value, Balls) else Balls.exact(np.full(like.mid.shape, float(value)))


@dataclass(frozen=True, slots=True)
class Currents:
    """Currents in A as functions, and the flux linkage in Wb that is available."""

    d: Bend
    q: Bend
    available: Bend

    def at(self, places: Any) -> Currents:
        """The functions on some of the boxes."""
        return Currents(self.d.at(places), self.q.at(places), self.available.at(places))


def currents(reference: WeakeningReference, boxes: Boxes, t: Balls, x: Balls) -> Currents:
    """What the emitted constants give in exact arithmetic at torques and excess flux
    linkages inside some boxes.
    """
    curves = []
    for curve in (reference.d, reference.q, reference.flux):
        local = t - float(curve.starts[boxes.segment])
        value, slope, bend = taylor([float(c) for c in curve.coefficients[boxes.segment]], local)
        curves.append(Bend(_as_balls(value, t), slope, 0, bend, 0, 0))
    d, q, flux = curves
    one = Balls.exact(np.ones(boxes.count))
    available = Bend(flux.value - x, flux.t, -one, flux.tt, 0, 0)
    if not boxes.weakens:
        return Currents(d, q, available)
    arguments = t - float(reference.torque_mid), x - float(reference.excess_mid)
    more_d, more_q = (
        _surface(part, *arguments) for part in (reference.surface_d, reference.surface_q)
    )
    excess, torque = Bend(x, 0, one, 0, 0, 0), Bend(t, one, 0, 0, 0, 0)
    return Currents(
        _sum(d, excess.times(more_d)), _sum(q, excess.times(more_q).times(torque)), available
    )


def _sum(left: Bend, right: Bend) -> Bend:
    return Bend(*(getattr(left, field.name) + getattr(right, field.name) for field in fields(Bend)))


def rounding(
    reference: WeakeningReference, boxes: Boxes
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds of what rounding adds to i_d and i_q in A and to the excess flux linkage in Wb,
    shape (N,).

    Operation by operation as `WeakeningReference.currents`, with and without fused multiply-add.
    """
    zero, segment = Balls.exact(np.zeros(boxes.count)), boxes.segment
    t = Rounded(boxes.t, zero)
    d, q, flux = (
        horner(curve.starts, curve.coefficients, segment, t)
        for curve in (reference.d, reference.q, reference.flux)
    )
    delta = rounded(boxes.x, flux.error)
    if boxes.weakens:
        x = rounded_sum(t, exact(-float(reference.torque_mid)))
        y = rounded_sum(delta, exact(-float(reference.excess_mid)))
        more_d, more_q = (
            _rounded_surface(part, x, y) for part in (reference.surface_d, reference.surface_q)
        )
        d = rounded_sum(product(delta, more_d), d)
        q = rounded_sum(product(product(delta, t), more_q), q)
    error_d, error_q, error = (
        np.broadcast_to(part.error.upper(), boxes.t_low.shape) for part in (d, q, delta)
    )
    return error_d, error_q, error


def _rounded_surface(surface: SingleSurface, x: Rounded, y: Rounded) -> Rounded:
    rows = [horner((0.0,), (row,), 0, x) for row in surface.rows]
    value = rows[-1]
    for row in rows[-2::-1]:
        value = rounded_sum(product(value, y), row)
    return value


def _spans(
    machine: SaturatedMachine, i_d: Balls, i_q: Balls
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """First cell of each box and number of further ones, by both currents."""
    spans = []
    for balls, cells in ((i_d, machine.flux_map.rows), (i_q, machine.flux_map.columns)):
        first = cells(np.nextafter(balls.lower(), -np.inf))
        spans.append((first, cells(np.nextafter(balls.upper(), np.inf)) - first))
    return spans


def formulas(machine: Machine, i_d: Balls, i_q: Balls) -> Iterator[tuple[Any, JetFunction]]:
    """Flux linkages of which one holds at every point of each box of currents,
    with the boxes that each is for.

    A flux map is one bicubic per cell, which is followed over the whole box. Boxes that touch more
    than `MOST_CELLS` have none.
    """
    if isinstance(machine, LinearMachine):
        yield slice(None), _linear(machine)
    if not isinstance(machine, SaturatedMachine):
        return
    (row, rows), (column, columns) = _spans(machine, i_d, i_q)
    few = (rows + 1) * (columns + 1) <= MOST_CELLS
    for down in range(MOST_CELLS):
        for along in range(MOST_CELLS // (down + 1)):
            places = np.flatnonzero(few & (rows >= down) & (columns >= along))
            if places.size > 0:
                yield places, _cubics(machine, row[places] + down, column[places] + along)


def resolved(machine: Machine, i_d: Balls, i_q: Balls) -> NDArray[np.bool_]:
    """Whether `formulas` holds a formula for every point of a box."""
    if not isinstance(machine, SaturatedMachine):
        return np.ones(np.broadcast_shapes(i_d.mid.shape, i_q.mid.shape), dtype=np.bool_)
    (_, rows), (_, columns) = _spans(machine, i_d, i_q)
    return np.asarray((rows + 1) * (columns + 1) <= MOST_CELLS)


def _linear(machine: LinearMachine) -> JetFunction:
    l_d, l_q = (Balls.exact(value) for value in (machine.l_d, machine.l_q))

    def jet(i_d: Value, i_q: Value) -> Jet:
        return Jet(i_d * l_d + machine.psi_pm, i_q * l_q, l_d, 0, 0, l_q, 0, 0, 0, 0, 0, 0)

    return jet


def _cubics(
    machine: SaturatedMachine, row: NDArray[np.intp], column: NDArray[np.intp]
) -> JetFunction:
    coefficients, corner_d, corner_q = machine.flux_map.cubics(row, column)

    def jet(i_d: Value, i_q: Value) -> Jet:
        d, q = (
            bicubic(coefficients[:, :, flux], i_d - corner_d, i_q - corner_q) for flux in range(2)
        )
        return Jet(d[0], q[0], d[1], d[2], q[1], q[2], d[3], d[4], d[5], q[3], q[4], q[5])

    return jet


Parts = tuple[Value, ...]  # A function of the currents: value, gradient, and Hessian (dd, dq, qq).


def machine_parts(
    machine: Machine, formula: JetFunction, i_d: Balls, i_q: Balls
) -> tuple[Parts, Parts, Parts]:
    """Torque in N m, squared flux linkage in Wb^2 and squared current in
    A^2 with their derivatives.
    """
    jet = formula(i_d, i_q)
    torque = torque_parts(jet, i_d, i_q, 1.5 * machine.pole_pairs)
    flux = (
        jet.psi_d.squared() + jet.psi_q.squared(),
        (jet.psi_d * jet.l_dd + jet.psi_q * jet.l_qd) * 2,
        (jet.psi_d * jet.l_dq + jet.psi_q * jet.l_qq) * 2,
        (jet.l_dd * jet.l_dd + jet.psi_d * jet.d_dd + jet.l_qd * jet.l_qd + jet.psi_q * jet.q_dd)
        * 2,
        (jet.l_dd * jet.l_dq + jet.psi_d * jet.d_dq + jet.l_qd * jet.l_qq + jet.psi_q * jet.q_dq)
        * 2,
        (jet.l_dq * jet.l_dq + jet.psi_d * jet.d_qq + jet.l_qq * jet.l_qq + jet.psi_q * jet.q_qq)
        * 2,
    )
    two = Balls.exact(2.0)
    return torque, flux, (i_d.squared() + i_q.squared(), i_d * 2, i_q * 2, two, 0, two)


def composed(parts: Parts, i_d: Bend, i_q: Bend) -> Bend:
    """A function of the currents as one of torque and excess flux linkage, by the chain rule."""
    value, by_d, by_q, by_dd, by_dq, by_qq = parts

    def second(one: str, other: str, both: str) -> Value:
        d_1, d_2, q_1, q_2 = (
            getattr(i_d, one),
            getattr(i_d, other),
            getattr(i_q, one),
            getattr(i_q, other),
        )
        straight = by_d * getattr(i_d, both) + by_q * getattr(i_q, both)
        return straight + by_dd * d_1 * d_2 + by_dq * (d_1 * q_2 + d_2 * q_1) + by_qq * q_1 * q_2

    return Bend(
        value,
        by_d * i_d.t + by_q * i_q.t,
        by_d * i_d.x + by_q * i_q.x,
        second("t", "t", "tt"),
        second("t", "x", "tx"),
        second("x", "x", "xx"),
    )


def inverse_square(available: Bend) -> Bend:
    """One over the square of the available flux linkage, which is positive."""
    inverse = available.value.reciprocal()
    square = inverse.squared()
    cube, fourth = inverse * square * -2, square.squared() * 6
    slope = available.t
    return Bend(
        square,
        cube * slope,
        cube * available.x,
        fourth * slope * slope + cube * available.tt,
        fourth * slope * available.x,
        fourth * available.x * available.x,
    )
