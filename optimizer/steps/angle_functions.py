"""Angles in single precision: brought into a turn, and their cosine and sine by polynomials."""

from __future__ import annotations

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair, Rotation

PI = 3.1415927  # The float32 next to pi, which lies above it; `wrap` returns less than this.
FAR = 65536.0  # rad; beyond it an angle counts as 0.

# Sine over angle, and cosine: what stands behind the 1, of powers of the squared angle; up to pi/4
# and up to 0.4 rad.
_SINE = (-0.16666658, 0.008332287, -0.00019525598)
_COSINE = (-0.49999887, 0.041655786, -0.0013591051)
_SMALL_SINE = (-0.16666406, 0.0082862)
_SMALL_COSINE = (-0.5, 0.0416663, -0.00138272)
_SMALL_SQUARE = 0.16  # rad^2


def wrap(o: Arithmetic, theta: Reals) -> Reals:
    """An angle in rad brought into -pi to pi (pi excluded); 0 for not-a-number and beyond 65536
    rad.
    """
    return o.cases(
        "angle",
        ((theta < PI) & (theta >= -PI), lambda: theta),
        ((theta < FAR) & (theta > -FAR), lambda: _folded(o, theta)),
        otherwise=lambda: o.full(0.0, theta),
    )


def _folded(o: Arithmetic, theta: Reals) -> Reals:
    turns = o.let("turns", theta * 0.15915494)
    half = o.choose(turns < 0.0, o.full(-0.5, turns), o.full(0.5, turns))
    nearest = o.let("nearest", turns + half)
    n = o.let("n", o.real(o.let("whole", o.whole(nearest))))
    near = o.let(
        "near",
        (theta - n * 6.28125) - n * 0.0019353072,
        "2 pi in two parts, the first product exact",
    )
    below = o.let("below", o.choose(near >= PI, near - 6.2831855, near))
    return o.choose(below < -PI, below + 6.2831855, below)


def rotation(o: Arithmetic, theta: Reals) -> Rotation:
    """Cosine and sine of an angle in rad, by polynomials around the nearest multiple of pi/2;
    largest error 1.2e-7 from -pi to pi. That of 0 for not-a-number and beyond 65536 rad.
    """
    known = o.let("known", o.choose(o.magnitude(theta) < FAR, theta, o.full(0.0, theta)))
    above = o.let("above", known * 0.63661977 + 65536.5, "above 0: the conversion rounds down")
    quarters = o.let("quarters", o.whole(above))
    n = o.let("n", o.real(o.let("whole", quarters - 65536)))
    x = o.let(
        "x",
        (known - n * 1.5703125) - n * 0.0004838268,
        "pi/2 in two parts, the first product exact",
    )
    square = o.let("square", x * x)
    cosine = o.let("cosine", _from_one(_COSINE, square))
    sine = o.let("sine", x * _from_one(_SINE, square))
    turn = o.cases(
        "turn",
        (o.has_bit(quarters, 1), lambda: Rotation(-sine, cosine)),
        otherwise=lambda: Rotation(cosine, sine),
    )
    return o.cases(
        "whole_turn",
        (o.has_bit(quarters, 2), lambda: Rotation(-turn.cosine, -turn.sine)),
        otherwise=lambda: turn,
    )


def small_rotation(o: Arithmetic, theta: Reals) -> Rotation:
    """The same, quicker within 0.4 rad."""
    square = o.let("square", theta * theta)
    return o.cases(
        "turn",
        (
            square <= _SMALL_SQUARE,
            lambda: Rotation(
                _from_one(_SMALL_COSINE, square), theta * _from_one(_SMALL_SINE, square)
            ),
        ),
        otherwise=lambda: Rotation(*o.rotation(theta)),
    )


def turned(o: Arithmetic, x: Pair, y: Pair) -> Rotation:  # noqa: ARG001
    """The rotation by the sum of two angles."""
    return Rotation(x[0] * y[0] - x[1] * y[1], x[1] * y[0] + x[0] * y[1])


def _from_one(coefficients: tuple[float, ...], square: Reals) -> Reals:
    """A polynomial whose constant is 1, by Horner's rule from the last coefficient on."""
    value = square * coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = square * (coefficient + value)
    return 1.0 + value
