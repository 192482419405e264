"""Locks of folders, on this system and as Windows has them."""

from __future__ import annotations

import errno
import fcntl
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import pytest

from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.host_compiler import (
    FolderTakenError,
    flush_folder,
    lock_folder,
)


def windows(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Files are locked and folders cannot be opened; the lock itself is that of this system."""
    module = ModuleType("msvcrt")

    def locking(handle: int, mode: int, count: int) -> None:
        assert (mode, count) == (2, 1)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None

    module.locking, module.LK_NBLCK = locking, 2  # type: ignore[attr-defined]
    opened = os.open

    def no_folders(path: Path, flags: int, mode: int = 0o777) -> int:
        if Path(path).is_dir():
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, flags, mode)

    monkeypatch.setattr(system, "WINDOWS", True)
    monkeypatch.setattr(os, "open", no_folders)
    monkeypatch.setitem(sys.modules, "msvcrt", module)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))


@pytest.mark.parametrize("there", ["here", "windows"])
def test_one_at_a_time(there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    if there == "windows":
        windows(monkeypatch, tmp_path)
    first = lock_folder(folder)
    with pytest.raises(FolderTakenError):
        lock_folder(tmp_path / "out" / ".." / "out")
    os.close(lock_folder(tmp_path))
    os.close(first)
    os.close(lock_folder(folder))
    flush_folder(folder)
    assert [*folder.iterdir()] == []
