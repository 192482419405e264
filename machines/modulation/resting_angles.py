"""Angles between which phases rest, and what that saves of the switching loss.

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
    algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446
    (clamping angle psi); "Simple analytical and graphical methods for carrier-based PWM-VSI
    drives", IEEE Transactions on Power Electronics 14(1), 1999, doi:10.1109/63.737592 (switching
    loss function).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.quarter_waves import HALF_PI, angle_of, wave_integral

THIRTY = math.pi / 6.0


SIXTY = math.pi / 3.0


# Loads this close to pure reactance count as motoring, so that rounding does not turn the
# clamping angle to and fro.
REACTIVE = 1e-9


def folded(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Angle from -90 to 90 degrees (rad) that a lag has when generating counts as motoring with
    current reversed.

    Args:
        sine, cosine: Of the lag, times any positive factor, any shape.
    """
    generating = cosine < -REACTIVE * np.hypot(sine, cosine)
    return np.asarray(
        np.arctan2(np.where(generating, -sine, sine), np.abs(cosine)), dtype=np.float64
    )


def clamping_angle(load_angle: ArrayLike) -> FloatArray:
    """Clamping angle psi of GDPWM in rad: phi + 30 degrees, within 0 and 60 degrees (Hava 1998).

    psi = 0, 30 and 60 degrees is DPWM0, DPWM1 and DPWM2: each phase rests from psi - 60
    degrees to psi after its peaks.

    Args:
        load_angle: Angle phi in rad by which the current lags the voltage, any shape. Loss depends
            on the magnitude of the current alone, so that generating (phi beyond 90 degrees) is as
            motoring with the current reversed.
    """
    phi = np.asarray(load_angle, dtype=np.float64)
    return np.clip(folded(np.sin(phi), np.cos(phi)) + THIRTY, 0.0, SIXTY)


def rectified_integral(start: FloatArray, end: FloatArray) -> FloatArray:
    """Integral of |cos x| from start to end in rad, any shape."""

    def primitive(x: FloatArray) -> FloatArray:
        half_waves = np.rint(x / math.pi)
        return np.asarray(2.0 * half_waves + np.sin(x - math.pi * half_waves))

    return primitive(end) - primitive(start)


def saving(
    *intervals: tuple[float, float], one_rail: bool = False
) -> Callable[[FloatArray], FloatArray]:
    """Make the ``loss_factor`` of a phase that rests in given intervals.

    Args:
        intervals: First and last angle in rad from the positive peak of the phase's reference, for
            each half wave.
        one_rail: Whether it rests in every other half wave only.
    """

    def loss_factor(load_angle: FloatArray) -> FloatArray:
        saved = sum(
            (rectified_integral(start - load_angle, end - load_angle) for start, end in intervals),
            np.zeros_like(load_angle),
        )
        return 1.0 - saved * (0.25 if one_rail else 0.5)

    return loss_factor


def saturated_resting(r: FloatArray) -> FloatArray:
    """``overmodulated`` of all discontinuous modulators: u = 1 up to 30 degrees, sqrt(3) r cos(x -
    30 deg) from there.

    Args:
        r: Amplitude over v_dc, any shape.
    """
    edge = np.minimum(THIRTY + angle_of(1.0 / (math.sqrt(3.0) * r)), HALF_PI)
    end = np.full_like(r, HALF_PI)
    return (
        0.5 * np.sin(edge)
        + math.sqrt(3.0) * r * wave_integral(edge, end, THIRTY)
        - 0.5 * (1.0 - np.sin(edge))
    )
