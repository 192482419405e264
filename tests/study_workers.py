"""Worker processes of a study, as the tests look at them and kill them."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil


def parts_in(folder: Path) -> int:
    """How many parts a folder of a study holds."""
    return len([*folder.glob("parts/part-*.parquet")])


def worker_processes(of: int | None = None) -> list[psutil.Process]:
    """Worker processes that a process started or its children did; this one unless another is
    named.
    """
    found = []
    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(of).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                if "spawn_main" in " ".join(child.cmdline()):
                    found.append(child)
    return found


@contextmanager
def killing_workers(
    folder: Path, every: float, of: int | None = None, parts: int = 0
) -> Iterator[list[int]]:
    """Kill one worker of a process after the other while parts come into a folder that has so many;
    the list of the killed.

    On a machine so busy that no part comes in ``every`` seconds the next one is waited for: workers
    that are all killed while they start compute nothing, ever.
    """
    done, killed, drawn = threading.Event(), list[int](), random.Random(1)

    def kill() -> None:
        seen = parts
        while not done.wait(every):
            there = parts_in(folder)
            found = worker_processes(of) if there > seen else []
            if found:
                seen = there
                chosen = drawn.choice(found)
                with suppress(psutil.NoSuchProcess):
                    chosen.kill()
                    killed.append(chosen.pid)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        done.set()
        thread.join()
