"""The devices that ship with the package, typed from public data sheets."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from dqforge.machines.devices.inverter import (
    Curve,
    DeviceKind,
    DeviceModel,
    EnergyTable,
    Family,
    exponent_of,
    line,
)
from dqforge.machines.devices.sections import DeviceFile, EnergySection, OnState, ThermalSection
from dqforge.machines.devices.thermal_network import FosterNetwork
from dqforge.machines.entries.former_keys import read_model
from dqforge.machines.entries.kinds import quantities
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.errors import InputError, KeyPath, dotted, shown
from dqforge.machines.files.library_files import LibraryFiles
from dqforge.machines.files.positioned_yaml import YamlDocument, parse_yaml
from dqforge.machines.records import dataclass

_FILES = LibraryFiles("device", "devices")


def names() -> list[str]:
    """Names of the devices in the library, in alphabetical order."""
    return _FILES.names()


def read_text(name: str) -> bytes:
    """Bytes of a device in the library; raises `InputError` when there is none of this name."""
    return _FILES.read(name)


def load(name: str) -> DeviceModel:
    """Device from the library; raises `InputError` when there is none of this name."""
    return read_device_yaml(read_text(name), _FILES.source(name))


# Devices in the JSON files of transistordatabase (N. Foerster et al., Paderborn University).
#
# Energies in J, currents in A, temperatures in degC. The capacities of the Foster network are not
# read: in published files they hold r/tau instead of tau/r.

_GATE = 15.0


_HOTTEST = 175.0


_TOLERANCE = 0.25


def read_transistordatabase(content: bytes, source: str) -> DeviceModel:
    """Device in a JSON file of transistordatabase.

    Energies are those of type ``graph_i_e``, else ``single``; of several gate resistances those
    with the most temperatures are read, and ``graph_r_e`` tells the influence of the gate
    resistance where it agrees with them to 25 %. Channels are those at the gate voltage nearest to
    15 V, of the diode nearest to -15 V.

    Args:
        content: Bytes of the file, UTF-8.
        source: Its name, for messages.

    Raises:
        InputError: The file is no such JSON, lacks data, or has data that no device has; with the
            path of the first fault.
    """
    return _Reader(Node(parsed(content, source), "", source)).device()


class _Reader:
    """One device in the making."""

    def __init__(self, root: Node) -> None:
        self.root = root
        self.findings: list[str] = []
        self.kind = self.device_kind()
        self.rating = root["i_abs_max"].optional() or root["i_cont"].optional()

    def device_kind(self) -> DeviceKind:
        """MOSFET or IGBT; GaN transistors conduct like the former."""
        node = self.root["type"]
        name = node.text().upper()
        if "IGBT" in name:
            return "igbt"
        if "MOSFET" in name or "GAN" in name:
            return "mosfet"
        raise node.place.fault(
            f"{shown(node.value)[:60]} is no switch; write IGBT, MOSFET, SiC-MOSFET or "
            "GaN-Transistor"
        )

    def device(self) -> DeviceModel:
        """The device."""
        root = self.root
        switch, diode = root["switch"], root["diode"]
        conduction = self.channel(switch["channel"], _GATE)
        if conduction is None:
            raise switch["channel"].place.fault(
                "no on-state curve; write entries with t_j, v_g and graph_v_i"
            )
        reverse = None if diode.value is None else self.channel(diode["channel"], -_GATE)
        if reverse is None:
            if self.kind == "igbt":
                message = "no data for the diode; write entries with t_j and graph_v_i"
                raise Place(root.source, "diode.channel").fault(message)
            self.findings.append("no data for the diode")
        turn_on, turn_off = (
            self.needed(switch["e_on"], "turn_on"),
            self.needed(switch["e_off"], "turn_off"),
        )
        recovery = None if diode.value is None else self.energies(diode["e_rr"], "recovery")
        if recovery is None:
            self.findings.append(
                "no recovery energy of the diode; it is taken as part of the turn-on energy"
            )
        case = sum(root[key].optional() or 0.0 for key in ("r_th_cs", "r_th_switch_cs"))
        with root.place.named():
            return DeviceModel(
                name=" ".join(root["name"].text().split())[:80] or "device",
                kind=self.kind,
                conduction=conduction,
                turn_on=turn_on,
                turn_off=turn_off,
                recovery=recovery,
                diode=reverse,
                thermal=self.thermal(switch["thermal_foster"]),
                diode_thermal=None
                if diode.value is None
                else self.thermal(diode["thermal_foster"]),
                case_resistance=case or None,
                max_junction_temperature=self.hottest(switch["t_j_max"]),
                blocking_voltage=root["v_abs_max"].optional(),
                max_current=self.rating,
                findings=tuple(self.findings),
            )

    def hottest(self, node: Node) -> float:
        """Largest junction temperature."""
        given = node.optional()
        return _HOTTEST if given is None else checked_temperature(given, node.place)

    def channel(self, entries: Node, gate: float) -> Family | None:
        """On-state voltages at the gate voltage nearest to the one given.

        None if there are none.
        """
        nearest: dict[float, tuple[float, Node]] = {}
        for entry in entries:
            temperature, v_g = self.temperature(entry), entry["v_g"].optional()
            distance = abs((gate if v_g is None else v_g) - gate)
            if temperature not in nearest or distance < nearest[temperature][0]:
                nearest[temperature] = distance, entry["graph_v_i"]
        if not nearest:
            return None
        # Curves of weak gates saturate, where digitised currents run back and forth:
        # only those used are checked.
        temperatures = tuple(sorted(nearest))
        return Family(temperatures, tuple(self.drop(nearest[t][1]) for t in temperatures))

    def drop(self, node: Node) -> Curve:
        """On-state voltage over current of one curve, which the file has the other way round."""
        drops, currents = node.pair()
        # Up to the threshold the current is zero at several voltages: the last of them counts.
        zeros = sum(1 for _ in itertools.takewhile(lambda current: current == 0.0, currents))
        first = min(max(zeros - 1, 0), len(currents) - 1)
        return checked_drop(currents[first:], drops[first:], self.rating, node.place)

    def needed(self, entries: Node, event: str) -> EnergyTable:
        """Energies over current; raises `InputError` if there are none."""
        table = self.energies(entries, event)
        if table is None:
            raise entries.place.fault(
                "no switching energies; write entries with v_supply, t_j and graph_i_e"
            )
        return table

    def energies(self, entries: Node, event: str) -> EnergyTable | None:
        """Energies over current; None if there are none."""
        graphs, singles = _entries(entries, "graph_i_e"), _entries(entries, "single")
        tables: dict[tuple[float, float | None], dict[float, Curve]] = {}
        for entry in graphs or singles:
            voltage, temperature = self.voltage(entry), self.temperature(entry)
            if graphs:
                place, (currents, values) = entry["graph_i_e"].place, entry["graph_i_e"].pair()
            else:
                place, (current, value) = (
                    entry.place,
                    (entry["i_x"].number(), entry["e_x"].number()),
                )
                currents, values = (0.0, current), (0.0, value)
            curve = checked_energies(currents, values, voltage, self.rating, place)
            tables.setdefault((voltage, entry["r_g"].optional()), {}).setdefault(temperature, curve)
        if not tables:
            return None
        (_, r_g), _ = max(tables.items(), key=lambda item: len(item[1]))
        left_out = {other for _, other in tables if other != r_g}
        if left_out:
            self.findings.append(
                f"{entries.path}: read at r_g = {r_g} Ohm, the other gate resistances are ignored"
            )
        kept = {voltage: found for (voltage, other), found in tables.items() if other == r_g}
        voltages = tuple(sorted(kept))
        families = tuple(
            Family(
                tuple(sorted(kept[voltage])), tuple(kept[voltage][t] for t in sorted(kept[voltage]))
            )
            for voltage in voltages
        )
        table = EnergyTable(voltages, families, exponent_of(self.kind, event), r_g)
        gate = None if r_g is None else self.gate(entries, table, r_g)
        return EnergyTable(voltages, families, table.exponent, r_g, gate)

    def gate(self, entries: Node, table: EnergyTable, r_g: float) -> Family | None:
        """Energies over gate resistance that agree with those over current.

        None if there are none.
        """
        found: dict[float, Curve] = {}
        for entry in _entries(entries, "graph_r_e"):
            node = entry["graph_r_e"]
            resistances, values = node.pair()
            voltage, temperature = self.voltage(entry), self.temperature(entry)
            current = entry["i_x"].optional()
            for k, energy in enumerate(values):
                if energy <= 0.0:
                    raise node.place.fault(f"energy {k} is {energy:g} J; write a positive number")
            with node.place.named():
                curve = Curve(resistances, values)
            expected = None if current is None else table.at(current, voltage, temperature)
            here = float(curve.at(np.asarray(r_g), "hold"))
            if (
                expected is None
                or bool(expected.outside)
                or abs(here / float(expected.value) - 1.0) > _TOLERANCE
            ):
                self.findings.append(
                    f"{node.path} does not agree with the energies over current and is ignored"
                )
                continue
            found.setdefault(temperature, curve)
        if not found:
            return None
        return Family(tuple(sorted(found)), tuple(found[t] for t in sorted(found)), "hold")

    def voltage(self, entry: Node) -> float:
        """Reference voltage of an entry."""
        node = entry["v_supply"]
        if node.value is None:
            raise entry.place.fault("the reference voltage is missing; write v_supply, such as 600")
        return checked_voltage(node.number(), node.place)

    def temperature(self, entry: Node) -> float:
        """Junction temperature of an entry."""
        return checked_temperature(entry["t_j"].number(), entry["t_j"].place)

    def thermal(self, node: Node) -> FosterNetwork | None:
        """Foster network by its vectors, or its total; None if there is none."""
        if node.value is None:
            return None
        parts, times = list(node["r_th_vector"]), list(node["tau_vector"])
        total = node["r_th_total"].optional()
        if not parts:
            if not total:
                return None
            constant = node["tau_total"].optional() or 0.0
            with node.place.named():
                return FosterNetwork(
                    (checked_thermal(total, node["r_th_total"].place),), (constant,)
                )
        resistances = tuple(checked_thermal(part.number(), part.place) for part in parts)
        if total and abs(sum(resistances) / total - 1.0) > _TOLERANCE:
            self.findings.append(
                f"{node.path}: the parts make {sum(resistances):g} K/W, r_th_total is {total:g}; "
                "the parts are used"
            )
        with node.place.named():
            return FosterNetwork(resistances, tuple(part.number() for part in times))


def _entries(entries: Node, kind: str) -> list[Node]:
    """Entries of one type of data."""
    found = []
    for entry in entries:
        given = entry["dataset_type"]
        if given.value not in ("graph_i_e", "graph_r_e", "single"):
            raise given.place.fault(
                f"{shown(given.value)[:60]} is not known; write graph_i_e, graph_r_e or single"
            )
        if given.value == kind:
            found.append(entry)
    return found


# Devices in the YAML of the library: typed from data sheets, each value with its source.


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


# Checks that all readers of device data share: units that were mixed up,
# and points that no device has.

_KELVIN = 230.0


_COLDEST = -80.0


_LARGEST_CURRENT = 2e4


_RATIO = 50.0


_HIGHEST_DROP = 50.0


# Share of its largest value by which a digitised curve may fall.
_JITTER = 0.05


_SLOWEST = 2e-6


_SLOWEST_HIGH = 1e-5


_HIGH = 1000.0


_LARGEST_RESISTANCE = 20.0


@dataclass(frozen=True, slots=True)
class Place:
    """A part of a device file: what it is called in messages, and its line where one is known."""

    source: str
    path: str
    line: int | None = None

    def fault(self, message: str) -> InputError:
        """Error that names this part."""
        return InputError(
            f"{self.path}: {message}" if self.path else message, source=self.source, line=self.line
        )

    @contextmanager
    def named(self) -> Iterator[None]:
        """Give the place to each `InputError` without one that the block raises."""
        try:
            yield
        except InputError as error:
            if error.source is not None:
                raise
            raise self.fault(error.message) from None


def checked_temperature(value: float, place: Place) -> float:
    """Junction temperature in degC, unless it looks like kelvin."""
    if value > _KELVIN:
        raise place.fault(
            f"{value:g} looks like kelvin; write degrees Celsius, {value - 273.15:.4g}"
        )
    if value < _COLDEST:
        raise place.fault(
            f"{value:g} degC is colder than any junction; write degrees Celsius, such as 25"
        )
    return value


def checked_voltage(value: float, place: Place) -> float:
    """Reference voltage in V of energies."""
    if not 1.0 <= value <= 2e4:
        raise place.fault(
            f"the reference voltage {value:g} V is outside 1 V to 20 kV; write volts, such as 600"
        )
    return value


def _checked_currents(currents: tuple[float, ...], rating: float | None, place: Place) -> None:
    """Refuse currents that look like mA, or like kA."""
    largest = max(currents)
    if largest > _LARGEST_CURRENT or (rating is not None and largest > _RATIO * rating):
        raise place.fault(
            f"currents up to {largest:g} A look like mA; write amperes, {largest / 1e3:g}"
        )
    if rating is not None and 0.0 < largest < rating / (10.0 * _RATIO):
        raise place.fault(
            f"currents up to {largest:g} A look like kA for a device of {rating:g} A; write amperes"
        )


def checked_energies(
    currents: tuple[float, ...],
    energies: tuple[float, ...],
    voltage: float,
    rating: float | None,
    place: Place,
) -> Curve:
    """Curve of energies in J over currents in A, at a voltage in V.

    `rating` is the current of the device, or None.
    """
    for k, energy in enumerate(energies):
        if energy < 0.0:
            raise place.fault(
                f"energy {k} is negative, {energy:g} J; write what the device loses, as a positive "
                "number"
            )
    with place.named():
        curve = Curve(currents, energies)
    _checked_currents(currents, rating, place)
    # Switching takes nanoseconds to a few microseconds: E = v i t / 2 and the like.
    time = energies[-1] / (voltage * currents[-1]) if currents[-1] > 0.0 else 0.0
    limit = _SLOWEST if voltage <= _HIGH else _SLOWEST_HIGH
    if time > limit:
        unit, factor = ("mJ", 1e-3) if time * 1e-3 <= limit else ("uJ", 1e-6)
        raise place.fault(
            f"{energies[-1]:g} J at {currents[-1]:g} A and {voltage:g} V look like {unit}; "
            f"write joules, {energies[-1] * factor:g}"
        )
    return curve


def checked_drop(
    currents: tuple[float, ...], drops: tuple[float, ...], rating: float | None, place: Place
) -> Curve:
    """Curve of on-state voltages in V over currents in A.

    `rating` is the current of the device, or None.
    """
    with place.named():
        curve = Curve(currents, drops)
    _checked_currents(currents, rating, place)
    if max(drops) > _HIGHEST_DROP:
        raise place.fault(
            f"a drop of {max(drops):g} V looks like mV; write volts, {max(drops) / 1e3:g}"
        )
    highest = 0.0
    for k, drop in enumerate(drops):
        if drop < highest - _JITTER * max(drops):
            raise place.fault(
                f"the drop {k} falls to {drop:g} V from {highest:g} V while the current rises to "
                f"{currents[k]:g} A; write the points of one curve in ascending order"
            )
        highest = max(highest, drop)
    return curve


def checked_thermal(resistance: float, place: Place) -> float:
    """Thermal resistance of an element in K/W."""
    if not 0.0 < resistance <= _LARGEST_RESISTANCE:
        message = (
            f"{resistance:g} K/W is no resistance of a power device to its case; write K/W, such "
            "as 0.1"
        )
        raise place.fault(message)
    return resistance


# JSON of others: values with their paths, so that each complaint names its place.

_MOST_ENTRIES = 200


_MOST_POINTS = 2000


class Node:
    """A value of the file with its path."""

    __slots__ = ("path", "source", "value")

    def __init__(self, value: Any, path: str, source: str) -> None:
        self.value, self.path, self.source = value, path, source

    @property
    def place(self) -> Place:
        """Where the value stands."""
        return Place(self.source, self.path or "the file")

    def __getitem__(self, key: str) -> Node:
        """Value of a key, None where there is none; raises `InputError` if this is no object."""
        if not isinstance(self.value, dict):
            raise self.place.fault(f"expected an object with keys such as '{key}'; write {{...}}")
        return Node(self.value.get(key), f"{self.path}.{key}" if self.path else key, self.source)

    def __iter__(self) -> Iterator[Node]:
        """Entries of a list; none of null."""
        if self.value is None:
            return iter(())
        if not isinstance(self.value, list):
            raise self.place.fault("expected a list; write [...]")
        if len(self.value) > _MOST_ENTRIES:
            raise self.place.fault(
                f"the list has {len(self.value)} entries; write at most {_MOST_ENTRIES}"
            )
        return iter(
            [Node(part, f"{self.path}[{k}]", self.source) for k, part in enumerate(self.value)]
        )

    def number(self) -> float:
        """Finite number; raises `InputError` if this is none."""
        found = self.optional()
        if found is None:
            raise self.place.fault("the number is missing; write it")
        return found

    def optional(self) -> float | None:
        """Finite number, or None for null."""
        value = self.value
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.place.fault(
                f"{shown(value)[:60]} is not a number; write one without quotes and units"
            )
        try:
            found = float(value)
        except OverflowError:
            found = math.inf
        if not math.isfinite(found):
            raise self.place.fault(f"{found} is not finite; write a number, or remove the point")
        return found

    def pair(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Two lists of numbers of equal length."""
        if not (
            isinstance(self.value, list)
            and len(self.value) == 2
            and all(isinstance(r, list) for r in self.value)
        ):
            raise self.place.fault("expected two lists; write [[x0, x1, ...], [y0, y1, ...]]")
        left, right = self.value
        if not left or len(left) != len(right):
            raise self.place.fault(
                f"the lists have {len(left)} and {len(right)} numbers; write as many of both"
            )
        if len(left) > _MOST_POINTS:
            raise self.place.fault(
                f"the curve has {len(left)} points; write at most {_MOST_POINTS}"
            )
        rows = [
            tuple(
                Node(part, f"{self.path}[{k}][{j}]", self.source).number()
                for j, part in enumerate(row)
            )
            for k, row in enumerate(self.value)
        ]
        return rows[0], rows[1]

    def text(self) -> str:
        """Short text, '' for anything else."""
        return self.value if isinstance(self.value, str) else ""


def parsed(content: bytes, source: str) -> Any:
    """Content of a JSON file, not-finite numbers included.

    Raises `InputError` with a position if it is none.
    """
    try:
        return json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        message = f"byte {error.start} is not UTF-8; save the file with the encoding UTF-8"
        raise InputError(message, source=source) from None
    except json.JSONDecodeError as error:
        message = f"not JSON: {error.msg}; export the device again"
        raise InputError(message, source=source, line=error.lineno, column=error.colno) from None
    except RecursionError:
        raise InputError(
            "not a device: nested too deeply; export the device again", source=source
        ) from None
    except ValueError:
        raise InputError("a number has too many digits; write at most 17", source=source) from None
