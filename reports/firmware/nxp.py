"""Headers of NXP's MCAT, read and written: inputs from their comments, constants from their macros;
whole, or into a project's own one, which keeps everything else.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from decimal import ROUND_HALF_UP, Decimal
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.mcat_numbers import (
    FLAGS,
    INPUTS,
    MACROS,
    PROJECT_INPUTS,
    PROJECT_MACROS,
    SPELLINGS,
)
from dqforge.optimizer.firmware.mcat_sheet import McatFile
from dqforge.optimizer.firmware.targets.nxp import NXP
from dqforge.reports.firmware.c_macros import Macros, read_macros, with_values
from dqforge.reports.firmware.json_text import JsonText, parsed_json, with_json_values
from dqforge.reports.firmware.target import Target, no_number, plain_number
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import FileTitle


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


# Headers of MCAT written: whole, or into a project's own one, which keeps everything else.

_EXISTING = "existing file"

_BEFORE_USER = re.compile(r"^[ \t]*/\* USER INPUT START \*/", re.MULTILINE)


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``m1_pmsm_appconfig.h``, or that of the motor of an existing file.

    Args:
        found: The configuration.
        title: What stands at its head.
        existing_text: A header of the project, whose macros, comments and user's lines stay; the
            constants are made for its age. None for a new one.

    Raises:
        InputError: The existing file is that of another arithmetic, or none of MCAT.
    """
    file = McatFile.of(found)
    if existing_text is None:
        return {"m1_pmsm_appconfig.h": _anew(file, title).encode("utf-8")}
    theirs = read_file(existing_text, _EXISTING)
    if theirs.edition.fixed != file.edition.fixed:
        ours = "fixed point" if file.edition.fixed else "float"
        raise InputError(
            f"the existing header is not one of a {ours} build, as the design requires; name one "
            f"that is, or give or leave out control.current_loop.q_formats",
            source=_EXISTING,
        )
    prefix = motor_of(existing_text) or "M1_"
    file = file.in_edition(theirs.edition.version).in_project(theirs)
    text = _merged(file, prefix, existing_text)
    return {f"{prefix.lower()}pmsm_appconfig.h": text.encode("utf-8")}


def _anew(file: McatFile, title: FileTitle) -> str:
    sections = [
        (section, [(macro, _text(file, macro)) for macro in macros if macro in file.own])
        for section, macros in MACROS.items()
    ]
    values = {
        section: {key: _value(key, file.own[key]) for key in keys if key in file.own}
        for section, keys in INPUTS.items()
    }
    motor = {"motorName": file.name, "motorDescription": f"made by dqforge {title.version}"}
    context = {
        "title": title,
        "version": file.edition.version,
        "file": "m1_pmsm_appconfig.h",
        "prefix": "M1_",
        "inputs": _json(values),
        "motor": _json(motor),
        "sections": sections,
    }
    return render("firmware/nxp/m1_pmsm_appconfig.h.j2", context)


def _text(file: McatFile, macro: str) -> str:
    return constant_text(float(file.own[macro]), file.kind(macro), commented=file.edition.commented)


def _value(key: str, value: OwnValue) -> OwnValue:
    """An input as JSON holds it: flags as such, whole numbers without a point."""
    if key in FLAGS:
        return bool(value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _json(values: object) -> str:
    """As MCAT's own reader takes it, and without what would end a comment."""
    return json.dumps(values, indent=4, ensure_ascii=True).replace("/", "\\u002f")


def _merged(file: McatFile, prefix: str, text: str) -> str:
    text = _with_comments(file, text)
    macros = read_macros(text, _EXISTING)
    texts = {
        prefix + macro.removeprefix("M1_"): _text(file, macro)
        for group in MACROS.values()
        for macro in group
        if macro in file.own
    }
    changed = with_values(text, macros, texts)
    missing = "".join(
        f"#define {macro} {value}\n" for macro, value in texts.items() if macro not in macros
    )
    if not missing:
        return changed
    user = _BEFORE_USER.search(changed)
    place = user.start() if user else changed.rfind("#endif")
    place = len(changed) if place < 0 else place
    return f"{changed[:place]}{missing}{changed[place:]}"


def _with_comments(file: McatFile, text: str) -> str:
    """The text with the inputs in its comments changed where they stand."""
    held = with_inputs(objects(text, _EXISTING))
    if held is not None:
        inside = with_json_values(text[held.start : held.end], _EXISTING, _changes(file, held.json))
        return text[: held.start] + inside + text[held.end :]
    lines = text.split("\n")
    for part in line_inputs(text, _EXISTING):
        value = file.own.get(part.key)
        if value is not None and not isinstance(value, str):
            line = lines[part.line - 1]
            head, sign, tail = line.partition("=")
            lines[part.line - 1] = head + sign + tail.replace(part.text, plain(value), 1)
    return "\n".join(lines)


def _changes(file: McatFile, json_text: JsonText) -> dict[tuple[str, ...], OwnValue]:
    """Values of the inputs that stand there already, by path."""
    changes: dict[tuple[str, ...], OwnValue] = {}
    spelled = {ours: theirs for theirs, ours in SPELLINGS.items()}
    for section, keys in INPUTS.items():
        there = json_text.value(section)
        if not isinstance(there, dict):
            continue
        for key in keys:
            name = key if key in there else spelled.get(key, key)
            value = file.own.get(key)
            if key == "parametersKt" and value is None and file.edition.current_share != 1.0:
                value = file.own.get("parametersKe")
            if name in there and value is not None:
                changes[section, name] = _value(key, value)
    return changes


# Numbers as MCAT's headers print them.

DIGITS = 6


def constant_text(value: float, kind: str, *, commented: bool) -> str:
    """The text behind a macro.

    Args:
        value: Its number.
        kind: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``.
        commented: Whether it is that of the older age, which prints all digits.
    """
    if kind == "plain":
        return f"({plain(value)})"
    text = _all_digits(value) if commented else six_digits(value)
    return f"({text}F)" if kind == "float" else f"{kind}({text})"


def six_digits(value: float) -> str:
    """As it is with fewer than six decimal places, else with six significant digits."""
    if value == int(value):
        return f"{value:.1f}"
    exact = Decimal(repr(value))
    exponent = exact.as_tuple().exponent
    if isinstance(exponent, int) and -exponent < DIGITS:
        return f"{exact:f}"
    step = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    return f"{Decimal(value).quantize(step, rounding=ROUND_HALF_UP):f}"


def plain(value: float | bool) -> str:
    """A number without exponent, whole ones without a point; true or false."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not value.is_integer():
        return f"{Decimal(repr(value)):f}"
    return str(int(value))


def _all_digits(value: float) -> str:
    return f"{value:.1f}" if value == int(value) else f"{Decimal(repr(value)):f}"


# NXP's motor control among the firmware whose files are written and read.

TARGET = Target(
    NXP,
    "NXP motor control (MCAT: m1_pmsm_appconfig.h, 2016 to 2026)",
    write,
    recognise,
    read,
    of_project=frozenset(PROJECT_INPUTS + PROJECT_MACROS),
)
