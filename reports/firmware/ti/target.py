"""Motor blocks of TI's lab written: a header to include in the block of one's own motor, or the
values of the motor that an existing file chooses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.targets.ti import TI
from dqforge.optimizer.firmware.ti_format import BOARD_PREFIX, KEYS, MOTOR_PREFIX
from dqforge.reports.firmware.c_macros import Macros, with_values
from dqforge.reports.firmware.target import Target, c_float
from dqforge.reports.firmware.ti.reader import chosen_motor, found_as, prefixes_of, read, recognise
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


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
