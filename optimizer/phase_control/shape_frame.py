"""Coordinates along the back-EMF: there and back, and the voltage that they need in turning."""

from __future__ import annotations

from typing import Any, NamedTuple

from dqforge.machines.names import CurrentFrame
from dqforge.machines.transforms import Reals
from dqforge.optimizer.phase_control.phase_records import Alphabetazero, ControlGains
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, Dq, Rotation

# Of a shape in Wb and of its square: below it counts as none.
LEAST, LEAST_SQUARE = 1.0e-9, 1.0e-18
_ROOT_2, _HALF_ROOT_2 = 1.4142135, 0.70710677


class Frame(NamedTuple):
    """Quantities in the frame of the integrals."""

    d: Reals
    q: Reals
    zero: Reals


class _Side(NamedTuple):
    """Square, length and its inverse of a shape in the plane, and square with the zero sequence."""

    square: Reals
    side: Reals
    inverse: Reals
    whole: Reals


def _side(o: Arithmetic, f: Alphabetazero) -> _Side:
    square = o.let("square", (f.alpha * f.alpha) + (f.beta * f.beta))
    side = o.let("side", o.root(square))
    inverse = o.let("inverse", o.choose(side > LEAST, 1.0 / side, o.full(0.0, side)))
    return _Side(square, side, inverse, o.let("whole", square + (2.0 * (f.zero * f.zero))))


class PlanarFrame:
    """The frame dqx: along the back-EMF without its zero sequence."""

    def to_frame(self, o: Arithmetic, f: Alphabetazero, x: Alphabetazero, psi_pm: Reals) -> Frame:
        """Coordinates along the shape f (q) and at right angles to it (d), over
        a_x = psi_pm / |f|; the zero sequence as it is.
        """
        scale = o.let("scale", 1.0 / psi_pm)
        return Frame(
            scale * ((f.beta * x.alpha) - (f.alpha * x.beta)),
            scale * ((f.alpha * x.alpha) + (f.beta * x.beta)),
            x.zero,
        )

    def from_frame(self, o: Arithmetic, f: Alphabetazero, x: Frame, psi_pm: Reals) -> Alphabetazero:
        """Stationary coordinates from those along the shape f, times a_x; nothing in the plane
        where f vanishes there.
        """
        square = o.let("square", (f.alpha * f.alpha) + (f.beta * f.beta))
        scale = o.let("scale", _over(o, psi_pm, square))
        return Alphabetazero(
            scale * ((x.q * f.alpha) + (x.d * f.beta)),
            scale * ((x.q * f.beta) - (x.d * f.alpha)),
            x.zero,
        )

    def coupling(
        self,
        o: Arithmetic,
        gains: ControlGains,
        f: Alphabetazero,
        slope: Alphabetazero,
        x: Frame,
        omega_e: Reals,
    ) -> Alphabetazero:
        """Voltage in V that currents x in A need which are constant along the shape f, as it turns
        and changes: omega_e L (a N')' x. slope: derivative of f by the angle.
        """
        square = o.let("square", (f.alpha * f.alpha) + (f.beta * f.beta))
        along = o.let("along", (f.alpha * slope.alpha) + (f.beta * slope.beta))
        per_whole = o.let("per_whole", _over(o, 1.0, square))
        growth = o.let("growth", (2.0 * along) * per_whole)
        q_rate, d_rate = o.let("q_rate", -x.q * growth), o.let("d_rate", -x.d * growth)
        scale = o.let("scale", (omega_e * gains.psi_pm) * per_whole)
        alpha, beta = _turning(f, slope, Dq(x.d, x.q), Dq(d_rate, q_rate))
        none = o.full(0.0, omega_e)
        return Alphabetazero((gains.l_q * scale) * alpha, (gains.l_q * scale) * beta, none)


class SpatialFrame:
    """The frame dqy: along the back-EMF with its zero sequence."""

    def to_frame(self, o: Arithmetic, f: Alphabetazero, x: Alphabetazero, psi_pm: Reals) -> Frame:
        """Coordinates along the shape f with its zero sequence (q), at right angles to it in the
        plane (d) and in space (zero), over a_y = psi_pm / |f|; power-invariant: a zero sequence
        counts root 2 times.
        """
        scale = o.let("scale", 1.0 / psi_pm)
        _, side, inverse, whole = _side(o, f)
        along = o.let("along", (f.alpha * x.alpha) + (f.beta * x.beta))
        across = o.let("across", (f.beta * x.alpha) - (f.alpha * x.beta))
        length = o.let("length", o.root(whole))
        return Frame(
            scale * ((length * inverse) * across),
            scale * (along + (2.0 * (f.zero * x.zero))),
            scale * (_ROOT_2 * (((f.zero * inverse) * along) - (side * x.zero))),
        )

    def from_frame(self, o: Arithmetic, f: Alphabetazero, x: Frame, psi_pm: Reals) -> Alphabetazero:
        """Stationary coordinates from those along the shape f, times a_y; nothing where f
        vanishes.
        """
        _, side, inverse, whole = _side(o, f)
        scale = o.let("scale", _over(o, psi_pm, whole))
        across = o.let("across", (o.root(whole) * inverse) * x.d)
        along = o.let("along", x.q + ((_ROOT_2 * (f.zero * inverse)) * x.zero))
        return Alphabetazero(
            scale * ((along * f.alpha) + (across * f.beta)),
            scale * ((along * f.beta) - (across * f.alpha)),
            scale * ((x.q * f.zero) - (_HALF_ROOT_2 * (side * x.zero))),
        )

    def coupling(
        self,
        o: Arithmetic,
        gains: ControlGains,
        f: Alphabetazero,
        slope: Alphabetazero,
        x: Frame,
        omega_e: Reals,
    ) -> Alphabetazero:
        """Voltage in V that currents x in A need which are constant along the shape f, as it turns
        and changes: omega_e L (a N')' x. slope: derivative of f by the angle.
        """
        _, side, inverse, whole = _side(o, f)
        along = o.let("along", (f.alpha * slope.alpha) + (f.beta * slope.beta))
        per_whole = o.let("per_whole", _over(o, 1.0, whole))
        both = 2.0 * (along + (2.0 * (f.zero * slope.zero)))
        growth = o.let("growth", both * per_whole)
        side_growth = o.let("side_growth", (along * inverse) * inverse)
        common = o.let("common", _ROOT_2 * (inverse * x.zero))
        q = o.let("q", x.q + (common * f.zero))
        rising = common * (slope.zero - (f.zero * side_growth))
        q_rate = o.let("q_rate", rising - (q * growth))
        d = o.let("d", (o.root(whole) * inverse) * x.d)
        d_rate = o.let("d_rate", -d * ((0.5 * growth) + side_growth))
        zero = o.let("zero", _HALF_ROOT_2 * (side * x.zero))
        scale = o.let("scale", (omega_e * gains.psi_pm) * per_whole)
        alpha, beta = _turning(f, slope, Dq(d, q), Dq(d_rate, q_rate))
        apart = ((x.q * slope.zero) - (zero * side_growth)) - (((x.q * f.zero) - zero) * growth)
        return Alphabetazero(
            (gains.l_q * scale) * alpha, (gains.l_q * scale) * beta, (gains.l_0 * scale) * apart
        )


class RotorFrame:
    """Rotor coordinates, dq0."""

    def coupling(
        self, o: Arithmetic, gains: ControlGains, x: Dq, acting: Rotation, omega_e: Reals
    ) -> Alphabetazero:
        """Voltage in V that currents in A need which are constant in rotor coordinates: where the
        voltage acts.
        """
        d = -(omega_e * (gains.l_q * x.q))
        turning = o.let("turning", Dq(d, omega_e * (gains.l_d * x.d)))
        plane = o.let("plane", o.park_inverse(turning, acting))
        return Alphabetazero(plane.alpha, plane.beta, o.full(0.0, omega_e))


def shape_frame(frame: CurrentFrame) -> PlanarFrame | SpatialFrame | None:
    """The frame of the integrals where it follows the back-EMF, else None."""
    if frame == "dqy":
        return SpatialFrame()
    return PlanarFrame() if frame == "dqx" else None


def _over(o: Arithmetic, a: Any, square: Reals) -> Reals:
    return o.choose(square > LEAST_SQUARE, a / square, o.full(0.0, square))


def _turning(f: Alphabetazero, slope: Alphabetazero, x: Dq, rate: Dq) -> AlphaBeta:
    """Derivative of what x is in the plane, over the scale."""
    q, d = x.q, x.d
    return AlphaBeta(
        ((q * slope.alpha) + (rate.q * f.alpha)) + ((d * slope.beta) + (rate.d * f.beta)),
        ((q * slope.beta) + (rate.q * f.beta)) - ((d * slope.alpha) + (rate.d * f.alpha)),
    )
