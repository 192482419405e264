"""Lines of SimpleFOC's Commander: members of a motor set over a serial line.

A line that is longer than the Commander's 20 characters would be cut and its rest run as another
command, and the Commander has no comments: what begins with a semicolon runs nothing, because no
motor has that letter. All lines are short for that reason.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, shown
from dqforge.optimizer.firmware.configuration import Number, Origin, OwnValue
from dqforge.optimizer.firmware.simplefoc_format import LOOP_PERIOD, MEMBERS, SIGNIFICANT, V_DC
from dqforge.reports.firmware.simplefoc.sketch import COMMANDS
from dqforge.reports.firmware.target import number_text, plain_number

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import FileTitle

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


def members_of(text: str, place: str) -> tuple[dict[str, Number], dict[str, Origin]]:
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
