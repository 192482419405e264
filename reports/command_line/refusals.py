"""What is said of an error: one line, and on a terminal the line of the file below it, with a mark
under the place.
"""

from __future__ import annotations

import os
import shutil
import sys
from contextlib import suppress

from dqforge.machines.errors import DqforgeError
from dqforge.machines.lately_read import line_of

_NARROWEST = 20
_CUT = "..."


def tell(message: str, error: DqforgeError | None = None) -> None:
    """One line on stderr, if that can still be written.

    On a terminal in colour, with the line that ``error`` is about; plain in a pipe, on a terminal
    that is dumb, and where NO_COLOR is set.
    """
    with suppress(OSError):
        if _in_colour():
            _tell_in_colour(message, error)
        else:
            sys.stderr.write(f"dqforge: {message}\n")
        sys.stderr.flush()


def _in_colour() -> bool:
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return not plain and sys.stderr.isatty()


def _tell_in_colour(message: str, error: DqforgeError | None) -> None:
    from rich.console import Console
    from rich.text import Text

    place, _, _ = message.partition(": ") if error is not None and error.source else ("", "", "")
    told = Text.assemble(("dqforge: ", "bold red"), (place, "bold"), message[len(place) :])
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(told)
    room = shutil.get_terminal_size().columns
    for row, style in excerpt(error, room) if error is not None else ():
        console.print(
            Text.assemble((row[: row.find("|") + 1], "dim"), (row[row.find("|") + 1 :], style))
        )


def excerpt(error: DqforgeError, room: int) -> list[tuple[str, str]]:
    """The line of the file that an error is about and the mark below it, each with its style;
    nothing where the line is not at hand.

    Args:
        error: With source, line and column.
        room: Columns of the terminal. A longer line is cut on both sides of the place.
    """
    line = None
    if error.source is not None and error.line is not None:
        line = line_of(error.source, error.line)
    if line is None or not line.strip():
        return []
    gutter = f"{error.line:>5} | "
    shown, place = _around(_printable(line), error.column, max(room - len(gutter), _NARROWEST))
    rows = [(gutter + shown, "")]
    if place is not None:
        from rich.cells import cell_len

        blank = " " * (len(gutter) - 2)
        rows.append((f"{blank}| {' ' * cell_len(shown[:place])}^", "bold red"))
    return rows


def _printable(line: str) -> str:
    """A line in which nothing moves the cursor, each character in its place."""
    return "".join(c if c.isprintable() else " " if c == "\t" else "?" for c in line)


def _around(line: str, column: int | None, room: int) -> tuple[str, int | None]:
    """The part of a line that a terminal has room for, and where in it the column is, from 0.

    Characters of double width take two columns: of a line with any, half as many are shown.
    """
    from rich.cells import cell_len

    line = line.rstrip()
    place = None if column is None else min(column - 1, len(line))
    if cell_len(line) <= room:
        return line, place
    most = room if cell_len(line) == len(line) else room // 2
    first = 0 if place is None else max(0, min(place - most // 2, len(line) - most))
    part = line[first : first + most]
    if first > 0:
        part = _CUT + part[len(_CUT) :]
    if first + most < len(line):
        part = part[: -len(_CUT)] + _CUT
    return part, None if place is None else place - first
