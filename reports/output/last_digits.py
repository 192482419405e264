"""What other libraries or another processor make of a file: the same but for the last digits."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.reports.output.line_comparison import Difference, difference_of_lines, tokens

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
