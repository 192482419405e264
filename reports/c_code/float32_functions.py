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

PI = np.float32(3.1415927)

"""The float next to pi, which lies above it; `wrap` returns less than this."""


_EIGHTH, _THREE_EIGHTHS = np.float32(0.7853982), np.float32(2.3561945)


_SINE = np.array([-0.1666666, 0.008332445, -0.00019550518], dtype=np.float32)


_COSINE = np.array([0.04166666, -0.0013888152, 0.000024528672], dtype=np.float32)


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
    """Cosine and sine of angles from -pi to pi in rad; largest error 1.2e-7."""
    back, ahead = theta < -_THREE_EIGHTHS, theta > _THREE_EIGHTHS
    right, left = ~back & (theta < -_EIGHTH), ~ahead & (theta > _EIGHTH)
    high, low = np.float32(1.5703125), np.float32(0.0004838268)
    double_high, double_low = np.float32(3.140625), np.float32(0.0009676536)
    x = np.select(
        [ahead, left, back, right],
        [
            (theta - double_high) - double_low,
            (theta - high) - low,
            (theta + double_high) + double_low,
            (theta + high) + low,
        ],
        theta,
    )
    square = x * x
    sine = x + (x * square) * (((_SINE[2] * square) + _SINE[1]) * square + _SINE[0])
    cosine = (np.float32(1.0) - np.float32(0.5) * square) + (square * square) * (
        ((_COSINE[2] * square) + _COSINE[1]) * square + _COSINE[0]
    )
    flipped = back | ahead
    return (
        np.asarray(
            np.select([flipped, left, right], [-cosine, -sine, sine], cosine), dtype=np.float32
        ),
        np.asarray(
            np.select([flipped, left, right], [-sine, cosine, -cosine], sine), dtype=np.float32
        ),
    )


SINGLE = Arithmetic(np.float32, wrap, rotation)

"""Single precision, in which transforms and observers equal their C functions."""
