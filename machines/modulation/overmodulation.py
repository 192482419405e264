"""Modulators beyond their linear range: saturated duty cycles, the fundamental that is left,
and the way back.

Duty cycles saturate at 0 and 1. Continuous modulators keep their zero sequence. Discontinuous ones
choose as they always do while the references need at most v_dc between two lines; where they need
more, the phases with the highest and the lowest reference are at their rails whatever is chosen,
and the third follows the nearer rail, as with DPWM1. Then all discontinuous modulators make the
same line voltages, in phase with the references, up to six-step operation. (Saturation without that
rule turns the fundamental of DPWM0 and DPWM2 by up to 30 degrees, and takes that of DPWM3 and of
DPWMMIN and DPWMMAX back to 0.466 and 0.551 v_dc, below the linear range.)

References
----------
A. M. Hava, R. J. Kerkman, T. A. Lipo, "Carrier-based PWM-VSI overmodulation strategies: analysis,
comparison, and design", IEEE Transactions on Power Electronics 13(4), 1998, doi:10.1109/63.704136
(voltage gain by saturation). The integrals here were derived anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.clamping import DISCONTINUOUS
from dqforge.machines.modulation.modulators import (
    LINEAR_LIMITS,
    SIX_STEP_AMPLITUDE,
    Modulation,
    zero_sequence,
)
from dqforge.machines.names import ModulationName

_THIRTY = math.pi / 6.0


_HALF_PI = 0.5 * math.pi


# Each bisection halves the interval of 1/reference; 60 leave less than a
# rounding of the fundamental.
_BISECTIONS = 60


def saturate(
    name: ModulationName, voltage: FloatArray, current: FloatArray, v_dc: float
) -> Modulation:
    """Zero sequence, duty cycles within [0, 1] and resting phases, at any
    amplitude of the references.

    Within the linear range the same as `dqforge.machines.modulation.modulators.modulate`, save that
    any phase whose duty cycle is exactly 0 or 1 counts as resting.

    Parameters
    ----------
    name:
        The modulator.
    voltage, current:
        Phase references in V from the star point and phase currents in A, shape (..., 3).
    v_dc:
        DC-link voltage in V.
    """
    voltage, current = np.broadcast_arrays(voltage, current)
    v_zero = zero_sequence(name, voltage, current, v_dc)
    if name in DISCONTINUOUS:
        beyond = np.ptp(voltage, axis=-1) > v_dc
        v_zero = np.where(beyond, zero_sequence("dpwm1", voltage, current, v_dc), v_zero)
    duty = np.clip((voltage + v_zero[..., None]) / v_dc, 0.0, 1.0)
    # A phase tied to its rail misses it by a rounding of its voltage.
    near = np.rint(duty)
    duty = np.where(np.abs(duty - near) < 4.0 * np.finfo(np.float64).eps, near, duty)
    return Modulation(
        zero_sequence=v_zero, duty=duty, clamped=np.asarray((duty == 0.0) | (duty == 1.0))
    )


def _wave(start: FloatArray, end: FloatArray, shift: float, order: int = 1) -> FloatArray:
    """Integral of cos(order x - shift) cos(x) from start to end in rad, any shape."""

    def primitive(x: FloatArray) -> FloatArray:
        slow = x * math.cos(shift) if order == 1 else np.sin((order - 1) * x - shift) / (order - 1)
        return np.asarray(0.5 * (slow + np.sin((order + 1) * x - shift) / (order + 1)))

    return primitive(end) - primitive(start)


def _angle(cosine: FloatArray) -> FloatArray:
    return np.arccos(np.clip(cosine, -1.0, 1.0))


# Each of the following is int (u - 1/2) cos x dx over 0 to 90 degrees, u saturated, for r = V /
# v_dc beyond the linear limit, with x from the peak of the phase's reference. The other quarters
# follow by symmetry: the fundamental is 4/pi of it.
def _spwm(r: FloatArray) -> FloatArray:
    """For u - 1/2 = r cos x."""
    edge = _angle(0.5 / r)
    # x - sin x cos x of the small angle left, written so that nothing large cancels.
    left = _HALF_PI - edge
    return 0.5 * np.sin(edge) + 0.5 * r * (left - 0.5 * np.sin(2.0 * left))


def _third_harmonic(k: float) -> Callable[[FloatArray], FloatArray]:
    """For u - 1/2 = r (cos x - k cos 3x): saturated between two roots of a cubic,
    or from 0 on once the dip is too.
    """

    def quarter(r: FloatArray) -> FloatArray:
        # 4 k c^3 - (1 + 3 k) c + 1 / (2 r) = 0 has three real roots c = scale cos(t),
        # cos 3t = -1 / (2 r k scale^3).
        scale = math.sqrt((1.0 + 3.0 * k) / (3.0 * k))
        third = _angle(-0.5 / (r * k * scale**3)) / 3.0
        outer, inner = (
            _angle(scale * np.cos(third - shift)) for shift in (2.0 * math.pi / 3.0, 0.0)
        )
        # The root above one means that the dip is saturated.
        below = _wave(np.zeros_like(r), inner, 0.0) - k * _wave(np.zeros_like(r), inner, 0.0, 3)
        end = np.full_like(r, _HALF_PI)
        beyond = _wave(outer, end, 0.0) - k * _wave(outer, end, 0.0, 3)
        return 0.5 * (np.sin(outer) - np.sin(inner)) + r * (below + beyond)

    return quarter


def _svpwm(r: FloatArray) -> FloatArray:
    """For u - 1/2 = sqrt(3)/2 r cos(x - 30 deg) up to 60 degrees, 3/2 r cos x from there."""
    half = _angle(1.0 / (math.sqrt(3.0) * r))
    start, end = np.maximum(_THIRTY - half, 0.0), np.minimum(_THIRTY + half, 2.0 * _THIRTY)
    sixty, ninety = np.full_like(r, 2.0 * _THIRTY), np.full_like(r, _HALF_PI)
    outer = np.where(r > 2.0 / 3.0, _angle(1.0 / (3.0 * r)), sixty)
    first = _wave(np.zeros_like(r), start, _THIRTY) + _wave(end, sixty, _THIRTY)
    saturated = np.sin(end) - np.sin(start) + np.sin(outer) - np.sin(sixty)
    left = ninety - outer
    last = 0.75 * r * (left - 0.5 * np.sin(2.0 * left))
    return 0.5 * math.sqrt(3.0) * r * first + 0.5 * saturated + last


def _dpwm(r: FloatArray) -> FloatArray:
    """For u = 1 up to 30 degrees, sqrt(3) r cos(x - 30 deg) from there."""
    edge = np.minimum(_THIRTY + _angle(1.0 / (math.sqrt(3.0) * r)), _HALF_PI)
    end = np.full_like(r, _HALF_PI)
    return (
        0.5 * np.sin(edge)
        + math.sqrt(3.0) * r * _wave(edge, end, _THIRTY)
        - 0.5 * (1.0 - np.sin(edge))
    )


_QUARTERS: dict[ModulationName, Callable[[FloatArray], FloatArray]] = {
    "spwm": _spwm,
    "thipwm6": _third_harmonic(1.0 / 6.0),
    "thipwm4": _third_harmonic(1.0 / 4.0),
    "svpwm": _svpwm,
    **dict.fromkeys(DISCONTINUOUS, _dpwm),
}


def fundamental(name: ModulationName, amplitude: ArrayLike, v_dc: float) -> FloatArray:
    """Amplitude of the fundamental phase voltage in V (peak) that the saturated
    modulator makes of a reference.

    Parameters
    ----------
    name:
        The modulator.
    amplitude:
        Amplitude of the phase-voltage reference in V (peak), any shape;
        infinity is six-step operation.
    v_dc:
        DC-link voltage in V.

    Returns
    -------
    FloatArray
        Of the shape of `amplitude`: the reference itself in the linear range, rising from there to
        2 v_dc / pi, which discontinuous modulators reach at 2 v_dc / sqrt 3 and the others in the
        limit. Always in phase with the reference.
    """
    r = np.asarray(amplitude, dtype=np.float64) / v_dc
    limit = LINEAR_LIMITS[name]
    beyond = np.isfinite(r) & (r > limit)
    quarter = _QUARTERS[name](np.where(beyond, r, 2.0 * limit))
    saturated = np.minimum(4.0 / math.pi * quarter, SIX_STEP_AMPLITUDE)
    return v_dc * np.where(beyond, saturated, np.where(np.isposinf(r), SIX_STEP_AMPLITUDE, r))


def reference_for(name: ModulationName, wanted: ArrayLike, v_dc: float) -> FloatArray:
    """Amplitude of the reference in V (peak) of which the saturated modulator
    makes a wanted fundamental.

    Parameters
    ----------
    name:
        The modulator.
    wanted:
        Fundamental amplitude of the phase voltage in V (peak), any shape.
    v_dc:
        DC-link voltage in V.

    Returns
    -------
    FloatArray
        Of the shape of `wanted`. At six-step operation infinity, or 2 v_dc / sqrt 3 for
        discontinuous modulators; NaN beyond, which no modulator makes.
    """
    target = np.asarray(wanted, dtype=np.float64) / v_dc
    limit = LINEAR_LIMITS[name]
    # In 1/r all references beyond the linear range are a bounded interval.
    low, high = np.zeros_like(target), np.full_like(target, 1.0 / limit)
    if name in DISCONTINUOUS:
        low = low + 0.5 * math.sqrt(3.0)
    least = low
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        enough = fundamental(name, 1.0 / middle, 1.0) >= target
        low, high = np.where(enough, middle, low), np.where(enough, high, middle)
    at_end = np.asarray(target >= SIX_STEP_AMPLITUDE * (1.0 - 1e-15))
    inverse = np.where(at_end, least, 0.5 * (low + high))
    found = np.divide(1.0, inverse, out=np.full_like(inverse, np.inf), where=inverse > 0.0)
    found = np.where(target > limit, found, target)
    return v_dc * np.where(target > SIX_STEP_AMPLITUDE * (1.0 + 1e-12), np.nan, found)
