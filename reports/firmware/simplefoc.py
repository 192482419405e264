"""SimpleFOC's motors, read and written: sketches, a header, lines of the Commander."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, NoReturn

from dqforge.machines.errors import InputError, shown
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Number, Origin, OwnValue
from dqforge.optimizer.firmware.targets.simplefoc import (
    LOOP_PERIOD,
    MEMBERS,
    SIGNIFICANT,
    SIMPLEFOC,
    V_DC,
    configuration,
    voltage_limit,
)
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.firmware.c_macros import (
    Definition,
    Macros,
    NotArithmeticError,
    Unknown,
    evaluated,
    read_assignments,
    read_macros,
    tokens_of,
    with_values,
    without_comments,
)
from dqforge.reports.firmware.target import Target, c_float, number_text, plain_number
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration
    from dqforge.reports.firmware.target import FileTitle


def recognise(name: str, text: str) -> bool:
    """Whether a file sets members of a motor of SimpleFOC.

    Args:
        name: Its name.
        text: Its text.
    """
    if "BLDCMotor" in text:
        return name.lower().endswith((".h", ".hpp", ".ino", ".cpp", ".cc", ".c"))
    return is_script(text)


def read(text: str, place: str) -> Configuration:
    """The configuration of the motor in a file.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It has no motor of SimpleFOC, or a value is no number; with the line.
    """
    name = PurePath(place).stem
    if "BLDCMotor" not in text and is_script(text):
        own, origins = members_of_script(text, place)
        return configuration(name, own, origins)
    found = sketch_of(text, place)
    own, origins = members_of_sketch(found)
    own = _with_voltages(own)
    remarks: tuple[str, ...] = ()
    if found.others:
        others = ", ".join(found.others)
        remarks = (f"of several motors the first, {found.motor}, is read; {others} are not",)
    return configuration(name, own, origins, remarks)


def _with_voltages(own: dict[str, Number]) -> dict[str, Number]:
    """The members with the voltages that the text works out from the link, as far as that is
    known.
    """
    limit = voltage_limit(float(own[V_DC])) if V_DC in own else math.nan
    filled = {name: limit if math.isnan(value) else value for name, value in own.items()}
    return {name: value for name, value in filled.items() if not math.isnan(value)}


# Lines of SimpleFOC's Commander: members of a motor set over a serial line.
#
# A line that is longer than the Commander's 20 characters would be cut and its rest run as another
# command, and the Commander has no comments: what begins with a semicolon runs nothing, because no
# motor has that letter. All lines are short for that reason.

LETTER = "M"  # Letter under which a sketch has added its motor, as in the library's examples.
LONGEST = 19  # Characters of a line, so that it fits with its end into the Commander's 20.
_LINE = re.compile(r"([A-Za-z])([A-Z]{1,2})([-+.\d][^\s]*)", re.ASCII)
_NOTES = {V_DC: "link {}V", LOOP_PERIOD: "loop {}s", "pole_pairs": "pole pairs {}"}

_NOTED = {
    name: re.compile("; *" + words.replace("{}", r"(\S+)"), re.ASCII)
    for name, words in _NOTES.items()
}


def is_script(text: str) -> bool:
    """Whether all lines of a text are lines of the Commander, and some set a member."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    said = [line for line in lines if not line.startswith(";")]
    return bool(said) and all(
        (found := _LINE.fullmatch(line)) is not None and found[1] == said[0][0] for line in said
    )


def members_of_script(text: str, place: str) -> tuple[dict[str, Number], dict[str, Origin]]:
    """Values and origins of the members that a script sets.

    Raises:
        InputError: A value is no number; with its line.
    """
    own: dict[str, Number] = {}
    origins: dict[str, Origin] = {}
    for index, whole in enumerate(text.splitlines(), 1):
        line = whole.strip()
        for name, said in _said(line):
            value = plain_number(said)
            if value is None or (_is_whole(name) and not value.is_integer()):
                kind = "a whole number" if _is_whole(name) else "a number"
                message = f"{shown(line)} holds {shown(said)}, not {kind}; write one"
                raise InputError(message, source=place, line=index)
            own[name] = int(value) if _is_whole(name) else value
            origins[name] = Origin(line.removesuffix(said).strip(), said, index)
    return own, origins


def script(values: Mapping[str, OwnValue], title: FileTitle, existing: str | None) -> str:
    """Lines that set the values; lines of an existing script keep their place and their letter.

    Args:
        values: Members, link and period of the loop.
        title: What stands at the head of a new script.
        existing: A script whose other lines are to stay.
    """
    letter = _letter(existing)
    lines = {
        name: f"{letter}{member.command}{printed(values[name])}"
        for name, member in MEMBERS.items()
        if member.command and name in values
    }
    notes = {
        name: f"; {words.format(printed(values[name]))}"
        for name, words in _NOTES.items()
        if name in values
    }
    wanted = notes | lines
    if existing is None:
        head = [f"; dqforge {title.version}", f"; {title.prefix}", f"; {title.digest[:16]}"]
        return "".join(f"{line[:LONGEST]}\n" for line in (*head, *wanted.values()))
    kept = []
    for line in existing.splitlines():
        name = next((name for name, _ in _said(line.strip()) if name in wanted), None)
        kept.append(line if name is None else wanted.pop(name))
    return "".join(f"{line}\n" for line in (*kept, *wanted.values()))


def printed(value: OwnValue) -> str:
    """A value as a line holds it."""
    return number_text(value, SIGNIFICANT)


def _said(line: str) -> list[tuple[str, str]]:
    """The member that a line sets, with the text of its value; empty for all others."""
    if line.startswith(";"):
        return [
            (name, found[1])
            for name, pattern in _NOTED.items()
            if (found := pattern.fullmatch(line)) is not None
        ]
    found = _LINE.fullmatch(line)
    name = None if found is None else COMMANDS.get(found[2])
    return [] if found is None or name is None else [(name, found[3])]


def _is_whole(name: str) -> bool:
    return name in MEMBERS and MEMBERS[name].whole


def _letter(existing: str | None) -> str:
    for line in (existing or "").splitlines():
        found = _LINE.fullmatch(line.strip())
        if found is not None:
            return found[1]
    return LETTER


# Names of SimpleFOC's motor in C++, and its enumerators with their numbers.

# Enumerators by the member that takes them, in the order of their numbers.
ENUMERATORS = {
    "torque_controller": (
        "TorqueControlType::voltage",
        "TorqueControlType::dc_current",
        "TorqueControlType::foc_current",
        "TorqueControlType::estimated_current",
    ),
    "controller": (
        "MotionControlType::torque",
        "MotionControlType::velocity",
        "MotionControlType::angle",
        "MotionControlType::velocity_openloop",
        "MotionControlType::angle_openloop",
    ),
    "foc_modulation": (
        "FOCModulationType::SinePWM",
        "FOCModulationType::SpaceVectorPWM",
        "FOCModulationType::Trapezoid_120",
        "FOCModulationType::Trapezoid_150",
    ),
}

# Members that the header works out from the link.
VOLTAGES = ("voltage_limit", "PID_current_q.limit", "PID_current_d.limit")

# Members by their line of the Commander.
COMMANDS = {member.command: name for name, member in MEMBERS.items() if member.command}
READ = (*MEMBERS, "phase_inductance")  # Members that are read.

# Other ways to write members.
FORMER = {
    "LPF_velocity": "LPF_velocity.Tf",
    "LPF_current_q": "LPF_current_q.Tf",
    "LPF_current_d": "LPF_current_d.Tf",
    "phase_inductance_dq.d": "axis_inductance.d",
    "phase_inductance_dq.q": "axis_inductance.q",
}

# What the arguments of BLDCMotor set: the q axis before the d axis.
CONSTRUCTOR = (
    "pole_pairs",
    "phase_resistance",
    "KV_rating",
    "axis_inductance.q",
    "axis_inductance.d",
)

# Ends of the names of the macros for the link in V and the period of the loop in s.
LINK, PERIOD = "V_DC", "LOOP_PERIOD"

# Functions of the motor that set a limit, with the member that they set.
LIMIT_CALLS = {
    "updateVoltageLimit": "voltage_limit",
    "updateCurrentLimit": "current_limit",
    "updateVelocityLimit": "velocity_limit",
}


# Members of SimpleFOC's motor in C++: in a sketch of a user, or in the header that is written.

Found = tuple[dict[str, Number], dict[str, Origin]]

_CONSTRUCTED = re.compile(
    r"\bBLDCMotor[ \t]+(\w+)[ \t]*(?:=[ \t]*BLDCMotor[ \t]*)?"
    r"\(([^;(){}]*+(?:\([^();]*+\)[^;(){}]*+)*+)\)[ \t]*;",
    re.ASCII,
)

_CALLED = re.compile(
    r"\b(\w+)(?:\.|->)(" + "|".join(LIMIT_CALLS) + r")[ \t]*\(([^;(){}]*+)\)[ \t]*;", re.ASCII
)

_SUPPLY = "voltage_power_supply"


@dataclass(frozen=True, slots=True)
class Sketch:
    """A text of C++ with one motor.

    ``motor`` is the motor's name in it, ``arguments`` the texts given to its constructor with their
    line, ``others`` further motors.
    """

    text: str
    place: str
    motor: str
    macros: Macros
    assignments: Macros
    arguments: tuple[str, ...] = ()
    line: int | None = None
    others: tuple[str, ...] = ()

    def member(self, definition: Definition) -> str | None:
        """Member of the motor that an assignment sets; None where it sets something else."""
        name = definition.name.replace("->", ".")
        if not name.startswith(f"{self.motor}."):
            return None
        member = name[len(self.motor) + 1 :]
        member = FORMER.get(member, member)
        return member if member in READ else None


def sketch_of(text: str, place: str) -> Sketch:
    """What a text of C++ says of its motor.

    Raises:
        InputError: It has no motor of SimpleFOC, or is damaged.
    """
    plain = without_comments(text, place)
    constructed = list(_CONSTRUCTED.finditer(plain))
    assignments = read_assignments(text, place)
    if constructed:
        first = constructed[0]
        line = plain.count("\n", 0, first.start()) + 1
        arguments = tuple(part.strip() for part in _arguments(first[2]))
        _refuse_pins(arguments, plain, place, line)
        return Sketch(
            text,
            place,
            first[1],
            read_macros(text, place),
            assignments,
            arguments,
            line,
            tuple(one[1] for one in constructed[1:]),
        )
    for definition in assignments.every:
        motor, _, member = definition.name.replace("->", ".").partition(".")
        if FORMER.get(member, member) in MEMBERS:
            return Sketch(text, place, motor, read_macros(text, place), assignments)
    raise InputError(
        "this is no sketch of SimpleFOC with a BLDCMotor; name the file that constructs it",
        source=place,
    )


def _refuse_pins(arguments: tuple[str, ...], plain: str, place: str, line: int) -> None:
    """Refuse the constructor of the library's first version, which takes pins first."""
    pins = all(re.fullmatch(r"\w+", argument, re.ASCII) for argument in arguments)
    if pins and len(arguments) >= len(CONSTRUCTOR) - 1 and "BLDCDriver" not in plain:
        message = (
            "BLDCMotor takes pins here, as SimpleFOC 1 has it; name a sketch with a BLDCDriver "
            "(2.0 and later)"
        )
        raise InputError(message, source=place, line=line)


FROM_LINK = math.nan  # Value of a voltage that the text works out from the link.


def members_of_sketch(sketch: Sketch) -> Found:
    """Values and origins of the members, the constructor's before what is assigned; voltages that
    are no numbers are `FROM_LINK`.
    """
    own: dict[str, Number] = {}
    origins: dict[str, Origin] = {}
    for name, argument in zip(CONSTRUCTOR, sketch.arguments, strict=False):
        value = _value(argument, sketch)
        if value is None and argument not in ("NOT_SET", ""):
            _refuse(f"BLDCMotor's {name}", argument, sketch.place, sketch.line)
        if value is not None:
            own[name] = _whole(name, value, f"BLDCMotor's {name}", sketch.place, sketch.line)
            origins[name] = Origin(f"BLDCMotor's {name}", argument, sketch.line)
    if "axis_inductance.q" in own and "axis_inductance.d" not in own:
        own["phase_inductance"] = own.pop("axis_inductance.q")
        origins["phase_inductance"] = origins.pop("axis_inductance.q")
    for name, value, origin in (*_constants(sketch), *_called(sketch), *_assigned(sketch)):
        own[name] = value
        origins[name] = origin
    if "axis_inductance.q" in own and "axis_inductance.d" in own:
        own.pop("phase_inductance", None)
        origins.pop("phase_inductance", None)
    return own, origins


def _constants(sketch: Sketch) -> Iterator[tuple[str, Number, Origin]]:
    """The link and the period of the loop: macros of the header, the supply of a driver."""
    for end, name in ((LINK, V_DC), (PERIOD, LOOP_PERIOD)):
        for macro in sketch.macros:
            if macro.endswith(f"_{end}"):
                value = sketch.macros.number(macro)
                if value is not None:
                    said = sketch.macros.text(macro) or ""
                    yield name, value, Origin(macro, said, sketch.macros.line(macro))
    for definition in sketch.assignments.every:
        if definition.name.replace("->", ".").endswith(f".{_SUPPLY}"):
            value = _value(definition.text, sketch)
            if value is not None:
                yield V_DC, value, Origin(definition.name, definition.text, definition.line)


def _called(sketch: Sketch) -> Iterator[tuple[str, Number, Origin]]:
    """Limits that are set by a function."""
    plain = without_comments(sketch.text, sketch.place)
    for found in _CALLED.finditer(plain):
        value = _value(found[3], sketch) if found[1] == sketch.motor else None
        if value is not None:
            line = plain.count("\n", 0, found.start()) + 1
            call = f"{found[1]}.{found[2]}"
            yield LIMIT_CALLS[found[2]], float(value), Origin(call, found[3].strip(), line)


def _assigned(sketch: Sketch) -> Iterator[tuple[str, Number, Origin]]:
    for definition in sketch.assignments.every:
        name = sketch.member(definition)
        if name is None:
            continue
        text, origin = definition.text, Origin(definition.name, definition.text, definition.line)
        enumerators = ENUMERATORS.get(name, ())
        value = _value(text, sketch)
        if text in enumerators:
            yield name, enumerators.index(text), origin
        elif value is None and name in VOLTAGES:
            yield name, FROM_LINK, origin
        elif value is None:
            _refuse(definition.name, text, sketch.place, definition.line)
        else:
            kept = _whole(name, value, definition.name, sketch.place, definition.line)
            yield name, kept, origin


def _value(text: str, sketch: Sketch) -> Number | None:
    """Value of an expression, or of the name of a macro or a variable; None where it has none."""
    try:
        value = evaluated(tokens_of(text), {})
    except NotArithmeticError:
        return None
    if not isinstance(value, Unknown):
        return value
    defined = sketch.macros.value(value.name)
    return sketch.assignments.value(value.name) if defined is None else defined


def _whole(name: str, value: Number, said: str, place: str, line: int | None) -> Number:
    """The value, as a whole number for a member that is one."""
    if name not in MEMBERS or not MEMBERS[name].whole:
        return float(value)
    if not float(value).is_integer():
        message = f"{said} is {value:g}; write a whole number"
        raise InputError(message, source=place, line=line)
    return int(value)


def _refuse(said: str, text: str, place: str, line: int | None) -> NoReturn:
    raise InputError(f"{said} is {shown(text)}, not a number; write one", source=place, line=line)


def _arguments(text: str) -> list[str]:
    """Arguments of a call, at commas outside parentheses."""
    found, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            found.append("")
        else:
            found[-1] += character
    return found


# SimpleFOC's motor written: a header with one function, and lines of the Commander.

_EXISTING = "existing file"


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_simplefoc.h`` and ``<prefix>_simplefoc.txt``.

    Args:
        found: The configuration.
        title: What stands at the head of the header, and shortened of the script.
        existing_text: A sketch, a header or a script whose other lines are to stay; None without
            one. The other one of the two files is written anew.
    """
    own = found.own
    as_script = existing_text is not None and is_script(existing_text)
    header = _header(own, title)
    if existing_text is not None and not as_script:
        header = _in_sketch(own, sketch_of(existing_text, _EXISTING))
    lines = script(own, title, existing_text if as_script else None)
    return {
        f"{title.prefix}_simplefoc.h": header.encode("utf-8"),
        f"{title.prefix}_simplefoc.txt": lines.encode("utf-8"),
    }


def literal(name: str, value: OwnValue) -> str:
    """A value in C++: an enumerator, a whole number, or a single-precision number."""
    if name in ENUMERATORS:
        return ENUMERATORS[name][int(value)]
    return c_float(value, SIGNIFICANT) if isinstance(value, float) else str(value)


def _header(own: Mapping[str, OwnValue], title: FileTitle) -> str:
    members = [
        (name, "v_max" if name in VOLTAGES else literal(name, own[name]), member.says)
        for name, member in MEMBERS.items()
        if name in own
    ]
    macro = title.prefix.upper()
    context = {
        "title": title,
        "macro": macro,
        "v_dc": literal(V_DC, own[V_DC]) if V_DC in own else None,
        "period": literal(LOOP_PERIOD, own[LOOP_PERIOD]) if LOOP_PERIOD in own else None,
        "arguments": ", ".join(literal(name, own[name]) for name in CONSTRUCTOR if name in own),
        "members": members,
        "inductance": literal("axis_inductance.q", own["axis_inductance.q"]),
    }
    return render("firmware/simplefoc/motor.h.j2", context)


def _in_sketch(own: Mapping[str, OwnValue], sketch: Sketch) -> str:
    """The sketch with the values where it sets them; what it does not set stands behind the last
    of them, or else behind the constructor.
    """
    wanted = {name: literal(name, own[name]) for name in MEMBERS if name in own}
    values, last = {}, None
    for definition in sketch.assignments.every:
        member = sketch.member(definition)
        if member in wanted:
            values[definition.name] = wanted[member]
            last = definition
    missing = [
        name
        for name in wanted
        if not any(sketch.member(one) == name for one in sketch.assignments.every)
    ]
    text = with_values(sketch.text, sketch.assignments, values)
    if last is None or not missing:
        return text
    lines = text.split("\n")
    at = last.line
    while at < len(lines) and ";" not in lines[at - 1]:
        at += 1
    before = lines[last.line - 1]
    indent = before[: len(before) - len(before.lstrip())]
    added = [
        f"{indent}{sketch.motor}.{name} = {wanted[name]}; // {comment_text(MEMBERS[name].says)}"
        for name in missing
    ]
    return "\n".join((*lines[:at], *added, *lines[at:]))


# SimpleFOC among the firmware whose files are written and read.

TARGET = Target(SIMPLEFOC, "SimpleFOC (Arduino-FOC 2.4)", write, recognise, read)
