"""Configurations of moteus, read and written: files of commands, dumps of the whole."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, shown
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin
from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.moteus_format import (
    FILTER,
    GEAR,
    KNOWN,
    OF_OUTPUT,
    SLIP,
    WHOLE,
    configuration,
)
from dqforge.optimizer.firmware.targets.moteus import MOTEUS
from dqforge.reports.firmware.target import Target, no_number, number_text, plain_number

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import OwnValue
    from dqforge.reports.firmware.target import FileTitle


ENDING = ".moteus.cfg"
_MARK = re.compile(r"^\s*(?:conf\s+set\s+)?(?:motor|servo)\.[A-Za-z_]\w*(?:\.\w+)*[ \t]+\S", re.M)

# Kv times ``motor.v_per_hz`` of firmware before ABI 0x010a, as moteus_tool converts it.
_FORMER_SCALE = 1.09 * 0.5 * 60.0
_SAME_FOR_BOTH = ("motor.inductance_d_H", "motor.inductance_q_H")
_SIX_DECIMALS = re.compile(r"0\.(?=\d{6}$)0*([1-9]\d*)")
_ENOUGH_DIGITS = 3

# What may be nan or inf: there is no such limit then.
_UNLIMITED = (
    "servo.max_velocity",
    "servo.default_accel_limit",
    "servo.max_current_desired_rate",
    SLIP,
)

_FIELDS = {
    "pole_pairs": "motor.poles",
    "r_s": "motor.resistance_ohm",
    "l_d": "motor.inductance_d_H",
    "l_q": "motor.inductance_q_H",
    "psi_pm": "motor.Kv",
    "inertia": "servo.inertia_feedforward",
    "i_max": "servo.max_current_A",
    "omega_m_max": "servo.max_velocity",
    "f_sw": "servo.pwm_rate_hz",
    "t_s": "servo.pwm_rate_hz",
    "speed.kp": "servo.pid_position.kd",
    "speed.ki": "servo.pid_position.kp",
    "pll.kp": FILTER,
    "pll.ki": FILTER,
}

_CONVERSIONS = {
    "pole_pairs": "twice the pole pairs",
    "psi_pm": "60/(sqrt(3) 2 pi p Kv)",
    "omega_m_max": "revolutions per second times 2 pi",
    "t_s": "one PWM period, two above 30 kHz",
    "speed.kp": "over 2 pi and the torque constant",
    "speed.ki": "over 2 pi and the torque constant",
}


def recognise(name: str, text: str) -> bool:
    """Whether a file is a configuration of moteus.

    Args:
        name: Its name.
        text: Its text.
    """
    return name.lower().endswith(ENDING) or (
        _MARK.search(text) is not None and not text.lstrip().startswith(("<", "{"))
    )


def read(text: str, place: str) -> Configuration:
    """The configuration in a file of commands, or in a dump.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It is none, or a value of it does not fit its key; with the line.
    """
    # A later line sets again what an earlier one has set.
    lines = {line.key: line for line in config_lines(text, place)}
    origins = {
        key: _origin(lines[key])
        for key in KNOWN
        if key in lines
        and not (key in _UNLIMITED and lines[key].value.lower().lstrip("-") in ("nan", "inf"))
    }
    numbers = {key: _number(key, origin, place) for key, origin in origins.items()}
    said = list(_former_names(lines, numbers, origins, place))
    ratio = _gear(lines, place)
    if ratio != 1.0:
        for key, power in OF_OUTPUT.items():
            if key in numbers:
                numbers[key] = numbers[key] / ratio**power
        said.append(
            f"{GEAR} {ratio:g}: speeds, inertia and gains of the position are those of the output, "
            "and are converted to the rotor's"
        )
    if not numbers:
        raise InputError(
            "this file sets none of moteus' values of motor and servo; save it again with "
            "moteus_tool --dump-config",
            source=place,
        )
    poles = numbers.get("motor.poles", 0)
    if poles % 2:
        raise InputError(
            f"motor.poles is {poles:g}; write an even number, two for each pole pair",
            source=place,
            line=origins["motor.poles"].line,
        )
    said += _few_digits(origins)
    found = configuration(_name(place), numbers)
    return replace(found, origins=_fields(found, origins), conventions=(*found.conventions, *said))


def _name(place: str) -> str:
    name = PurePath(place).name
    return name[: -len(ENDING)] if name.lower().endswith(ENDING) else PurePath(place).stem


def _origin(line: ConfigLine) -> Origin:
    return Origin(line.key, line.value, line.number)


def _number(key: str, origin: Origin, place: str) -> float | int:
    value = plain_number(origin.text)
    if value is None:
        complaint = no_number(origin.text)
    elif key in WHOLE and not (value.is_integer() and 0.0 <= value <= 65535.0):
        complaint = f"is {value:g}; write a whole number from 0 to 65535"
    elif value < 0.0 and key != "motor.inductance_d_scale":
        complaint = f"is {value:g}; write a number from zero on"
    else:
        return int(value) if key in WHOLE else value
    raise InputError(f"{origin.key} {complaint}", source=place, line=origin.line)


def _former_names(
    lines: dict[str, ConfigLine],
    numbers: dict[str, float | int],
    origins: dict[str, Origin],
    place: str,
) -> list[str]:
    """Values under names of older firmware, put under today's; what was done, in words."""
    said = []
    former = lines.get("motor.v_per_hz")
    if former is not None and "motor.Kv" not in numbers:
        value = _number(former.key, _origin(former), place)
        if value > 0.0:
            numbers["motor.Kv"] = _FORMER_SCALE / value
            origins["motor.Kv"] = replace(_origin(former), conversion="Kv = 32.7/v_per_hz")
            said.append(
                f"motor.v_per_hz {value:g} of firmware before ABI 0x010a: motor.Kv "
                f"{numbers['motor.Kv']:.6g}, as moteus_tool converts it"
            )
    former = lines.get("motor.inductance_H")
    if former is not None and not any(key in numbers for key in _SAME_FOR_BOTH):
        value = _number(former.key, _origin(former), place)
        numbers |= dict.fromkeys(_SAME_FOR_BOTH, value)
        origins |= dict.fromkeys(_SAME_FOR_BOTH, _origin(former))
        said.append("motor.inductance_H is taken for both axes")
    return said


def _gear(lines: dict[str, ConfigLine], place: str) -> float:
    line = lines.get(GEAR)
    if line is None:
        return 1.0
    ratio = _number(GEAR, _origin(line), place)
    if not ratio > 0.0:
        raise InputError(
            f"{GEAR} is {ratio:g}; write a number above zero", source=place, line=line.number
        )
    return ratio


def _few_digits(origins: dict[str, Origin]) -> list[str]:
    """Small values that a dump with its six decimals has cut to few digits."""
    said = []
    for key in ("motor.resistance_ohm", *_SAME_FOR_BOTH):
        origin = origins.get(key)
        match = None if origin is None else _SIX_DECIMALS.fullmatch(origin.text)
        if match is not None and len(match[1]) < _ENOUGH_DIGITS:
            share = 0.5 / int(match[1])
            said.append(f"{key} {match[0]} is cut to {len(match[1])} digits: +-{share:.1%}")
    return said


def _fields(found: Configuration, origins: dict[str, Origin]) -> dict[str, Origin]:
    """Origins by the names of fields, and of everything else by its key."""
    fields = {
        field: replace(
            origins[key], conversion=origins[key].conversion or _CONVERSIONS.get(field, "")
        )
        for field, key in _FIELDS.items()
        if key in origins
    }
    for axis, key in (("current_d", "motor.inductance_d_H"), ("current_q", "motor.inductance_q_H")):
        if "servo.pid_dq_hz" in origins and key in origins and getattr(found, axis) is not None:
            hertz = origins["servo.pid_dq_hz"]
            fields[f"{axis}.kp"] = replace(hertz, conversion=f"2 pi servo.pid_dq_hz {key}")
            fields[f"{axis}.ki"] = replace(
                hertz, conversion="2 pi servo.pid_dq_hz motor.resistance_ohm"
            )
        elif "servo.pid_dq.kp" in origins:
            own = f"servo.pid_{'q' if axis == 'current_q' else 'dq'}"
            own = own if f"{own}.kp" in origins else "servo.pid_dq"
            fields |= {
                f"{axis}.{gain}": origins[f"{own}.{gain}"]
                for gain in ("kp", "ki")
                if f"{own}.{gain}" in origins
            }
    return origins | fields


# Lines of moteus' console in a file: which of them set a value, and where.

# Empty lines, comments, other commands, and the end of what ``conf enumerate`` answers.
_SET = re.compile(r"(?P<lead>\s*(?:conf\s+set\s+)?)(?P<key>[A-Za-z]\w*(?:\.\w+)+)(?P<rest>.*)")
_OTHER = re.compile(r"\s*(?:(?:conf|tel|d|aux[12]|id)\b.*|OK\s*|#.*)?")


@dataclass(frozen=True, slots=True)
class ConfigLine:
    """A line that sets a value.

    ``lead`` is what stands before the key (with ``conf set`` or without), ``tail`` what stands
    behind the value; ``number`` is that of the line, from 1.
    """

    lead: str
    key: str
    value: str
    tail: str
    number: int


def config_lines(text: str, place: str) -> list[ConfigLine]:
    """The lines of a text that set values, in their order.

    Args:
        text: Of the file.
        place: Its path, for messages.

    Raises:
        InputError: A line is none of moteus' console, or lacks its value; with its number.
    """
    found = []
    for number, line in enumerate(text.split("\n"), 1):
        match = _SET.fullmatch(line)
        if match is None:
            if not _OTHER.fullmatch(line) or re.match(r"\s*conf\s+set\b", line):
                raise InputError(
                    f"{shown(line.strip()[:40])} is neither 'conf set NAME VALUE' nor 'NAME "
                    "VALUE'; save the file again with moteus_tool --dump-config",
                    source=place,
                    line=number,
                )
            continue
        found.append(_line(match, number, place))
    return found


def _line(match: re.Match[str], number: int, place: str) -> ConfigLine:
    code, mark, comment = match["rest"].partition("#")
    value = code.strip()
    if not value or " " in value or not code[0].isspace():
        what = "has no value" if not value else f"has {shown(value[:40])} for its value"
        raise InputError(
            f"{match['key']} {what}; write one number behind it", source=place, line=number
        )
    after = code[len(code) - len(code.lstrip()) + len(value) :] + mark + comment
    return ConfigLine(match["lead"], match["key"], value, after, number)


# Configurations of moteus written: a line per value, as moteus_tool --write-config sends it.

SAVE = "conf write"  # Command that keeps the values over a restart.
_EXISTING = "existing file"


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>.moteus.cfg``. Comments are none: moteus_tool sends every line to the drive.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: Its prefix names the file.
        existing_text: File whose other lines are to stay; None without one.
    """
    numbers = {key: value for key in KNOWN if (value := found.own.get(key)) is not None}
    if existing_text is None:
        text = "".join(f"conf set {key} {printed(value)}\n" for key, value in numbers.items())
        text += f"{SAVE}\n"
    else:
        text = _replaced(existing_text, numbers)
    return {f"{title.prefix}{ENDING}": text.encode("utf-8")}


def printed(value: OwnValue) -> str:
    """A value as it is sent."""
    return number_text(value, FLOAT32_DIGITS)


def _replaced(text: str, numbers: dict[str, OwnValue]) -> str:
    """The text with other values on the lines that set them; further ones stand behind the last
    line that sets a value, in its form.
    """
    lines = config_lines(text, _EXISTING)
    _refuse_old(lines)
    values = _of_output(lines, numbers)
    rows = text.split("\n")
    for line in lines:
        if line.key in values:
            rows[line.number - 1] = f"{line.lead}{line.key} {values[line.key]}{line.tail}"
    present = {line.key for line in lines}
    last = lines[-1] if lines else None
    lead = "conf set " if last is None else last.lead
    further = [f"{lead}{key} {value}" for key, value in values.items() if key not in present]
    place = 0 if last is None else last.number
    return "\n".join((*rows[:place], *further, *rows[place:]))


def _of_output(lines: list[ConfigLine], numbers: dict[str, OwnValue]) -> dict[str, str]:
    """Values as printed, behind the gear that the file states."""
    stated = [line for line in lines if line.key == GEAR]
    ratio = plain_number(stated[-1].value) if stated else 1.0
    if ratio is None or not ratio > 0.0:
        raise InputError(
            f"{GEAR} is {stated[-1].value}; write a number above zero",
            source=_EXISTING,
            line=stated[-1].number,
        )
    return {
        key: printed(
            float(value) * ratio**power
            if (power := OF_OUTPUT.get(key, 0)) and ratio != 1.0
            else value
        )
        for key, value in numbers.items()
    }


def _refuse_old(lines: list[ConfigLine]) -> None:
    """Refuse files of firmware that has no servo.pid_dq_hz."""
    places = {line.key: line.number for line in lines}
    if "servo.pid_dq.kp" in places and "servo.pid_dq_hz" not in places:
        raise InputError(
            "servo.pid_dq.kp is of firmware before ABI 0x010e, which has no servo.pid_dq_hz; flash "
            "a newer one (moteus_tool --flash converts its configuration) and dump it again",
            source=_EXISTING,
            line=places["servo.pid_dq.kp"],
        )


# moteus among the firmware whose files are written and read.

TARGET = Target(MOTEUS, "moteus (mjbots, ABI 0x010e and later)", write, recognise, read)
