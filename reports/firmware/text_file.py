"""Configuration files of others as text: bounded, decoded, and encoded again as they were."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.records import dataclass
from dqforge.machines.wording import shown

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import OwnValue

# Size of the largest file that is read; a larger one is refused by its size. The largest real ones,
# projects of a vendor's tool, have less than 1 MB.
MOST_BYTES = 8_000_000
_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_LONGEST_NUMBER = 60
_LEAST, _MOST = 1e-30, 1e30

# What to write for a number that `in_range` refuses.
IN_RANGE = f"write one from {_LEAST:g} to {_MOST:g}"


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text of others.

    Args:
        source: File name as the user gave it.
        text: Its text with line feeds at the ends of lines, without byte order mark.
        encoding: Name of the encoding with which `encoded` gives it back.
        crlf: Whether its lines end in carriage return and line feed.
    """

    source: str
    text: str
    encoding: str = "utf-8"
    crlf: bool = False

    def encoded(self, text: str) -> bytes:
        """Another text in encoding and line ends of this one."""
        whole = text.replace("\n", "\r\n") if self.crlf else text
        try:
            return whole.encode(self.encoding)
        except UnicodeEncodeError:
            return whole.encode("utf-8")


def read_text_file(place: str | Path) -> TextFile:
    """Text of a regular file of at most `MOST_BYTES`.

    Raises:
        InputError: There is no such file, it is too large, or no text.
    """
    return decoded_file(read_regular_file(place, MOST_BYTES), str(place))


def decoded_file(content: bytes, source: str) -> TextFile:
    """Text in UTF-8, UTF-16 with its mark, or latin-1.

    Raises:
        InputError: It is binary, damaged or empty; with the line.
    """
    encoding = _encoding(content)
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        if encoding == "utf-16":
            raise InputError(
                "the UTF-16 text is damaged; save the file again", source=source
            ) from None
        encoding = "latin-1"
        text = content.decode(encoding)
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        message = "this is binary data, not text; name a file that the firmware's tool writes"
        raise InputError(message, source=source, line=line)
    if not text.strip():
        message = "the file is empty; name one that the firmware's tool writes"
        raise InputError(message, source=source, line=1)
    feeds = text.count("\n")
    crlf = feeds > 0 and text.count("\r\n") == feeds
    plain = text.replace("\r\n", "\n").replace("\r", "\n")
    return TextFile(source, plain, encoding, crlf)


def _encoding(content: bytes) -> str:
    if content[:2] in _WIDE:
        return "utf-16"
    return "utf-8-sig" if content.startswith(codecs.BOM_UTF8) else "utf-8"


def in_range(value: float) -> bool:
    """Whether the float32 of a firmware can hold it, and products of a few such numbers a float."""
    return value == 0.0 or _LEAST <= abs(value) <= _MOST


def plain_number(text: str) -> float | None:
    """Value of a decimal number as files write it; None of anything else, and of what is not
    `in_range`.
    """
    stripped = text.strip()
    if len(stripped) > _LONGEST_NUMBER or not _NUMBER.fullmatch(stripped):
        return None
    value = float(stripped)
    return value if in_range(value) else None


def no_number(text: str) -> str:
    """What is wrong with a text of which `plain_number` makes nothing, and what to write."""
    kind = "beyond every firmware's range" if _NUMBER.fullmatch(text.strip()) else "not a number"
    return f"is {shown(text[:_LONGEST_NUMBER])}, {kind}; {IN_RANGE}"


def number_text(value: OwnValue, digits: int) -> str:
    """A value as plain files hold it: of a float that many significant digits, words and whole
    numbers as they are.
    """
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def c_float(value: float, digits: int) -> str:
    """A float constant of C: with a point or an exponent, and the suffix."""
    text = f"{value:.{digits}g}"
    return f"{text if '.' in text or 'e' in text else text + '.0'}f"
