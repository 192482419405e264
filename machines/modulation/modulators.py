"""Carrier-based modulators: common-mode voltage, duty cycles, clamped phases and
the waveforms of a period.

Phase references are measured from the machine's star point; adding the zero-sequence voltage V0
refers them to the negative rail, and division by v_dc makes the duty cycles of the upper switches,
u_x = (V_x + V0) / v_dc (paper 000, (13)). Phase quantities have a last axis of 3 (a, b, c); the
axis of angles, where there is one, comes just before it.

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical and graphical methods for
    carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics 14(1), 1999,
    doi:10.1109/63.737592 (linear limits, modulation index, waveforms). T. D. Nguyen et al., "A
    direct digital technique implementation of general discontinuous pulse width modulation
    strategy", IEEE Transactions on Industrial Electronics 58(9), 2011, doi:10.1109/TIE.2010.2102311
    (DDT-GDPWM).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.modulation.registry import (
    INSCRIBED,
    MODULATORS,
    compared_at,
    overmodulated,
    resting_phase,
    sector_rule,
    zero_sequence_of,
)
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import DOUBLES, Triple, clarke, clarke_inverse, dq_to_phases

__all__ = [
    "MODULATORS",
    "SIX_STEP_AMPLITUDE",
    "BoolArray",
    "Modulation",
    "PhaseWaveforms",
    "clamped_phases",
    "in_linear_range",
    "linear_limit",
    "modulate",
    "modulation_index",
    "period_waveforms",
    "sector_waveforms",
    "zero_sequence",
]

# Fundamental phase-voltage amplitude of six-step operation, as a fraction of v_dc.
SIX_STEP_AMPLITUDE = 2.0 / math.pi

# A reference that was computed to lie on the limit exceeds it by a few roundings at most.
_LIMIT_ROUNDING = 1e-12

# Beyond the circle in the hexagon two phases reach their rails but for this.
_RAIL_ROUNDING = 1e-12

# Parts of a sector that overmodulation gives a rule of their own; even, since six-step operation
# jumps at its middle.
_OVERMODULATED_PARTS = 12


@dataclass(frozen=True, slots=True)
class Modulation:
    """What a modulator makes of phase references.

    Args:
        zero_sequence: Zero-sequence voltage V0 in V between star point and negative rail, shape
            (...).
        duty: Duty cycles of the upper switches, shape (..., 3). Not clipped: outside [0, 1] the
            reference is beyond the linear range.
        clamped: True where the phase does not switch, shape (..., 3).
    """

    zero_sequence: FloatArray
    duty: FloatArray
    clamped: BoolArray


@dataclass(frozen=True, slots=True)
class PhaseWaveforms:
    """Phase quantities at n angles, for any number of operating points.

    Args:
        theta_e: Electrical angle of the d axis from phase a in rad, shape (..., n).
        weight: Weights of the angles in an average, shape (..., n), sum 1 over the last axis.
        voltage: Phase voltage references in V from the star point, shape (..., n, 3).
        current: Phase currents in A, shape (..., n, 3).
        modulation: Zero sequence (..., n), duty cycles and clamped phases (..., n, 3).
    """

    theta_e: FloatArray
    weight: FloatArray
    voltage: FloatArray
    current: FloatArray
    modulation: Modulation

    def phase_sum(self, values: FloatArray) -> FloatArray:
        """Average over the angles of the sum over the phases of `values`, shape (..., n, 3).

        Result shape (...).
        """
        return np.asarray(np.sum(self.weight * np.sum(values, axis=-1), axis=-1), dtype=np.float64)


def linear_limit(name: ModulationName, v_dc: float, margin: float = 0.0) -> float:
    """Largest phase-voltage amplitude in V (peak) that modulator `name` makes without
    overmodulation from v_dc in V.

    Half of v_dc for SPWM, 0.561 v_dc for THIPWM4, v_dc / sqrt 3 for all others (Hava 1999); less
    ``margin``, a share of 0 to 1 that is kept for control.
    """
    return MODULATORS[name].linear_limit * v_dc * (1.0 - margin)


def modulation_index(amplitude: FloatArray, v_dc: float) -> FloatArray:
    """Phase-voltage amplitude (V, peak, any shape) relative to six-step operation,
    2 v_dc / pi (Hava 1999).

    The linear range ends at pi/4 = 0.785 for SPWM, at 0.881 for THIPWM4 and at pi / (2
    sqrt 3) = 0.907 for all others.
    """
    return amplitude / (SIX_STEP_AMPLITUDE * v_dc)


def in_linear_range(name: ModulationName, amplitude: FloatArray | float, v_dc: float) -> BoolArray:
    """Tell where the phase-voltage amplitude (V, peak, any shape) is within the linear range.

    False for NaN.

    Args:
        name: The modulator.
        amplitude: Phase-voltage amplitude in V (peak), any shape.
        v_dc: DC-link voltage in V.
    """
    return np.asarray(amplitude <= linear_limit(name, v_dc) * (1.0 + _LIMIT_ROUNDING))


def zero_sequence(
    name: ModulationName, voltage: FloatArray, current: FloatArray, v_dc: float
) -> FloatArray:
    """Zero-sequence voltage V0 in V from the negative rail, by the rules of
    `dqforge.machines.modulation.registry`.

    Args:
        name: The modulator.
        voltage: Phase references in V from the star point, shape (..., 3).
        current: Phase currents in A, shape (..., 3); only GDPWM and DDT-GDPWM look at them.
        v_dc: DC-link voltage in V.

    Returns:
        FloatArray, shape (...)
    """
    v, i, vector, turn = compared_at(name, *np.broadcast_arrays(voltage, current))
    link = np.full(v.a.shape, v_dc, dtype=np.float64)
    return np.asarray(zero_sequence_of(DOUBLES, name, v, i, link, vector, turn), dtype=np.float64)


def clamped_phases(name: ModulationName, voltage: FloatArray, current: FloatArray) -> BoolArray:
    """Mark the phase that does not switch, shape (..., 3): exactly one with discontinuous
    modulators, else none.

    Args:
        name: The modulator.
        voltage: Phase references in V from the star point, shape (..., 3).
        current: Phase currents in A, shape (..., 3).
    """
    voltage, current = np.broadcast_arrays(voltage, current)
    if not MODULATORS[name].rests:
        return np.zeros(voltage.shape, dtype=np.bool_)
    phase, _ = resting_phase(name, voltage, current)
    return np.asarray(phase[..., None] == np.arange(3))


def modulate(
    name: ModulationName, voltage: FloatArray, current: FloatArray, v_dc: float
) -> Modulation:
    """Zero sequence, duty cycles and clamped phases, parameters as in `zero_sequence` (paper 000,
    (13) and (14)).

    The duty cycle of a clamped phase is exactly 0 or 1. Nothing is clipped: test the amplitude of
    the reference with `in_linear_range`.

    Args:
        name: The modulator.
        voltage: Phase references in V from the star point, shape (..., 3).
        current: Phase currents in A, shape (..., 3); only GDPWM and DDT-GDPWM look at them.
        v_dc: DC-link voltage in V.
    """
    v_zero = zero_sequence(name, voltage, current, v_dc)
    clamped = clamped_phases(name, voltage, current)
    duty = (voltage + v_zero[..., None]) / v_dc
    return Modulation(
        zero_sequence=v_zero, duty=np.where(clamped, np.rint(duty), duty), clamped=clamped
    )


def _waveforms(
    name: ModulationName,
    v_d: FloatArray,
    v_q: FloatArray,
    i_d: FloatArray,
    i_q: FloatArray,
    v_dc: float,
    theta_e: FloatArray,
    weight: FloatArray,
    overmodulation: OvermodulationName = "none",
) -> PhaseWaveforms:
    voltage = dq_to_phases(v_d[..., None], v_q[..., None], theta_e)
    current = dq_to_phases(i_d[..., None], i_q[..., None], theta_e)
    if overmodulation == "none":
        made = modulate(name, voltage, current, v_dc)
    else:
        voltage = _on_hexagon(overmodulation, voltage, v_dc)
        made = _at_the_rails(modulate(name, voltage, current, v_dc))
    return PhaseWaveforms(theta_e, weight, voltage, current, made)


def _on_hexagon(method: OvermodulationName, voltage: FloatArray, v_dc: float) -> FloatArray:
    """What overmodulation makes of phase voltages in V, shape (..., 3)."""
    vector = clarke(DOUBLES, Triple(*np.moveaxis(voltage, -1, 0)))
    made = overmodulated(method, vector, np.full(voltage.shape[:-1], v_dc))
    return np.stack(clarke_inverse(DOUBLES, made), axis=-1)


def _at_the_rails(made: Modulation) -> Modulation:
    """The same with phases that reach a rail, but for a rounding, resting there."""
    near = np.clip(np.rint(made.duty), 0.0, 1.0)
    rests = np.abs(made.duty - near) < _RAIL_ROUNDING
    duty = np.where(rests, near, made.duty)
    return Modulation(made.zero_sequence, duty, made.clamped | rests)


def _operating_points(*values: ArrayLike) -> tuple[FloatArray, ...]:
    return tuple(np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values)))


def period_waveforms(
    name: ModulationName,
    v_d: ArrayLike,
    v_q: ArrayLike,
    i_d: ArrayLike,
    i_q: ArrayLike,
    v_dc: float,
    *,
    angles: int = 1440,
) -> PhaseWaveforms:
    """Waveforms over one electrical period, for display and for harmonics.

    Args:
        name: The modulator.
        v_d, v_q, i_d, i_q: Phase voltages in V and currents in A in rotor coordinates (peak),
            broadcastable to the shape (...).
        v_dc: DC-link voltage in V.
        angles: Number n of angles. They are the midpoints of n equal intervals from theta_e = 0,
            all with the weight 1/n. The average of a quantity that jumps where the clamped phase
            changes is in error by at most about one jump in n; `sector_waveforms` has no such
            error.

    Returns:
        With n = `angles` for arrays of the shape (..., n) and (..., n, 3).
    """
    v_d, v_q, i_d, i_q = _operating_points(v_d, v_q, i_d, i_q)
    theta_e = (np.arange(angles, dtype=np.float64) + 0.5) * (2.0 * math.pi / angles)
    weight = np.full(angles, 1.0 / angles)
    return _waveforms(name, v_d, v_q, i_d, i_q, v_dc, theta_e, weight)


def sector_waveforms(
    name: ModulationName,
    v_d: ArrayLike,
    v_q: ArrayLike,
    i_d: ArrayLike,
    i_q: ArrayLike,
    v_dc: float,
    overmodulation: OvermodulationName = "none",
) -> PhaseWaveforms:
    """Waveforms at the angles that average losses over a period to rounding,
    parameters as in `period_waveforms`.

    The 24 angles cover the 60 degrees in which phase a has the highest and phase c the lowest
    reference, with Gauss rules between the angles where an integrand has a kink or a jump. Since
    the phases repeat each other after 120 degrees, and every half wave the other with rails and
    signs exchanged, `PhaseWaveforms.phase_sum` over this sector is the sum over the phases of the
    average over the period, for any quantity that is the same in both half waves. DPWMMIN and
    DPWMMAX treat the half waves differently: 48 angles cover 120 degrees there.

    Without voltage the direction of the voltage vector is taken as that of the d axis.

    Args:
        name: The modulator.
        v_d, v_q, i_d, i_q: Phase voltages in V and currents in A in rotor coordinates (peak),
            broadcastable to the shape (...).
        v_dc: DC-link voltage in V.
        overmodulation: What becomes of voltages beyond the circle in the hexagon; there the angles
            are four times as many, and the averages good to 1e-4.
    """
    v_d, v_q, i_d, i_q = _operating_points(v_d, v_q, i_d, i_q)
    voltage_angle = np.arctan2(v_q, v_d)
    beyond = np.any(np.hypot(v_d, v_q) > INSCRIBED * v_dc)
    method: OvermodulationName = overmodulation if beyond else "none"
    parts = 1 if method == "none" else _OVERMODULATED_PARTS
    alpha, weight = sector_rule(name, voltage_angle - np.arctan2(i_q, i_d), parts)
    theta_e = alpha - voltage_angle[..., None]
    return _waveforms(name, v_d, v_q, i_d, i_q, v_dc, theta_e, weight, method)
