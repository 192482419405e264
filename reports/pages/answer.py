"""What every command returns: tables and lines for people, plain data for programs, a figure,
and files.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import field, replace
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Protocol

from dqforge.machines.errors import DqforgeError, InputError, WritingError
from dqforge.machines.files.input_files import line_of, read_regular_file
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.progress import Progress, TaskID

    from dqforge.machines.design.design import Design
    from dqforge.reports.plain_data import PlainData


@dataclass(frozen=True, slots=True)
class Files:
    """Files that a command writes.

    Args:
        contents: Bytes by name.
        part: The part of an output folder that they are (`dqforge.reports.output.folder`); empty
            for files that are put into a folder without a list of hashes.
        design: What they were made from, None where that is no design.
        named: Whether their paths are printed behind the tables.
        options: Options of the command on which the files depend, for `dqforge verify`.
        given: Further files that they were made from, by name.
        follow: What to do next with them, ``{out}`` for their folder.
    """

    contents: Mapping[str, bytes]
    part: str
    design: Design | None = None
    named: bool = True
    options: Mapping[str, str] = field(default_factory=dict)
    given: Mapping[str, bytes] = field(default_factory=dict)
    follow: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table of text: ``columns`` are the headings with units, ``rows`` the cells,
    ``notes`` lines below.
    """

    title: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a command, not yet shown.

    Args:
        name: What was asked about: the design, a paper, a capture.
        tables: For the terminal.
        plain: For ``--json``, by the keys of docs/reference/json.md.
        figure: Draws the figure of ``--plot``; None where there is none.
        files: To be written; None where there are none.
        notes: Lines for the terminal, behind the tables.
        exit_code: With which the command ends.
    """

    name: str
    tables: Sequence[Table]
    plain: PlainData
    figure: Callable[[], Figure] | None = None
    files: Files | None = None
    notes: tuple[str, ...] = ()
    exit_code: int = 0


# Writing results: whole or not at all.

OUT = "out"  # Folder in which those of designs and studies are made where none is named.
LARGEST_FILE = 64_000_000  # Bytes of the largest file that dqforge writes, many times over.

# Bytes of the largest JSON that is read: once decoded it takes some twenty times as much memory.
LARGEST_JSON = 16_000_000


def read_output(path: Path, wanted: str, most_bytes: int = LARGEST_FILE) -> bytes:
    """A file that dqforge wrote.

    ``wanted`` says in the message what to give instead of one that cannot be read.

    Raises:
        InputError: The file cannot be read, is no regular file, or is far larger than anything that
            dqforge writes.
    """
    try:
        return read_regular_file(path, most_bytes)
    except InputError as error:
        reason = error.message.partition(";")[0]
        raise InputError(f"cannot be read ({reason}); give {wanted}", source=str(path)) from None


def write_atomically(path: Path, pieces: Iterable[bytes], option: str = "-o") -> None:
    """Write a file through a temporary one beside it: flushed to disk, then renamed over the
    target. What a killed run left beside it goes.

    Args:
        path: The file.
        pieces: Its content, one after the other.
        option: Which the message names.

    Raises:
        InputError: The folder cannot be written; what stood there is there as it was.
    """
    from dqforge.reports.operating_system.host_compiler import alone
    from dqforge.reports.operating_system.system import undisturbed

    temporary = beside(path)
    try:
        with alone(path) as locked:
            for left in left_beside(path) if locked else ():
                if not left.is_dir():
                    left.unlink(missing_ok=True)
            try:
                with temporary.open("xb") as stream:
                    for piece in pieces:
                        stream.write(piece)
                    stream.flush()
                    os.fsync(stream.fileno())
                with undisturbed():
                    temporary.replace(path)
            except BaseException:
                with suppress(OSError):
                    temporary.unlink(missing_ok=True)
                raise
    except OSError as error:
        reason = error.strerror or error
        raise WritingError(
            f"cannot write {path}: {reason}; choose another file with {option}"
        ) from error


def beside(path: Path) -> Path:
    """A new name for what is written beside a file or folder before it takes its place."""
    return path.parent / f"{_prefix(path)}{secrets.token_hex(4)}"


def left_beside(path: Path) -> list[Path]:
    """What killed runs left there."""
    return sorted(each for each in path.parent.iterdir() if each.name.startswith(_prefix(path)))


def _prefix(path: Path) -> str:
    return f".{path.name}.dqforge-"


FIGURE_SUFFIXES = (".svg", ".png", ".pdf", ".csv")


def check_figure_path(path: Path, made: Path | None = None) -> None:
    """Refuse a figure's file name before anything is computed for it.

    Args:
        path: The file.
        made: A folder that will be there by the time the figure is written.

    Raises:
        InputError: The suffix is not .svg, .png, .pdf or .csv, or the folder is not there.
    """
    if path.suffix.lower() not in FIGURE_SUFFIXES:
        got = f"the suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(
            f"a figure is written as .svg, .png or .pdf, its data as .csv; {path.name!r} has {got}"
        )
    if not path.parent.is_dir() and path.parent != made:
        raise InputError(
            f"cannot write {path}: there is no folder {path.parent}; make it, or choose another "
            "file"
        )


# Tables for the terminal: results become rows of text here, and nowhere are they computed.

# What stands between two columns, and beside the first and the last, in characters.
_BETWEEN, _EDGES = 3, 2
# A longer cell is a sentence, which may take several lines.
_SHORT = 24
# A table with no more rows than this is turned rather than parted where it is too wide.
_FEW_ROWS = 4
_LEAST_SENTENCE = 20
_GLUE = "\x1f"
NUMBER_AND_UNIT = re.compile(r"(?<=\d) (?=[^\W\d_]|[%°Ω/])")


def fitted(table: Table, room: int) -> list[Table]:
    """The table for a terminal of ``room`` characters: no number is parted from itself or its unit.

    Headings and sentences take several lines first; where that is not enough, a table of few rows
    is turned, so that a row becomes a column, and any other is parted, with its first column
    repeated. A single cell wider than the terminal stays whole.
    """
    notes = [line for note in table.notes for line in _paragraph(note, room)]
    table = replace(table, title="\n".join(_paragraph(table.title, room)), notes=tuple(notes))
    if not table.columns:
        return [table]
    widths = _widths(table, room)
    if widths is not None:
        return [_wrapped(table, widths)]
    turned = _turned(table)
    if len(table.rows) <= _FEW_ROWS and _widths(turned, room) is not None:
        return fitted(turned, room)
    return _parted(table, room)


def _cells(table: Table) -> list[list[str]]:
    """Headings and cells by column."""
    return [[table.columns[k], *(row[k] for row in table.rows)] for k in range(len(table.columns))]


def _sentence(cell: str) -> bool:
    return len(cell) > _SHORT and " " in cell


def _lines(text: str, width: int) -> list[str]:
    """A text in lines of a width, broken at spaces, but not between a number and its unit."""
    glued = NUMBER_AND_UNIT.sub(_GLUE, text)
    lines = textwrap.wrap(glued, max(width, 1), break_long_words=False, break_on_hyphens=False)
    return [line.replace(_GLUE, " ") for line in lines] or [""]


def _paragraph(text: str, width: int) -> list[str]:
    """Lines of a text that may have lines of its own, those that fit as they are."""
    lines = text.split("\n")
    return [
        part for line in lines for part in ([line] if len(line) <= width else _lines(line, width))
    ]


def _longest(lines: Sequence[str]) -> int:
    return max(len(line) for line in lines)


def _least(title: str, cells: Sequence[str]) -> int:
    """The least width of a column: short cells whole, words of headings and sentences."""
    whole = [len(cell) for cell in cells if not _sentence(cell)]
    words = [_longest(_lines(text, 1)) for text in [title, *filter(_sentence, cells)]]
    room = [min(len(cell), _LEAST_SENTENCE) for cell in cells if _sentence(cell)]
    return max([*whole, *words, *room])


def _widths(table: Table, room: int) -> list[int] | None:
    """Widths of the columns within a terminal; None where they do not fit beside each other."""
    columns = _cells(table)
    natural = [_longest(column) for column in columns]
    left = room - _EDGES - _BETWEEN * (len(columns) - 1)
    if sum(natural) <= left:
        return natural
    least = [_least(column[0], column[1:]) for column in columns]
    left -= sum(least)
    if left < 0:
        return None
    wanted = [most - few for most, few in zip(natural, least, strict=True)]
    return [few + left * want // sum(wanted) for few, want in zip(least, wanted, strict=True)]


def _wrapped(table: Table, widths: Sequence[int]) -> Table:
    """Headings and sentences in lines of these widths."""

    def cell(text: str, width: int) -> str:
        return "\n".join(_lines(text, width)) if len(text) > width else text

    rows = [tuple(map(cell, row, widths)) for row in table.rows]
    return replace(table, columns=tuple(map(cell, table.columns, widths)), rows=tuple(rows))


def _turned(table: Table) -> Table:
    """Rows as columns, headed by their first cell."""
    heading, *others = _cells(table)
    return replace(table, columns=tuple(heading), rows=tuple(map(tuple, others)))


def _parted(table: Table, room: int) -> list[Table]:
    """Several tables of as many columns as fit, each behind the first column."""
    parts: list[Table] = []
    taken: list[int] = []
    for k in range(1, len(table.columns)):
        if taken and _widths(_chosen(table, [0, *taken, k]), room) is None:
            parts.append(_chosen(table, [0, *taken]))
            taken = []
        taken.append(k)
    parts.append(_chosen(table, [0, *taken]))
    shown = []
    for place, part in enumerate(parts):
        title = table.title if place == 0 else ""
        notes = table.notes if place == len(parts) - 1 else ()
        widths = _widths(part, room) or [_least(c[0], c[1:]) for c in _cells(part)]
        shown.append(_wrapped(replace(part, title=title, notes=notes), widths))
    return shown


def _chosen(table: Table, kept: Sequence[int]) -> Table:
    """A table of some of its columns."""
    rows = tuple(tuple(row[k] for k in kept) for row in table.rows)
    return replace(table, columns=tuple(table.columns[k] for k in kept), rows=rows)


# The terminal: tables as text and a sign of life for long work; colour and motion only where a
# person is looking.

_PIPE_WIDTH = 160
# Tables are fitted to the terminal before they are drawn; what no table can hold is left whole.
_NEVER_FULL = 100_000
_REFRESH_S = 0.1
QUICK_S = 1.0  # What takes no longer shows no sign of life.

# The stage that every command begins with: the import of its own modules.
LOADING = "loading what the command needs"


def show(tables: Sequence[Table]) -> None:
    """Print tables to stdout; text from a design file is never read as markup."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable
    from rich.text import Text

    class Terminal(Console):
        """A console that leaves it to the command line what a closed pipe means."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    console = Terminal(
        width=None if sys.stdout.isatty() else _PIPE_WIDTH, highlight=False, soft_wrap=False
    )
    room, console.width = console.width, _NEVER_FULL
    for table in tables:
        for part in fitted(table, room):
            if part.title:
                console.print(Text(part.title, style="bold"))
            if part.columns:
                headed = any(part.columns)
                grid = RichTable(
                    box=box.SIMPLE_HEAD if headed else None, show_header=headed, pad_edge=False
                )
                for column in part.columns:
                    grid.add_column(Text(column), no_wrap=True)
                for row in part.rows:
                    grid.add_row(*(Text(cell) for cell in row))
                console.print(grid)
            for note in part.notes:
                console.print(Text(note, style="dim"))
        console.print()


_moving = Lock()  # Held by what moves on the terminal, of which there is room for one.


class Display(Protocol):
    """What moves on the terminal: the name of the stage under way, and the
    share of it that is done.
    """

    def name(self, text: str) -> None:
        """Name the stage that begins."""

    def move(self, share: float) -> None:
        """Show the share of the stage that is done."""


_shown: ContextVar[Display | None] = ContextVar("_shown", default=None)


def stage(text: str) -> None:
    """Name what begins now, where a person is looking; silent elsewhere."""
    display = _shown.get()
    if display is not None:
        display.name(text)


def shares() -> Callable[[float], None] | None:
    """What is told the share of a stage that is done; None where nobody is looking."""
    display = _shown.get()
    return None if display is None else display.move


@contextmanager
def _display(display: Display) -> Iterator[None]:
    token = _shown.set(display)
    try:
        yield
    finally:
        _shown.reset(token)


@dataclass(slots=True)
class _Spinner:
    """A line beside a turning mark."""

    text: str

    def name(self, text: str) -> None:
        self.text = text

    def move(self, share: float) -> None:
        self.text = f"{self.text.partition(',')[0]}, {100.0 * share:.0f} %"

    def spin(self, after: float, done: Event) -> None:
        """Turn until the work is done; quick work shows nothing."""
        if done.wait(after):
            return
        from rich.console import Console
        from rich.markup import escape

        text = self.text
        with Console(stderr=True).status(escape(text)) as shown:
            while not done.wait(_REFRESH_S):
                if self.text != text:
                    text = self.text
                    shown.update(escape(text))


@contextmanager
def status(text: str, after: float = 0.0) -> Iterator[None]:
    """Show a spinner on a terminal while the block runs, once it has run for ``after`` s.

    The text is that of the last `stage`, first ``text``. Silent in a pipe,
    and within another spinner or a bar.
    """
    if not sys.stderr.isatty() or not _moving.acquire(blocking=False):
        yield
        return
    done, spinner = Event(), _Spinner(text)
    thread = Thread(target=spinner.spin, args=(after, done), daemon=True)
    thread.start()
    try:
        with _display(spinner):
            yield
    finally:
        done.set()
        thread.join()
        _moving.release()


@dataclass(slots=True)
class _Bar:
    """A bar with a name."""

    bar: Progress
    task: TaskID

    def name(self, text: str) -> None:
        self.bar.update(self.task, description=text)

    def move(self, share: float) -> None:
        self.bar.update(self.task, completed=share)


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None] | None]:
    """Show a bar on a terminal, moved by a callback for the share that is done.

    None and silent in a pipe.

    Its name is that of the last `stage`, first ``text``.
    """
    if not sys.stderr.isatty() or not _moving.acquire(blocking=False):
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    try:
        with Progress(console=Console(stderr=True), transient=True) as bar:
            shown = _Bar(bar, bar.add_task(text, total=1.0))
            with _display(shown):
                yield shown.move
    finally:
        _moving.release()


# What is said of an error: one line, and on a terminal the line of the file below it, with a mark
# under the place.

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
