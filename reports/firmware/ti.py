"""Motor blocks of TI's lab, read and written: a block alone, the one of many that a file chooses,
an older user.h.
"""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.targets.ti import (
    BOARD_PREFIX,
    INSTASPIN,
    KEYS,
    MOTOR_PREFIX,
    OLDER_LAB,
    READ_ONLY,
    TI,
    VERSION,
    configuration,
)
from dqforge.reports.firmware.c_macros import Macros, read_macros, with_values
from dqforge.reports.firmware.target import Target, c_float
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import FileTitle


# What a project defines outside of the file, so that all that its loops need is looked at.
KNOWN = {
    "MOTOR1_ESMO": "1",
    "MOTOR1_PI_TUNE": "1",
    "MATH_TWO_PI": "6.283185307179586",
    "MATH_PI": "3.141592653589793",
}

_LISTED = 12
_ABSENT = ("NULL", "(NULL)", "( NULL )")
_PERMANENT_MAGNETS = "MOTOR_TYPE_PM"


def recognise(name: str, text: str) -> bool:
    """Whether a file holds a motor block of TI's lab.

    Args:
        name: Its name.
        text: Its text.
    """
    header = name.lower().endswith((".h", ".hpp", ".txt", ".c"))
    return header and prefixes_of(text) is not None and "POLE_PAIRS" in text


def read(text: str, place: str) -> Configuration:
    """The motor that a file chooses.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It holds none, several and chooses none, or a value of it is no number; with the
            line.
    """
    macros, name = chosen_motor(text, place)
    prefixes = prefixes_of(text)
    assert prefixes is not None
    own, origins = _values(macros, prefixes, place)
    return configuration(name or PurePath(place).stem, own, origins, _version(macros, prefixes[0]))


def chosen_motor(text: str, place: str) -> tuple[Macros, str]:
    """The macros of a file with those of one motor, and that motor's name ("" for a block alone).

    Raises:
        InputError: As `read`.
    """
    prefixes = prefixes_of(text)
    if prefixes is None:
        raise InputError(
            "this file holds no USER_MOTOR1_... of TI's lab; name its user_mtr1.h or user.h",
            source=place,
        )
    macros = read_macros(text, place, known=KNOWN)
    blocks = list(CHOICE.finditer(text))
    if not blocks:
        return macros, ""
    chooser = blocks[0][1]
    names = list(dict.fromkeys(block[2] for block in blocks if block[1] == chooser))
    name = macros.text(chooser)
    if name is None:
        offered = {macro.text for macro in macros.every if macro.name == chooser}
        if len(offered) == 1:
            name = offered.pop()
            macros = read_macros(text, place, known=KNOWN | {chooser: name})
    if name is None or name not in names:
        line = text.count("\n", 0, blocks[0].start()) + 1
        raise InputError(_which(chooser, name, names), source=place, line=line)
    return macros, name


def _which(chooser: str, name: str | None, names: list[str]) -> str:
    """How to choose one of several motors."""
    listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
    why = (
        f"this file holds {len(names)} motors and chooses none that does not depend on the board"
        if name is None
        else f"{chooser} is {shown(name)}, which this file does not hold"
    )
    return f"{why}; write '#define {chooser} NAME' above them with one of {listed}"


def _version(macros: Macros, prefix: str) -> str:
    if prefix == "USER_MOTOR_":
        return INSTASPIN
    return OLDER_LAB if f"{prefix}FREQ_MAX_HZ" in macros else VERSION


def found_as(macros: Macros, name: str, prefixes: tuple[str, str]) -> str | None:
    """What a macro of today is called in a file, None where it is not there."""
    return next((macro for macro in candidates(name, prefixes) if macro in macros), None)


def _values(
    macros: Macros, prefixes: tuple[str, str], place: str
) -> tuple[dict[str, OwnValue], dict[str, Origin]]:
    own: dict[str, OwnValue] = {}
    origins: dict[str, Origin] = {}
    for name in READ:
        macro = found_as(macros, name, prefixes)
        text = None if macro is None else macros.text(macro)
        if macro is None or text is None or text in _ABSENT:
            continue
        kind = (KEYS.get(name) or READ_ONLY[name]).kind
        own[name] = _value(macros, macro, kind)
        origins[name] = Origin(macro, text, macros.line(macro))
    if not own:
        raise InputError(
            "this file has no values of the motor that it chooses; name a whole user_mtr1.h",
            source=place,
        )
    machine = own.get("USER_MOTOR1_TYPE")
    if machine is not None and str(machine).upper() != _PERMANENT_MAGNETS:
        origin = origins["USER_MOTOR1_TYPE"]
        raise InputError(
            f"{origin.key} is {shown(machine)}: only machines with permanent magnets "
            f"({_PERMANENT_MAGNETS}) are read; choose one",
            source=place,
            line=origin.line,
        )
    if machine is not None:
        own["USER_MOTOR1_TYPE"] = _PERMANENT_MAGNETS
    return own, origins


def _value(macros: Macros, macro: str, kind: str) -> OwnValue:
    if kind == "word":
        return (macros.text(macro) or "").strip("() ")
    if kind == "whole":
        value = macros.whole(macro)
        assert value is not None
        if not 0 <= value <= 65535:
            macros.refuse(macro, f"is {value}; write a whole number of 0 to 65535")
        return value
    return macros.needed(macro)


# Names of TI's motor macros: those of today, of older labs and of the second motor.

READ = (*KEYS, *READ_ONLY)  # Macros that are read; all others of a file are kept and not looked at.

# What older labs called a macro of the motor, by its name of today.
_FORMER_MOTOR = {
    "Rr_Ohm": ("Rr",),
    "Rs_Ohm": ("Rs",),
    "Ls_d_H": ("Ls_d",),
    "Ls_q_H": ("Ls_q",),
    "RATED_FLUX_VpHz": ("RATED_FLUX",),
    "MAGNETIZING_CURRENT_A": ("MAGNETIZING_CURRENT",),
    "MAX_CURRENT_A": ("MAX_CURRENT",),
    "RES_EST_CURRENT_A": ("RES_EST_CURRENT",),
    "IND_EST_CURRENT_A": ("IND_EST_CURRENT",),
    "FLUX_EXC_FREQ_Hz": ("FLUX_EST_FREQ_Hz",),
    "FREQ_LOW_Hz": ("FREQ_LOW",),
    "FREQ_HIGH_Hz": ("FREQ_HIGH",),
    "FREQ_MAX_Hz": ("FREQ_MAX",),
    "VOLT_MIN_V": ("VOLT_MIN",),
    "VOLT_MAX_V": ("VOLT_MAX",),
    "KP_IQ_HIGH_SF": ("KP_IQ_SF",),
    "KI_IQ_HIGH_SF": ("KI_IQ_SF",),
}

_FORMER_BOARD = {
    "PWM_FREQ_kHz": ("NUM_PWM_FREQ_kHz",),
    "NUM_ISR_TICKS_PER_SPEED_TICK": ("NUM_CTRL_TICKS_PER_SPEED_TICK",),
}

_PREFIXES = (
    ("USER_MOTOR1_", "USER_M1_"),
    ("USER_MOTOR2_", "USER_M2_"),
    ("USER_MOTOR_", "USER_"),
)

# One block of a file that holds several motors: the macro that chooses, and the motor's name.
CHOICE = re.compile(
    r"^[ \t]*#[ \t]*(?:el)?if\b[^\n]*?\b(USER_MOTOR[12]?)[ \t]*==[ \t]*\(?([A-Za-z_]\w{0,80})",
    re.MULTILINE | re.ASCII,
)


def prefixes_of(text: str) -> tuple[str, str] | None:
    """Prefixes of the motor's and of the board's macros in a text; None where it holds neither."""
    for motor, board in _PREFIXES:
        if motor in text:
            return motor, board
    return None


def candidates(name: str, prefixes: tuple[str, str]) -> tuple[str, ...]:
    """What a macro may be called in a file with other prefixes, the likeliest first."""
    motor, board = prefixes
    of_motor = name.startswith(MOTOR_PREFIX)
    prefix, bare = (motor, name[len(MOTOR_PREFIX) :]) if of_motor else (board, _bare(name))
    former = (_FORMER_MOTOR if of_motor else _FORMER_BOARD).get(bare, ())
    upper = (f"{bare[:-2]}HZ",) if bare.endswith("_Hz") else ()
    return tuple(prefix + part for part in (bare, *upper, *former))


def _bare(name: str) -> str:
    return name[len(BOARD_PREFIX) :]


# Motor blocks of TI's lab written: a header to include in the block of one's own motor, or the
# values of the motor that an existing file chooses.

_EXISTING = "existing file"
SLOT = "my_pm_motor_1"  # The motor that TI's file keeps for one's own.


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_user_mtr1.h``.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: What stands at the head of the file.
        existing_text: A user_mtr1.h or a header as written before: the values of the motor that it
            chooses are replaced, but for those for starting it; everything else stays. None without
            one.
    """
    name = f"{title.prefix}_user_mtr1.h"
    if existing_text is not None:
        return {name: _with_macros(existing_text, found).encode("utf-8")}
    lines = [
        (macro, printed(value), key.says, key.decided)
        for macro, key in KEYS.items()
        if (value := found.own.get(macro)) is not None
    ]
    text = render(
        "firmware/ti/user_mtr1.h.j2",
        {
            "title": title,
            "guard": f"{title.prefix.upper()}_USER_MTR1_H",
            "slot": SLOT,
            "sections": [
                (words, [line for line in lines if section == _section(line[0], line[3])])
                for section, words in _SECTIONS.items()
            ],
        },
    )
    return {name: text.encode("utf-8")}


_SECTIONS = {
    "design": "The machine",
    "board": "Timing and voltage",
    "gains": "Gains, as multiples of those that the lab works out",
    "start": "Starting the motor: rules to begin with",
}


def _section(macro: str, decided: str) -> str:
    """Part of the file in which a macro stands."""
    return "board" if macro.startswith(BOARD_PREFIX) else decided


def printed(value: OwnValue) -> str:
    """A value as the macros have it: in brackets, with a point and the suffix of a float."""
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"({value})"
    return f"({c_float(value, FLOAT32_DIGITS)})"


def _with_macros(text: str, found: Configuration) -> str:
    """The text with the design's values in the block of its motor; the macros of the machine that
    it lacks stand behind the last of those that it has.
    """
    macros, _ = chosen_motor(text, _EXISTING)
    prefixes = prefixes_of(text)
    assert prefixes is not None
    values, missing = {}, []
    for macro, value in found.own.items():
        key = KEYS.get(macro)
        if key is None or key.decided == "start":
            continue
        there = found_as(macros, macro, prefixes)
        if there is not None:
            values[there] = printed(value)
        elif key.decided == "design" and macro.startswith(MOTOR_PREFIX):
            missing.append(f"#define {prefixes[0]}{macro[len(MOTOR_PREFIX) :]} {printed(value)}\n")
    values |= _of_q_current(found, macros, prefixes)
    return with_values(_inserted(text, macros, prefixes[0], "".join(missing)), macros, values)


def _of_q_current(
    found: Configuration, macros: Macros, prefixes: tuple[str, str]
) -> dict[str, str]:
    """Factors of labs that have one pair for the q current."""
    pairs = (("KP_IQ_SF", "KP_IQ_HIGH_SF"), ("KI_IQ_SF", "KI_IQ_HIGH_SF"))
    return {
        prefixes[0] + one: printed(found.own[MOTOR_PREFIX + of])
        for one, of in pairs
        if prefixes[0] + one in macros and MOTOR_PREFIX + of in found.own
    }


def _inserted(text: str, macros: Macros, prefix: str, lines: str) -> str:
    """The text with lines behind the last macro of the chosen motor.

    They stand behind every place that is replaced, so that those places stay where they are.
    """
    ends = [macro.end for macro in macros.by_name.values() if macro.name.startswith(prefix)]
    if not lines or not ends:
        return text
    line_end = text.find("\n", max(ends))
    place = len(text) if line_end < 0 else line_end + 1
    lead = "" if text[:place].endswith("\n") else "\n"
    return text[:place] + lead + lines + text[place:]


# TI's universal lab among the firmware whose files are written and read.

TARGET = Target(
    TI,
    "TI universal motor control lab (user_mtr1.h, labs of 2021 and 2024)",
    write,
    recognise,
    read,
)
