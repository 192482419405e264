"""The angle functions of ``control_types.j2`` on numpy arrays of float32: same operations,
same order, same bits.

The transforms are those of `dqforge.machines.transforms` in `SINGLE`. Every function takes and
returns float32 arrays of one shape; the C code equals it bit for bit without contraction of
products and sums (-ffp-contract=off).
"""

from __future__ import annotations

import numpy as np

from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.observers.parts import Arithmetic

# The float next to pi, which lies above it; `wrap` returns less than this.
PI = np.float32(3.1415927)
_SINE = np.array([-0.16666658, 0.008332287, -0.00019525598], dtype=np.float32)
_COSINE = np.array([-0.49999887, 0.041655786, -0.0013591051], dtype=np.float32)
_SMALL_SINE = np.array([-0.16666406, 0.0082862], dtype=np.float32)
_SMALL_COSINE = np.array([-0.5, 0.0416663, -0.00138272], dtype=np.float32)
_ZERO, _ONE, _FAR = np.float32(0.0), np.float32(1.0), np.float32(65536.0)


def wrap(theta: SingleArray) -> SingleArray:
    """Angle in rad brought into -pi to pi (pi excluded); 0 for not-a-number and beyond 65536
    rad.
    """
    outside = (theta >= PI) | (theta < -PI)
    known = (theta < np.float32(65536.0)) & (theta > np.float32(-65536.0))
    angle = np.where(known, theta, np.float32(0.0))
    turns = angle * np.float32(0.15915494)
    n = np.trunc(turns + np.where(turns < 0.0, np.float32(-0.5), np.float32(0.5))).astype(
        np.float32
    )
    folded = (angle - n * np.float32(6.28125)) - n * np.float32(0.0019353072)
    folded = np.where(folded >= PI, folded - np.float32(6.2831855), folded)
    folded = np.where(folded < -PI, folded + np.float32(6.2831855), folded)
    return np.asarray(np.where(outside & known, folded, angle), dtype=np.float32)


def rotation(theta: SingleArray) -> tuple[SingleArray, SingleArray]:
    """Cosine and sine of angles in rad; largest error 1.2e-7 from -pi to pi, those of 0 for
    not-a-number and beyond 65536 rad.
    """
    known = np.where(np.abs(theta) < _FAR, theta, _ZERO)
    quarters = ((known * np.float32(0.63661977)) + np.float32(65536.5)).astype(np.int32)
    n = (quarters - 65536).astype(np.float32)
    x = (known - (n * np.float32(1.5703125))) - (n * np.float32(0.0004838268))
    square = x * x
    cosine = _ONE + (square * _polynomial(_COSINE, square))
    sine = x * (_ONE + (square * _polynomial(_SINE, square)))
    odd, back = (quarters & 1) != 0, (quarters & 2) != 0
    across, along = np.where(odd, -sine, cosine), np.where(odd, cosine, sine)
    return (
        np.asarray(np.where(back, -across, across), dtype=np.float32),
        np.asarray(np.where(back, -along, along), dtype=np.float32),
    )


def small_rotation(theta: SingleArray) -> tuple[SingleArray, SingleArray]:
    """Cosine and sine of angles in rad, by shorter polynomials within 0.4 rad; largest error as of
    `rotation`.
    """
    square = theta * theta
    cosine = _ONE + (square * _polynomial(_SMALL_COSINE, square))
    sine = theta * (_ONE + (square * _polynomial(_SMALL_SINE, square)))
    small, (far_cosine, far_sine) = square <= np.float32(0.16), rotation(theta)
    return np.where(small, cosine, far_cosine), np.where(small, sine, far_sine)


def turned(
    x: tuple[SingleArray, SingleArray], y: tuple[SingleArray, SingleArray]
) -> tuple[SingleArray, SingleArray]:
    """The rotation by the sum of two angles."""
    return x[0] * y[0] - x[1] * y[1], x[1] * y[0] + x[0] * y[1]


def _polynomial(coefficients: SingleArray, x: SingleArray) -> SingleArray:
    """Horner's rule from the last coefficient on."""
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = coefficient + (x * value)
    return np.asarray(value, dtype=np.float32)


# Single precision, in which transforms and observers equal their C functions.
SINGLE = Arithmetic(np.float32, wrap, rotation)
