"""Folders that one process at a time writes, and names in them that last.

The lock goes with the process, however that ends. Linux and macOS lock the folder itself. Windows
opens no folders: locked is a file in the folder for temporary files, whose name follows from the
path.
"""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
from importlib import import_module
from pathlib import Path

from dqforge.reports.operating_system import system

_TAKEN = (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)


class FolderTakenError(Exception):
    """Another process has the lock."""


def lock_folder(folder: Path) -> int:
    """Lock a folder; what comes back is closed by `os.close`, which gives the lock back.

    Where a file system knows no locks, nothing keeps two processes apart.

    Args:
        folder: It must exist.

    Raises:
        FolderTakenError: Another process has it.
        OSError: The folder cannot be opened.
    """
    handle = _open_stand_in(folder) if system.WINDOWS else os.open(folder, os.O_RDONLY)
    try:
        _lock(handle)
    except OSError as error:
        if error.errno in _TAKEN:
            os.close(handle)
            raise FolderTakenError from error
    return handle


def _open_stand_in(folder: Path) -> int:
    real = os.path.normcase(os.path.realpath(folder))
    name = f"dqforge-{hashlib.sha256(real.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}.lock"
    return os.open(Path(tempfile.gettempdir()) / name, os.O_RDWR | os.O_CREAT, 0o600)


def _lock(handle: int) -> None:
    # Each module is there on its own system alone.
    if system.WINDOWS:
        windows = import_module("msvcrt")
        windows.locking(handle, windows.LK_NBLCK, 1)
    else:
        posix = import_module("fcntl")
        posix.flock(handle, posix.LOCK_EX | posix.LOCK_NB)


def flush_folder(folder: Path) -> None:
    """Make new names in a folder last a loss of power; Windows has no call for it."""
    if system.WINDOWS:
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
