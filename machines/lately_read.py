"""Lines of files that were read a moment ago, for whoever shows where one is wrong.

They are kept as they were read: a message about a line never reads its file again, which may have
changed, or have an end no more.
"""

from __future__ import annotations

import codecs
from collections import OrderedDict

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
