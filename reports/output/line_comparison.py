"""Two texts that must be the same: where they first differ, with both values,
and what was compared, in numbers.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


_CHECKSUM = re.compile(r"\b[0-9a-f]{64}\b")


_NUMBER = re.compile(
    r"(?<![A-Za-z0-9_.])(?<![A-Za-z]-)[-+]?(?:0x[0-9A-Fa-f]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[FfUuLl]*\b"
)


_MACRO = re.compile(r"^#define ([A-Za-z_]\w*)[ \t]+(\S.*)$", re.MULTILINE)


_ROW = re.compile(r"^\s*\{.*\},?\s*$", re.MULTILINE)


_KEY = re.compile(r'^\s*"([^"]+)": ')


_TOKEN = re.compile(r"\s+|[-+]?(?:0x[0-9A-Fa-f]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\w*|\w+|.")


_LONGEST = 60


@dataclass(frozen=True, slots=True)
class Difference:
    """The first difference of two texts: one-based line, what stands there,
    and what must stand there.
    """

    line: int
    found: str
    expected: str
    name: str = ""

    def __str__(self) -> str:
        named = f"{self.name} is " if self.name else ""
        return f"{self.line}: {named}{self.found}, the design gives {self.expected}"


@dataclass(frozen=True, slots=True)
class Tally:
    """What emitted files hold.

    Macros with a value, literals in code and tables, rows of test vectors, figures in comments,
    checksums of the input, and single values of the result.
    """

    files: int = 0
    macros: int = 0
    literals: int = 0
    vectors: int = 0
    figures: int = 0
    checksums: int = 0
    entries: int = 0

    def __add__(self, other: Tally) -> Tally:
        names = self.__dataclass_fields__
        return Tally(**{name: getattr(self, name) + getattr(other, name) for name in names})


def _shown(text: str) -> str:
    """A piece of a line for a message, on one line and in quotes where it is
    not a plain word or number.
    """
    if not text:
        return "nothing"
    if re.fullmatch(r"[-+\w.]+", text):
        return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
    return ascii(text if len(text) <= _LONGEST else text[:_LONGEST] + "...")


def _name_of(line: str) -> str:
    """What a line gives a value to, where it says so."""
    macro = re.match(r"#define ([A-Za-z_]\w*)[ \t]", line)
    key = _KEY.match(line)
    return macro[1] if macro else key[1] if key else ""


def _pieces(found: str, expected: str) -> tuple[str, str]:
    """The first tokens that differ in two lines."""
    pairs = zip_longest(_TOKEN.findall(found), _TOKEN.findall(expected), fillvalue="")
    return next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))


def tokens(line: str) -> list[str]:
    """Numbers, words and single characters of a line."""
    return _TOKEN.findall(line)


def difference_of_lines(number: int, have: str | None, want: str | None) -> Difference:
    """How two lines differ that do; None for one that is not there."""
    if have is None:
        return Difference(number, "no such line", _shown(want or ""))
    if want is None:
        return Difference(number, _shown(have), "its end")
    found, expected = _pieces(have, want)
    return Difference(number, _shown(found), _shown(expected), _name_of(want))


def first_difference(found: str, expected: str) -> Difference | None:
    """Where two texts first differ, None where they do not."""
    lines = zip_longest(found.split("\n"), expected.split("\n"))
    for number, (have, want) in enumerate(lines, 1):
        if have != want:
            return difference_of_lines(number, have, want)
    return None


def _leaves(value: Any) -> int:
    if isinstance(value, dict):
        return sum(map(_leaves, value.values()))
    if isinstance(value, list):
        return sum(map(_leaves, value))
    return 1


def tally(name: str, text: str) -> Tally:
    """What a file holds, by its name."""
    if name.endswith(".json"):
        return Tally(files=1, entries=_leaves(json.loads(text)))
    comments = " ".join(_COMMENT.findall(text))
    code = _COMMENT.sub(" ", text)
    checksums = len(_CHECKSUM.findall(comments))
    macros = len(_MACRO.findall(code))
    code = _MACRO.sub("", code)
    rows = _ROW.findall(code) if name.endswith("_vectors.h") else []
    rest = _ROW.sub("", code) if rows else code
    counted = Counter(
        files=1, macros=macros, literals=len(_NUMBER.findall(rest)), vectors=len(rows)
    )
    figures = len(_NUMBER.findall(_CHECKSUM.sub("", comments)))
    return Tally(**counted, figures=figures, checksums=checksums)


# What other libraries or another processor make of a file: the same but for the last digits.

# Relative difference of numbers that counts as one of the last digits: eight units of float32.
RELATIVE = 1e-6
NOISE = 1e-12  # Magnitude below which a number is what rounding left of zero.
BOUND = f"the last digits ({RELATIVE:g} of a number, {NOISE:g} of zero)"

# What reading an archive raises that was tampered with.
_DAMAGED = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)

_FRACTION = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][-+]?\d+)?(?=[Ff]?$)")
_CODE = re.compile(r"[-+]?\d+$")
_BITS = re.compile(r"0x([0-9A-F]{8})U$")


def _close(have: float, want: float) -> bool:
    largest = max(abs(have), abs(want))
    return abs(have - want) <= RELATIVE * largest or largest <= NOISE


def _alike(have: str, want: str, *, vectors: bool) -> bool:
    """Whether two tokens are one number but for its last digits."""
    if have == want:
        return True
    first, second = _FRACTION.match(have), _FRACTION.match(want)
    if first and second:
        return _close(float(first[0]), float(second[0]))
    if not vectors:
        return False
    one, other = _BITS.match(have), _BITS.match(want)
    if one and other:
        values = [struct.unpack(">f", bytes.fromhex(bits[1]))[0] for bits in (one, other)]
        return _close(values[0], values[1])
    codes = _CODE.match(have) and _CODE.match(want)
    return bool(codes) and abs(int(have) - int(want)) <= 1


def changed_value(have: str, want: str, name: str) -> Difference | None:
    """Where two texts first differ by more than last digits, None where they do not.

    Args:
        have, want: What lies there, and what was computed.
        name: Of the file: in test vectors, whole numbers are bits of float32 or codes, and may be
            off by one.
    """
    vectors = name.endswith("_vectors.h")
    lines = zip_longest(have.split("\n"), want.split("\n"))
    for number, (one, other) in enumerate(lines, 1):
        if one == other:
            continue
        if one is None or other is None:
            return difference_of_lines(number, one, other)
        pairs = zip_longest(tokens(one), tokens(other), fillvalue="")
        if not all(_alike(first, second, vectors=vectors) for first, second in pairs):
            return difference_of_lines(number, one, other)
    return None


def _arrays(content: bytes) -> Mapping[str, NDArray[Any]] | None:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except _DAMAGED:
        return None


def _changed(have: NDArray[Any], want: NDArray[Any], *, exact: bool) -> Iterator[tuple[int, ...]]:
    """Places of samples that differ."""
    if want.dtype.kind != "f":
        same = have == want
    elif exact:
        same = (have == want) | (np.isnan(have) & np.isnan(want))
    else:
        finite = np.abs(want[np.isfinite(want)])
        bound = RELATIVE * float(finite.max(initial=0.0)) + NOISE
        same = np.isclose(have, want, rtol=0.0, atol=bound, equal_nan=True)
    for place in np.argwhere(~same):
        yield tuple(place.tolist())


def changed_sample(have: bytes, want: bytes, *, exact: bool = False) -> str | None:
    """Where two archives of samples first differ by more than last digits, or at all; None where
    they do not. The bound is `RELATIVE` of the largest magnitude of an array.
    """
    found, expected = _arrays(have), _arrays(want)
    if expected is None or found is None or list(found) != list(expected):
        return ": is no archive of the samples that the design gives"
    for name, array in expected.items():
        there = found[name]
        if there.dtype != array.dtype or there.shape != array.shape:
            return f": {name} has another shape or type than the design gives"
        place = next(_changed(there, array, exact=exact), None)
        if place is not None:
            index = ", ".join(map(str, place))
            return f": {name}[{index}] is {there[place]}, the design gives {array[place]}"
    return None
