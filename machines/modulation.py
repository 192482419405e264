"""Carrier-based modulators: common-mode voltage, duty cycles, clamped phases and the waveforms of a period.

Phase references are measured from the machine's star point; adding the zero-sequence voltage V0 refers them to the
negative rail, and division by v_dc makes the duty cycles of the upper switches, u_x = (V_x + V0) / v_dc (paper 000,
(13)). Phase quantities have a last axis of 3 (a, b, c); the axis of angles, where there is one, comes just before it.

References
----------
A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM algorithm", IEEE Transactions
on Industry Applications 34(5), 1998, doi:10.1109/28.720446 (GDPWM).
A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical and graphical methods for carrier-based PWM-VSI drives", IEEE
Transactions on Power Electronics 14(1), 1999, doi:10.1109/63.737592 (linear limits, modulation index, waveforms).
T. D. Nguyen et al., "A direct digital technique implementation of general discontinuous pulse width modulation
strategy", IEEE Transactions on Industrial Electronics 58(9), 2011, doi:10.1109/TIE.2010.2102311 (DDT-GDPWM).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.settings import ModulationName
from dqforge.machines.synchronous import FloatArray

BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

LINEAR_LIMITS: dict[ModulationName, float] = {
    "spwm": 0.5,
    "svpwm": 1.0 / math.sqrt(3.0),
    "ddt-gdpwm": 1.0 / math.sqrt(3.0),
}
"""Largest phase-voltage amplitude (peak) without overmodulation, as a fraction of v_dc (Hava 1999)."""

SIX_STEP_AMPLITUDE = 2.0 / math.pi
"""Fundamental phase-voltage amplitude of six-step operation, as a fraction of v_dc."""

# A reference that was computed to lie on the limit exceeds it by a few roundings at most.
_LIMIT_ROUNDING = 1e-12

_PHASE_SHIFT = np.array([0.0, 2.0, -2.0]) * (math.pi / 3.0)
_SECTOR = math.pi / 3.0

# Eight Gauss points integrate products of three sines over at most 60 degrees to rounding.
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True)
class Modulation:
    """What a modulator makes of phase references.

    Parameters
    ----------
    zero_sequence:
        Zero-sequence voltage V0 in V between star point and negative rail, shape (...).
    duty:
        Duty cycles of the upper switches, shape (..., 3). Not clipped: outside [0, 1] the reference is beyond the
        linear range.
    clamped:
        True where the phase does not switch, shape (..., 3).
    """

    zero_sequence: FloatArray
    duty: FloatArray
    clamped: BoolArray


@dataclass(frozen=True, slots=True)
class PhaseWaveforms:
    """Phase quantities at n angles, for any number of operating points.

    Parameters
    ----------
    theta_e:
        Electrical angle of the d axis from phase a in rad, shape (..., n).
    weight:
        Weights of the angles in an average, shape (..., n), sum 1 over the last axis.
    voltage:
        Phase voltage references in V from the star point, shape (..., n, 3).
    current:
        Phase currents in A, shape (..., n, 3).
    modulation:
        Zero sequence (..., n), duty cycles and clamped phases (..., n, 3).
    """

    theta_e: FloatArray
    weight: FloatArray
    voltage: FloatArray
    current: FloatArray
    modulation: Modulation

    def phase_sum(self, values: FloatArray) -> FloatArray:
        """Average over the angles of the sum over the phases of `values`, shape (..., n, 3); result shape (...)."""
        return np.asarray(np.sum(self.weight * np.sum(values, axis=-1), axis=-1), dtype=np.float64)


def linear_limit(name: ModulationName, v_dc: float) -> float:
    """Largest phase-voltage amplitude in V (peak) that modulator `name` makes without overmodulation from v_dc in V.

    Half of v_dc for SPWM, v_dc / sqrt 3 for SVPWM and DDT-GDPWM (Hava 1999).
    """
    return LINEAR_LIMITS[name] * v_dc


def modulation_index(amplitude: FloatArray, v_dc: float) -> FloatArray:
    """Phase-voltage amplitude (V, peak, any shape) relative to six-step operation, 2 v_dc / pi (Hava 1999).

    The linear range ends at pi/4 = 0.785 for SPWM and at pi / (2 sqrt 3) = 0.907 for SVPWM and DDT-GDPWM.
    """
    return amplitude / (SIX_STEP_AMPLITUDE * v_dc)


def in_linear_range(name: ModulationName, amplitude: FloatArray | float, v_dc: float) -> BoolArray:
    """Tell where the phase-voltage amplitude (V, peak, any shape) is within the linear range; False for NaN."""
    return np.asarray(amplitude <= linear_limit(name, v_dc) * (1.0 + _LIMIT_ROUNDING))


def inverse_park(x_d: FloatArray, x_q: FloatArray, theta_e: FloatArray) -> FloatArray:
    """Phase values (..., 3) of amplitude-invariant dq values (...) at the electrical angle theta_e in rad (...)."""
    angle = np.asarray(theta_e)[..., None] - _PHASE_SHIFT
    phases = np.asarray(x_d)[..., None] * np.cos(angle) - np.asarray(x_q)[..., None] * np.sin(angle)
    return np.asarray(phases, dtype=np.float64)


def _ddt_clamp(voltage: FloatArray, current: FloatArray) -> tuple[IndexArray, BoolArray]:
    """Index (...) of the phase that DDT-GDPWM clamps, and True (...) where it is clamped to the positive rail.

    Of the phases with the highest and the lowest reference, the one with the larger current is clamped, the highest
    if the currents are equal. Of equal references the first is the highest and the last is the lowest, so that the two
    are never the same phase.
    """
    highest = np.argmax(voltage, axis=-1)
    lowest = 2 - np.argmin(voltage[..., ::-1], axis=-1)
    magnitude = np.abs(current)
    i_highest, i_lowest = (np.take_along_axis(magnitude, k[..., None], axis=-1)[..., 0] for k in (highest, lowest))
    upper = i_highest >= i_lowest
    return np.where(upper, highest, lowest), upper


def _spwm_zero_sequence(voltage: FloatArray, _current: FloatArray, v_dc: float) -> FloatArray:
    return np.full(voltage.shape[:-1], 0.5 * v_dc, dtype=np.float64)


def _svpwm_zero_sequence(voltage: FloatArray, _current: FloatArray, v_dc: float) -> FloatArray:
    return np.asarray(0.5 * (v_dc - np.max(voltage, axis=-1) - np.min(voltage, axis=-1)))


def _ddt_zero_sequence(voltage: FloatArray, current: FloatArray, v_dc: float) -> FloatArray:
    _, upper = _ddt_clamp(voltage, current)
    return np.asarray(np.where(upper, v_dc - np.max(voltage, axis=-1), -np.min(voltage, axis=-1)), dtype=np.float64)


_ZERO_SEQUENCES: dict[ModulationName, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "spwm": _spwm_zero_sequence,
    "svpwm": _svpwm_zero_sequence,
    "ddt-gdpwm": _ddt_zero_sequence,
}


def zero_sequence(name: ModulationName, voltage: FloatArray, current: FloatArray, v_dc: float) -> FloatArray:
    """Zero-sequence voltage V0 in V from the negative rail.

    ::

        SPWM       V0 = v_dc / 2
        SVPWM      V0 = (v_dc - V_max - V_min) / 2
        DDT-GDPWM  V0 = v_dc - V_max   if |I_max| >= |I_min|,   else   -V_min

    where I_max and I_min are the currents of the phases with the highest and the lowest reference. Paper 000 (14)
    prints -V_max in the last case, which would clamp no phase.

    Parameters
    ----------
    name:
        The modulator.
    voltage:
        Phase references in V from the star point, shape (..., 3).
    current:
        Phase currents in A, shape (..., 3); only DDT-GDPWM looks at them.
    v_dc:
        DC-link voltage in V.

    Returns
    -------
    FloatArray, shape (...)
    """
    voltage, current = np.broadcast_arrays(voltage, current)
    return _ZERO_SEQUENCES[name](voltage, current, v_dc)


def clamped_phases(name: ModulationName, voltage: FloatArray, current: FloatArray) -> BoolArray:
    """Mark the phase that does not switch, shape (..., 3): exactly one with DDT-GDPWM, none with SPWM and SVPWM."""
    voltage, current = np.broadcast_arrays(voltage, current)
    if name != "ddt-gdpwm":
        return np.zeros(voltage.shape, dtype=np.bool_)
    phase, _ = _ddt_clamp(voltage, current)
    return np.asarray(phase[..., None] == np.arange(3))


def modulate(name: ModulationName, voltage: FloatArray, current: FloatArray, v_dc: float) -> Modulation:
    """Zero sequence, duty cycles and clamped phases, parameters as in `zero_sequence` (paper 000, (13) and (14)).

    The duty cycle of a clamped phase is exactly 0 or 1. Nothing is clipped: test the amplitude of the reference with
    `in_linear_range`.
    """
    v_zero = zero_sequence(name, voltage, current, v_dc)
    clamped = clamped_phases(name, voltage, current)
    duty = (voltage + v_zero[..., None]) / v_dc
    return Modulation(zero_sequence=v_zero, duty=np.where(clamped, np.rint(duty), duty), clamped=clamped)


def _waveforms(
    name: ModulationName,
    v_d: FloatArray,
    v_q: FloatArray,
    i_d: FloatArray,
    i_q: FloatArray,
    v_dc: float,
    theta_e: FloatArray,
    weight: FloatArray,
) -> PhaseWaveforms:
    voltage = inverse_park(v_d[..., None], v_q[..., None], theta_e)
    current = inverse_park(i_d[..., None], i_q[..., None], theta_e)
    return PhaseWaveforms(theta_e, weight, voltage, current, modulate(name, voltage, current, v_dc))


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

    Parameters
    ----------
    name:
        The modulator.
    v_d, v_q, i_d, i_q:
        Phase voltages in V and currents in A in rotor coordinates (peak), broadcastable to the shape (...).
    v_dc:
        DC-link voltage in V.
    angles:
        Number n of angles. They are the midpoints of n equal intervals from theta_e = 0, all with the weight 1/n. The
        average of a quantity that jumps where the clamped phase changes is in error by at most about one jump in n;
        `sector_waveforms` has no such error.

    Returns
    -------
    PhaseWaveforms
        With n = `angles` for arrays of the shape (..., n) and (..., n, 3).
    """
    v_d, v_q, i_d, i_q = _operating_points(v_d, v_q, i_d, i_q)
    theta_e = (np.arange(angles, dtype=np.float64) + 0.5) * (2.0 * math.pi / angles)
    weight = np.full(angles, 1.0 / angles)
    return _waveforms(name, v_d, v_q, i_d, i_q, v_dc, theta_e, weight)


def _sector_rule(lag: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles (..., 24) of the voltage vector in its first sector, in rad, and their weights (..., 24) of sum 1.

    `lag` (...) in rad is the angle by which the current lags the voltage. The sector, 0 to 60 degrees, keeps the order
    V_a > V_b > V_c. It is split where a phase current is zero and where |i_a| = |i_c|, that is where DDT-GDPWM hands
    over, and each part gets its own Gauss rule.
    """
    current_zero = np.mod(lag + math.pi / 6.0, math.pi / 3.0)
    hand_over = np.minimum(np.mod(lag + math.pi / 6.0, math.pi / 2.0), _SECTOR)
    edges = np.sort(np.stack([np.zeros_like(lag), current_zero, hand_over, np.full_like(lag, _SECTOR)], axis=-1))
    half = 0.5 * np.diff(edges, axis=-1)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*lag.shape, 3 * _GAUSS_NODES.size)
    return (middle + half * _GAUSS_NODES).reshape(shape), (half * _GAUSS_WEIGHTS / _SECTOR).reshape(shape)


def sector_waveforms(
    name: ModulationName, v_d: ArrayLike, v_q: ArrayLike, i_d: ArrayLike, i_q: ArrayLike, v_dc: float
) -> PhaseWaveforms:
    """Waveforms at the 24 angles that average losses over a period to rounding, parameters as in `period_waveforms`.

    The angles cover the 60 degrees in which phase a has the highest and phase c the lowest reference, with Gauss rules
    between the angles where an integrand has a kink or a jump. Since the phases repeat each other after 120 degrees,
    and every half wave the other with rails and signs exchanged, `PhaseWaveforms.phase_sum` over this sector is the sum
    over the phases of the average over the period, for any quantity that is the same in both half waves.

    Without voltage the direction of the voltage vector is taken as that of the d axis.
    """
    v_d, v_q, i_d, i_q = _operating_points(v_d, v_q, i_d, i_q)
    voltage_angle = np.arctan2(v_q, v_d)
    alpha, weight = _sector_rule(voltage_angle - np.arctan2(i_q, i_d))
    return _waveforms(name, v_d, v_q, i_d, i_q, v_dc, alpha - voltage_angle[..., None], weight)
