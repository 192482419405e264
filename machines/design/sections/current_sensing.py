"""The current measurement of the inverter in a design file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.design.settings import settings_from
from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.entries.kinds import Section
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.files.positioned_yaml import YamlDocument

ShuntResistance = Annotated[Quantity, QuantityRule("resistance", 1e-6, 100.0)]


AmplifierGain = Annotated[Quantity, QuantityRule("number", 1e-3, 1e4)]


ConverterVoltage = Annotated[Quantity, QuantityRule("voltage", 0.1, 20.0)]


ConverterBits = Annotated[int, Field(ge=6, le=32)]


class CurrentSensingSection(Section):
    """How the phase currents are measured; firmware that counts in integers needs it."""

    shunt: ShuntResistance = Field(
        description="shunt (Ohm); of a current sensor its volts per ampere, in Ohm as well"
    )
    gain: AmplifierGain = Field(description="gain of the amplifier behind it")
    reference: ConverterVoltage = Field(description="reference voltage of the converter (V)")
    bits: ConverterBits = Field(default=12, description="bits of the converter")
    offset: ConverterVoltage | None = Field(
        default=None,
        description="voltage at the converter without current (V); default half the reference",
    )


def check_current_sensing(section: CurrentSensingSection | None, document: YamlDocument) -> None:
    """Check the offset against the reference; raises `InputError` with a position."""
    if section is None or section.offset is None:
        return
    if section.offset.si >= section.reference.si:
        raise document.error(
            f"inverter.current_sensing.offset {section.offset.text} is not below the reference "
            f"{section.reference.text}; without current the converter must be within its range",
            ("inverter", "current_sensing", "offset"),
        )


def read_current_sensing(section: CurrentSensingSection | None) -> CurrentSensing | None:
    """The measurement in SI units, None where the file says nothing of it."""
    return None if section is None else settings_from(CurrentSensing, section)
