"""Integrals of saturated duty cycles over a quarter of a period."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray

HALF_PI = 0.5 * math.pi


def wave_integral(start: FloatArray, end: FloatArray, shift: float, order: int = 1) -> FloatArray:
    """Integral of cos(order x - shift) cos(x) over an interval.

    Args:
        start, end: Its ends in rad, any shape.
        shift: Angle in rad.
        order: 1 or an odd order.
    """

    def primitive(x: FloatArray) -> FloatArray:
        slow = x * math.cos(shift) if order == 1 else np.sin((order - 1) * x - shift) / (order - 1)
        return np.asarray(0.5 * (slow + np.sin((order + 1) * x - shift) / (order + 1)))

    return primitive(end) - primitive(start)


def angle_of(cosine: FloatArray) -> FloatArray:
    """Angle in rad of a cosine, any shape, taken as +-1 beyond."""
    return np.arccos(np.clip(cosine, -1.0, 1.0))
