"""Files of ST's MCSDK read: headers, motor file (JSON), project of Workbench 5 (XML)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import NoReturn

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.firmware_method import number
from dqforge.optimizer.firmware.st_keys import (
    COUNTED,
    HEADERS,
    MOTOR_FILE,
    OTHERWISE,
    READ_ONLY,
    TABLE,
    VERSION,
    WHOLE,
)
from dqforge.optimizer.firmware.st_scales import (
    CONVENTIONS,
    integers,
    joined,
    printed,
    st_configuration,
)
from dqforge.reports.firmware.c_macros import Definition, Macros, read_macros
from dqforge.reports.firmware.json_text import JsonText, parsed_json
from dqforge.reports.firmware.st.names import BEYOND, FIELDS, POSSIBLE
from dqforge.reports.firmware.st.project import is_project, read_project

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
        return printed(1e-3 * value), "ls is in mH, as the description says"
    if value / (r_s or 0.5) > _BETWEEN:
        return printed(1e-3 * value), f"ls {value:g} is taken in mH, as Workbench writes it"
    return value, f"ls {value:g} is taken in H, as exports of the motor profiler have it"
