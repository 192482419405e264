"""Sine against triangle, with a third harmonic or without.

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical and graphical methods for
    carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics 14(1), 1999,
    doi:10.1109/63.737592.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulator import (
    HALF_PI,
    Modulator,
    angle_of,
    constant,
    wave_integral,
)

_THIRD = -4.0 * math.sqrt(3.0) / math.pi


def _plain(r: FloatArray) -> FloatArray:
    """For u - 1/2 = r cos x."""
    edge = angle_of(0.5 / r)
    # x - sin x cos x of the small angle left, written so that nothing large cancels.
    left = HALF_PI - edge
    return 0.5 * np.sin(edge) + 0.5 * r * (left - 0.5 * np.sin(2.0 * left))


def saturated_third(k: float) -> Callable[[FloatArray], FloatArray]:
    """Make ``overmodulated`` for u - 1/2 = r (cos x - k cos 3x).

    Saturated between two roots of a cubic, or from 0 on once the dip is too.

    Args:
        k: Share of the third harmonic, above 1/9.
    """

    def quarter(r: FloatArray) -> FloatArray:
        # 4 k c^3 - (1 + 3 k) c + 1 / (2 r) = 0 has three real roots c = scale cos(t),
        # cos 3t = -1 / (2 r k scale^3).
        scale = math.sqrt((1.0 + 3.0 * k) / (3.0 * k))
        third = angle_of(-0.5 / (r * k * scale**3)) / 3.0
        outer, inner = (
            angle_of(scale * np.cos(third - shift)) for shift in (2.0 * math.pi / 3.0, 0.0)
        )
        # The root above one means that the dip is saturated.
        zero, end = np.zeros_like(r), np.full_like(r, HALF_PI)
        below = wave_integral(zero, inner, 0.0) - k * wave_integral(zero, inner, 0.0, 3)
        beyond = wave_integral(outer, end, 0.0) - k * wave_integral(outer, end, 0.0, 3)
        return 0.5 * (np.sin(outer) - np.sin(inner)) + r * (below + beyond)

    return quarter


MODULATORS = (
    Modulator(
        name="spwm",
        kind="sine",
        text="sine against triangle, nothing is added",
        linear_limit=0.5,
        distortion=constant(1.5, _THIRD, 9.0 / 8.0),
        overmodulated=_plain,
    ),
    Modulator(
        name="thipwm6",
        kind="third-harmonic",
        share=1.0 / 6.0,
        text="a third harmonic of 1/6 is added",
        linear_limit=1.0 / math.sqrt(3.0),  # the phase peaks at sqrt(3)/2 of the amplitude
        distortion=constant(1.5, _THIRD, 1.0),
        overmodulated=saturated_third(1.0 / 6.0),
    ),
    Modulator(
        name="thipwm4",
        kind="third-harmonic",
        share=1.0 / 4.0,
        text="a third harmonic of 1/4 is added",
        # The phase peaks where cos^2 = 7/12, at 7/6 sqrt(7/12) = 0.891 of the amplitude.
        linear_limit=6.0 * math.sqrt(3.0 / 343.0),
        distortion=constant(1.5, _THIRD, 63.0 / 64.0),
        overmodulated=saturated_third(1.0 / 4.0),
    ),
)
