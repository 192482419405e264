"""Space-vector modulation: the highest and the lowest reference as far from their rails."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulator import (
    HALF_PI,
    Modulator,
    angle_of,
    constant,
    wave_integral,
)

_ROOT3 = math.sqrt(3.0)


_THIRTY = math.pi / 6.0


def _saturated(r: FloatArray) -> FloatArray:
    """For u - 1/2 = sqrt(3)/2 r cos(x - 30 deg) up to 60 degrees, 3/2 r cos x from there."""
    half = angle_of(1.0 / (_ROOT3 * r))
    start, end = np.maximum(_THIRTY - half, 0.0), np.minimum(_THIRTY + half, 2.0 * _THIRTY)
    sixty, ninety = np.full_like(r, 2.0 * _THIRTY), np.full_like(r, HALF_PI)
    outer = np.where(r > 2.0 / 3.0, angle_of(1.0 / (3.0 * r)), sixty)
    first = wave_integral(np.zeros_like(r), start, _THIRTY) + wave_integral(end, sixty, _THIRTY)
    saturated = np.sin(end) - np.sin(start) + np.sin(outer) - np.sin(sixty)
    left = ninety - outer
    last = 0.75 * r * (left - 0.5 * np.sin(2.0 * left))
    return 0.5 * _ROOT3 * r * first + 0.5 * saturated + last


MODULATORS = (
    Modulator(
        name="svpwm",
        kind="centred",
        text="highest and lowest reference at the same distance from the rails",
        linear_limit=1.0 / _ROOT3,
        distortion=constant(
            1.5, -4.0 * _ROOT3 / math.pi, 27.0 / 16.0 - 81.0 * _ROOT3 / (64.0 * math.pi)
        ),
        overmodulated=_saturated,
    ),
)
