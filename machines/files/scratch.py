"""Folders for what a command needs for a while: gone with it, however it ends short of a kill."""

from __future__ import annotations

import atexit
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_held: set[Path] = set()

# Once more where a removal was refused once, or cut off by Ctrl-C.
_TRIES = 4


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder below the one of the system (``TMPDIR``), removed with all that it holds.

    A removal that is refused is tried again at the end of the command, and raises nothing.

    Raises:
        OSError: It cannot be made.
    """
    folder = Path(tempfile.gettempdir()) / f"dqforge-{secrets.token_hex(8)}"
    _held.add(folder)  # before it is there: a signal may come as soon as it is
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        _remove(folder)


@contextmanager
def cleared_up() -> Iterator[None]:
    """Remove the folders that are still there at the end of the block, as of the process."""
    try:
        yield
    finally:
        _clear_up()


def _clear_up() -> None:
    for folder in [*_held]:
        _remove(folder)


def _remove(folder: Path) -> None:
    cut_off = None
    for _ in range(_TRIES):
        if folder not in _held:  # gone, or that of the process which forked this one
            break
        try:
            shutil.rmtree(folder, ignore_errors=True)
            if not os.path.lexists(folder):
                _held.discard(folder)
        except KeyboardInterrupt as error:
            cut_off = error
    if cut_off is not None:
        raise cut_off


atexit.register(_clear_up)
if hasattr(os, "register_at_fork"):  # those of the process that forks are its own to remove
    os.register_at_fork(after_in_child=_held.clear)
