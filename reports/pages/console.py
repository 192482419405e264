"""The terminal: tables as text and a sign of life for long work; colour and motion only
where a person is looking.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.reports.pages.table import Table


_PIPE_WIDTH = 160


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
    for table in tables:
        console.print(Text(table.title, style="bold"))
        if table.columns:
            has_header = any(table.columns)
            grid = RichTable(
                box=box.SIMPLE_HEAD if has_header else None, show_header=has_header, pad_edge=False
            )
            for column in table.columns:
                grid.add_column(Text(column), overflow="fold")
            for row in table.rows:
                grid.add_row(*(Text(cell) for cell in row))
            console.print(grid)
        for note in table.notes:
            console.print(Text(note, style="dim"))
        console.print()


_moving = Lock()

"""Held by what moves on the terminal, of which there is room for one."""


@contextmanager
def status(text: str, after: float = 0.0) -> Iterator[None]:
    """Show a spinner on a terminal while the block runs, once it has run for ``after`` s.

    Silent in a pipe.

    Within another spinner or a bar it is silent, too.
    """
    if not sys.stderr.isatty() or not _moving.acquire(blocking=False):
        yield
        return
    done = Event()
    thread = Thread(target=_spin, args=(text, after, done), daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        _moving.release()


def _spin(text: str, after: float, done: Event) -> None:
    """Turn a spinner until the work is done; quick work shows none."""
    if done.wait(after):
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        done.wait()


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None] | None]:
    """Show a bar on a terminal, moved by a callback for the share that is done.

    None and silent in a pipe.
    """
    if not sys.stderr.isatty() or not _moving.acquire(blocking=False):
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    try:
        with Progress(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(text, total=1.0)
            yield lambda share: bar.update(task, completed=share)
    finally:
        _moving.release()
