"""Devices in the YAML of the library: typed from data sheets, each value with its source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dqforge.machines.devices.checks import Place, checked_drop, checked_energies
from dqforge.machines.devices.curves import Curve, Family, line
from dqforge.machines.devices.device import DeviceModel, exponent_of
from dqforge.machines.devices.energies import EnergyTable
from dqforge.machines.devices.sections import DeviceFile, EnergySection, OnState, ThermalSection
from dqforge.machines.devices.switch import DeviceKind
from dqforge.machines.devices.thermal_network import FosterNetwork
from dqforge.machines.entries.complaints import read_model
from dqforge.machines.entries.kinds import quantities
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.files.positioned_yaml import YamlDocument, parse_yaml
from dqforge.machines.places import KeyPath, dotted

_HOTTEST = 175.0


def read_device_yaml(content: bytes, source: str) -> DeviceModel:
    """Device in a YAML file of dqforge.

    Args:
        content: Bytes of the file.
        source: Its name, for messages.

    Raises:
        InputError: The file is none, lacks data, or has data that no device has; with the position
            of the first fault.
    """
    document = parse_yaml(content, source)
    sections = read_model(document, DeviceFile)
    rating, hottest = sections.max_current.si, sections.max_junction_temperature
    findings = [
        f"{dotted(path)} is inferred: {value.note or value.source}"
        for path, value in _inferred(sections)
    ]
    if sections.diode is None:
        if sections.kind == "igbt":
            message = (
                "no data for the diode; write diode: [{temperature: 25 degC, threshold: 1 V, "
                "resistance: 3 mOhm}]"
            )
            raise document.error(message, ("kind",))
        findings.append("no data for the diode")
    if sections.recovery is None:
        findings.append(
            "no recovery energy of the diode; it is taken as part of the turn-on energy"
        )
    return DeviceModel(
        name=" ".join(part for part in (sections.manufacturer, sections.name) if part),
        kind=sections.kind,
        conduction=_on_state(sections.on_state, rating, document, ("on_state",)),
        turn_on=_energies(sections.turn_on, sections.kind, rating, document, "turn_on"),
        turn_off=_energies(sections.turn_off, sections.kind, rating, document, "turn_off"),
        recovery=None
        if sections.recovery is None
        else _energies(sections.recovery, sections.kind, rating, document, "recovery"),
        diode=None
        if sections.diode is None
        else _on_state(sections.diode, rating, document, ("diode",)),
        thermal=_thermal(sections.thermal, document, "thermal"),
        diode_thermal=_thermal(sections.diode_thermal, document, "diode_thermal"),
        case_resistance=None if sections.case_resistance is None else sections.case_resistance.si,
        max_junction_temperature=_HOTTEST if hottest is None else hottest.si,
        blocking_voltage=None
        if sections.blocking_voltage is None
        else sections.blocking_voltage.si,
        max_current=rating,
        findings=tuple(findings),
    )


def device_values(content: bytes, source: str) -> tuple[tuple[str, Quantity], ...]:
    """Each quantity of a device file with its path; raises `InputError` like `read_device_yaml`."""
    sections = read_model(parse_yaml(content, source), DeviceFile)
    return tuple((dotted(path), value) for path, value in quantities(sections))


def _inferred(sections: DeviceFile) -> Iterator[tuple[KeyPath, Quantity]]:
    return ((path, value) for path, value in quantities(sections) if value.inferred)


def _family(
    temperatures: Sequence[Quantity],
    curves: Sequence[Curve],
    document: YamlDocument,
    path: KeyPath,
    *,
    hold: bool = False,
) -> Family:
    """Curves at their temperatures.

    Raises `InputError` with a position when these do not ascend.
    """
    with document.at(path, key=True):
        return Family(
            tuple(part.si for part in temperatures), tuple(curves), "hold" if hold else "extend"
        )


def _on_state(
    entries: Sequence[OnState], rating: float, document: YamlDocument, path: KeyPath
) -> Family:
    """On-state voltages at several temperatures."""
    curves = []
    for k, entry in enumerate(entries):
        here = (*path, k)
        if (entry.points is None) == (entry.resistance is None):
            raise document.error(
                f"{dotted(here)}: write either resistance (and threshold) or points", here
            )
        if entry.points is None and entry.resistance is not None:
            curves.append(
                line(rating, entry.threshold.si if entry.threshold else 0.0, entry.resistance.si)
            )
            continue
        with document.at((*here, "points"), key=True):
            points = entry.points or ()
            currents, drops = (
                tuple(p.current.si for p in points),
                tuple(p.voltage.si for p in points),
            )
            curves.append(checked_drop(currents, drops, rating, Place(document.source, "")))
    return _family([entry.temperature for entry in entries], curves, document, path)


def _energies(
    section: EnergySection, kind: DeviceKind, rating: float, document: YamlDocument, event: str
) -> EnergyTable:
    """Energies of one kind of event."""
    curves = []
    for k, entry in enumerate(section.curves):
        with document.at((event, "curves", k, "points"), key=True):
            currents = tuple(point.current.si for point in entry.points)
            energies = tuple(point.energy.si for point in entry.points)
            if len(currents) == 1 and currents[0] > 0.0:
                currents, energies = (0.0, *currents), (0.0, *energies)
            place = Place(document.source, "")
            curves.append(checked_energies(currents, energies, section.voltage.si, rating, place))
    family = _family(
        [entry.temperature for entry in section.curves], curves, document, (event, "curves")
    )
    gate = None
    if section.over_gate_resistance is not None:
        over = section.over_gate_resistance
        found = []
        for k, part in enumerate(over):
            with document.at((event, "over_gate_resistance", k, "points"), key=True):
                found.append(
                    Curve(
                        tuple(p.resistance.si for p in part.points),
                        tuple(p.energy.si for p in part.points),
                    )
                )
        path = (event, "over_gate_resistance")
        gate = _family([part.temperature for part in over], found, document, path, hold=True)
    exponent = (
        exponent_of(kind, event)
        if section.voltage_exponent is None
        else section.voltage_exponent.si
    )
    resistance = None if section.gate_resistance is None else section.gate_resistance.si
    with document.at((event,), key=True):
        return EnergyTable((section.voltage.si,), (family,), exponent, resistance, gate)


def _thermal(
    section: ThermalSection | None, document: YamlDocument, key: str
) -> FosterNetwork | None:
    """Network from junction to case."""
    if section is None:
        return None
    if (section.resistance is None) == (section.foster is None):
        raise document.error(f"{key}: write either resistance or foster", (key,), key=True)
    if section.foster is None and section.resistance is not None:
        return FosterNetwork((section.resistance.si,), (0.0,))
    elements = section.foster or ()
    return FosterNetwork(
        tuple(part.resistance.si for part in elements),
        tuple(part.time_constant.si for part in elements),
    )
