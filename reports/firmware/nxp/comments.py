"""Inputs of MCAT in the comments of its headers: one JSON, or lines such as
``//Loop bandwidth = 280 [Hz]``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import FLAGS, INPUTS, MACROS, SPELLINGS
from dqforge.reports.firmware.json_text import JsonText, parsed_json
from dqforge.reports.firmware.target import no_number, plain_number

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
