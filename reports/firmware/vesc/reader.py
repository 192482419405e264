"""VESC's motor configurations read: XML of VESC Tool, or a header with its macros."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import PurePath

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Configuration, Number, Origin
from dqforge.optimizer.firmware.vesc_format import KEYS, LOOP_DEFAULTS, configuration, version_of
from dqforge.reports.firmware.c_macros import parsed_xml, read_macros
from dqforge.reports.firmware.target import no_number, plain_number

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
