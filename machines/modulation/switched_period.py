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
from dqforge.machines.modulation.overmodulation import saturate
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
