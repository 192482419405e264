"""Ctrl-C while a study runs: the first one ends it in order, the second one at once."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from dqforge.reports.operating_system import system

_SHOW_CURSOR = "\x1b[?25h"


@dataclass(slots=True)
class AskedToStop:
    """What has been asked of this process.

    Args:
        number: The signal that came first, 0 for none.
        wake: Called as it comes, to end a wait.
        at_once: Whether the signal interrupts what is under way: nothing of it is worth waiting
            for.
    """

    number: int = 0
    wake: Callable[[], None] = lambda: None
    at_once: bool = False

    def __bool__(self) -> bool:
        return self.number > 0

    def take(self, number: int, _: FrameType | None) -> None:
        """The handler of the signal."""
        if self.number:
            _leave(number)
        self.number = number
        self.wake()
        if self.at_once:
            raise KeyboardInterrupt


def _leave(number: int) -> None:
    """End this process as it is: files are written under another name first, workers end with the
    process that started them.
    """
    with suppress(OSError, ValueError):
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), _SHOW_CURSOR.encode())
    os._exit(128 + number)


@contextmanager
def asked_to_stop() -> Iterator[AskedToStop]:
    """Take Ctrl-C and the request to end while the block runs; elsewhere than in the main thread
    signals go their usual way.
    """
    asked = AskedToStop()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number, old in before.items():
            if old is not signal.SIG_IGN:
                signal.signal(number, asked.take)
        yield asked
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def deaf_to_the_terminal() -> Iterator[None]:
    """Threads and processes that are started within the block never see Ctrl-C: it goes to every
    process of a terminal, and only this one knows what to do with it.

    A mask is inherited by threads and by what they start, so that it holds for a worker from its
    first instruction on, and for those that take the place of others later.
    """
    if system.WINDOWS:
        with _without_ctrl_c():
            yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Windows hands down to a process whether the one that starts it ignores Ctrl-C; what takes the
    place of a worker later, outside the block, hears it.
    """
    console = getattr(ctypes, "windll").kernel32  # noqa: B009 - there alone
    console.SetConsoleCtrlHandler(None, True)
    try:
        yield
    finally:
        console.SetConsoleCtrlHandler(None, False)
