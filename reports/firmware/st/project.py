"""Projects of Workbench 5 (``.stmcx``): variables read, and replaced where they stand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.firmware_method import number
from dqforge.optimizer.firmware.st_keys import WHOLE
from dqforge.optimizer.firmware.st_scales import printed, st_configuration
from dqforge.reports.firmware.c_macros import elements, parsed_xml, with_attribute
from dqforge.reports.firmware.st.names import (
    BEYOND,
    BY_HAND,
    EXECUTION_RATE,
    FIELDS,
    OWN_NAMES,
    POSSIBLE,
    SENSORS,
    STRUCTURE,
    SURFACE,
    TOPOLOGY,
    VARIABLES,
)
from dqforge.reports.firmware.target import plain_number

if TYPE_CHECKING:
    from dqforge.machines.files.positioned_xml import Element

_ROOT = "STWorkBench"


def is_project(text: str) -> bool:
    """Whether a text is a project of Workbench 5."""
    return f"<{_ROOT}" in text[:4000]


def read_project(text: str, place: str) -> Configuration:
    """The configuration of the first motor of a project.

    Raises:
        InputError: It is no XML, has no motor, or a value is impossible; with the line.
    """
    found = _variables(text, place)
    raw: dict[str, OwnValue] = {}
    for name, variable in VARIABLES.items():
        element = found.get(name)
        if element is not None and name not in _unused(found):
            raw[variable.macro] = _value(element, variable.macro, variable.unit, place)
    own = _as_macros(raw)
    rate = found.get(EXECUTION_RATE)
    if rate is not None:
        own["REGULATION_EXECUTION_RATE"] = _chosen(rate, place)
    return st_configuration("", own, version="5", origins=_origins(found, own))


def with_variables(text: str, own: Mapping[str, OwnValue]) -> str:
    """The project with the values of a configuration in the variables that it has."""
    source = "existing file"
    found = _variables(text, source)
    raw, unused = _as_variables(own), _unused(found)
    edits: dict[int, str] = {}
    for name, variable in VARIABLES.items():
        value = number(raw, variable.macro)
        if name in found and name not in unused and value is not None:
            edits[found[name].start] = f"{printed(value / variable.unit):.6g}"
    for name in BY_HAND:
        if name in found:
            edits[found[name].start] = "true"
    every = number(own, "REGULATION_EXECUTION_RATE")
    if EXECUTION_RATE in found and every is not None:
        items = _items(found[EXECUTION_RATE])
        if f"{every:g}" in items:
            edits[found[EXECUTION_RATE].start] = str(items.index(f"{every:g}"))
    return with_attribute(text, source, "value", edits)


def _variables(text: str, place: str) -> dict[str, Element]:
    """Elements of the first motor's variables by name; of several the first counts."""
    root = parsed_xml(text, place)
    systems = [element for element in elements(root) if element.tag == "system"]
    if not systems:
        message = "this project has no motor; save it again with Workbench"
        raise InputError(message, source=place, line=root.line)
    found: dict[str, Element] = {}
    for element in elements(systems[0]):
        name = element.attributes.get("name")
        if element.tag == "var" and name is not None and "value" in element.attributes:
            found.setdefault(name, element)
    if not any(name in found for name in ("Pole Pairs", "Rs")):
        message = "the first motor of this project has no variables; save it again with Workbench"
        raise InputError(message, source=place, line=systems[0].line)
    return found


def _unused(found: Mapping[str, Element]) -> tuple[str, ...]:
    """Variables that Workbench does not look at: those of the other kind of machine, and of the
    other kind of current measurement.
    """
    surface = _tag(found.get(STRUCTURE)) == SURFACE
    sensors = _tag(found.get(TOPOLOGY)) == SENSORS
    return (
        *(("Ld", "Lq") if surface else ("Ls",) if "Lq" in found else ()),
        *(("Shunt resistor(s) value", "Amplifying network gain") if sensors else ("ICS gain",)),
    )


def _tag(element: Element | None) -> str:
    """Tag of the item that a list has chosen."""
    if element is None:
        return ""
    items, chosen = _items(element), plain_number(element.attributes["value"])
    return items[int(chosen)] if chosen is not None and 0 <= chosen < len(items) else ""


def _value(element: Element, macro: str, unit: float, place: str) -> OwnValue:
    text, name = element.attributes["value"], element.attributes["name"]
    value = plain_number(text)
    if value is None:
        message = f"{name} is {text[:40]!r}, not a number; write one"
        raise InputError(message, source=place, line=element.line)
    low, high = POSSIBLE.get(macro, BEYOND)
    scaled = printed(value * unit) if unit != 1.0 else value
    if not low <= scaled <= high:
        message = f"{name} is {value:g}; write a value from {low / unit:g} to {high / unit:g}"
        raise InputError(message, source=place, line=element.line)
    if macro in WHOLE and not scaled.is_integer():
        message = f"{name} is {value:g}; write a whole number"
        raise InputError(message, source=place, line=element.line)
    return int(scaled) if scaled.is_integer() else scaled


def _as_macros(raw: dict[str, OwnValue]) -> dict[str, OwnValue]:
    """Variables as macros: one inductance with a ratio, a rate for a period, shared dividers."""
    own = dict(raw)
    l_d, l_q = number(own, "Ld"), number(own, "Lq")
    if l_q:
        own["LS"] = l_q
        if l_d:
            own["ld_lq_ratio"] = printed(l_d / l_q)
    if "sensor_slope" in own:
        own |= {"RSHUNT": 1, "AMPLIFICATION_GAIN": own["sensor_slope"]}
    own.setdefault("NOMINAL_BUS_VOLTAGE_V", own.get("motor_voltage", 0))
    period = number(own, "speed_period")
    if period:
        own["SPEED_LOOP_FREQUENCY_HZ"] = round(1.0 / period)
    for gain, divider, shared in (
        ("PID_FLUX_KP_DEFAULT", "flux_kp_divider", "TF_KPDIV"),
        ("PID_FLUX_KI_DEFAULT", "flux_ki_divider", "TF_KIDIV"),
    ):
        value, own_divider, other = number(own, gain), number(own, divider), number(own, shared)
        if value is not None and own_divider and other and own_divider != other:
            own[gain] = value * other / own_divider
    for name in OWN_NAMES:
        own.pop(name, None)
    if not number(own, "NOMINAL_BUS_VOLTAGE_V"):
        own.pop("NOMINAL_BUS_VOLTAGE_V", None)
    return own


def _as_variables(own: Mapping[str, OwnValue]) -> dict[str, OwnValue]:
    raw = dict(own)
    inductance, ratio = number(own, "LS"), number(own, "ld_lq_ratio")
    if inductance is not None:
        raw |= {"Lq": inductance, "Ld": inductance * (1.0 if ratio is None else ratio)}
    rate = number(own, "SPEED_LOOP_FREQUENCY_HZ")
    if rate:
        raw["speed_period"] = 1.0 / rate
    shunt, gain = number(own, "RSHUNT"), number(own, "AMPLIFICATION_GAIN")
    if shunt is not None and gain is not None:
        raw["sensor_slope"] = shunt * gain
    raw["flux_kp_divider"] = own.get("TF_KPDIV", "")
    raw["flux_ki_divider"] = own.get("TF_KIDIV", "")
    raw["motor_voltage"] = own.get("NOMINAL_BUS_VOLTAGE_V", "")
    return raw


def _items(element: Element) -> list[str]:
    return [item.attributes.get("tag", "") for item in elements(element) if item.tag == "item"]


def _chosen(element: Element, place: str) -> int:
    items, text = _items(element), element.attributes["value"]
    place_of = plain_number(text)
    if place_of is None or not 0 <= place_of < len(items) or not items[int(place_of)].isdigit():
        message = f"{EXECUTION_RATE} is {text[:40]!r}, none of its items; save the project again"
        raise InputError(message, source=place, line=element.line)
    return int(items[int(place_of)])


def _origins(found: Mapping[str, Element], own: Mapping[str, OwnValue]) -> dict[str, Origin]:
    by_macro = dict(_named(found))
    origins = {}
    for field, (macro, conversion) in FIELDS.items():
        other = "MOTOR_MAX_SPEED_RPM" if macro == "MAX_APPLICATION_SPEED_RPM" else macro
        element = by_macro.get(macro, by_macro.get(other))
        if element is not None and (macro in own or other in own):
            text = element.attributes["value"]
            origins[field] = Origin(element.attributes["name"], text, element.line, conversion)
    return origins


def _named(found: Mapping[str, Element]) -> Iterator[tuple[str, Element]]:
    for name, variable in VARIABLES.items():
        if name in found:
            yield variable.macro, found[name]
    if EXECUTION_RATE in found:
        yield "REGULATION_EXECUTION_RATE", found[EXECUTION_RATE]
    if "SpeedCtrl - Execution rate" in found:
        yield "SPEED_LOOP_FREQUENCY_HZ", found["SpeedCtrl - Execution rate"]
