"""What the YAML parser complains of, in plain English with a position."""

from __future__ import annotations

import re

import yaml

from dqforge.machines.errors import InputError
from dqforge.machines.places import Position
from dqforge.machines.wording import shown

_LINE_END = re.compile(r"\r\n|\r|\n")


# What the YAML library says, and what it means to somebody who edits a design file.
_PLAIN_ENGLISH = (
    ("found character '\\t'", "a tab is used for indentation; write spaces"),
    (
        "mapping values are not allowed",
        (
            "a ':' where none can stand; check the indentation, the space behind each ':', or use "
            "quotes"
        ),
    ),
    (
        "could not find expected ':'",
        "this line has no 'key: value'; write a colon and a space behind the key",
    ),
    (
        "expected '<document start>'",
        "this line does not continue the mapping above; line up the keys",
    ),
    (
        "expected <block end>",
        "this line does not line up with its neighbours; indent the keys of a section equally",
    ),
    ("expected ',' or '}'", "a '{' is not closed; separate the entries by commas and end with '}'"),
    ("expected ',' or ']'", "a '[' is not closed; separate the entries by commas and end with ']'"),
    ("found unexpected end of stream", "a quoted text is not closed; write the missing quote"),
    ("found unexpected document separator", "a quoted text is not closed; write the missing quote"),
    (
        "expected the node content",
        "a bracket, comma or mark stands where a value must; write the value, or use quotes",
    ),
    (
        "expected alphabetic or numeric",
        "'&' and '*' start references, which are not read; put the text in quotes",
    ),
    ("cannot start any token", "this character must stand in quotes at the start of a value"),
    (
        "unknown escape character",
        "a backslash in double quotes starts an escape; use single quotes",
    ),
    (
        "sequence entries are not allowed",
        "a list entry '-' is not allowed here; put it on its own indented line",
    ),
)


def position_of(before: str) -> Position:
    """Position of the character behind a text."""
    lines = _LINE_END.split(before)
    return Position(len(lines), len(lines[-1]) + 1)


def translated(error: yaml.MarkedYAMLError, source: str) -> InputError:
    """What the parser found wrong, in our words and with a position."""
    problem = error.problem or "not YAML"
    message = next((text for start, text in _PLAIN_ENGLISH if start in problem), None)
    mark = error.problem_mark or error.context_mark
    if message is None:
        message = f"not YAML: {shown(problem)[1:-1]}"
    elif "not closed" in message or "'key: value'" in message:
        # The library reports where it gave up; the user wants to see where the trouble began.
        mark = error.context_mark or mark
    if mark is None:
        return InputError(message, source=source)
    return InputError(message, source=source, line=mark.line + 1, column=mark.column + 1)
