"""VESC's motor configurations read: XML of VESC Tool, or a header with its macros."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import PurePath

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Configuration, Number, Origin
from dqforge.optimizer.firmware.vesc_format import configuration, version_of
from dqforge.reports.firmware.c_macros import parsed_xml, read_macros
from dqforge.reports.firmware.target import no_number, plain_number
from dqforge.reports.firmware.vesc.names import FORMER, READ, WHOLE, WORDS, define

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
