"""Macros of motor-ctrl-lib that its parameters are written with, and names of its structure."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.infineon_format import KEYS, READ_ONLY, TABLE_KEYS, Kind
from dqforge.reports.firmware.c_macros import (
    NotArithmeticError,
    Unknown,
    evaluated,
    tokens_of,
    without_comments,
)

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
