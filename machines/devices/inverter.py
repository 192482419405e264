"""The inverter and its devices: what is bolted to the heat sink, in SI units."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.thermal_network import FosterNetwork, ThermalNetwork
from dqforge.machines.errors import InputError
from dqforge.machines.names import OvermodulationName, Topology
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Inverter:
    """A two-level voltage-source inverter.

    Args:
        v_dc: DC-link voltage in V.
        f_sw: Switching (carrier) frequency in Hz.
        device: The switch position, six of which make the bridge; None when no loss data are given.
        coolant_temperature: Temperature in degC that `SwitchDevice.thermal_resistance` refers to.
        dead_time: Dead time in s.
        i_max: Largest permitted current in A (peak), or None when only the machine limits it.
        device_model: The tables that `device` was made from, where the design names some.
        topology: How the phases are fed; `TOPOLOGIES` has the rules.
        capacitor_esr: Series resistance of the DC-link capacitor in Ohm at the carrier frequency.
        neutral_inductance: Inductance in H of a choke in the neutral conductor; 0 without one.
        neutral_resistance: Resistance in Ohm of the neutral's conductor and choke; 0 leaves its
            loss out.
        midpoint_capacitance: Both halves of a split link together, C_1 + C_2 in F; None for a link
            that is not split.
        overmodulation: What the control makes of voltages beyond the circle in the hexagon.
        overmodulation_limit: Largest fundamental then, as a share of that of six-step operation.
        current_sensing: How the phase currents are measured, None where that is not said.
    """

    v_dc: float
    f_sw: float
    device: SwitchDevice | None = None
    coolant_temperature: float = 25.0
    dead_time: float = 0.0
    i_max: float | None = None
    topology: Topology = "three-wire"
    device_model: DeviceModel | None = None
    capacitor_esr: float = 0.0
    neutral_inductance: float = 0.0
    neutral_resistance: float = 0.0
    midpoint_capacitance: float | None = None
    overmodulation: OvermodulationName = "none"
    overmodulation_limit: float = 1.0
    current_sensing: CurrentSensing | None = None

    @property
    def lost_per_dead_time(self) -> float:
        """Amplitude in V that each second of a dead time takes from the fundamental of a phase:
        that of a square wave of the height f_sw v_dc, 4/pi f_sw v_dc.
        """
        return 4.0 / math.pi * self.f_sw * self.v_dc


# Real semiconductor devices: conduction, switching and thermal behaviour as their data
# sheets give it, in tables.

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


# Piecewise linear curves of data sheets: a quantity over current or gate
# resistance at several temperatures.

BoolArray = NDArray[np.bool_]


End = Literal["extend", "hold"]


@dataclass(frozen=True, slots=True)
class Lookup:
    """What a table says, arrays of the shape (...).

    Args:
        value: The quantity in SI units.
        outside: Where the table does not reach: the value is held or carried on from its edge.
    """

    value: FloatArray
    outside: BoolArray

    def times(self, factor: Lookup) -> Lookup:
        """Product of two look-ups, outside where either is."""
        return Lookup(self.value * factor.value, self.outside | factor.outside)

    def plus(self, other: Lookup) -> Lookup:
        """Sum of two look-ups, outside where either is."""
        return Lookup(self.value + other.value, self.outside | other.outside)


@dataclass(frozen=True, slots=True)
class Curve:
    """Points of a curve, straight in between.

    Args:
        x, y: Abscissas, strictly ascending and not negative, and ordinates, not negative; SI units,
            N >= 1 of each.

    Raises:
        InputError: A point breaks one of these rules; with its number.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.x or len(self.x) != len(self.y):
            raise InputError(
                f"the curve has {len(self.x)} abscissas and {len(self.y)} ordinates; write pairs"
            )
        for name, values in (("abscissa", self.x), ("ordinate", self.y)):
            for k, value in enumerate(values):
                if not 0.0 <= value < np.inf:
                    raise InputError(
                        f"{name} {k} is {value:g}; write a finite number that is not negative"
                    )
        for k, (left, right) in enumerate(pairwise(self.x), 1):
            if not right > left:
                raise InputError(
                    f"abscissa {k} is {right:g}, not above {left:g} before it; write ascending ones"
                )

    def at(self, x: FloatArray, end: End) -> FloatArray:
        """Ordinates at abscissas of any shape: held below the first point, extended or held beyond
        the last.
        """
        inside: FloatArray = np.interp(x, self.x, self.y)
        if end == "hold" or len(self.x) < 2:
            return inside
        slope = (self.y[-1] - self.y[-2]) / (self.x[-1] - self.x[-2])
        # A curve that falls at its end must not be carried on below zero.
        return np.maximum(inside + slope * np.maximum(x - self.x[-1], 0.0), 0.0)


@dataclass(frozen=True, slots=True)
class Family:
    """Curves at several parameters, mostly junction temperatures.

    Linear in the parameter, held outside its range.

    Args:
        parameters: Strictly ascending, K >= 1, one per curve; junction temperatures in degC.
        curves: The curves.
        end: Whether a curve is carried on along its last segment, or held.
    """

    parameters: tuple[float, ...]
    curves: tuple[Curve, ...]
    end: End = "extend"

    def __post_init__(self) -> None:
        if not self.parameters or len(self.parameters) != len(self.curves):
            raise InputError(
                f"{len(self.parameters)} temperatures for {len(self.curves)} curves; write one for "
                "each"
            )
        for left, right in pairwise(self.parameters):
            if not left < right:
                raise InputError(
                    f"temperature {right:g} stands behind {left:g}; write them ascending, each once"
                )
        if not np.all(np.isfinite(self.parameters)):
            raise InputError("a temperature is not finite; write degrees Celsius")

    @property
    def reach(self) -> float:
        """Largest abscissa that all curves have."""
        return min(curve.x[-1] for curve in self.curves)

    def at(self, x: ArrayLike, parameter: ArrayLike) -> Lookup:
        """Values at abscissas and parameters.

        Args:
            x, parameter: In the units of the curves, broadcastable to the shape (...).

        Returns:
            Outside where the parameter is out of range, or `x` beyond the last point of a curve
            that is used. Below the first point a curve is held, which is not marked: every
            alternating current passes there.
        """
        where, wanted = np.broadcast_arrays(
            np.asarray(x, np.float64), np.asarray(parameter, np.float64)
        )
        grid = np.asarray(self.parameters)
        held = np.clip(wanted, grid[0], grid[-1])
        value = np.zeros(where.shape)
        outside = np.asarray(held != wanted)
        for k, curve in enumerate(self.curves):
            # The weight of a curve falls from one at its own parameter to zero at its neighbours'.
            weight = np.interp(held, grid, np.eye(grid.size)[k])
            value = value + weight * curve.at(where, self.end)
            outside = outside | ((weight > 0.0) & (where > curve.x[-1]))
        return Lookup(value, np.asarray(outside))


def line(x_end: float, threshold: float, slope: float) -> Curve:
    """Straight line from (0, threshold) to x_end, as threshold voltage and
    resistance describe a device.
    """
    return Curve((0.0, x_end), (threshold, threshold + slope * x_end))


# Switching energies of a device over current, voltage, junction temperature and gate
# resistance.

# Ratios to the nearest given voltage within which a power law is taken on trust.
_VOLTAGE_SPAN = (0.5, 1.5)

# Exponents of the voltage where only one is given.
#
# IGBT 1.3 to 1.4 and diode 0.6: A. Wintrich et al., "Application Manual Power Semiconductors",
# SEMIKRON, 2nd ed. 2015, chapter 5.2, quoted without the page at hand. MOSFET 1: current and
# voltage cross linearly, and what the output capacitance adds lies between 1 and 2.
EXPONENTS: dict[tuple[DeviceKind, str], float] = {
    ("mosfet", "turn_on"): 1.0,
    ("mosfet", "turn_off"): 1.0,
    ("mosfet", "recovery"): 0.6,
    ("igbt", "turn_on"): 1.3,
    ("igbt", "turn_off"): 1.3,
    ("igbt", "recovery"): 0.6,
}


@dataclass(frozen=True, slots=True)
class EnergyTable:
    """Energy of one switching event.

    Args:
        voltages: DC voltages of the tables in V, ascending, K >= 1.
        tables: One family per voltage: energy in J over current in A at junction temperatures in
            degC.
        exponent: Energy grows with (v / v_ref) to this power beyond the voltages given; between two
            it is linear in the voltage.
        gate_resistance: External gate resistance of the tables in Ohm; None where it is not known.
        gate: Energy in J over gate resistance in Ohm at junction temperatures in degC, for the
            ratio alone; or None.
    """

    voltages: tuple[float, ...]
    tables: tuple[Family, ...]
    exponent: float
    gate_resistance: float | None = None
    gate: Family | None = None

    def __post_init__(self) -> None:
        if not self.voltages or len(self.voltages) != len(self.tables):
            raise InputError(
                f"{len(self.voltages)} voltages for {len(self.tables)} tables of energy; write one "
                "for each"
            )
        if not (self.voltages[0] > 0.0 and all(a < b for a, b in pairwise(self.voltages))):
            raise InputError("the voltages of the energies must be positive and ascend, each once")
        if self.gate is not None and self.gate_resistance is None:
            raise InputError(
                "energies over the gate resistance need the one of the other tables; write r_g"
            )
        if not 0.0 <= self.exponent <= 3.0:
            raise InputError(
                f"the exponent of the voltage is {self.exponent:g}; write 0 to 3, such as 1.3"
            )

    def at(
        self,
        current: ArrayLike,
        voltage: ArrayLike,
        temperature: ArrayLike,
        gate_resistance: float | None = None,
    ) -> Lookup:
        """Energy in J.

        Args:
            current, voltage, temperature: Switched current in A (its magnitude counts), DC voltage
                in V and junction temperature in degC, broadcastable to the shape (...).
            gate_resistance: External gate resistance in Ohm; that of the tables if None.

        Returns:
            Outside beyond the tables; where the voltage is below half or above one and a half times
            the nearest given one; and everywhere when another gate resistance is asked for than the
            tables know of.
        """
        size, volt, kelvin = np.broadcast_arrays(
            *(np.asarray(part, dtype=np.float64) for part in (current, voltage, temperature))
        )
        size, volt = np.abs(size), np.abs(volt)
        grid = np.asarray(self.voltages)
        held = np.clip(volt, grid[0], grid[-1])
        ratio = volt / held
        found = Lookup(
            np.zeros(size.shape), (ratio < _VOLTAGE_SPAN[0]) | (ratio > _VOLTAGE_SPAN[1])
        )
        for k, table in enumerate(self.tables):
            weight = np.interp(held, grid, np.eye(grid.size)[k])
            part = table.at(size, kelvin)
            found = found.plus(Lookup(weight * part.value, part.outside & (weight > 0.0)))
        found = found.times(Lookup(ratio**self.exponent, np.zeros(size.shape, dtype=bool)))
        return (
            found
            if gate_resistance is None
            else found.times(self._gate_factor(gate_resistance, kelvin))
        )

    def _gate_factor(self, wanted: float, temperature: FloatArray) -> Lookup:
        """Energy at a gate resistance over that of the tables.

        One, and outside, where nothing tells it.
        """
        if self.gate is None or self.gate_resistance is None:
            known = self.gate_resistance is not None and wanted == self.gate_resistance
            return Lookup(np.ones(temperature.shape), np.full(temperature.shape, not known))
        asked, base = (
            self.gate.at(resistance, temperature) for resistance in (wanted, self.gate_resistance)
        )
        low = max(curve.x[0] for curve in self.gate.curves)
        outside = asked.outside | (wanted < low and wanted != self.gate_resistance)
        return Lookup(asked.value / base.value, np.asarray(outside))


# What losses need to know of a switching device.

DeviceKind = Literal["mosfet", "igbt"]


@dataclass(frozen=True, slots=True)
class SwitchDevice:
    """One switch position of a half bridge: the transistor together with its antiparallel diode.

    Args:
        kind: ``mosfet`` conducts both ways through its channel; ``igbt`` hands negative current to
            its diode.
        on_resistance: R_DS(on) or r_CE in Ohm at 25 degC junction temperature.
        on_resistance_temperature_coefficient: Relative change of the on resistance per kelvin, in
            1/K, linear around 25 degC.
        on_voltage: V_CE0 in V (0 for a MOSFET).
        diode_voltage, diode_resistance: V_F0 in V and r_F in Ohm of the diode.
        turn_on_energy, turn_off_energy, reverse_recovery_energy: E_on, E_off and E_rr in J at
            `reference_current` (A) and `reference_voltage` (V); proportional to both.
        thermal_resistance: Junction to coolant, per switch position, in K/W.
        max_junction_temperature: Largest permitted junction temperature in degC.
    """

    kind: DeviceKind
    on_resistance: float
    turn_on_energy: float
    turn_off_energy: float
    reference_current: float
    reference_voltage: float
    thermal_resistance: float
    reverse_recovery_energy: float = 0.0
    on_resistance_temperature_coefficient: float = 0.0
    on_voltage: float = 0.0
    diode_voltage: float = 0.0
    diode_resistance: float = 0.0
    max_junction_temperature: float = 175.0

    @property
    def switching_energy(self) -> float:
        """Energy of one turn-on and one turn-off (with the recovery it causes) at
        the reference point, in J.
        """
        return self.turn_on_energy + self.turn_off_energy + self.reverse_recovery_energy


# How an inverter measures its phase currents: shunt, amplifier, converter.


@dataclass(frozen=True, slots=True)
class CurrentSensing:
    """One channel of the current measurement.

    Args:
        shunt: Volts per ampere before the amplifier in Ohm: the shunt, or the slope of a sensor.
        gain: Gain of the amplifier.
        reference: Reference voltage of the converter in V, its largest code.
        bits: Bits of the converter.
        offset: Voltage in V at the converter without current; None for half the reference.
    """

    shunt: float
    gain: float
    reference: float
    bits: int = 12
    offset: float | None = None

    @property
    def slope(self) -> float:
        """Volts at the converter per ampere."""
        return self.shunt * self.gain

    @property
    def full_scale(self) -> float:
        """Largest current in A (peak) that is measured in both directions."""
        zero = 0.5 * self.reference if self.offset is None else self.offset
        return min(zero, self.reference - zero) / self.slope

    @property
    def step(self) -> float:
        """Current in A of one code of the converter."""
        return float(self.reference / (self.slope * 2**self.bits))
