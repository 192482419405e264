"""Real semiconductor devices: conduction, switching and thermal behaviour as their data
sheets give it, in tables.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.curves import Family, Lookup, line
from dqforge.machines.devices.energies import EXPONENTS, EnergyTable
from dqforge.machines.devices.switch import DeviceKind, SwitchDevice
from dqforge.machines.devices.thermal_network import FosterNetwork, ThermalNetwork
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

REFERENCE_TEMPERATURE = 25.0  # Junction temperature in degC of `SwitchDevice.on_resistance`.
_STEP = 50.0
_LEAST_DISTANCE = 5.0
_ANGLES = 2048
_COEFFICIENTS = (-0.02, 0.05)


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """One switch position: the transistor and its antiparallel diode, as tables.

    Args:
        name: What the maker calls it.
        kind: ``mosfet`` conducts both ways through its channel; ``igbt`` hands negative current to
            its diode.
        conduction: On-state voltage of the transistor in V over current in A at junction
            temperatures in degC.
        turn_on, turn_off: Switching energies.
        recovery: Energy that the diode loses when it recovers; None where it is in `turn_on` or not
            known.
        diode: Forward voltage of the diode like `conduction`; None for a MOSFET whose data leave it
            out.
        thermal, diode_thermal: Junction to case, of transistor and diode; None where nothing is
            known.
        case_resistance: Case to heat sink in K/W per switch position; None where nothing is known.
        max_junction_temperature: Largest permitted junction temperature in degC.
        blocking_voltage, max_current: Ratings in V and A, or None.
        findings: Sentences on what was left out or repaired when the data were read.
    """

    name: str
    kind: DeviceKind
    conduction: Family
    turn_on: EnergyTable
    turn_off: EnergyTable
    recovery: EnergyTable | None = None
    diode: Family | None = None
    thermal: ThermalNetwork | None = None
    diode_thermal: ThermalNetwork | None = None
    case_resistance: float | None = None
    max_junction_temperature: float = 175.0
    blocking_voltage: float | None = None
    max_current: float | None = None
    findings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind == "igbt" and self.diode is None:
            raise InputError(
                "an IGBT needs the data of its diode; write its forward voltage over current"
            )

    @classmethod
    def from_switch_device(cls, device: SwitchDevice, name: str = "switch") -> DeviceModel:
        """The simple device of a few constants in the form of tables, exact at and
        between 25 degC and its maximum.

        Energies are proportional to current and voltage; below 25 degC and above the largest
        permitted temperature the values there are held, and marked.
        """
        reach, hot = _REACH, max(device.max_junction_temperature, REFERENCE_TEMPERATURE + 1.0)
        warm = 1.0 + device.on_resistance_temperature_coefficient * (hot - REFERENCE_TEMPERATURE)
        pair = (REFERENCE_TEMPERATURE, hot)
        channel = tuple(
            line(reach, device.on_voltage, device.on_resistance * factor)
            for factor in (1.0, max(warm, 0.0))
        )
        diode = line(reach, device.diode_voltage, device.diode_resistance)

        def energy(joule: float) -> EnergyTable:
            curve = line(reach, 0.0, joule / device.reference_current)
            return EnergyTable((device.reference_voltage,), (Family(pair, (curve, curve)),), 1.0)

        return cls(
            name=name,
            kind=device.kind,
            conduction=Family(pair, channel),
            turn_on=energy(device.turn_on_energy),
            turn_off=energy(device.turn_off_energy),
            recovery=energy(device.reverse_recovery_energy),
            diode=Family(pair, (diode, diode)),
            thermal=FosterNetwork((device.thermal_resistance,), (0.0,)),
            case_resistance=0.0,
            max_junction_temperature=device.max_junction_temperature,
        )

    def on_voltage(self, current: ArrayLike, temperature: ArrayLike) -> Lookup:
        """On-state voltage of the transistor in V for currents in A (magnitudes) and degC,
        broadcast to (...).
        """
        return self.conduction.at(np.abs(np.asarray(current, dtype=np.float64)), temperature)

    def diode_voltage(self, current: ArrayLike, temperature: ArrayLike) -> Lookup:
        """Forward voltage of the diode in V for currents in A (magnitudes) and degC,
        broadcast to (...).

        Raises:
            InputError: Nothing is known of the diode.
        """
        if self.diode is None:
            raise InputError(
                f"{self.name}: no data for the diode; give its forward voltage over current"
            )
        return self.diode.at(np.abs(np.asarray(current, dtype=np.float64)), temperature)

    def on_resistance(self, current: ArrayLike, temperature: ArrayLike) -> Lookup:
        """Voltage over current of the transistor in Ohm for currents in A and degC,
        broadcast to (...).

        Infinite at zero current where there is a threshold; the slope of the first
        segment where there is none.
        """
        size = np.maximum(np.abs(np.asarray(current, dtype=np.float64)), 1e-6)
        found = self.conduction.at(size, temperature)
        return Lookup(found.value / size, found.outside)

    def turn_on_energy(
        self,
        current: ArrayLike,
        voltage: ArrayLike,
        temperature: ArrayLike,
        gate_resistance: float | None = None,
    ) -> Lookup:
        """E_on in J, see `EnergyTable.at`."""
        return self.turn_on.at(current, voltage, temperature, gate_resistance)

    def turn_off_energy(
        self,
        current: ArrayLike,
        voltage: ArrayLike,
        temperature: ArrayLike,
        gate_resistance: float | None = None,
    ) -> Lookup:
        """E_off in J, see `EnergyTable.at`."""
        return self.turn_off.at(current, voltage, temperature, gate_resistance)

    def recovery_energy(
        self,
        current: ArrayLike,
        voltage: ArrayLike,
        temperature: ArrayLike,
        gate_resistance: float | None = None,
    ) -> Lookup:
        """E_rr in J, see `EnergyTable.at`; zero where it is part of E_on or not known."""
        if self.recovery is None:
            shape = np.broadcast_shapes(
                *(np.shape(part) for part in (current, voltage, temperature))
            )
            return Lookup(np.zeros(shape), np.zeros(shape, dtype=bool))
        return self.recovery.at(current, voltage, temperature, gate_resistance)

    def switch_device(
        self,
        current: float,
        voltage: float,
        temperature: float,
        thermal_resistance: float | None = None,
    ) -> SwitchDevice:
        """The simple device with the losses of this one at an operating point.

        For a sinusoidal current of this amplitude, at this voltage and junction temperature, the
        averages over a period of the conduction loss and of each switching energy are the same. For
        an IGBT so is the average of v i^2, which parts threshold and resistance; duty cycles weigh
        the current otherwise, and the two differ there.

        Args:
            current: Amplitude in A, positive.
            voltage: DC voltage in V, positive.
            temperature: Junction temperature in degC.
            thermal_resistance: Junction to coolant in K/W; that of the data, to the heat sink, if
                None.

        Raises:
            InputError: Nothing tells the thermal resistance, or the numbers given are not positive.
        """
        if not (current > 0.0 and voltage > 0.0):
            raise InputError(
                f"{self.name}: current and voltage of the operating point must be positive"
            )
        threshold, resistance, coefficient = self._linear_channel(current, temperature)
        diode = (0.0, 0.0) if self.diode is None else _straight(self.diode, current, temperature)
        wave = _half_wave(current)

        def energy(table: EnergyTable | None) -> float:
            if table is None:
                return 0.0
            return (
                float(np.mean(table.at(wave, voltage, temperature).value) / np.mean(wave)) * current
            )

        return SwitchDevice(
            kind=self.kind,
            on_resistance=resistance,
            turn_on_energy=energy(self.turn_on),
            turn_off_energy=energy(self.turn_off),
            reference_current=current,
            reference_voltage=voltage,
            thermal_resistance=self.resistance_to_sink()
            if thermal_resistance is None
            else thermal_resistance,
            reverse_recovery_energy=energy(self.recovery),
            on_resistance_temperature_coefficient=coefficient,
            on_voltage=threshold,
            diode_voltage=diode[0],
            diode_resistance=diode[1],
            max_junction_temperature=self.max_junction_temperature,
        )

    def resistance_to_sink(self) -> float:
        """Thermal resistance of the transistor from junction to heat sink in K/W.

        Raises `InputError` if unknown.
        """
        if self.thermal is None:
            raise InputError(
                f"{self.name}: no thermal resistance in its data; write thermal_resistance: 0.3 K/W"
            )
        return self.thermal.resistance + (self.case_resistance or 0.0)

    def _linear_channel(self, current: float, temperature: float) -> tuple[float, float, float]:
        """Threshold in V, resistance at 25 degC in Ohm and its temperature coefficient in 1/K."""
        other = REFERENCE_TEMPERATURE
        if abs(temperature - other) < _LEAST_DISTANCE:
            other = temperature + _STEP
        threshold, here = (
            (0.0, 0.0)
            if self.kind == "mosfet"
            else _straight(self.conduction, current, temperature)
        )
        wave = _half_wave(current)

        def resistance(kelvin: float) -> float:
            volt = self.conduction.at(wave, kelvin).value - threshold
            return float(np.mean(volt * wave) / np.mean(wave**2))

        here, there = resistance(temperature), resistance(other)
        # R (1 + alpha (T - 25)) through both temperatures.
        slope = (there - here) / (other - temperature)
        cold = here - slope * (temperature - REFERENCE_TEMPERATURE)
        if cold <= 0.0 or not _COEFFICIENTS[0] <= slope / cold <= _COEFFICIENTS[1]:
            return threshold, max(here, 0.0), 0.0
        return threshold, cold, slope / cold + 0.0  # never -0


_REACH = 1e5  # Current in A up to which the lines of a simple device are drawn.


def _half_wave(amplitude: float) -> FloatArray:
    """Half a period of a sinusoidal current at the middles of equal steps, shape (N,)."""
    return np.asarray(amplitude * np.sin((np.arange(_ANGLES) + 0.5) * np.pi / _ANGLES))


def _straight(family: Family, amplitude: float, temperature: float) -> tuple[float, float]:
    """Threshold and resistance with the averages of v i and v i^2 of a curve
    over a sinusoidal current.
    """
    wave = _half_wave(amplitude)
    volt = family.at(wave, temperature).value
    moments = [float(np.mean(wave**k)) for k in (1, 2, 3)]
    once, twice = float(np.mean(volt * wave)), float(np.mean(volt * wave**2))
    resistance = (twice * moments[0] - once * moments[1]) / (
        moments[2] * moments[0] - moments[1] ** 2
    )
    threshold = (once - resistance * moments[1]) / moments[0]
    if threshold < 0.0:
        return 0.0, once / moments[1]
    return (threshold, resistance) if resistance >= 0.0 else (once / moments[0], 0.0)


def exponent_of(kind: DeviceKind, event: str) -> float:
    """Exponent of the voltage of turn_on, turn_off or recovery, where the data do not tell it."""
    return EXPONENTS[kind, event]
