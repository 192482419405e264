"""How a run of a study ends before its end: one line, and a folder that the next run goes on
with.
"""

from __future__ import annotations

from dqforge.machines.errors import DqforgeError


class EngineStoppedError(DqforgeError):
    """The run could not go on; the line says why, and what is kept."""

    def __init__(self, message: str) -> None:
        super().__init__(f"explore: {message}")


class SchedulerLostError(EngineStoppedError):
    """The scheduler answers no more."""


class StudyInterruptedError(EngineStoppedError):
    """Somebody pressed Ctrl-C, or the process was asked to end.

    Args:
        number: The signal; the exit code follows from it as a shell's does, 130 for Ctrl-C.
    """

    def __init__(self, number: int, kept: str) -> None:
        super().__init__(f"interrupted after {kept}")
        self.exit_code = 128 + number


def kept(done: int, count: int) -> str:
    """How much of a study is done, and that it goes on from there."""
    return f"{done:,} of {count:,} rows; they are kept, run the same command again"
