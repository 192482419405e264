"""Devices in files: the switch of a design, as constants or as a reference,
and the device files of the library.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from dqforge.machines.devices.inverter import DeviceKind
from dqforge.machines.entries.former_keys import TAGS
from dqforge.machines.entries.kinds import (
    About,
    Coefficient,
    Current,
    Drop,
    Energy,
    FileName,
    Listing,
    Name,
    OnResistance,
    PhaseCurrent,
    Section,
    Temperature,
    ThermalResistance,
    Version,
    Voltage,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule

PointCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, zero=True)]


GateResistance = Annotated[Quantity, QuantityRule("resistance", 1e-3, 1e4)]


Exponent = Annotated[Quantity, QuantityRule("number", 0.0, 3.0)]


TimeConstant = Annotated[Quantity, QuantityRule("time", 1e-9, 1e6)]


class DeviceSection(Section):
    """One switch position: transistor and antiparallel diode."""

    kind: DeviceKind = Field(
        description="mosfet (conducts both ways) or igbt (its diode conducts backwards)"
    )
    on_resistance: OnResistance = Field(description="R_DS(on) or r_CE at 25 degC (Ohm)")
    on_resistance_temperature_coefficient: Coefficient | None = Field(
        default=None, description="relative change of on_resistance (1/K; write %/K); default 0"
    )
    on_voltage: Drop | None = Field(default=None, description="V_CE0 of an IGBT (V); default 0")
    diode_voltage: Drop | None = Field(
        default=None, description="threshold voltage of the diode (V); default 0"
    )
    diode_resistance: OnResistance | None = Field(
        default=None, description="differential resistance of the diode (Ohm)"
    )
    turn_on_energy: Energy = Field(description="E_on at the reference point (J)")
    turn_off_energy: Energy = Field(description="E_off at the reference point (J)")
    reverse_recovery_energy: Energy | None = Field(
        default=None, description="E_rr at the reference point (J); default 0"
    )
    reference_current: Current = Field(description="current of the energies (A)")
    reference_voltage: Voltage = Field(description="voltage of the energies (V)")
    thermal_resistance: ThermalResistance = Field(
        description="junction to coolant, per switch position (K/W)"
    )
    max_junction_temperature: Temperature | None = Field(
        default=None,
        description=(
            "largest permitted junction temperature (degC, also without a unit); default 175"
        ),
    )


class DeviceReference(Section):
    """A device by its data: in a file beside the design, or from the library."""

    file: FileName | None = Field(
        default=None,
        description=(
            "transistordatabase (.json), PLECS (.xml) or dqforge (.yaml), beside the design"
        ),
    )
    name: Name | None = Field(
        default=None, description="device of the library, such as sirectifier-sii400s12"
    )
    junction_temperature: Temperature | None = Field(
        default=None,
        description="where its tables are made constants (degC, also without a unit); default 100",
    )
    reference_current: PhaseCurrent | None = Field(
        default=None, description="amplitude for which they are (A); default the current limit"
    )
    thermal_resistance: ThermalResistance | None = Field(
        default=None,
        description="junction to coolant, per switch position (K/W); default that of its data",
    )


def _form(value: Any) -> str:
    """Tag of the form in which a device is given."""
    keys = set(value) if isinstance(value, dict) else set()
    return TAGS[1] if isinstance(value, DeviceReference) or keys & {"file", "name"} else TAGS[0]


DeviceEntry = Annotated[
    Annotated[DeviceSection, Tag(TAGS[0])] | Annotated[DeviceReference, Tag(TAGS[1])],
    Discriminator(_form),
]


class DropPoint(Section):
    """A point of an on-state curve."""

    current: PointCurrent = Field(description="current (A)")
    voltage: Drop = Field(description="on-state voltage (V)")


class OnState(Section):
    """On-state voltage at one junction temperature."""

    temperature: Temperature = Field(description="junction temperature (degC)")
    threshold: Drop | None = Field(default=None, description="threshold voltage (V); default 0")
    resistance: OnResistance | None = Field(default=None, description="resistance (Ohm)")
    points: Annotated[Listing[DropPoint], Field(min_length=1, max_length=200)] | None = Field(
        default=None, description="points instead of threshold and resistance"
    )


class EnergyPoint(Section):
    """A point of an energy curve."""

    current: PointCurrent = Field(description="current (A)")
    energy: Energy = Field(description="energy (J)")


class EnergyCurve(Section):
    """Energy over current at one junction temperature."""

    temperature: Temperature = Field(description="junction temperature (degC)")
    points: Annotated[Listing[EnergyPoint], Field(min_length=1, max_length=200)] = Field(
        description="points; a single one stands for a line through zero"
    )


class GatePoint(Section):
    """A point of energy over gate resistance."""

    resistance: GateResistance = Field(description="external gate resistance (Ohm)")
    energy: Energy = Field(description="energy (J)")


class GateCurve(Section):
    """Energy over gate resistance at one junction temperature."""

    temperature: Temperature = Field(description="junction temperature (degC)")
    points: Annotated[Listing[GatePoint], Field(min_length=2, max_length=200)] = Field(
        description="points"
    )


class EnergySection(Section):
    """Energy of one kind of switching event."""

    voltage: Voltage = Field(description="DC voltage of the energies (V)")
    voltage_exponent: Exponent | None = Field(
        default=None, description="energy grows with the voltage to this power"
    )
    gate_resistance: GateResistance | None = Field(
        default=None, description="external gate resistance (Ohm)"
    )
    curves: Annotated[Listing[EnergyCurve], Field(min_length=1, max_length=20)] = Field(
        description="one per junction temperature"
    )
    over_gate_resistance: (
        Annotated[Listing[GateCurve], Field(min_length=1, max_length=20)] | None
    ) = Field(default=None, description="influence of the gate resistance")


class FosterElement(Section):
    """One element of a Foster network."""

    resistance: ThermalResistance = Field(description="R_i (K/W)")
    time_constant: TimeConstant = Field(description="tau_i (s)")


class ThermalSection(Section):
    """Junction to case."""

    resistance: ThermalResistance | None = Field(
        default=None, description="steady state alone (K/W)"
    )
    foster: Annotated[Listing[FosterElement], Field(min_length=1, max_length=20)] | None = Field(
        default=None, description="elements of the Foster network"
    )


class DeviceFile(Section):
    """Data of one switch position."""

    device: Version = Field(description="version of this format")
    name: Name = Field(description="part number")
    manufacturer: Name | None = Field(default=None, description="who makes it")
    about: About = Field(default="", description="what it is, and where its data come from")
    kind: DeviceKind = Field(
        description="mosfet (conducts both ways) or igbt (its diode conducts backwards)"
    )
    blocking_voltage: Voltage | None = Field(default=None, description="rated voltage (V)")
    max_current: Current = Field(description="end of the lines by threshold and resistance (A)")
    max_junction_temperature: Temperature | None = Field(
        default=None, description="default 175 degC"
    )
    on_state: Annotated[Listing[OnState], Field(min_length=1, max_length=20)] = Field(
        description="transistor, one entry per junction temperature"
    )
    diode: Annotated[Listing[OnState], Field(min_length=1, max_length=20)] | None = Field(
        default=None, description="diode, one entry per junction temperature"
    )
    turn_on: EnergySection = Field(description="E_on")
    turn_off: EnergySection = Field(description="E_off")
    recovery: EnergySection | None = Field(default=None, description="E_rr of the diode")
    thermal: ThermalSection | None = Field(default=None, description="transistor, junction to case")
    diode_thermal: ThermalSection | None = Field(
        default=None, description="diode, junction to case"
    )
    case_resistance: ThermalResistance | None = Field(
        default=None, description="case to heat sink (K/W)"
    )
