"""Headers of MCAT read: inputs from their comments, constants from their macros."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import PurePath

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import FLAGS, INPUTS, MACROS, SPELLINGS
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import McatFile
from dqforge.reports.firmware.c_macros import Macros, read_macros
from dqforge.reports.firmware.json_text import JsonText, parsed_json
from dqforge.reports.firmware.target import no_number, plain_number

FRACTIONS = ("FRAC16", "FRAC32", "ACC32")
MOST_DIGITS = 7  # Significant digits beyond which a header is one of the older age.

# What the headers of the library define for all that include them.
_PI = "\n#define FLOAT_PI 3.14159265358979\n#define PI FLOAT_PI\n"
_NUMBER = re.compile(r"\d*\.\d+")
_NAME = re.compile(r"(?<![\w.])[A-Z_][A-Z0-9_]*\b", re.ASCII)
_KEPT = dict.fromkeys(FRACTIONS, float)


def recognise(name: str, text: str) -> bool:
    """Whether a file is a header of MCAT for one motor.

    Args:
        name: Its name.
        text: Its text.
    """
    if not name.lower().endswith((".h", ".hpp", ".txt", ".c")):
        return False
    return motor_of(text) is not None and "_D_KP_GAIN" in text


def read(text: str, place: str) -> Configuration:
    """The configuration in a header of MCAT.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It is none, or a constant or an input is no number; with the line.
    """
    return read_file(text, place).configuration()


def read_file(text: str, place: str) -> McatFile:
    """A header with the age that it is of; as `read`."""
    prefix = motor_of(text)
    if prefix is None:
        raise InputError(
            "this file holds none of MCAT's macros (M1_MOTOR_PP, M1_I_MAX, M1_D_KP_GAIN); name "
            "the m1_pmsm_appconfig.h of the project",
            source=place,
        )
    macros = read_macros(text + _PI, place, functions=_KEPT)
    if f"{prefix}R_R" in macros or f"{prefix}L_M" in macros:
        rotor = next(name for name in (f"{prefix}R_R", f"{prefix}L_M") if name in macros)
        macros.refuse(
            rotor,
            "makes this the header of an induction machine; name that of a machine with magnets",
        )
    own: dict[str, OwnValue] = {}
    origins: dict[str, Origin] = {}
    found = objects(text, place)
    name = motor_name(found) or PurePath(place).stem
    inputs = with_inputs(found)
    if inputs is not None:
        for key, value, written, line in json_inputs(inputs.json):
            own[key], origins[key] = value, Origin(key, written, line)
    commented = False
    if inputs is None:
        for part in line_inputs(text, place):
            own[part.key] = plain_number(part.text) or 0.0
            origins[part.key] = Origin(part.key, part.text, part.line)
            commented = True
    _constants(macros, prefix, own, origins)
    if inputs is None and not commented:
        _by_hand(macros, prefix, own, origins)
    fixed = _is_fixed(macros, prefix)
    old = commented or (inputs is None and _has_many_digits(macros, prefix))
    file = McatFile.read(name, own, origins, fixed=fixed, commented=old)
    return replace(file, origins=_by_field(origins, file))


def _constants(
    macros: Macros, prefix: str, own: dict[str, OwnValue], origins: dict[str, Origin]
) -> None:
    """Constants by the macros of the first motor; MCAT leaves some empty."""
    for macro in macros:
        name = f"M1_{macro.removeprefix(prefix)}" if macro.startswith(prefix) else ""
        text = macros.text(macro) or ""
        if name not in KNOWN or not text or text.startswith("(uint16_t)"):
            continue
        value = None if _built_elsewhere(macros, macro) else macros.number(macro)
        if value is not None:
            own[name] = int(value) if name.endswith(("_SHIFT", "_PP")) else value
            origins[name] = Origin(macro, text, macros.line(macro))


def _built_elsewhere(macros: Macros, macro: str) -> bool:
    """Whether a constant has no value here because names in it are defined in other headers."""
    if macros.value(macro) is not None:
        return False
    seen, waiting = {macro}, [macro]
    while waiting:
        for name in _NAME.findall(macros.text(waiting.pop()) or ""):
            if name not in macros and name not in FRACTIONS:
                return True
            if name not in seen:
                seen.add(name)
                waiting.append(name)
    return False


def _by_hand(
    macros: Macros, prefix: str, own: dict[str, OwnValue], origins: dict[str, Origin]
) -> None:
    """What headers that are kept by hand say in macros of their own, in place of inputs."""
    if macros.value(f"{prefix}N_NOM_RAD") is not None:
        name = f"{prefix}N_NOM_RAD"
        own["M1_N_NOM"] = macros.needed(name)
        origins["M1_N_NOM"] = Origin(name, macros.text(name) or "", macros.line(name))
    for macro, key, inverse in BY_HAND:
        value = macros.value(prefix + macro)
        if key in own or value is None or (inverse and not value):
            continue
        own[key] = 1.0 / value if inverse else float(value)
        text = macros.text(prefix + macro) or ""
        origins[key] = Origin(prefix + macro, text, macros.line(prefix + macro))


def _is_fixed(macros: Macros, prefix: str) -> bool:
    text = macros.text(f"{prefix}D_KP_GAIN") or macros.text(f"{prefix}CLOOP_LIMIT") or ""
    return text.lstrip("( ").startswith(FRACTIONS)


def _has_many_digits(macros: Macros, prefix: str) -> bool:
    """Whether gains are printed with more digits than MCAT prints since 2021."""
    for name in ("D_KP_GAIN", "Q_KP_GAIN", "BEMF_DQ_KP_GAIN"):
        found = _NUMBER.search(macros.text(prefix + name) or "")
        if found is not None and len(found[0].replace(".", "").lstrip("0")) > MOST_DIGITS:
            return True
    return False


def _by_field(origins: dict[str, Origin], file: McatFile) -> dict[str, Origin]:
    """Origins of the fields of a drive and of its gains, beside those of the file's own names."""
    named = {field: origins[key] for field, key in _FIELDS.items() if key in origins}
    for field, key in _UNROUNDED.items():
        if key in origins and file.sheet.meant(_FIELDS[field]):
            named[field] = origins[key]
    if "psi_pm" not in named and "parametersKe" in origins:
        named["psi_pm"] = origins["parametersKe"]
    return {**origins, **named}


_FIELDS = {
    "pole_pairs": "M1_MOTOR_PP",
    "r_s": "parametersRs",
    "l_d": "parametersLd",
    "l_q": "parametersLq",
    "psi_pm": "parametersKt",
    "inertia": "parametersJ",
    "i_max": "M1_SPEED_LOOP_HIGH_LIMIT",
    "omega_m_max": "M1_N_NOM",
    "v_dc": "parametersUphNom",
    "t_s": "currentLoopSampleTime",
    "t_speed": "speedLoopSampleTime",
    "current_d.kp": "M1_D_KP_GAIN",
    "current_d.ki": "M1_D_KI_GAIN",
    "current_q.kp": "M1_Q_KP_GAIN",
    "current_q.ki": "M1_Q_KI_GAIN",
    "speed.kp": "M1_SPEED_PI_PROP_GAIN",
    "speed.ki": "M1_SPEED_PI_INTEG_GAIN",
    "pll.kp": "M1_TO_KP_GAIN",
    "pll.ki": "M1_TO_KI_GAIN",
}

_UNROUNDED = {"i_max": "speedLoopUpperLimit", "omega_m_max": "parametersNnom"}


# Inputs of MCAT in the comments of its headers: one JSON, or lines such as ``//Loop bandwidth =
# 280 [Hz]``.

_OBJECT = re.compile(r"/\*\s*(\{.*?\})\s*\*/", re.DOTALL)

_LINE = re.compile(
    r"^[ \t]*(?://|\*)[ \t]*([A-Za-z][\w \t&-]*?)[ \t]*=[ \t]*(\S+)[ \t]*\[[^\]\n]*\][ \t]*$"
)


@dataclass(frozen=True, slots=True)
class InputLine:
    """One input in a line comment: its key, its text, its one-based line."""

    key: str
    text: str
    line: int


@dataclass(frozen=True, slots=True)
class CommentObject:
    """A JSON object that is a comment: where it stands, and what it holds."""

    start: int
    end: int
    json: JsonText


def objects(text: str, place: str) -> list[CommentObject]:
    """JSON objects among the comments of a header, in their order.

    Args:
        text: The text of the header.
        place: Its path, for messages.

    Raises:
        InputError: A comment begins as one and is none; with the line.
    """
    return [
        CommentObject(found.start(1), found.end(1), _alone(text, found, place))
        for found in _OBJECT.finditer(text)
    ]


def _alone(text: str, found: re.Match[str], place: str) -> JsonText:
    """The object with so many ends of lines above it that its lines are those of the file."""
    return parsed_json("\n" * text.count("\n", 0, found.start(1)) + found[1], place)


def motor_name(found: list[CommentObject]) -> str | None:
    """The name of the motor in these objects."""
    for part in found:
        name = part.json.value("motorName")
        if isinstance(name, str):
            return name
    return None


def with_inputs(found: list[CommentObject]) -> CommentObject | None:
    """The object that holds the inputs."""
    for part in found:
        if isinstance(part.json.value("parameters"), dict):
            return part
    return None


def json_inputs(json: JsonText) -> Iterator[tuple[str, float | bool, str, int | None]]:
    """Inputs that are there: key, value, text and line.

    Args:
        json: The object of inputs.

    Raises:
        InputError: An input is neither a number nor empty; with its line.
    """
    spelled = {key: key for keys in INPUTS.values() for key in keys} | SPELLINGS
    for section in INPUTS:
        held = json.value(section)
        if held is None:
            continue
        if not isinstance(held, dict):
            json.refuse((section,), "is no section of inputs; copy the comment from MCAT again")
        for key, value in held.items():
            if key not in spelled or value == "":
                continue
            number: float | bool | None
            if key in FLAGS and isinstance(value, bool):
                number = value
            else:
                number = json.number(section, key)
            if number is not None:
                where = json.line(section, key)
                yield spelled[key], number, json.written(section, key), where


def line_inputs(text: str, place: str) -> Iterator[InputLine]:
    """Inputs of the line comments of older headers.

    Args:
        text: The text of the header.
        place: Its path, for messages.

    Raises:
        InputError: A known input is followed by something that is no number; with the line.
    """
    loop: tuple[str, ...] = ()
    for number, line in enumerate(text.split("\n"), 1):
        found = _LINE.match(line)
        if found is None:
            loop = _loop_below(line, loop)
            continue
        what = " ".join(found[1].lower().split())
        key = COMMENTED.get(what, "")
        if what in LOOP_WORDS and loop:
            key = loop[LOOP_WORDS.index(what)]
        if key:
            if plain_number(found[2]) is None:
                message = f"{found[1].strip()} {no_number(found[2])}"
                raise InputError(message, source=place, line=number)
            yield InputLine(key, found[2], number)


def _loop_below(line: str, loop: tuple[str, ...]) -> tuple[str, ...]:
    """The inputs that the comments below a line are about."""
    heading = HEADING_LINE.match(line)
    if heading is None:
        return loop
    words = " ".join(heading[1].lower().split())
    for start, keys in COMMENTED_LOOPS.items():
        if words.startswith(start):
            return keys
    return () if words.startswith("position & speed") else loop


# Which motor a header of MCAT is that of, and the line comments of its older age.

# Macros that are read and written, as of the first motor.
KNOWN = frozenset(macro for macros in MACROS.values() for macro in macros)

# Inputs by what stands before the sign of equality in a comment.
COMMENTED = {
    "pole-pair number": "parametersPP",
    "pole-pair numbers": "parametersPP",
    "stator resistance": "parametersRs",
    "direct axis inductance": "parametersLd",
    "quadrature axis inductance": "parametersLq",
    "back-emf constant": "parametersKe",
    "drive inertia": "parametersJ",
    "nominal current": "parametersIphNom",
}

# Inputs of the comments on bandwidth, attenuation and sample time, by the heading above them.
COMMENTED_LOOPS = {
    "current loop control": ("currentLoopF0", "currentLoopKsi", "currentLoopSampleTime"),
    "speed loop control": ("speedLoopF0", "speedLoopKsi", "speedLoopSampleTime"),
    "sensorless bemf": ("sensorlessBemfObsrvF0", "sensorlessBemfObsrvKsi", ""),
}

# Macros of headers that are kept by hand, inputs that they stand for, and whether as one over.
BY_HAND = (
    ("R", "parametersRs", False),
    ("LD", "parametersLd", False),
    ("LQ", "parametersLq", False),
    ("CLOOP_FREQ", "currentLoopF0", False),
    ("CURRENT_CLOOP_FREQ", "currentLoopF0", False),
    ("CLOOP_ATT", "currentLoopKsi", False),
    ("CURRENT_CLOOP_ATT", "currentLoopKsi", False),
    ("FAST_LOOP_FREQ", "currentLoopSampleTime", True),
    ("FASTLOOP_FREQ", "currentLoopSampleTime", True),
    ("SLOW_LOOP_FREQ", "speedLoopSampleTime", True),
    ("SLOWLOOP_FREQ", "speedLoopSampleTime", True),
)

LOOP_WORDS = ("loop bandwidth", "loop attenuation", "loop sample time")
HEADING_LINE = re.compile(r"^[ \t]*(?://|/?\*+)[ \t]*([A-Za-z][^=\n]*)$")
_PREFIX = re.compile(r"^[ \t]*#[ \t]*define[ \t]+M([1-9])_(?:MOTOR_PP|I_MAX|D_KP_GAIN)\b", re.M)


def motor_of(text: str) -> str | None:
    """The prefix of the macros, such as ``M1_``; None where no motor's macros stand there.

    Args:
        text: The text of the header.
    """
    found = _PREFIX.search(text)
    return None if found is None else f"M{found[1]}_"
