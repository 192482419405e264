"""Files of an explored folder: written whole or not at all, read only where they are files, and
taken away only where a study wrote them.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NoReturn

from dqforge.machines.errors import DqforgeError, InputError
from dqforge.reports.operating_system.folder_lock import (
    FolderTakenError,
    flush_folder,
    lock_folder,
)

PARTS = "parts"
FRONT, SENSITIVITY, REPORT = "front.parquet", "sensitivity.json", "report.html"
BESIDE = (FRONT, SENSITIVITY, REPORT)  # What stands beside ``study.json`` when a study is done.
WINNERS = "winners"  # Folder in which each row that is exported has one.
LARGEST_PART = 2_000_000_000  # Bytes of the largest part that is read.

# Flags of opening: no links, no waiting for a pipe, and bytes as they are.
_PART = re.compile(r"part-(\d{6,9})\.parquet")
_LEFTOVER = re.compile(r"\.(?:part-\d{6,9}\.parquet|[a-z][a-z-]*\.(?:json|parquet|html))\.new")
_FULL = (errno.ENOSPC, errno.EDQUOT)
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


class StoreError(DqforgeError):
    """What is computed cannot be kept, or what was kept cannot be read; parts that are finished
    stay.
    """


def part_name(part: int) -> str:
    """Name of a part's file in its folder."""
    return f"part-{part:06d}.parquet"


def part_files(folder: Path, parts: Collection[int] | None = None) -> dict[int, Path]:
    """Files that have the name of a part, by its number, links and folders left out.

    Args:
        folder: Of the study.
        parts: Those that are looked for, None for all.
    """
    if parts is not None:
        paths = {part: folder / PARTS / part_name(part) for part in sorted(parts)}
        return {
            part: path for part, path in paths.items() if path.is_file() and not path.is_symlink()
        }
    found = {}
    for entry in _entries(folder / PARTS):
        match = _PART.fullmatch(entry.name)
        if (
            match
            and part_name(int(match[1])) == entry.name
            and entry.is_file(follow_symlinks=False)
        ):
            found[int(match[1])] = Path(entry.path)
    return dict(sorted(found.items()))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read the folder {folder}: {error.strerror}") from error


def remove_leftovers(folder: Path) -> None:
    """Remove files that a run was writing when it ended."""
    for place in (folder, folder / PARTS):
        for entry in _entries(place):
            if _LEFTOVER.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                Path(entry.path).unlink(missing_ok=True)


def read_whole(path: Path) -> bytes:
    """A file of a study; links are not followed.

    Raises:
        OSError: It cannot be read, or is no regular file.
    """
    _refuse_link(path)  # which Windows would follow
    descriptor = os.open(path, os.O_RDONLY | _PLAIN)
    with os.fdopen(descriptor, "rb") as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST_PART:
            raise OSError(errno.EINVAL, "no file of a study")
        return file.read()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it: flushed, renamed, and the folder flushed.

    Raises:
        StoreError: It cannot be written; the old one, if any, is there as it was.
    """
    temporary = path.parent / f".{path.name}.new"
    try:
        _refuse_link(path)
        temporary.unlink(missing_ok=True)
        _fill(temporary, content)
        temporary.replace(path)
        flush_folder(path.parent)
    except OSError as error:
        refuse_write(path, error)


def _refuse_link(path: Path) -> None:
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link")


def write_below(folder: Path, name: str, content: bytes) -> None:
    """Write a file into a folder of the study, which is made if missing; raises as
    `write_whole`, and `StoreError` where a link leads out of the study.
    """
    path = folder / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse_write(path, error)
    if not Path(os.path.realpath(path.parent)).is_relative_to(os.path.realpath(folder)):
        raise StoreError(f"cannot write {path}: a link leads out of {folder}; take another -o")
    write_whole(path, content)


def _fill(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _PLAIN, 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        path.unlink(missing_ok=True)
        raise


def refuse_write(path: Path, error: OSError) -> NoReturn:
    """Say in one line that a file cannot be written, and what to do."""
    reason = error.strerror or str(error)
    advice = "make room" if error.errno in _FULL else "make it writable"
    raise StoreError(
        f"cannot write {path}: {reason}; {advice} and run the same command again, finished parts "
        "are kept"
    ) from error


def keep_folder(folder: Path) -> int:
    """Keep other runs from a folder, until the process ends or closes what comes back.

    Raises:
        InputError: Another run has it.
    """
    try:
        return lock_folder(folder)
    except FolderTakenError as error:
        raise InputError(
            f"{folder} is being written by another run; wait for it, or take another -o"
        ) from error


def own_files(folder: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """Files that a study wrote: its parts, then those of ``names`` that are there."""
    yield from part_files(folder).values()
    for name in names:
        path = folder / name
        if path.is_file() and not path.is_symlink():
            yield path
