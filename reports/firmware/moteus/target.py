"""Configurations of moteus written: a line per value, as moteus_tool --write-config sends it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.moteus_format import GEAR, KNOWN, OF_OUTPUT
from dqforge.optimizer.firmware.targets.moteus import MOTEUS
from dqforge.reports.firmware.moteus.reader import ENDING, ConfigLine, config_lines, read, recognise
from dqforge.reports.firmware.target import Target, number_text, plain_number

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


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
