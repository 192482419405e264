"""Modulators beyond their linear range: saturated duty cycles, the fundamental that is left,
and the way back.

Duty cycles saturate at 0 and 1. Continuous modulators keep their zero sequence. Discontinuous ones
choose as they always do while the references need at most v_dc between two lines; where they need
more, the phases with the highest and the lowest reference are at their rails whatever is chosen,
and the third follows the nearer rail, as with DPWM1. Then all discontinuous modulators make the
same line voltages, in phase with the references, up to six-step operation. (Saturation without that
rule turns the fundamental of DPWM0 and DPWM2 by up to 30 degrees, and takes that of DPWM3 and of
DPWMMIN and DPWMMAX back to 0.466 and 0.551 v_dc, below the linear range.)

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "Carrier-based PWM-VSI overmodulation strategies:
    analysis, comparison, and design", IEEE Transactions on Power Electronics 13(4), 1998,
    doi:10.1109/63.704136 (voltage gain by saturation). The integrals here were derived anew.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    Modulation,
    zero_sequence,
)
from dqforge.machines.names import ModulationName

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

    Args:
        name: The modulator.
        voltage, current: Phase references in V from the star point and phase currents in A, shape
            (..., 3).
        v_dc: DC-link voltage in V.
    """
    voltage, current = np.broadcast_arrays(voltage, current)
    v_zero = zero_sequence(name, voltage, current, v_dc)
    if MODULATORS[name].rests:
        beyond = np.ptp(voltage, axis=-1) > v_dc
        v_zero = np.where(beyond, zero_sequence("dpwm1", voltage, current, v_dc), v_zero)
    duty = np.clip((voltage + v_zero[..., None]) / v_dc, 0.0, 1.0)
    # A phase tied to its rail misses it by a rounding of its voltage.
    near = np.rint(duty)
    duty = np.where(np.abs(duty - near) < 4.0 * np.finfo(np.float64).eps, near, duty)
    return Modulation(
        zero_sequence=v_zero, duty=duty, clamped=np.asarray((duty == 0.0) | (duty == 1.0))
    )


def fundamental(name: ModulationName, amplitude: ArrayLike, v_dc: float) -> FloatArray:
    """Amplitude of the fundamental phase voltage in V (peak) that the saturated
    modulator makes of a reference.

    Args:
        name: The modulator.
        amplitude: Amplitude of the phase-voltage reference in V (peak), any shape; infinity is
            six-step operation.
        v_dc: DC-link voltage in V.

    Returns:
        Of the shape of `amplitude`: the reference itself in the linear range, rising from there to
        2 v_dc / pi, which discontinuous modulators reach at 2 v_dc / sqrt 3 and the others in the
        limit. Always in phase with the reference.
    """
    r = np.asarray(amplitude, dtype=np.float64) / v_dc
    limit = MODULATORS[name].linear_limit
    beyond = np.isfinite(r) & (r > limit)
    quarter = MODULATORS[name].overmodulated(np.where(beyond, r, 2.0 * limit))
    saturated = np.minimum(4.0 / math.pi * quarter, SIX_STEP_AMPLITUDE)
    return v_dc * np.where(beyond, saturated, np.where(np.isposinf(r), SIX_STEP_AMPLITUDE, r))


def reference_for(name: ModulationName, wanted: ArrayLike, v_dc: float) -> FloatArray:
    """Amplitude of the reference in V (peak) of which the saturated modulator
    makes a wanted fundamental.

    Args:
        name: The modulator.
        wanted: Fundamental amplitude of the phase voltage in V (peak), any shape.
        v_dc: DC-link voltage in V.

    Returns:
        Of the shape of `wanted`. At six-step operation infinity, or 2 v_dc / sqrt 3 for
        discontinuous modulators; NaN beyond, which no modulator makes.
    """
    target = np.asarray(wanted, dtype=np.float64) / v_dc
    limit = MODULATORS[name].linear_limit
    # In 1/r all references beyond the linear range are a bounded interval.
    low, high = np.zeros_like(target), np.full_like(target, 1.0 / limit)
    if MODULATORS[name].rests:
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
