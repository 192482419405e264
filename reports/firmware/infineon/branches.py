"""Which lines of a C source a build keeps: conditions worked out for the symbols of a project, all
others blanked, every character in its place.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.c_arithmetic import NotArithmeticError, Unknown, evaluated, tokens_of
from dqforge.reports.firmware.c_macros import without_comments

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
