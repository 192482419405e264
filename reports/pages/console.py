"""The terminal: tables as text and a sign of life for long work; colour and motion only
where a person is looking.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Protocol

from dqforge.reports.pages.table import fitted

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from dqforge.reports.pages.table import Table

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
