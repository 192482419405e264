"""A folder that changes from its old content to its new one in a single step,
whatever happens on the way.

The new content is written beside the folder, flushed to disk, and exchanged with it by one call of
the system. Where that cannot be done (the folder is a mount point, holds the working directory or
folders of others, its file system exchanges nothing, or the system is not Linux), everything is
first written into a folder inside it; a rename says that it is complete, and only then are the
files moved to their places. Who reads a folder between this and the end sees `PENDING` in it.
"""

from __future__ import annotations

import ctypes
import os
import secrets
import shutil
import stat
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.folder_lock import flush_folder

# Folder inside an output folder while its files are moved into their places.
PENDING = ".dqforge-swap"
_STAGED = ".dqforge-new"
_RENAME_EXCHANGE = 2
_AT_FDCWD = -100


def _fill(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a new folder in their order, each flushed to disk."""
    folder.mkdir()
    for name, content in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    flush_folder(folder)


def _exchange(first: Path, second: Path) -> None:
    """Exchange two folders in one step; raises OSError where the system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    call = getattr(library, "renameat2", None)
    if call is None:
        raise OSError("the system exchanges no folders")
    done = call(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE)
    if done != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def files_below(folder: Path) -> Iterator[str]:
    """Names, relative to a folder, of everything in it that is no folder.

    Links are not followed.
    """
    for place, folders, files in os.walk(folder):
        linked = [name for name in folders if (Path(place) / name).is_symlink()]
        for name in (*files, *linked):
            yield (Path(place) / name).relative_to(folder).as_posix()


def _holds_only_files(folder: Path, own: Collection[str]) -> bool:
    """Whether all that a folder holds beside dqforge's own files can be carried over by links."""
    for entry in folder.iterdir():
        mode = entry.lstat().st_mode
        if stat.S_ISDIR(mode):
            if not any(name.startswith(f"{entry.name}/") for name in own):
                return False
            if any(f"{entry.name}/{name}" not in own for name in files_below(entry)):
                return False
        elif not stat.S_ISREG(mode) and not stat.S_ISLNK(mode):
            return False
    return True


def _can_exchange(folder: Path, own: Collection[str]) -> bool:
    if not system.LINUX:
        return False
    here = Path.cwd()
    if folder == here or folder in here.parents or os.path.ismount(folder):
        return False  # whoever stands in the folder would be left in the old one
    about, above = folder.stat(), folder.parent.stat()
    if about.st_dev != above.st_dev or os.listxattr(folder):
        return False
    return _holds_only_files(folder, own)


def _same_file(first: Path, second: Path) -> bool:
    try:
        a, b = first.lstat(), second.lstat()
    except OSError:
        return False
    return (a.st_dev, a.st_ino) == (b.st_dev, b.st_ino)


def _retire(old: Path, folder: Path, own: Collection[str]) -> None:
    """Remove a folder that was exchanged, without losing what somebody put into it meanwhile."""
    for name in list(files_below(old)):
        left, there = old / name, folder / name
        if name not in own and not _same_file(left, there):
            newer = not os.path.lexists(there) or left.lstat().st_mtime > there.lstat().st_mtime
            if newer:
                there.parent.mkdir(parents=True, exist_ok=True)
                left.replace(there)
                continue
        left.unlink()
    shutil.rmtree(old, ignore_errors=True)


def _sibling_prefix(folder: Path) -> str:
    return f".{folder.name}.dqforge-"


def clear_sibling(sibling: Path, folder: Path, own: Collection[str] | None) -> None:
    """Remove what a killed run left beside a folder.

    ``own`` names dqforge's files in it; None says that it was never completed: copies and links,
    nothing that is only there.
    """
    if own is None:
        shutil.rmtree(sibling, ignore_errors=True)
    else:
        _retire(sibling, folder, own)


def siblings(folder: Path) -> list[Path]:
    """What killed runs left beside a folder."""
    return sorted(folder.parent.glob(f"{_sibling_prefix(folder)}*"))


def _swap(
    folder: Path, contents: Mapping[str, bytes], carried: Collection[str], own: Collection[str]
) -> None:
    """Write beside the folder, and put that in its place in one step.

    Raises OSError with everything as it was.
    """
    sibling = folder.parent / f"{_sibling_prefix(folder)}{secrets.token_hex(4)}"
    exists = folder.is_dir()
    try:
        _fill(sibling, contents)
        if exists:
            about = folder.stat()
            os.chown(sibling, about.st_uid, about.st_gid)
            sibling.chmod(stat.S_IMODE(about.st_mode))
        for name in carried:
            place = sibling / name
            place.parent.mkdir(parents=True, exist_ok=True)
            os.link(folder / name, place, follow_symlinks=False)
        flush_folder(sibling)
        if exists:
            _exchange(sibling, folder)
        else:
            sibling.rename(folder)
    except BaseException:
        shutil.rmtree(sibling, ignore_errors=True)
        raise
    flush_folder(folder.parent)
    if exists:
        _retire(sibling, folder, own)


def finish_pending(folder: Path, marker: str) -> None:
    """Move the files of a run that was cut off into their places; its ``marker`` goes last."""
    pending = folder / PENDING
    names = sorted(files_below(pending), key=lambda name: (name == marker, name))
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (pending / name).replace(folder / name)
    flush_folder(folder)
    shutil.rmtree(pending)


def _replace_inside(
    folder: Path, contents: Mapping[str, bytes], superseded: Collection[str], marker: str
) -> None:
    """Write into the folder itself, say so, and move every file to its place."""
    staged, pending = folder / _STAGED, folder / PENDING
    shutil.rmtree(staged, ignore_errors=True)
    try:
        _fill(staged, contents)
    except BaseException:
        shutil.rmtree(staged, ignore_errors=True)
        raise
    staged.rename(pending)
    flush_folder(folder)
    for name in superseded:
        (folder / name).unlink(missing_ok=True)
    finish_pending(folder, marker)
    remove_empty_folders(folder, superseded)


def remove_empty_folders(folder: Path, names: Collection[str]) -> None:
    """Remove the folders in which files of these names lay, as far as they are empty."""
    for below in sorted({Path(name).parent for name in names} - {Path()}, reverse=True):
        try:
            (folder / below).rmdir()
        except OSError:
            continue


def replace_content(
    folder: Path,
    contents: Mapping[str, bytes],
    own: Collection[str],
    superseded: Collection[str],
    marker: str,
) -> None:
    """Put files into a folder all at once; what others put there stays.

    Args:
        folder: Real path (no link); need not exist, its parent must.
        contents: Files by name relative to the folder, ``marker`` last.
        own: Names of dqforge's files that lie there now.
        superseded: Those of them that go away.
        marker: Name of the file by which a complete folder is known.

    Raises:
        OSError: The folder cannot be written; it is as it was.
    """
    if not folder.is_dir():
        _swap(folder, contents, (), ())
        return
    if _can_exchange(folder, {*own, *contents}):
        carried = [
            name for name in files_below(folder) if name not in contents and name not in superseded
        ]
        try:
            _swap(folder, contents, carried, {*contents, *superseded})
        except OSError:
            # no exchange, no links, or no right to the folder above:
            # the way inside needs none of them
            pass
        else:
            return
    _replace_inside(folder, contents, superseded, marker)
