"""An electrical period as it is switched: instants, exact Fourier coefficients,
distortion of voltage and current.

Source: Fourier integrals of rectangular pulses, and Parseval's theorem; D. G. Holmes, T. A. Lipo,
"Pulse Width Modulation for Power Converters", IEEE Press 2003, chapters 2 and 3 (regular sampling,
distortion factors).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    Modulation,
    zero_sequence,
)
from dqforge.machines.modulation.ripple import switching_instants
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class SwitchedPeriod:
    """One electrical period of pulses, N carrier periods of equal length.

    Args:
        duty: Duty cycles, shape (N, 3), within [0, 1].
        edges: Electrical angles in rad at which the upper switches turn on and off, shape (N, 3,
            2).
        v_dc: DC-link voltage in V.
    """

    duty: FloatArray
    edges: FloatArray
    v_dc: float

    def leg_voltage(self, orders: ArrayLike) -> ComplexArray:
        """Harmonics of the leg voltages against the negative rail, shape (H, 3), in V (peak).

        The phasor X of the order n stands for Re(X exp(j n theta)).

        Args:
            orders: Orders n from 1 on, shape (H,).
        """
        order = np.asarray(orders, dtype=np.int64)
        harmonics = np.empty((order.size, 3), dtype=np.complex128)
        for k, n in enumerate(order):  # one order at a time: N carriers may be many
            turns = np.exp(-1j * float(n) * self.edges)
            harmonics[k] = np.sum(turns[..., 0] - turns[..., 1], axis=0) / (1j * math.pi * float(n))
        return self.v_dc * harmonics

    def line_voltage(self, orders: ArrayLike) -> ComplexArray:
        """Harmonics of the line voltages ab, bc, ca, shape (H, 3), in V (peak)."""
        leg = self.leg_voltage(orders)
        return leg - np.roll(leg, -1, axis=-1)

    def phase_voltage(self, orders: ArrayLike) -> ComplexArray:
        """Harmonics of the voltages against the star point, shape (H, 3), in V (peak)."""
        leg = self.leg_voltage(orders)
        return np.asarray(leg - np.mean(leg, axis=-1, keepdims=True))

    def line_voltage_thd(self) -> float:
        """Distortion of the line voltages: r.m.s. of all harmonics over that of the fundamental;
        no order left out.

        Centred pulses overlap, so that a line voltage is v_dc for the
        difference of the duty cycles.
        """
        square = self.v_dc**2 * float(np.mean(np.abs(self.duty - np.roll(self.duty, -1, axis=-1))))
        fundamental = float(np.mean(np.abs(self.line_voltage([1])) ** 2)) / 2.0
        return math.sqrt(max(square / fundamental - 1.0, 0.0))

    def _states(self) -> tuple[FloatArray, FloatArray]:
        """Lengths in rad (6N + 1,) between the switching instants, and phase
        voltages in V (6N + 1, 3) there.
        """
        place = self.edges.reshape(-1, 3, 2).transpose(0, 2, 1).reshape(-1)
        direction = np.tile(np.repeat([1.0, -1.0], 3), len(self.duty))
        leg = np.tile(np.arange(3), 2 * len(self.duty))
        order = np.argsort(place, kind="stable")
        change = np.zeros((place.size + 1, 3))
        change[np.arange(1, place.size + 1), leg[order]] = direction[order]
        states = np.cumsum(change, axis=0)
        bounds = np.concatenate([[0.0], place[order], [2.0 * math.pi]])
        return np.diff(bounds), self.v_dc * (states - np.mean(states, axis=-1, keepdims=True))

    def harmonic_flux(self, omega_e: float) -> float:
        """R.m.s. of the integral of all harmonics of a phase voltage, in V s,
        of the three phases together.

        Divided by an inductance it is the r.m.s. ripple of the phase current, low harmonics
        included. Exact: the integral of the switched voltage is straight between the instants, and
        its fundamental is taken out by Parseval's theorem.

        Args:
            omega_e: Electrical speed in rad/s.
        """
        length, voltage = self._states()
        voltage = voltage - np.sum(length[:, None] * voltage, axis=0) / (2.0 * math.pi)
        end = np.cumsum(length[:, None] * voltage, axis=0)
        start = np.concatenate([np.zeros((1, 3)), end[:-1]])
        mean = np.sum(0.5 * length[:, None] * (start + end), axis=0) / (2.0 * math.pi)
        start, end = start - mean, end - mean
        square = np.sum(length[:, None] * (start**2 + start * end + end**2), axis=0) / (
            6.0 * math.pi
        )
        fundamental = np.abs(self.phase_voltage([1])[0]) ** 2 / 2.0
        return math.sqrt(max(float(np.mean(square - fundamental)), 0.0)) / omega_e

    def current_thd(self, omega_e: float, inductance: float, current: float) -> float:
        """Distortion of the phase currents: r.m.s. of all harmonics over that of the fundamental.

        Args:
            omega_e, inductance, current: Electrical speed in rad/s, phase inductance in H (the same
                in both axes), fundamental current in A (peak).
        """
        return self.harmonic_flux(omega_e) / inductance * math.sqrt(2.0) / current


def switched_period(
    name: ModulationName,
    amplitude: float,
    v_dc: float,
    carrier_ratio: int,
    *,
    load_angle: float = 0.0,
) -> SwitchedPeriod:
    """Pulses of one electrical period with regular sampling in the middle of each carrier period.

    Args:
        name: The modulator; its duty cycles saturate beyond the linear range
            (`dqforge.machines.modulation.modulators.overmodulation.saturate`).
        amplitude: Amplitude of the phase-voltage reference in V (peak); phase a peaks at the angle
            0.
        v_dc: DC-link voltage in V.
        carrier_ratio: Carrier periods N per electrical period. Multiples of 3 make the three phases
            alike.
        load_angle: Angle in rad by which the current lags the voltage; only GDPWM and DDT-GDPWM
            depend on it.

    Raises:
        InputError: With less than 3 carrier periods, which make no three-phase voltage.
    """
    if carrier_ratio < 3:
        raise InputError(
            "carrier_ratio: expected 3 carrier periods per electrical period or more, got "
            f"{carrier_ratio}"
        )
    length = 2.0 * math.pi / carrier_ratio
    start = length * np.arange(carrier_ratio)
    middle = np.asarray(start + 0.5 * length, dtype=np.float64)
    zero = np.zeros(())
    voltage = dq_to_phases(np.asarray(amplitude), zero, middle)
    current = dq_to_phases(
        np.asarray(math.cos(load_angle)), np.asarray(-math.sin(load_angle)), middle
    )
    duty = saturate(name, voltage, current, v_dc).duty
    edges = start[:, None, None] + switching_instants(duty, length)
    return SwitchedPeriod(duty=duty, edges=edges, v_dc=v_dc)


# Modulators beyond their linear range: saturated duty cycles, the fundamental that is left,
# and the way back.
#
# Duty cycles saturate at 0 and 1. Continuous modulators keep their zero sequence. Discontinuous
# ones choose as they always do while the references need at most v_dc between two lines; where they
# need more, the phases with the highest and the lowest reference are at their rails whatever is
# chosen, and the third follows the nearer rail, as with DPWM1. Then all discontinuous modulators
# make the same line voltages, in phase with the references, up to six-step operation. (Saturation
# without that rule turns the fundamental of DPWM0 and DPWM2 by up to 30 degrees, and takes that of
# DPWM3 and of DPWMMIN and DPWMMAX back to 0.466 and 0.551 v_dc, below the linear range.)
#
# References:
#     A. M. Hava, R. J. Kerkman, T. A. Lipo, "Carrier-based PWM-VSI overmodulation strategies:
#     analysis, comparison, and design", IEEE Transactions on Power Electronics 13(4), 1998,
#     doi:10.1109/63.704136 (voltage gain by saturation). The integrals here were derived anew.

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
