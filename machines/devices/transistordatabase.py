"""Devices in the JSON files of transistordatabase (N. Foerster et al., Paderborn University).

Energies in J, currents in A, temperatures in degC. The capacities of the Foster network are not
read: in published files they hold r/tau instead of tau/r.
"""

from __future__ import annotations

import itertools

import numpy as np

from dqforge.machines.devices.checks import (
    Place,
    checked_drop,
    checked_energies,
    checked_temperature,
    checked_thermal,
    checked_voltage,
)
from dqforge.machines.devices.curves import Curve, Family
from dqforge.machines.devices.device import DeviceModel, exponent_of
from dqforge.machines.devices.energies import EnergyTable
from dqforge.machines.devices.positioned_json import Node, parsed
from dqforge.machines.devices.switch import DeviceKind
from dqforge.machines.devices.thermal_network import FosterNetwork
from dqforge.machines.wording import shown

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
                f"{entries.path}: read at r_g = {r_g} Ohm, the other gate resistances are left out"
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
                    f"{node.path} does not agree with the energies over current and is left out"
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
