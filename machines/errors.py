"""The errors that a user can cause, each with the exit code the command line answers with; the
words of their messages; and the places in a design file that they are about.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from typing import NamedTuple

from dqforge.machines.records import dataclass


class DqforgeError(Exception):
    """Base of all errors that are reported as one line, without a traceback.

    Args:
        message: What is wrong, what was expected, what to write; on a key of a design it begins
            with the key.
        source: File name as the user gave it, or None when there is no file.
        line, column: One-based position in the file, or None.

    ``section`` is the dotted key that the error is about where the message names none
    (`dqforge.machines.errors`); ``others`` are the further faults of the same file, in its order.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        source: str | None = None,
        line: int | None = None,
        column: int | None = None,
    ) -> None:
        self.message = message
        self.source = source
        self.line = line
        self.column = column
        self.section: str | None = None
        self.others: tuple[DqforgeError, ...] = ()
        super().__init__(message)

    def __str__(self) -> str:
        position = [str(part) for part in (self.source, self.line, self.column) if part is not None]
        text = f"{':'.join(position)}: {self.message}" if position else self.message
        # A file name may hold control characters; they must not reach a
        # terminal or break the one line.
        return "".join(character if character.isprintable() else "?" for character in text)


class InputError(DqforgeError, ValueError):
    """The input is wrong; the message says where, what is wrong and what to write instead."""

    exit_code = 2


class WritingError(InputError):
    """A file or folder cannot be written; the design is not at fault."""


class NoSolutionError(DqforgeError):
    """The design is valid, but what it asks for cannot be had.

    The message says which limit stands in the way.
    """


class VerificationError(DqforgeError):
    """The emitted C does not do what the design says, or could not be compiled."""


# Words of messages: input values as they are shown, and what an unknown word may have been meant
# to be.

# Numbers of wires and legs, which names spell out.
_NUMERALS = {"3": "three", "4": "four", "6": "six"}


def shown(value: object, longest: int = 40) -> str:
    """Text of an input value for an error message: quoted, one line, printable,
    at most `longest` characters.
    """
    text = str(value)
    text = text if len(text) <= longest else text[: longest - 3] + "..."
    return "'" + "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text) + "'"


def close_matches(word: str, candidates: Iterable[str], limit: int = 2) -> list[str]:
    """Candidates that `word` may have been meant to be, best first.

    A candidate that differs in upper and lower case alone leaves no doubt,
    and is then the only one.
    """
    known = list(candidates)
    folded = [c for c in known if c.casefold() == word.casefold()]
    if folded:
        return [max(folded, key=lambda c: sum(a == b for a, b in zip(c, word, strict=False)))]
    return difflib.get_close_matches(_spelled_out(word), known, n=limit, cutoff=0.6)


def _spelled_out(word: str) -> str:
    """`word` with a numeral before a letter written as its name: 4-leg is four-leg."""
    return re.sub(r"^[346](?=[-_ ]?[A-Za-z])", lambda found: _NUMERALS[found[0]], word)


# Where the keys of a design stand in its file, and how a refusal from anywhere in the program
# finds its place there.
#
# What solves, tunes and prints knows nothing of files. Its messages begin with the key that they
# are about, such as ``control.observer: ...``; what cannot know the key stands in a block `about`
# a section. Where the design is at hand, `Places.locate` turns either into file, line and column.

KeyPath = tuple[str | int, ...]


_LEADING = re.compile(r"([a-z]\w*)((?:\.[a-z]\w*|\[\d+\])*)(?=[:, ]|$)", re.ASCII)


_PART = re.compile(r"\.([a-z]\w*)|\[(\d+)\]", re.ASCII)


class Position(NamedTuple):
    """One-based line and column in a file."""

    line: int
    column: int


def dotted(path: KeyPath) -> str:
    """Path as it is written in messages: ``losses.points[0].torque``."""
    text = ""
    for part in path:
        # A key is the user's text until it has been recognised.
        text += f"[{part}]" if isinstance(part, int) else ("." if text else "") + shown(part)[1:-1]
    return text


def leading_path(message: str) -> KeyPath:
    """Path of the dotted key that a message begins with; a first word that is no key counts,
    too.
    """
    found = _LEADING.match(message)
    if found is None:
        return ()
    parts = [int(index) if index else key for key, index in _PART.findall(found.group(2))]
    return (found.group(1), *parts)


def nearest(
    keys: Mapping[KeyPath, Position],
    values: Mapping[KeyPath, Position],
    path: KeyPath,
    *,
    key: bool = False,
) -> Position:
    """Where the value of a part begins, or its key, or the nearest enclosing
    part that is in the file.
    """
    for length in range(len(path), 0, -1):
        # For a key that is missing, its section's key is the line to look at.
        table = keys if key or length < len(path) else values
        if path[:length] in table:
            return table[path[:length]]
    return values[()]


def option_at(
    options: Mapping[KeyPath, str], keys: Mapping[KeyPath, Position], path: KeyPath
) -> str | None:
    """The option of the command line that set a part, or the nearest part around it.

    None for what the file says.
    """
    for length in range(len(path), 0, -1):
        if path[:length] in options:
            return options[path[:length]]
        if path[:length] in keys:
            return None
    return None


def behind_option(message: str, path: KeyPath) -> str:
    """A message that begins with the key of a part, without that key: the
    option before it names it.
    """
    for length in range(len(path), 0, -1):
        shorter = message.removeprefix(f"{dotted(path[:length])}: ")
        if shorter != message:
            return shorter
    return message


@dataclass(frozen=True, slots=True)
class Places:
    """Positions of the keys of a design file.

    Args:
        source: File name as the user gave it.
        keys, values: Where each key and its value begin, by path. List entries have the position of
            their value in both.
        sections: Keys that a design may have at its top level.
        options: For parts that an option of the command line set: that option.
    """

    source: str
    keys: Mapping[KeyPath, Position]
    values: Mapping[KeyPath, Position]
    sections: tuple[str, ...]
    options: Mapping[KeyPath, str] = field(default_factory=dict)

    def locate(self, error: DqforgeError, section: str = "") -> None:
        """Give file, line, column and key to an error on this design that has none.

        Args:
            error: Left as it is where it has a position, where it is about another file or an
                option of the command line, about compiled C or about what is written.
            section: The dotted key to name where the message names none.
        """
        option = error.message.startswith("--")
        if (
            error.line is not None
            or error.source is not None
            or option
            or isinstance(error, (VerificationError, WritingError))
        ):
            return
        path = leading_path(error.message)
        if not path or path[0] not in self.sections:
            path = leading_path(error.section or section)
            error.message = f"{dotted(path)}: {error.message}" if path else error.message
        given_by = option_at(self.options, self.keys, path)
        if given_by is not None:
            error.source, error.message = given_by, behind_option(error.message, path)
            return
        error.source = self.source
        error.line, error.column = self.of_key(path)

    def of_key(self, path: KeyPath) -> Position:
        """Where a key begins, or the nearest one round it that is in the file."""
        return nearest(self.keys, self.values, path, key=True)


@contextmanager
def about(section: str) -> Iterator[None]:
    """Name the section of the design that errors of the block are about,
    unless they know better.
    """
    try:
        yield
    except DqforgeError as error:
        if error.section is None:
            error.section = section
        raise
