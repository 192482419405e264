"""Lines of moteus' console in a file: which of them set a value, and where."""

from __future__ import annotations

import re

from dqforge.machines.errors import InputError, shown
from dqforge.machines.records import dataclass

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
