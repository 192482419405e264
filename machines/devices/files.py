"""Device data from files: transistordatabase (JSON), PLECS (XML), and the YAML of the library."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import PurePath

from dqforge.machines.devices.catalogue import (
    Place,
    checked_drop,
    checked_energies,
    checked_temperature,
    checked_thermal,
    checked_voltage,
)
from dqforge.machines.devices.inverter import (
    Curve,
    DeviceKind,
    DeviceModel,
    EnergyTable,
    Family,
    exponent_of,
)
from dqforge.machines.devices.thermal_network import CauerNetwork, FosterNetwork, ThermalNetwork
from dqforge.machines.errors import InputError, shown
from dqforge.machines.files.positioned_xml import Element, parsed

MAX_BYTES = 5_000_000


def read_device(content: bytes, source: str) -> DeviceModel:
    """Device in the bytes of a file.

    Args:
        content: Bytes of the file, at most 5 MB.
        source:
            Its name; the suffix chooses the format: .json (transistordatabase), .xml (PLECS),
            .yaml or .yml (dqforge).

    Raises:
        InputError: The file is none of its format or its data are not sound; with the file and the
            place in it.
    """
    if len(content) > MAX_BYTES:
        message = (
            f"the file has more than {MAX_BYTES // 1_000_000} MB, devices have a few hundred kB"
        )
        raise InputError(f"{message}; export one device alone", source=source)
    suffix = PurePath(source).suffix.lower()
    # Each reader brings libraries that the others do not need.
    if suffix == ".json":
        from dqforge.machines.devices.catalogue import read_transistordatabase

        return read_transistordatabase(content, source)
    if suffix == ".xml":
        return read_plecs(content, source)
    if suffix in (".yaml", ".yml"):
        from dqforge.machines.devices.catalogue import read_device_yaml

        return read_device_yaml(content, source)
    message = f"cannot read a device from a file with the suffix {suffix!r}"
    raise InputError(
        f"{message}; write .json (transistordatabase), .xml (PLECS) or .yaml", source=source
    )


# Devices in the thermal descriptions of PLECS (XML), as makers of semiconductors publish them.
#
# Format: PLECS User Manual, "Thermal Modeling" (Plexim),
# https://docs.plexim.com/plecs/latest/thermal-modeling/. Losses of the transistor stand at positive
# current; in descriptions "with Diode" those of the diode at negative current.

_CLASSES: dict[str, tuple[DeviceKind, bool]] = {
    "mosfet": ("mosfet", False),
    "mosfet with diode": ("mosfet", True),
    "igbt": ("igbt", False),
    "igbt with diode": ("igbt", True),
}


_METHODS = ("table only", "table and formula")


_MOST_AXIS = 500


def read_plecs(content: bytes, source: str) -> DeviceModel:
    """Device in a thermal description of PLECS.

    A formula beside a table is not evaluated, which is said among the findings;
    alone it is refused.

    Args:
        content: Bytes of the file.
        source: Its name, for messages.

    Raises:
        InputError: The file is no such description, has a document type, lacks data, or has data
            that no device has; with the line.
    """
    return _Reader(parsed(content, source), source).device()


class _Reader:
    """One device in the making."""

    def __init__(self, root: Element, source: str) -> None:
        self.source = source
        self.findings: list[str] = []
        if root.tag != "SemiconductorLibrary":
            raise self.at(root).fault(
                "this is no PLECS description; its first element is SemiconductorLibrary"
            )
        self.package = self.only(root, "Package")
        self.data = self.only(self.package, "SemiconductorData")
        name = (
            self.data.attributes.get("type") or self.package.attributes.get("class") or ""
        ).strip()
        if name.lower() not in _CLASSES:
            raise self.at(self.data).fault(
                f"the type {shown(name)[:60]} is no switch; write MOSFET, MOSFET with Diode, IGBT "
                "or IGBT with Diode"
            )
        self.kind, self.with_diode = _CLASSES[name.lower()]

    def at(self, element: Element) -> Place:
        """Where an element stands."""
        return Place(self.source, element.path, element.line)

    def only(self, parent: Element, tag: str) -> Element:
        """The one child of a name."""
        found = parent.children_named(tag)
        if len(found) != 1:
            message = f"{len(found) or 'no'} element {tag} found, one is needed; write one"
            raise self.at(found[1] if found else parent).fault(message)
        return found[0]

    def device(self) -> DeviceModel:
        """The device."""
        on_state = self.conduction(1.0)
        if on_state is None:
            raise self.at(self.data).fault(
                "no on-state voltages; write ConductionLoss with positive currents"
            )
        diode = self.conduction(-1.0)
        if diode is None:
            if self.kind == "igbt":
                message = (
                    "no data for the diode; write IGBT with Diode and its losses at negative "
                    "currents"
                )
                raise self.at(self.data).fault(message)
            self.findings.append("no data for the diode")
        turn_on, turn_off = (
            self.needed("TurnOnLoss", "turn_on"),
            self.needed("TurnOffLoss", "turn_off"),
        )
        recovery = self.energies("TurnOffLoss", "recovery", -1.0)
        if recovery is None:
            self.findings.append(
                "no recovery energy of the diode; it is taken as part of the turn-on energy"
            )
        parts = (
            self.package.attributes.get("vendor", ""),
            self.package.attributes.get("partnumber", ""),
        )
        network = self.thermal()
        with self.at(self.package).named():
            return DeviceModel(
                name=" ".join(" ".join(parts).split())[:80] or "device",
                kind=self.kind,
                conduction=on_state,
                turn_on=turn_on,
                turn_off=turn_off,
                recovery=recovery,
                diode=diode,
                thermal=network,
                diode_thermal=network if self.with_diode else None,
                findings=tuple(self.findings),
            )

    def needed(self, tag: str, event: str) -> EnergyTable:
        """Energies of the transistor; raises `InputError` if there are none."""
        found = self.energies(tag, event, 1.0)
        if found is None:
            raise self.at(self.data).fault(
                f"no switching energies; write {tag} with positive currents and voltages"
            )
        return found

    def numbers(self, element: Element) -> tuple[float, ...]:
        """Finite numbers of a text."""
        words = element.text.split()
        if not words or len(words) > _MOST_AXIS:
            raise self.at(element).fault(f"{len(words)} numbers; write 1 to {_MOST_AXIS}")
        found = []
        for word in words:
            try:
                value = float(word)
            except ValueError:
                raise self.at(element).fault(
                    f"{shown(word)[:40]} is not a number; write one"
                ) from None
            if not math.isfinite(value):
                raise self.at(element).fault(f"{word[:40]} is not finite; write a number")
            found.append(value)
        return tuple(found)

    def axis(self, parent: Element, tag: str) -> tuple[Element, tuple[float, ...]]:
        """Axis of a table, ascending."""
        element = self.only(parent, tag)
        values = self.numbers(element)
        for left, right in pairwise(values):
            if not right > left:
                raise self.at(element).fault(
                    f"{right:g} stands behind {left:g}; write ascending values, each once"
                )
        return element, values

    def check_method(self, element: Element) -> None:
        """Refuse losses without a table; say so where a formula beside it is left out."""
        methods = element.children_named("ComputationMethod")
        method = methods[0].text.strip().lower() if methods else _METHODS[0]
        if method not in _METHODS:
            raise self.at(element).fault(
                f"the losses are given as {shown(method)[:40]}; export them as 'Table only'"
            )
        formulas = [part.text.strip() for part in element.children_named("Formula")]
        if method == _METHODS[1] and formulas and formulas[0] not in ("", "E", "v"):
            finding = (
                f"{element.path}: the formula {shown(formulas[0])[:80]} is ignored, the table is "
                "used as it is"
            )
            if finding not in self.findings:
                self.findings.append(finding)

    def scaled(self, element: Element) -> float:
        """Factor of a table."""
        text = element.attributes.get("scale", "1")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise self.at(element).fault(
                f"the scale {shown(text)[:40]} is no positive number; write 1 or 0.001"
            )
        return value

    def rows(self, parent: Element, tag: str, count: int, axis: str) -> list[Element]:
        """Children of a table, as many as its axis has values."""
        found = parent.children_named(tag)
        if len(found) != count:
            raise self.at(parent).fault(
                f"{len(found)} elements {tag} for {count} values of {axis}; write as many"
            )
        return found

    def row(self, element: Element, currents: tuple[float, ...], scale: float) -> tuple[float, ...]:
        """Values over the current axis."""
        values = self.numbers(element)
        if len(values) != len(currents):
            raise self.at(element).fault(
                f"{len(values)} values for {len(currents)} currents; write as many"
            )
        return tuple(value * scale for value in values)

    def temperatures(self, parent: Element) -> tuple[float, ...]:
        """Axis of junction temperatures in degC."""
        element, values = self.axis(parent, "TemperatureAxis")
        return tuple(checked_temperature(value, self.at(element)) for value in values)

    def conduction(self, sign: float) -> Family | None:
        """On-state voltages at currents of one sign; None if there are none.

        Of several tables those for a gate that is on belong to the transistor,
        those for off to the diode.
        """
        gate = "on" if sign > 0.0 else "off"
        elements = self.data.children_named("ConductionLoss")
        chosen = [
            part for part in elements if part.attributes.get("gate", gate).lower() in (gate, "both")
        ]
        if not chosen:
            return None
        if len(chosen) > 1:
            raise self.at(chosen[1]).fault(
                'a second table of on-state voltages; write gate="on" or gate="off"'
            )
        element = chosen[0]
        self.check_method(element)
        _, currents = self.axis(element, "CurrentAxis")
        kept = _half(currents, sign)
        if not kept:
            return None
        temperatures, table = self.temperatures(element), self.only(element, "VoltageDrop")
        scale = self.scaled(table)
        curves = []
        for row in self.rows(table, "Temperature", len(temperatures), "TemperatureAxis"):
            values = self.row(row, currents, scale)
            drops = tuple(sign * values[k] + 0.0 for k in kept)
            curves.append(
                checked_drop(tuple(abs(currents[k]) for k in kept), drops, None, self.at(row))
            )
        return Family(temperatures, tuple(curves))

    def energies(self, tag: str, event: str, sign: float) -> EnergyTable | None:
        """Energies at currents of one sign; None if there are none, or only zeros of the diode."""
        elements = self.data.children_named(tag)
        if not elements:
            return None
        element = self.only(self.data, tag)
        self.check_method(element)
        _, currents = self.axis(element, "CurrentAxis")
        axis, voltages = self.axis(element, "VoltageAxis")
        temperatures, table = self.temperatures(element), self.only(element, "Energy")
        scale, kept = self.scaled(table), _half(currents, sign)
        columns = [k for k, voltage in enumerate(voltages) if voltage > 0.0]
        if not columns:
            raise self.at(axis).fault(
                "the reference voltage is missing; write a positive voltage, such as 600"
            )
        sheets: list[list[Curve]] = [[] for _ in columns]
        for block in self.rows(table, "Temperature", len(temperatures), "TemperatureAxis"):
            lines = self.rows(block, "Voltage", len(voltages), "VoltageAxis")
            for sheet, k in zip(sheets, columns, strict=True):
                values, place = self.row(lines[k], currents, scale), self.at(lines[k])
                voltage = checked_voltage(voltages[k], self.at(axis))
                if kept:
                    energies = tuple(values[j] + 0.0 for j in kept)
                    size = tuple(abs(currents[j]) for j in kept)
                    sheet.append(checked_energies(size, energies, voltage, None, place))
        if not kept or (
            sign < 0.0 and not any(max(curve.y) > 0.0 for sheet in sheets for curve in sheet)
        ):
            return None
        families = tuple(Family(temperatures, tuple(sheet)) for sheet in sheets)
        # Where the table holds a row at 0 V, its reader interpolates: linear in the voltage.
        exponent = 1.0 if 0.0 in voltages else exponent_of(self.kind, event)
        return EnergyTable(tuple(voltages[k] for k in columns), families, exponent)

    def thermal(self) -> ThermalNetwork | None:
        """Network from junction to case; None if there is none."""
        models = self.package.children_named("ThermalModel")
        branches = [branch for model in models for branch in model.children_named("Branch")]
        if not branches:
            self.findings.append("no thermal network")
            return None
        branch = branches[0]
        if len(branches) > 1:
            raise self.at(branches[1]).fault("a second branch of the thermal network; write one")
        kind = branch.attributes.get("type", "").strip().lower()
        if kind not in ("foster", "cauer"):
            raise self.at(branch).fault(
                f"the type {shown(kind)[:40]} is not known; write Foster or Cauer"
            )
        tag, second = ("RTauElement", "Tau") if kind == "foster" else ("RCElement", "C")
        parts = branch.children_named(tag)
        resistances = tuple(
            checked_thermal(self.attribute(part, "R"), self.at(part)) for part in parts
        )
        others = tuple(self.attribute(part, second) for part in parts)
        with self.at(branch).named():
            return (
                FosterNetwork(resistances, others)
                if kind == "foster"
                else CauerNetwork(resistances, others)
            )

    def attribute(self, element: Element, name: str) -> float:
        """Number in an attribute."""
        text = element.attributes.get(name, "")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.at(element).fault(f"{name}={shown(text)[:40]} is not a number; write one")
        return value


def _half(currents: tuple[float, ...], sign: float) -> list[int]:
    """Places of the currents of one sign and zero, from zero outwards.

    None if there is zero alone.
    """
    kept = [k for k, current in enumerate(currents) if current * sign >= 0.0]
    if not any(currents[k] != 0.0 for k in kept):
        return []
    return kept if sign > 0.0 else kept[::-1]
