"""Files that a user names, opened once and the same way everywhere: regular files only,
up to a stated size; and the lines of those read a moment ago.

A device or a named pipe has no end and a loop of links no content;
each is refused in one line instead of waited for.
"""

from __future__ import annotations

import codecs
import errno
import os
import stat
from collections import OrderedDict
from pathlib import Path

from dqforge.machines.errors import InputError

MEGABYTE = 1_000_000


_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_regular_file(place: str | Path, most_bytes: int, shown: str | None = None) -> bytes:
    """Content of a regular file of at most ``most_bytes`` bytes; links are followed.

    Args:
        place: Where the file lies.
        most_bytes: The largest size; a larger file is refused before it is read, never cut.
        shown: What the message calls the file; its path otherwise.

    Raises:
        InputError: There is no such file, it is no regular file, too large, may not be read, or its
            links lead in a circle.
    """
    name = str(place) if shown is None else shown
    try:
        # Without O_NONBLOCK the opening of a named pipe waits for its writer.
        descriptor = os.open(
            place, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        )
    except (OSError, ValueError) as error:
        raise InputError(_reason(error, place), source=name) from None
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            kind = next(
                (word for is_kind, word in _KINDS if is_kind(found.st_mode)), "no regular file"
            )
            raise InputError(f"this is {kind}; name a regular file", source=name)
        limit = f"at most {most_bytes / MEGABYTE:.4g} MB can be read"
        if found.st_size > most_bytes:
            raise InputError(
                f"the file has {found.st_size / MEGABYTE:.4g} MB, {limit}", source=name
            )
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            content = file.read(most_bytes + 1)
    except OSError as error:
        raise InputError(_reason(error, place), source=name) from None
    finally:
        os.close(descriptor)
    if (
        len(content) > most_bytes
    ):  # it grew while it was read, or belongs to /proc and states no size
        raise InputError(
            f"the file has more than {most_bytes / MEGABYTE:.4g} MB, {limit}", source=name
        )
    remember(name, content)
    return content


def _reason(error: OSError | ValueError, place: str | Path) -> str:
    """Why a file cannot be opened, and what to do."""
    if not isinstance(error, OSError):
        return "the file cannot be read: this is not a file name; check it"
    if error.errno == errno.ELOOP:
        return "its links lead in a circle; name the file itself"
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return "there is no such file; check the name"
    # Windows may open no folder, and says so of a folder as of a file without permission.
    if error.errno == errno.EISDIR or (error.errno == errno.EACCES and Path(place).is_dir()):
        return "this is a folder; name a regular file"
    if error.errno == errno.EACCES:
        return "the file may not be read; check its permissions"
    return f"the file cannot be read: {error.strerror}"


# Lines of files that were read a moment ago, for whoever shows where one is wrong.
#
# They are kept as they were read: a message about a line never reads its file again, which may
# have changed, or have an end no more.

_LARGEST = 4_000_000
_MOST_FILES = 8
_PACKED = (b"\x1f\x8b", b"PK\x03\x04")
_kept: OrderedDict[str, bytes] = OrderedDict()


def remember(name: str, content: bytes) -> None:
    """Keep the content of a file by what messages call it; not that of large or binary ones."""
    _kept.pop(name, None)
    packed = content.startswith(_PACKED) or b"\x00" in content
    if len(content) <= _LARGEST and not packed:
        _kept[name] = content
        if len(_kept) > _MOST_FILES:
            _kept.popitem(last=False)


def line_of(name: str, number: int) -> str | None:
    """A line of a file that was read lately, counted from 1, without its end; None where it is not
    there.

    What is no UTF-8 stands in it as question marks.
    """
    content = _kept.get(name)
    if content is None or number < 1:
        return None
    lines = content.removeprefix(codecs.BOM_UTF8).splitlines()
    return lines[number - 1].decode("utf-8", "replace") if number <= len(lines) else None
