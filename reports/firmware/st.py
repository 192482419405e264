"""Files of ST's MCSDK, read and written: headers, motor file, project of Workbench 5."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, NoReturn

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.firmware_method import number
from dqforge.optimizer.firmware.st_keys import (
    COUNTED,
    DRIVE,
    HEADERS,
    LOGARITHMS,
    MOTOR,
    MOTOR_FILE,
    OTHERWISE,
    READ_ONLY,
    SPEED_GAINS,
    STAGE,
    TABLE,
    VERSION,
    WHOLE,
)
from dqforge.optimizer.firmware.st_scales import (
    CONVENTIONS,
    FULL,
    current_scale,
    integers,
    joined,
    printed,
    st_configuration,
)
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.c_macros import (
    Definition,
    Macros,
    elements,
    parsed_xml,
    read_macros,
    with_attribute,
    with_values,
)
from dqforge.reports.firmware.json_text import JsonText, parsed_json, with_json_values
from dqforge.reports.firmware.target import Target, plain_number
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.machines.files.positioned_xml import Element
    from dqforge.reports.firmware.target import FileTitle


# Macros of the firmware that its parameter headers use.
KNOWN = {"SPEED_UNIT": "10", "U_01HZ": "10", "_01HZ": "10", "U_RPM": "60", "_RPM": "60"}
_SIGNS = ("PID_TORQUE_KP_DEFAULT", "MOTOR_VOLTAGE_CONSTANT", "AMPLIFICATION_GAIN", "TF_KPDIV")
_OLD_MODE = "STC_"  # How the names of control modes begin up to version 5.
MILLIHENRIES = "ls in mH"  # What the motor file of dqforge says of its inductance.

# ls/rs above which ls is taken for mH: in the middle between time constants of 1 ms.
_BETWEEN = 0.0316


def recognise(name: str, text: str) -> bool:
    """Whether a file is a parameter header, a motor file or a project of the MCSDK."""
    if name.endswith(".stmcx") or is_project(text):
        return True
    if text.lstrip().startswith("{"):
        return '"polePairs"' in text and '"BEmfConstant"' in text
    return any(re.search(rf"#\s*define\s+{sign}\b", text) for sign in _SIGNS)


def read(text: str, place: str) -> Configuration:
    """The configuration in one file.

    Raises:
        InputError: It is none of the three, or a value in it is impossible; with the line.
    """
    if is_project(text):
        return read_project(text, place)
    if text.lstrip().startswith("{"):
        return _motor_file(parsed_json(text, place), place)
    return _header(parameter_macros(text, place), place)


def read_several(files: Sequence[tuple[str, str]]) -> Configuration:
    """The configuration that several files state together, from text and place of each."""
    return joined(read(text, place) for text, place in files)


def parameter_macros(text: str, place: str) -> Macros:
    """Macros of a header, with those of the firmware that they use: speeds count in tenths of a
    hertz, whatever unit the header chooses, so that gains are those that were divided by it.
    """
    found = read_macros(text, place, known=KNOWN)
    known = {name: Definition(name, value, 0, 0, 0) for name, value in KNOWN.items()}
    return replace(found, by_name=dict(found.by_name) | known)


def origins(
    own: Mapping[str, OwnValue], where: Callable[[str], tuple[str, str, int | None]]
) -> dict[str, Origin]:
    """Where the values of a configuration stand, from key, text and line of a macro."""
    found = {}
    for field, (macro, conversion) in FIELDS.items():
        counted = COUNTED.get(macro, macro)
        fallback = "MOTOR_MAX_SPEED_RPM" if macro == "MAX_APPLICATION_SPEED_RPM" else counted
        name = macro if macro in own else fallback
        if name in own:
            key, text, line = where(name)
            found[field] = Origin(key, text, line, conversion)
    return found


def check(
    name: str, value: float, refuse: Callable[[str], NoReturn], *, whole: bool = False
) -> OwnValue:
    """A value that is possible, as an integer where it must be one."""
    low, high = POSSIBLE.get(name, BEYOND)
    if not low <= value <= high:
        refuse(f"is {value:g}; write a value from {low:g} to {high:g}")
    if whole and not value.is_integer():
        refuse(f"is {value:g}; write a whole number")
    return int(value) if value.is_integer() else value


def _header(macros: Macros, place: str) -> Configuration:
    own: dict[str, OwnValue] = {}
    named: dict[str, str] = {}
    for name in (*HEADERS, *COUNTED.values(), *READ_ONLY):
        spelled = _spelled(name, macros)
        if spelled is None or (name.startswith("CONSTANT") and not _fed_forward(macros)):
            continue
        named[name] = spelled
        own[name] = _value(macros, name, spelled)
    if not any(name in own for name in HEADERS):
        raise InputError(
            "no macro of the MCSDK is defined here; name drive_parameters.h, "
            "pmsm_motor_parameters.h, power_stage_parameters.h or several of them",
            source=place,
        )
    _check_table(own, macros, named)
    version = "5" if _is_old(macros) else VERSION

    def where(name: str) -> tuple[str, str, int | None]:
        spelled = named[name]
        return spelled, macros.text(spelled) or "", macros.line(spelled)

    return st_configuration("", own, version=version, origins=origins(own, where))


def _spelled(name: str, macros: Macros) -> str | None:
    """The name under which a header has a macro."""
    for spelled in (name, OTHERWISE.get(name, "")):
        if spelled and spelled in macros:
            return spelled
    return None


def _value(macros: Macros, name: str, spelled: str) -> OwnValue:
    if name in ("ANGC", "OFST"):
        return (macros.text(spelled) or "").replace(" ", "")
    value = macros.needed(spelled)
    return check(name, value, lambda words: macros.refuse(spelled, words), whole=name in WHOLE)


def _check_table(own: Mapping[str, OwnValue], macros: Macros, named: Mapping[str, str]) -> None:
    present = [name for name in TABLE if name in own]
    if not present:
        return
    for name in TABLE:
        if name not in own:
            macros.refuse(named[present[0]], f"stands without {name}; copy the whole header")
    for name in ("ANGC", "OFST"):
        found = integers(own[name])
        if found is None or len(found) != 8:
            macros.refuse(named[name], "is no table; write eight whole numbers in braces")
        if max(abs(value) for value in found) > 65536:
            macros.refuse(named[name], "holds a number beyond 65536; write smaller ones")


def _fed_forward(macros: Macros) -> bool:
    return macros.text("FEED_FORWARD_CURRENT_REG_ENABLING") == "ENABLE"


def _is_old(macros: Macros) -> bool:
    mode = macros.text("DEFAULT_CONTROL_MODE") or ""
    return mode.startswith(_OLD_MODE) or "MEAS_ERRORS_BEFORE_FAULTS" in macros


def _motor_file(found: JsonText, place: str) -> Configuration:
    own: dict[str, OwnValue] = {}
    keys = {macro: key for key, macro in MOTOR_FILE.items()}
    for key, macro in MOTOR_FILE.items():
        value = found.number(key)
        if value is not None and key != "ls":
            own[macro] = _number_of(found, (key,), macro, value)
    ratio = found.number("magneticStructure", "ld_lq_ratio")
    if ratio is not None:
        path = ("magneticStructure", "ld_lq_ratio")
        own["ld_lq_ratio"] = _number_of(found, path, "ld_lq_ratio", ratio)
    conventions: tuple[str, ...] = CONVENTIONS
    inductance = found.number("ls")
    if inductance is not None:
        henries, words = _inductance(inductance, number(own, "RS"), found.value("description"))
        own["LS"] = _number_of(found, ("ls",), "LS", henries)
        conventions = (*CONVENTIONS, words)
    if "POLE_PAIR_NUM" not in own or "LS" not in own:
        missing = "polePairs" if "POLE_PAIR_NUM" not in own else "ls"
        raise InputError(f"{missing} is missing; save the motor file again", source=place)

    def where(name: str) -> tuple[str, str, int | None]:
        key = keys.get(name, name)
        return key, found.written(key), found.line(key)

    label = found.value("label")
    name = label if isinstance(label, str) else PurePath(place).stem
    return st_configuration(name, own, origins=origins(own, where), conventions=conventions)


def _number_of(found: JsonText, path: tuple[str, ...], macro: str, value: float) -> OwnValue:
    return check(macro, value, lambda words: found.refuse(path, words), whole=macro in WHOLE)


def _inductance(value: float, r_s: float | None, description: object) -> tuple[float, str]:
    """Inductance in H of ``ls``, and how it was understood: Workbench writes mH, exports of the
    profiler H.
    """
    if isinstance(description, str) and MILLIHENRIES in description:
        return printed(1e-3 * value), "ls is in mH, as the description states"
    if value / (r_s or 0.5) > _BETWEEN:
        return printed(1e-3 * value), f"ls {value:g} is taken in mH, as Workbench writes it"
    return value, f"ls {value:g} is taken in H, as exports of the motor profiler have it"


# Projects of Workbench 5 (``.stmcx``): variables read, and replaced where they stand.

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
            raw[variable.macro] = _project_value(element, variable.macro, variable.unit, place)
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


def _project_value(element: Element, macro: str, unit: float, place: str) -> OwnValue:
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


# Variables of Workbench 5 and the macros that they are, and which values are possible.

MILLI = 1e-3


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of a project: the macro that it is, and its unit in that of the macro."""

    macro: str
    unit: float = 1.0


VARIABLES = {
    "Pole Pairs": Variable("POLE_PAIR_NUM"),
    "Max Rated Speed": Variable("MOTOR_MAX_SPEED_RPM"),
    "Nominal Current": Variable("NOMINAL_CURRENT_A"),
    "Nominal DC Voltage": Variable("motor_voltage"),
    "Nominal voltage": Variable("NOMINAL_BUS_VOLTAGE_V"),
    "Rs": Variable("RS"),
    "Ls": Variable("LS", MILLI),
    "Ld": Variable("Ld", MILLI),
    "Lq": Variable("Lq", MILLI),
    "B-EmfConstant": Variable("MOTOR_VOLTAGE_CONSTANT"),
    "inertia": Variable("inertia"),
    "friction": Variable("friction"),
    "Shunt resistor(s) value": Variable("RSHUNT"),
    "Amplifying network gain": Variable("AMPLIFICATION_GAIN"),
    "ICS gain": Variable("sensor_slope"),
    "PWM frequency": Variable("PWM_FREQUENCY"),
    "Dead time": Variable("SW_DEADTIME_NS"),
    "Torque - P dividend": Variable("PID_TORQUE_KP_DEFAULT"),
    "Torque - P divisor": Variable("TF_KPDIV"),
    "Torque - I dividend": Variable("PID_TORQUE_KI_DEFAULT"),
    "Torque - I divisor": Variable("TF_KIDIV"),
    "Flux - P dividend": Variable("PID_FLUX_KP_DEFAULT"),
    "Flux - P divisor": Variable("flux_kp_divider"),
    "Flux - I dividend": Variable("PID_FLUX_KI_DEFAULT"),
    "Flux - I divisor": Variable("flux_ki_divider"),
    "SpeedCtrl - Execution rate": Variable("speed_period", MILLI),
    "SpeedCtrl - P dividend": Variable("PID_SPEED_KP_DEFAULT"),
    "SpeedCtrl - P divisor": Variable("SP_KPDIV"),
    "SpeedCtrl - I dividend": Variable("PID_SPEED_KI_DEFAULT"),
    "SpeedCtrl - I divisor": Variable("SP_KIDIV"),
    "Main - ObsPLL - F1": Variable("F1"),
    "Main - ObsPLL - F2": Variable("F2"),
    "Main - ObsPLL - G1": Variable("GAIN1"),
    "Main - ObsPLL - G2": Variable("GAIN2"),
    "Main - ObsPLL - P dividend": Variable("PLL_KP_GAIN"),
    "Main - ObsPLL - P divisor": Variable("PLL_KPDIV"),
    "Main - ObsPLL - I dividend": Variable("PLL_KI_GAIN"),
    "Main - ObsPLL - I divisor": Variable("PLL_KIDIV"),
    "Main - ObsPLL - Average speed FIFO depth for speed loop": Variable("STO_FIFO_DEPTH_UNIT"),
    "SL - Minimum start-up output speed": Variable("OBS_MINIMUM_SPEED_RPM"),
}

# A list whose value is the place of the chosen item.
EXECUTION_RATE = "Torque&Flux - Execution rate"

# List of the kinds of machine, and the tag of those without saliency, which have Ls alone.
STRUCTURE, SURFACE = "I/SM-PMSM", "0"

# List of the kinds of current measurement, and the tag of sensors without a shunt.
TOPOLOGY, SENSORS = "Current reading topology", "2"

# What is no macro of the headers and is turned into those that are.
OWN_NAMES = (
    "Ld",
    "Lq",
    "motor_voltage",
    "speed_period",
    "flux_kp_divider",
    "flux_ki_divider",
    "sensor_slope",
)

# What must be true for Workbench to leave gains as they are.
BY_HAND = (
    "Torque&Flux - Manual editing enabled",
    "SpeedCtrl_Manual_editing",
    "Main - ObsPLL - Manual editing enabled",
)

# Least and largest value of a macro; all others lie between -65536 and 65536.
POSSIBLE = {
    "POLE_PAIR_NUM": (1.0, 200.0),
    "RS": (1e-6, 1e3),
    "LS": (1e-9, 10.0),
    "MOTOR_VOLTAGE_CONSTANT": (0.0, 1e5),
    "MOTOR_MAX_SPEED_RPM": (1.0, 1e6),
    "MAX_APPLICATION_SPEED_RPM": (1.0, 1e6),
    "NOMINAL_CURRENT_A": (1e-3, 1e5),
    "IQMAX_A": (1e-3, 1e5),
    "NOMINAL_BUS_VOLTAGE_V": (1.0, 2e4),
    "RSHUNT": (1e-6, 100.0),
    "AMPLIFICATION_GAIN": (1e-3, 1e4),
    "ADC_REFERENCE_VOLTAGE": (0.1, 20.0),
    "VBUS_PARTITIONING_FACTOR": (1e-5, 10.0),
    "PWM_FREQUENCY": (100.0, 1e7),
    "REGULATION_EXECUTION_RATE": (1.0, 100.0),
    "SPEED_LOOP_FREQUENCY_HZ": (1.0, 1e5),
    "SW_DEADTIME_NS": (0.0, 1e5),
    "SEGDIV": (0.0, 32767.0),
    "STO_FIFO_DEPTH_UNIT": (1.0, 1024.0),
    "STO_FIFO_DEPTH_DPP": (1.0, 1024.0),
    "ld_lq_ratio": (1e-3, 1e3),
    "inertia": (0.0, 1e11),
    "friction": (0.0, 1e10),
} | dict.fromkeys(
    (
        *("TF_KPDIV", "TF_KIDIV", "SP_KPDIV", "SP_KIDIV", "PLL_KPDIV", "PLL_KIDIV", "F1", "F2"),
        *("flux_kp_divider", "flux_ki_divider"),
    ),
    (1.0, 65536.0),
)

BEYOND = (-65536.0, 65536.0)

# Macros behind the values of a configuration, and how they are converted.
FIELDS = {
    "pole_pairs": ("POLE_PAIR_NUM", ""),
    "r_s": ("RS", ""),
    "l_d": ("LS", "times ld_lq_ratio where there is one"),
    "l_q": ("LS", ""),
    "psi_pm": ("MOTOR_VOLTAGE_CONSTANT", "sqrt(2/3) 60/(2 pi 1000 p)"),
    "inertia": ("inertia", "1e-6 kg m^2"),
    "viscous": ("friction", "1e-6 N m s/rad"),
    "i_max": ("NOMINAL_CURRENT_A", ""),
    "omega_m_max": ("MAX_APPLICATION_SPEED_RPM", "rpm to rad/s"),
    "v_dc": ("NOMINAL_BUS_VOLTAGE_V", ""),
    "f_sw": ("PWM_FREQUENCY", ""),
    "dead_time": ("SW_DEADTIME_NS", "ns to s"),
    "t_s": ("REGULATION_EXECUTION_RATE", "over PWM_FREQUENCY"),
    "t_speed": ("SPEED_LOOP_FREQUENCY_HZ", "its reciprocal"),
    "shunt": ("RSHUNT", ""),
    "sense_gain": ("AMPLIFICATION_GAIN", ""),
    "sense_reference": ("ADC_REFERENCE_VOLTAGE", ""),
    "current_q.kp": ("PID_TORQUE_KP_DEFAULT", "over TF_KPDIV, times v_dc/sqrt(3) over full scale"),
    "current_q.ki": (
        "PID_TORQUE_KI_DEFAULT",
        "over TF_KIDIV, times v_dc/sqrt(3) f over full scale",
    ),
    "current_d.kp": ("PID_FLUX_KP_DEFAULT", "over TF_KPDIV, times v_dc/sqrt(3) over full scale"),
    "current_d.ki": ("PID_FLUX_KI_DEFAULT", "over TF_KIDIV, times v_dc/sqrt(3) f over full scale"),
    "speed.kp": ("PID_SPEED_KP_DEFAULT", "over SP_KPDIV, full scale/32768 per 0.1 Hz"),
    "speed.ki": ("PID_SPEED_KI_DEFAULT", "over SP_KIDIV, full scale/32768 f per 0.1 Hz"),
    "pll.kp": ("PLL_KP_GAIN", "over PLL_KPDIV, per control period"),
    "pll.ki": ("PLL_KI_GAIN", "over PLL_KIDIV, per control period"),
}


# ST's MCSDK among the firmware whose files are written and read.

# Files of ST's MCSDK written: a header of its macros, the motor file, values in other files.

_EXISTING = "existing file"


_GROUPS = (
    ("machine (pmsm_motor_parameters.h)", MOTOR),
    ("power stage (power_stage_parameters.h, parameters_conversion.h)", STAGE),
    ("drive (drive_parameters.h)", DRIVE),
    ("currents of least loss (drive_parameters.h)", TABLE),
)


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_st_parameters.h`` and ``<prefix>_st_motor.json``.

    Args:
        found: The configuration.
        title: What stands at the head of the header.
        existing_text: A header of a project, a motor file, or a project of Workbench 5 (then a
            further file, ``<prefix>_st.stmcx``) whose other values and comments stay; None without
            one. Only macros and variables that it has are changed.
    """
    files = {
        f"{title.prefix}_st_parameters.h": _target_header(found, title),
        f"{title.prefix}_st_motor.json": _target_motor_file(found, title),
    }
    if existing_text is None:
        pass
    elif is_project(existing_text):
        files[f"{title.prefix}_st.stmcx"] = with_variables(existing_text, found.own)
    elif existing_text.lstrip().startswith("{"):
        values = _motor_values(found)
        merged = with_json_values(existing_text, _EXISTING, _kept(existing_text, values, found))
        files[f"{title.prefix}_st_motor.json"] = merged
    else:
        files[f"{title.prefix}_st_parameters.h"] = _with_macros(existing_text, found.own)
    return {name: text.encode("utf-8") for name, text in files.items()}


def _target_header(found: Configuration, title: FileTitle) -> str:
    groups = []
    for name, keys in _GROUPS:
        lines = [
            (macro, _macro(macro, found.own[macro]), _says(macro, says, found.own))
            for macro, says in keys.items()
            if macro in found.own
        ]
        if lines:
            groups.append((name, _with_logarithms(lines)))
    context = {
        "title": title,
        "guard": f"{title.prefix.upper()}_ST_PARAMETERS_H",
        "groups": groups,
        "table": "SEGDIV" in found.own,
        "version": found.version,
    }
    return render("firmware/st/parameters.h.j2", context)


def _macro(name: str, value: OwnValue) -> str:
    """A value as it stands behind its macro."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    if name in SPEED_GAINS:
        return f"{text}/(SPEED_UNIT/10)"
    return f"({text})" if text.startswith("-") else text


def _says(name: str, says: str, own: Mapping[str, OwnValue]) -> str:
    """The comment of a macro, with the counts of currents."""
    value, full = number(own, name), current_scale(own)
    if name in COUNTED and value is not None and full is not None:
        return f"{says}; {COUNTED[name]} {round(value * FULL / full)} in counts"
    return says


def _with_logarithms(lines: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    found = []
    for name, text, says in lines:
        found.append((name, text, says))
        if name in LOGARITHMS:
            found.append((f"{name}_LOG", f"LOG2(({text}))", ""))
    return found


def _with_macros(text: str, own: Mapping[str, OwnValue]) -> str:
    """The header with the values behind the macros that it has, in the unit that it has them in."""
    macros = parameter_macros(text, _EXISTING)
    full = current_scale(own)
    values: dict[str, str] = {}
    for name in (*MOTOR, *STAGE, *DRIVE, *TABLE):
        value = own.get(name)
        if value is None:
            continue
        _put(values, macros, name, value)
        counted = COUNTED.get(name)
        if counted is not None and counted in macros and full is not None:
            values[counted] = str(round((number(own, name) or 0.0) * FULL / full))
    return with_values(text, macros, values)


def _put(values: dict[str, str], macros: Macros, name: str, value: OwnValue) -> None:
    for spelled in (name, OTHERWISE.get(name, "")):
        if spelled and spelled in macros:
            values[spelled] = _macro(name, value)
            if name in LOGARITHMS and f"{name}_LOG" in macros:
                values[f"{name}_LOG"] = f"LOG2(({_macro(name, value)}))"


def _motor_values(found: Configuration) -> dict[tuple[str, ...], object]:
    """Values of the motor file by their paths; the inductance in mH."""
    values: dict[tuple[str, ...], object] = {}
    for key, macro in MOTOR_FILE.items():
        value = number(found.own, macro)
        if value is not None:
            scaled = printed(1e3 * value) if key == "ls" else value
            values[(key,)] = int(scaled) if float(scaled).is_integer() else scaled
    ratio = number(found.own, "ld_lq_ratio")
    values[("magneticStructure", "type")] = "SM-PMSM" if ratio is None else "I-PMSM"
    if ratio is not None:
        values[("magneticStructure", "ld_lq_ratio")] = ratio
    return values


def _kept(
    text: str, values: dict[tuple[str, ...], object], found: Configuration
) -> dict[tuple[str, ...], object]:
    """The values for an existing motor file: its inductance stays in the unit that it is in."""
    was, inductance = read(text, _EXISTING), number(found.own, "LS")
    henries = any("in H," in words for words in was.conventions)
    if henries and inductance is not None:
        values[("ls",)] = inductance
    return values


def _target_motor_file(found: Configuration, title: FileTitle) -> str:
    content: dict[str, object] = {
        "id": title.prefix,
        "label": title.name,
        "description": f"made by dqforge {title.version}; {MILLIHENRIES}",
        "hardwareFamily": "MOTOR",
    }
    for path, value in _motor_values(found).items():
        if len(path) == 1:
            content[path[0]] = value
        else:
            inner = content.setdefault(path[0], {})
            assert isinstance(inner, dict)
            inner[path[1]] = value
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


# ST's MCSDK among the firmware whose files are written and read.

TARGET = Target(
    ST,
    "ST MCSDK (headers of 5.4 to 6.4, motor file of Workbench 6, project of Workbench 5)",
    write,
    recognise,
    read,
    read_several,
)
