"""The errors that a user can cause, each with the exit code the command line answers with."""

from __future__ import annotations


class DqforgeError(Exception):
    """Base of all errors that are reported as one line, without a traceback.

    Args:
        message: What is wrong, what was expected, what to write; on a key of a design it begins
            with the key.
        source: File name as the user gave it, or None when there is no file.
        line, column: One-based position in the file, or None.

    ``section`` is the dotted key that the error is about where the message names none
    (`dqforge.machines.places`); ``others`` are the further faults of the same file, in its order.
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
