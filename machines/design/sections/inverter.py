"""The section ``inverter``: the switch, constants or tables from a file or the library, and the
current measurement.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import settings_from
from dqforge.machines.devices.inverter import CurrentSensing, DeviceModel, Inverter, SwitchDevice
from dqforge.machines.devices.sections import DeviceEntry, DeviceReference, DeviceSection
from dqforge.machines.entries.kinds import (
    Capacitance,
    ChokeInductance,
    DeadTime,
    OnResistance,
    PhaseCurrent,
    Rate,
    Section,
    Temperature,
    Voltage,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule, si_of
from dqforge.machines.errors import InputError, KeyPath, about
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import Topology
from dqforge.machines.units.quantities import format_quantity

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


class InverterSection(Section):
    """The inverter."""

    topology: Topology = Field(
        default="three-wire",
        description=(
            "three-wire: two-level bridge, star point not connected; four-leg: the neutral on a "
            "fourth leg; six-leg: a full bridge per phase on a common link; "
            "six-leg-isolated: both ends on separate links, no zero-sequence current; "
            "split-capacitor, diode-neutral: the neutral between two capacitors or two diodes"
        ),
    )
    v_dc: Voltage = Field(description="DC-link voltage (V)")
    switching_frequency: Rate = Field(description="carrier frequency (Hz)")
    dead_time: DeadTime | None = Field(default=None, description="dead time (s); default 0")
    max_current: PhaseCurrent | None = Field(
        default=None, description="largest phase current (A); kind peak (default) or rms"
    )
    coolant_temperature: Temperature | None = Field(
        default=None,
        description=(
            "temperature that thermal_resistance refers to (degC, also without a unit); default 25"
        ),
    )
    capacitor_esr: OnResistance | None = Field(
        default=None,
        description=(
            "series resistance of the DC-link capacitor (Ohm) for loss maps and missions; default 0"
        ),
    )
    neutral_inductance: ChokeInductance | None = Field(
        default=None, description="choke in the neutral of four legs (H); default: none"
    )
    neutral_resistance: OnResistance | None = Field(
        default=None,
        description="conductor and choke of the neutral (Ohm) for its copper loss; default 0",
    )
    midpoint_capacitance: Capacitance | None = Field(
        default=None,
        description="both halves of a split link together, C_1 + C_2 (F), for split-capacitor",
    )
    device: DeviceEntry | None = Field(
        default=None,
        description=(
            "the switch, needed for losses: its constants, or a file or name of the library"
        ),
    )
    current_sensing: CurrentSensingSection | None = Field(
        default=None,
        description="how the phase currents are measured, for firmware that counts in integers",
    )


_DEFAULT_JUNCTION = 175.0  # degC, usual for the power modules of today


_DEFAULT_GUESS = 100.0  # degC, between a warm heat sink and the limit


_PATH: KeyPath = ("inverter", "device")


def read_inverter_device(
    section: InverterSection, i_max: float, reading: Reading
) -> tuple[SwitchDevice | None, DeviceModel | None]:
    """Constants of the switch for the loss budget, and its tables where the design names some.

    Args:
        section: The inverter of the design file.
        i_max: Current limit of the drive in A (peak), where the tables are made constants unless
            the file says otherwise.
        reading: The design in the course of being read.

    Raises:
        InputError: The device file or the name is wrong, or the thermal resistance is known
            nowhere; with a position.
    """
    if section.device is None:
        return None, None
    if isinstance(section.device, DeviceSection):
        return _constants(section.device, reading), None
    reference = section.device
    model = reading.recalled(
        (_PATH, reference.file, reference.name), lambda: _model(reference, reading)
    )
    for finding in model.findings:
        reading.remarks.append(f"inverter.device ({model.name}): {finding}")
    guess = si_of(reference.junction_temperature)
    temperature = _DEFAULT_GUESS if guess is None else guess
    if reference.reference_current is not None:
        current = reading.peak(reference.reference_current, "inverter.device.reference_current")
    else:
        current = i_max
    with reading.document.at(_PATH, key=True):
        device = model.switch_device(
            current, section.v_dc.si, temperature, si_of(reference.thermal_resistance)
        )
    _remark(model, device, temperature, reading)
    if reference.thermal_resistance is None:
        value = format_quantity(device.thermal_resistance, "K/W")
        reach = "heat sink" if model.case_resistance else "case alone"
        reading.remarks.append(
            f"inverter.device.thermal_resistance is {value} by its data, from junction to {reach}"
        )
    return device, model


def _model(reference: DeviceReference, reading: Reading) -> DeviceModel:
    """Tables of the file or the device of the library."""
    # The readers are needed for devices with tables only; a design with constants
    # starts faster without them.
    document = reading.document
    if (reference.file is None) == (reference.name is None):
        message = "inverter.device: write either file or name"
        raise document.error(message, _PATH, key=True)
    if reference.name is not None:
        from dqforge.machines.devices import catalogue as device_catalogue

        with document.at((*_PATH, "name")):
            content = device_catalogue.read_text(reference.name)
        reading.files.append(content)
        reading.names.append("")  # it comes with the package
        return device_catalogue.load(reference.name)
    from dqforge.machines.devices.files import MAX_BYTES, read_device

    name = reference.file or ""
    content = reading.read_beside(name, (*_PATH, "file"), MAX_BYTES)
    try:
        return read_device(content, name)
    except InputError as error:
        if error.line is not None:
            raise
        raise document.error(
            f"inverter.device: {name}: {error.message}", (*_PATH, "file")
        ) from None


def _remark(model: DeviceModel, device: SwitchDevice, temperature: float, reading: Reading) -> None:
    """Say where the tables were made constants, and where they do not reach."""
    point = (
        f"{format_quantity(device.reference_current, 'A')}, "
        f"{format_quantity(device.reference_voltage, 'V')} and {temperature:g} degC"
    )
    reading.remarks.append(
        f"inverter.device: the tables of {model.name} are made constants at {point}: "
        f"on resistance {format_quantity(device.on_resistance, 'Ohm')} at 25 degC, "
        f"switching energy {format_quantity(device.switching_energy, 'J')} in all"
    )
    lookups = {
        "on-state voltage": model.on_voltage(device.reference_current, temperature),
        "turn-on energy": model.turn_on_energy(
            device.reference_current, device.reference_voltage, temperature
        ),
        "turn-off energy": model.turn_off_energy(
            device.reference_current, device.reference_voltage, temperature
        ),
        "recovery energy": model.recovery_energy(
            device.reference_current, device.reference_voltage, temperature
        ),
    }
    beyond = [name for name, found in lookups.items() if bool(found.outside)]
    if beyond:
        reading.remarks.append(
            f"inverter.device: {point} lie outside the tables of {', '.join(beyond)}"
        )
    if model.blocking_voltage is not None and device.reference_voltage > model.blocking_voltage:
        raise reading.document.error(
            f"inverter.v_dc {format_quantity(device.reference_voltage, 'V')} is above the "
            f"{model.blocking_voltage:g} V that {model.name} blocks; lower it, or take another "
            "device",
            ("inverter", "v_dc"),
        )


def _constants(section: DeviceSection, reading: Reading) -> SwitchDevice:
    """Constants of the design file."""
    if section.on_resistance_temperature_coefficient is None:
        reading.remarks.append(
            "inverter.device.on_resistance is taken as independent of temperature"
        )
    if section.max_junction_temperature is None:
        reading.remarks.append(
            f"inverter.device.max_junction_temperature is {_DEFAULT_JUNCTION:g} degC"
        )
    diode = (section.diode_voltage, section.diode_resistance)
    if section.kind == "igbt" and not any(entry is not None and entry.si > 0.0 for entry in diode):
        message = (
            "inverter.device: an IGBT conducts backwards through its diode; write diode_voltage: "
            "1.2 V"
        )
        raise reading.document.error(
            message, (*_PATH, "diode_voltage" if diode[0] is not None else "kind")
        )
    hottest = si_of(section.max_junction_temperature)
    return SwitchDevice(
        kind=section.kind,
        on_resistance=section.on_resistance.si,
        turn_on_energy=section.turn_on_energy.si,
        turn_off_energy=section.turn_off_energy.si,
        reference_current=section.reference_current.si,
        reference_voltage=section.reference_voltage.si,
        thermal_resistance=section.thermal_resistance.si,
        reverse_recovery_energy=si_of(section.reverse_recovery_energy) or 0.0,
        on_resistance_temperature_coefficient=si_of(section.on_resistance_temperature_coefficient)
        or 0.0,
        on_voltage=si_of(section.on_voltage) or 0.0,
        diode_voltage=si_of(section.diode_voltage) or 0.0,
        diode_resistance=si_of(section.diode_resistance) or 0.0,
        max_junction_temperature=_DEFAULT_JUNCTION if hottest is None else hottest,
    )


def check_inverter(section: InverterSection, document: YamlDocument) -> None:
    """Check the dead time against the switching frequency, and the current measurement; raises
    `InputError` with a position.
    """
    f_sw, dead_time = section.switching_frequency.si, section.dead_time
    if dead_time is not None and dead_time.si >= 0.5 / f_sw:
        raise document.error(
            f"inverter.dead_time {dead_time.text} is not shorter than half a switching period, "
            f"{format_quantity(0.5 / f_sw, 's')}; check both units",
            ("inverter", "dead_time"),
        )
    check_current_sensing(section.current_sensing, document)


@about("inverter")
def read_inverter(section: InverterSection, machine_limit: float, reading: Reading) -> Inverter:
    """Inverter in SI units.

    The machine's current limit in A (peak) is where tables of a device are made constants.
    """
    limit = section.max_current
    coolant = si_of(section.coolant_temperature)
    i_max = None if limit is None else reading.peak(limit, "inverter.max_current")
    largest = machine_limit if i_max is None else min(machine_limit, i_max)
    device, model = read_inverter_device(section, largest, reading)
    return Inverter(
        v_dc=section.v_dc.si,
        f_sw=section.switching_frequency.si,
        device=device,
        coolant_temperature=DEFAULT_COOLANT if coolant is None else coolant,
        dead_time=si_of(section.dead_time) or 0.0,
        i_max=i_max,
        topology=section.topology,
        device_model=model,
        capacitor_esr=si_of(section.capacitor_esr) or 0.0,
        neutral_inductance=si_of(section.neutral_inductance) or 0.0,
        neutral_resistance=si_of(section.neutral_resistance) or 0.0,
        midpoint_capacitance=si_of(section.midpoint_capacitance),
        current_sensing=read_current_sensing(section.current_sensing),
    )


DEFAULT_COOLANT = 25.0


# The current measurement of the inverter in a design file.


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
