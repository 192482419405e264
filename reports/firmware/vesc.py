"""VESC's motor configuration, read and written: XML of VESC Tool, a header with the same keys."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Configuration, Number, Origin
from dqforge.optimizer.firmware.targets.vesc import VESC
from dqforge.optimizer.firmware.vesc_format import (
    KEYS,
    LOOP_DEFAULTS,
    SIGNIFICANT,
    configuration,
    version_of,
)
from dqforge.reports.firmware.c_macros import parsed_xml, read_macros, with_texts, with_values
from dqforge.reports.firmware.target import Target, no_number, number_text, plain_number
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import OwnValue
    from dqforge.reports.firmware.target import FileTitle


ROOT = "MCConfiguration"  # Root element of the XML of a motor configuration.
FIELD_ORIENTED = 2  # motor_type of field-oriented control.


def is_xml(text: str) -> bool:
    """Whether a text is meant as XML."""
    return text.lstrip().startswith("<")


def recognise(name: str, text: str) -> bool:
    """Whether a file holds a motor configuration of VESC.

    Args:
        name: Its name.
        text: Its text.
    """
    if is_xml(text):
        return f"<{ROOT}" in text
    return "MCCONF_" in text and name.lower().endswith((".h", ".hpp", ".txt", ".c"))


def read(text: str, place: str) -> Configuration:
    """The configuration in a file of VESC Tool.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It is none, or a value of it is no number; with the line.
    """
    xml = is_xml(text)
    own, origins, written = _in_xml(text, place) if xml else _in_header(text, place)
    if not own:
        raise InputError(
            "this file holds none of VESC's keys of a motor; save the motor configuration as XML "
            "or as a C header with VESC Tool",
            source=place,
        )
    kind = origins.get("motor_type")
    if kind is not None and own["motor_type"] != FIELD_ORIENTED:
        raise InputError(
            f"{kind.key} is {kind.text}: this motor does not run with field-oriented control; "
            "detect it as FOC with VESC Tool, which writes 2",
            source=place,
            line=kind.line,
        )
    version = version_of(written, whole=xml)
    return configuration(PurePath(place).stem, own, origins, version)


Found = tuple[dict[str, Number], dict[str, Origin], Collection[str]]


def _in_xml(text: str, place: str) -> Found:
    """Values and origins by the name of the key, and every name as it is written; of several
    elements of one name the last counts, as VESC Tool reads them.
    """
    root = parsed_xml(text, place)
    if root.tag != ROOT:
        raise InputError(
            f"the root of this XML is {shown(root.tag)}, not {ROOT}; save the motor configuration "
            f"(not the app configuration) with VESC Tool",
            source=place,
            line=root.line,
        )
    own: dict[str, Number] = {}
    origins: dict[str, Origin] = {}
    for element in root.children:
        name = FORMER.get(element.tag, element.tag)
        if name in READ:
            origins[name] = Origin(element.tag, element.text.strip(), element.line)
            own[name] = _checked(name, plain_number(element.text), origins[name], place)
    return own, origins, {element.tag for element in root.children}


def _in_header(text: str, place: str) -> Found:
    """The same of macros; a macro whose text is no arithmetic is refused with its line."""
    macros = read_macros(text, place)
    own: dict[str, Number] = {}
    origins: dict[str, Origin] = {}
    former = [(old, new) for old, new in FORMER.items() if define(old) in macros]
    spelled = {old for old, _ in former} | {name for name in READ if define(name) in macros}
    for written, name in (*former, *((name, name) for name in READ)):
        macro = define(written)
        said = macros.text(macro)
        if said is not None:
            value = WORDS.get(said)
            value = macros.number(macro) if value is None else value
            origins[name] = Origin(macro, said, macros.line(macro))
            own[name] = _checked(name, value, origins[name], place)
    return own, origins, spelled


def _checked(name: str, value: float | None, origin: Origin, place: str) -> Number:
    """The value of a key, a whole number where it holds one."""
    if value is None:
        complaint = no_number(origin.text)
    elif name in WHOLE and not value.is_integer():
        complaint = f"is {value:g}; write a whole number"
    else:
        return int(value) if name in WHOLE else value
    raise InputError(f"{origin.key} {complaint}", source=place, line=origin.line)


# Names of VESC's motor configuration in C, and what its headers may write instead of numbers.

_OTHERWISE = {
    "motor_type": "MCCONF_DEFAULT_MOTOR_TYPE",
    "l_abs_current_max": "MCCONF_L_MAX_ABS_CURRENT",
    "l_min_erpm": "MCCONF_L_RPM_MIN",
    "l_max_erpm": "MCCONF_L_RPM_MAX",
    "l_erpm_start": "MCCONF_L_RPM_START",
    "s_pid_min_erpm": "MCCONF_S_PID_MIN_RPM",
}

_FURTHER = ("foc_encoder_ratio", "foc_fw_current_max", "l_erpm_start", "s_pid_min_erpm")


def define(name: str) -> str:
    """Name of the macro of a key (``cDefine`` in parameters_mcconf.xml)."""
    return _OTHERWISE.get(name, f"MCCONF_{name.upper()}")


# Keys that are read; all others of a file are kept and not looked at.
READ = tuple(dict.fromkeys((*KEYS, *LOOP_DEFAULTS, *_FURTHER)))

# Keys that hold whole numbers.
WHOLE = frozenset(
    {name for name, key in KEYS.items() if key.kind == "whole"}
    | {"foc_observer_type", "foc_sensor_mode"}
)

# Names that older versions used, and those of today.
FORMER = {
    "foc_f_sw": "foc_f_zv",
    "foc_sample_v0_v7": "foc_control_sample_mode",
}


def _numbered(*names: str) -> dict[str, float]:
    return {name: float(index) for index, name in enumerate(names)}


# Enumerators of the firmware (datatypes.h) with their numbers.
WORDS = (
    {"true": 1.0, "false": 0.0}
    | _numbered("MOTOR_TYPE_BLDC", "MOTOR_TYPE_DC", "MOTOR_TYPE_FOC")
    | _numbered(
        "FOC_SENSOR_MODE_SENSORLESS",
        "FOC_SENSOR_MODE_ENCODER",
        "FOC_SENSOR_MODE_HALL",
        "FOC_SENSOR_MODE_HFI",
        "FOC_SENSOR_MODE_HFI_START",
        "FOC_SENSOR_MODE_HFI_V2",
        "FOC_SENSOR_MODE_HFI_V3",
        "FOC_SENSOR_MODE_HFI_V4",
        "FOC_SENSOR_MODE_HFI_V5",
    )
    | _numbered(
        "FOC_CC_DECOUPLING_DISABLED",
        "FOC_CC_DECOUPLING_CROSS",
        "FOC_CC_DECOUPLING_BEMF",
        "FOC_CC_DECOUPLING_CROSS_BEMF",
    )
    | _numbered(
        "FOC_OBSERVER_ORTEGA_ORIGINAL",
        "FOC_OBSERVER_MXLEMMING",
        "FOC_OBSERVER_ORTEGA_LAMBDA_COMP",
        "FOC_OBSERVER_MXLEMMING_LAMBDA_COMP",
        "FOC_OBSERVER_MXV",
        "FOC_OBSERVER_MXV_LAMBDA_COMP",
        "FOC_OBSERVER_MXV_LAMBDA_COMP_LIN",
    )
    | _numbered("MTPA_MODE_OFF", "MTPA_MODE_IQ_TARGET", "MTPA_MODE_IQ_MEASURED")
    | _numbered("S_PID_SPEED_SRC_PLL", "S_PID_SPEED_SRC_FAST", "S_PID_SPEED_SRC_FASTER")
    | _numbered(
        "FOC_CONTROL_SAMPLE_MODE_V0",
        "FOC_CONTROL_SAMPLE_MODE_V0_V7",
        "FOC_CONTROL_SAMPLE_MODE_V0_V7_INTERPOL",
    )
    | _numbered(
        "PID_RATE_25_HZ",
        "PID_RATE_50_HZ",
        "PID_RATE_100_HZ",
        "PID_RATE_250_HZ",
        "PID_RATE_500_HZ",
        "PID_RATE_1000_HZ",
        "PID_RATE_2500_HZ",
        "PID_RATE_5000_HZ",
        "PID_RATE_10000_HZ",
    )
)


# VESC's motor configuration written: XML that VESC Tool merges, and a header of the same keys.

_EXISTING = "existing file"

# Limits that a file keeps where it allows less.
OF_PROJECT = ("l_current_min", "l_abs_current_max")


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_mcconf.xml`` and ``<prefix>_mcconf.h``.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: What stands at the head of the files.
        existing_text: XML or header whose other values and comments are to stay; None without one.
            The other one of the two files is written anew.
    """
    own = found.own if existing_text is None else _as_careful(found.own, existing_text)
    values = {name: printed(value) for name in KEYS if (value := own.get(name)) is not None}
    context = {
        "title": title,
        "guard": f"{title.prefix.upper()}_MCCONF_H_",
        "values": [(name, define(name), text, KEYS[name].says) for name, text in values.items()],
    }
    xml = render("firmware/vesc/mcconf.xml.j2", context)
    header = render("firmware/vesc/mcconf.h.j2", context)
    if existing_text is not None and is_xml(existing_text):
        xml = with_texts(existing_text, _EXISTING, _as_named_in_xml(values, existing_text))
    elif existing_text is not None:
        header = _with_macros(existing_text, values)
    return {
        f"{title.prefix}_mcconf.xml": xml.encode("utf-8"),
        f"{title.prefix}_mcconf.h": header.encode("utf-8"),
    }


def _as_careful(own: Mapping[str, OwnValue], text: str) -> dict[str, OwnValue]:
    """The values with the limit of braking and the trip of an existing file where they allow less:
    the battery and the board decide them as well.
    """
    kept = dict(own)
    try:
        theirs = read(text, _EXISTING).own
    except InputError:  # A value without a number limits nothing.
        return kept
    for name in OF_PROJECT:
        one, other, largest = own.get(name), theirs.get(name), own.get("l_current_max")
        if not all(isinstance(value, float) for value in (one, other, largest)):
            continue
        less = 0.0 < abs(float(other or 0.0)) < abs(float(one or 0.0))
        if less and (name == "l_current_min" or float(other or 0.0) > float(largest or 0.0)):
            kept[name] = float(other or 0.0)
    return kept


def printed(value: OwnValue) -> str:
    """A value as VESC Tool prints it."""
    return number_text(value, SIGNIFICANT)


def _as_named_in_xml(values: dict[str, str], text: str) -> dict[str, str]:
    """The values by the names that the text uses: those of older versions where it has them."""
    former = {new: old for old, new in FORMER.items() if f"<{old}>" in text}
    return {former.get(name, name): value for name, value in values.items()}


def _with_macros(text: str, values: dict[str, str]) -> str:
    """The header with other texts behind its macros; those that it has not stand before its end."""
    macros = read_macros(text, _EXISTING)
    former = {new: define(old) for old, new in FORMER.items() if define(old) in macros}
    named = {former.get(name, define(name)): value for name, value in values.items()}
    changed = with_values(text, macros, named)
    missing = "".join(
        f"#define {name} {value}\n" for name, value in named.items() if name not in macros
    )
    if not missing:
        return changed
    head, end, tail = changed.rpartition("#endif")
    guarded = end and macros.every and macros.every[0].text == ""
    return f"{head}{missing}\n{end}{tail}" if guarded else f"{changed.rstrip()}\n\n{missing}"


# VESC among the firmware whose files are written and read.

TARGET = Target(
    VESC,
    "VESC (bldc firmware and VESC Tool, parameters of 7.01)",
    write,
    recognise,
    read,
    of_project=frozenset(OF_PROJECT),
    one_meaning=True,
)
