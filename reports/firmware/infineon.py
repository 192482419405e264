"""Parameters of Infineon's motor-ctrl-lib, read and written: assignments to its structure
``params``, in files as ParamsDefault.c and in those that dqforge writes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Configuration, Number, Origin, OwnValue
from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.infineon_format import (
    KEYS,
    READ_ONLY,
    TABLE,
    TABLE_KEYS,
    TABLE_POINTS,
    Key,
    Kind,
    Place,
    configuration,
)
from dqforge.optimizer.firmware.targets.infineon import INFINEON
from dqforge.reports.firmware.c_macros import (
    Definition,
    Macros,
    NotArithmeticError,
    Unknown,
    evaluated,
    read_assignments,
    tokens_of,
    with_values,
    without_comments,
)
from dqforge.reports.firmware.target import (
    IN_RANGE,
    Target,
    c_float,
    in_range,
    no_number,
    plain_number,
)
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import FileTitle


ROTOR_FRAME = ("CTRL_METHOD_RFO",)

# Symbols of the two builds: the first is read, of the second its table alone.
STATOR_FRAME = ("CTRL_METHOD_SFO",)
_MARKS = re.compile(r"\bparams(?:_ptr)?(?:->|\.)(?:motor|ctrl)\.", re.ASCII)
_PATH = re.compile(r"[A-Za-z_]\w*(?:(?:->|\.)[A-Za-z_]\w*|\[\d{1,6}\])*", re.ASCII)
_POINTS = re.compile(r"_mtpa_flux_Wb\[\s*\d+U?\s*\]\s*=\s*\{([^{}]{0,20000})\}", re.ASCII)

# Names as headers give them to the constants of a board.
_ELSEWHERE = re.compile(r"[A-Z][A-Z0-9_]*", re.ASCII)
_LONGEST = 500


def recognise(name: str, text: str) -> bool:
    """Whether a file assigns parameters of motor-ctrl-lib.

    Args:
        name: Its name.
        text: Its text.
    """
    return name.lower().endswith((".c", ".h", ".hpp", ".txt")) and _MARKS.search(text) is not None


def read(text: str, place: str) -> Configuration:
    """The parameters in a file, as the build with rotor frame orientation takes them.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It assigns none of them, or something that is no number; with the line.
    """
    own, origins, left = _members(assignments(text, place))
    points = _table(text, place)
    if points is not None:
        of_table, where, _ = _members(assignments(text, place, STATOR_FRAME))
        own |= {name: of_table[name] for name in TABLE_KEYS if name in of_table}
        origins |= {name: where[name] for name in TABLE_KEYS if name in where}
        own[TABLE] = points
    if not any(name.startswith("params.motor.") for name in own):
        raise InputError(
            "this file assigns no members of params.motor; name ParamsDefault.c or what stands "
            "for it",
            source=place,
        )
    found = configuration(PurePath(place).stem, own, origins)
    return replace(found, conventions=(*found.conventions, *left))


def assignments(text: str, place: str, build: tuple[str, ...] = ROTOR_FRAME) -> Macros:
    """What a build assigns, that with rotor frame orientation where none is named."""
    return read_assignments(kept_by_build(text, place, build), place)


def _members(
    found: Macros,
) -> tuple[dict[str, OwnValue], dict[str, Origin], tuple[str, ...]]:
    """Values of the members that are read, where they stand, and sentences on those left out
    because another header defines what is assigned to them.
    """
    own: dict[str, OwnValue] = {}
    origins: dict[str, Origin] = {}
    values: dict[str, Number] = {}
    left: list[str] = []
    for definition in found.every:
        name = member(definition.name)
        value = _value(definition.text, values)
        if isinstance(value, (int, float)):
            values[name or definition.name] = value
        if name is None or name not in KINDS:
            continue
        if isinstance(value, str) and KINDS[name] != "word" and _ELSEWHERE.fullmatch(value):
            left.append(
                f"{definition.name} is {shown(definition.text)}, which this file does not define: "
                "omitted"
            )
        elif value is not None:
            own[name] = _as_kind(found, definition, name, value)
            origins[name] = Origin(definition.name, definition.text, definition.line)
        else:
            _refuse_unless_open(found, definition)
    return own, origins, tuple(left)


def _value(text: str, values: dict[str, Number]) -> Number | str | None:
    """Value of an expression of numbers, conversions and members assigned before; a word where it
    is one; None of anything else.
    """
    if len(text) > _LONGEST:
        return None

    def written(found: re.Match[str]) -> str:
        name = member(found[0]) or found[0]
        value = values.get(name, CONSTANTS.get(name))
        return found[0] if value is None else f"({value!r})"

    try:
        value = evaluated(tokens_of(_PATH.sub(written, text)), FUNCTIONS)
    except NotArithmeticError:
        return None
    return value.name if isinstance(value, Unknown) else value


def _as_kind(found: Macros, definition: Definition, name: str, value: Number | str) -> OwnValue:
    kind = KINDS[name]
    if (kind == "word") != isinstance(value, str):
        wanted = "an enumerator such as En" if kind == "word" else "a number"
        _refuse(found, definition, f"is {shown(definition.text)}; write {wanted}")
    if isinstance(value, str):
        return value
    if not in_range(value):
        _refuse(found, definition, f"is beyond every firmware's range; {IN_RANGE}")
    if kind == "real":
        return float(value)
    if not float(value).is_integer() or not 0 <= value <= 2**31:
        _refuse(found, definition, f"is {value:g}; write a whole number")
    return int(value)


def _refuse_unless_open(found: Macros, definition: Definition) -> None:
    """Refuse what is no arithmetic; what builds on members that are not assigned is left out."""
    names = [match[0] for match in _PATH.finditer(definition.text)]
    if not any(member(name) for name in names):
        _refuse(found, definition, f"is {shown(definition.text)}, not a number; write one")


def _refuse(found: Macros, definition: Definition, complaint: str) -> None:
    raise InputError(f"{definition.name} {complaint}", source=found.source, line=definition.line)


def _table(text: str, place: str) -> str | None:
    """Points of the flux linkage over torque; None without a table."""
    found = _POINTS.search(text)
    if found is None:
        return None
    line = text.count("\n", 0, found.start()) + 1
    parts = [part.strip() for part in found[1].split(",") if part.strip()]
    numbers = [plain_number(part.rstrip("fF")) for part in parts]
    if len(numbers) != TABLE_POINTS:
        message = f"the table has {len(numbers)} points; write {TABLE_POINTS}"
        raise InputError(message, source=place, line=line)
    for part, value in zip(parts, numbers, strict=True):
        if value is None:
            message = f"a point of the table {no_number(part)}"
            raise InputError(message, source=place, line=line)
    return ", ".join(f"{value:.7g}" for value in numbers if value is not None)


# Macros of motor-ctrl-lib that its parameters are written with, and names of its structure.

# Members that are read, by name, with their kinds.
KINDS: Mapping[str, Kind] = {
    name: key.kind for keys in (KEYS, TABLE_KEYS, READ_ONLY) for name, key in keys.items()
}

_TWO_PI = 2.0 * math.pi

# Functions and conversions of General.h.
FUNCTIONS: Mapping[str, Callable[..., float]] = {
    "HZ_TO_RADSEC": lambda x: _TWO_PI * x,
    "RADSEC_TO_HZ": lambda x: x / _TWO_PI,
    "TAU_TO_RADSEC": lambda x: 1.0 / x,
    "RADSEC_TO_TAU": lambda x: 1.0 / x,
    "PERIOD_TO_RADSEC": lambda x: _TWO_PI / x,
    "MECH_TO_ELEC": lambda x, poles: 0.5 * x * poles,
    "ELEC_TO_MECH": lambda x, poles: 2.0 * x / poles,
    "RPM_TO_HZ": lambda x: x / 60.0,
    "HZ_TO_RPM": lambda x: x * 60.0,
    "DEG_TO_RAD": math.radians,
    "RAD_TO_DEG": math.degrees,
    "RMS_TO_PK": lambda x: x * math.sqrt(2.0),
    "PK_TO_RMS": lambda x: x / math.sqrt(2.0),
    "PHASE_TO_LINE": lambda x: x * math.sqrt(3.0),
    "LINE_TO_PHASE": lambda x: x / math.sqrt(3.0),
    "PERC_TO_NORM": lambda x: 0.01 * x,
    "POW_TWO": lambda x: x * x,
    "POW_THREE": lambda x: x**3,
    "MIN": min,
    "MAX": max,
    "ABS": abs,
    "sqrtf": math.sqrt,
}

CONSTANTS: Mapping[str, float] = {
    "TWO_PI": _TWO_PI,
    "PI": math.pi,
    "ONE_OVER_TWO_PI": 1.0 / _TWO_PI,
    "SQRT_TWO": math.sqrt(2.0),
    "SQRT_THREE": math.sqrt(3.0),
    "ONE_OVER_SQRT_TWO": math.sqrt(0.5),
    "ONE_OVER_SQRT_THREE": 1.0 / math.sqrt(3.0),
    "LUT_1D_WIDTH": 128.0,
}

# What leads to a member: params itself, or a pointer to it.
STRUCTURE = re.compile(r"(?:^|\.)params(?:_ptr)?\.", re.ASCII)


def member(assigned: str) -> str | None:
    """Name of a member as ``params.motor.r``, of what is assigned; None of anything else."""
    plain = assigned.replace("->", ".")
    found = STRUCTURE.search(plain)
    return None if found is None else f"params.{plain[found.end() :]}"


# Which lines of a C source a build keeps: conditions worked out for the symbols of a project, all
# others blanked, every character in its place.

_DIRECTIVE = re.compile(r"[ \t]*#[ \t]*([a-z]+)\b[ \t]*(.*)", re.ASCII)


_ASKED = re.compile(r"\bdefined\s*(?:\(\s*([A-Za-z_]\w*)\s*\)|([A-Za-z_]\w*))", re.ASCII)


_MOST_DEPTH = 64


def kept_by_build(text: str, source: str, symbols: Collection[str]) -> str:
    """The text without comments, directives and the lines that a build with these symbols leaves
    out.

    A condition on anything but symbols counts as true.

    Raises:
        InputError: Conditions are not closed, or closed without being opened; with the line.
    """
    branches: list[tuple[bool, bool]] = []  # whether this branch counts, whether one has
    opened: list[int] = []  # lines of the conditions that are open
    kept = []
    for index, line in enumerate(without_comments(text, source).split("\n")):
        found = _DIRECTIVE.fullmatch(line)
        if found is None:
            kept.append(line if all(taken for taken, _ in branches) else " " * len(line))
            continue
        kept.append(" " * len(line))
        _step(branches, found[1], found[2], symbols, (source, index + 1))
        opened = [*opened, index + 1][: len(branches)]
    if branches:
        message = "the condition has no #endif; write it, or copy the whole file"
        raise InputError(message, source=source, line=opened[-1])
    return "\n".join(kept)


def _step(
    branches: list[tuple[bool, bool]],
    word: str,
    rest: str,
    symbols: Collection[str],
    place: tuple[str, int],
) -> None:
    source, line = place
    if word in ("if", "ifdef", "ifndef"):
        if len(branches) >= _MOST_DEPTH:
            message = f"more than {_MOST_DEPTH} nested conditions; name a smaller file"
            raise InputError(message, source=source, line=line)
        holds = _holds(word, rest, symbols)
        branches.append((holds, holds))
    elif word in ("elif", "else", "endif"):
        if not branches:
            message = f"#{word} without #if; copy the whole file"
            raise InputError(message, source=source, line=line)
        _, done = branches.pop()
        if word != "endif":
            taken = not done and (word == "else" or _holds("if", rest, symbols))
            branches.append((taken, done or taken))


def _holds(word: str, rest: str, symbols: Collection[str]) -> bool:
    if word != "if":
        return (rest.split()[:1] in [[symbol] for symbol in symbols]) == (word == "ifdef")
    asked = _ASKED.sub(lambda found: str(int((found[1] or found[2]) in symbols)), rest)
    try:
        value = evaluated(tokens_of(asked), {})
    except NotArithmeticError:
        return True
    return isinstance(value, Unknown) or bool(value)


# Parameters of motor-ctrl-lib written: two functions that assign them, or the values in a file
# that assigns them already.

_EXISTING = "existing file"


_PER_LINE = 8


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_params.h``.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: What stands at the head of the file.
        existing_text: A ParamsDefault.c or a header as written before: what it assigns to members
            that the design decides is replaced, but for those for starting the motor; everything
            else stays. None without one.
    """
    name = f"{title.prefix}_params.h"
    if existing_text is not None:
        return {name: _with_values(existing_text, found).encode("utf-8")}
    own = found.own
    points = str(own.get(TABLE, "")).split(", ") if TABLE in own else []
    text = render(
        "firmware/infineon/params.h.j2",
        {
            "title": title,
            "guard": f"{title.prefix.upper()}_PARAMS_H",
            "any": _lines(own, "any"),
            "rotor": _lines(own, "rotor"),
            "gains": _lines(own, "gains"),
            "table": [_line(own, name, key) for name, key in TABLE_KEYS.items() if name in own],
            "width": TABLE_POINTS,
            "points": [
                ", ".join(
                    c_float(float(point), FLOAT32_DIGITS)
                    for point in points[start : start + _PER_LINE]
                )
                for start in range(0, len(points), _PER_LINE)
            ],
        },
    )
    return {name: text.encode("utf-8")}


def _lines(own: Mapping[str, OwnValue], place: Place) -> list[tuple[str, str, str]]:
    return [
        _line(own, name, key) for name, key in KEYS.items() if key.place == place and name in own
    ]


def _line(own: Mapping[str, OwnValue], name: str, key: Key) -> tuple[str, str, str]:
    """What is assigned, its text, and its unit with what it means."""
    words = f"{key.unit}: {key.says}" if key.unit else key.says
    return name.replace("params.", "params->", 1), printed(own[name], key.kind), words


def printed(value: OwnValue, kind: Kind) -> str:
    """A value as the library's members take it."""
    if isinstance(value, str):
        return value
    if kind == "count" and isinstance(value, int):
        return f"{value:d}U"
    return c_float(value, FLOAT32_DIGITS)


def _with_values(text: str, found: Configuration) -> str:
    """The text with the design's values behind what it assigns; the table stays what the library
    makes of it.
    """
    there = assignments(text, _EXISTING)
    wanted = {
        name: printed(value, KEYS[name].kind)
        for name, value in found.own.items()
        if name in KEYS and not KEYS[name].start
    }
    values = {
        assigned: wanted[name]
        for assigned in there
        if (name := member(assigned)) is not None and name in wanted
    }
    return with_values(text, there, values)


# Infineon's motor-ctrl-lib among the firmware whose files are written and read.

TARGET = Target(
    INFINEON, "Infineon motor-ctrl-lib (ParamsDefault.c, release 4.5)", write, recognise, read
)
