"""Arrays of MATLAB 4 and 5 files; those of version 7.3 are HDF5."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.files import named_arrays as flux_map_arrays
from dqforge.machines.files.named_arrays import NamedArray, check_bytes, reading

_MATRIX, _COMPRESSED = 14, 15

# Kinds of elements of a MATLAB 5 file, with numpy's names of the numbers.
_STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}

# Classes of its variables, and the flag of complex ones.
_STRUCT, _TEXT, _NUMERIC, _COMPLEX = 2, 4, range(6, 16), 0x800


def arrays_of_mat4(content: bytes, source: str) -> list[NamedArray]:
    """Variables of a MATLAB 4 file."""
    from scipy.io import loadmat

    if 0 not in content[:4]:  # the first number, 0 to 4052, of the format that has no mark
        raise InputError("this is no MATLAB 4, 5 or 7.3 file; save it again", source=source)
    check_bytes(len(content), source)  # it holds numbers as they are, of 8 bytes at most
    with reading("MATLAB", source):
        variables = loadmat(io.BytesIO(content))
    return [
        NamedArray(name, name, values)
        for name, values in variables.items()
        if isinstance(values, np.ndarray)
    ]


def arrays_of_mat5(content: bytes, source: str) -> list[NamedArray]:
    """Variables of a MATLAB 5 file (MathWorks, "MAT-File Format"), fields of
    structs with dotted paths.
    """
    # Not by scipy: damaged files crash its reader (segmentation fault in 1.17),
    # and it inflates whatever there is.
    order = "<" if content[126:128] == b"IM" else ">"
    found: list[NamedArray] = []
    total = 0
    with reading("MATLAB", source):
        for kind, element in _elements(memoryview(content)[128:], order):
            variables = [(kind, element)]
            if kind == _COMPRESSED:
                inflated = zlib.decompressobj().decompress(
                    element, flux_map_arrays.MOST_BYTES + 1 - total
                )
                total += len(inflated)
                check_bytes(total, source)
                variables = list(_elements(memoryview(inflated), order))
            for inner, variable in variables:
                if inner == _MATRIX:
                    found += _variable(variable, order)
    return found


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Kinds and bytes of the elements of a MATLAB 5 file that stand one behind the other."""
    place = 0
    while place < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start, pad = place + 8, 0 if kind == _COMPRESSED else -size % 8
        if kind >> 16:  # up to four bytes stand within the tag
            kind, size, start, pad = kind & 0xFFFF, kind >> 16, place + 4, 4 - (kind >> 16)
        place = start + size + pad
        if start + size > len(content) or pad < 0:
            raise ValueError("it is cut off or damaged")
        yield kind, content[start : start + size]


def _variable(
    content: memoryview, order: str, path: str = "", name: str = ""
) -> Iterator[NamedArray]:
    """Array of a MATLAB 5 matrix, or all arrays within a struct.

    Cells, objects and sparse matrices hold no map.
    """
    parts = list(_elements(content, order))
    if not parts:
        return
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    form, shape = flags & 0xFF, _numbers(parts[1], order)
    name = name or bytes(parts[2][1]).decode("latin-1")
    path = path or name
    if form == _STRUCT and np.all(shape == 1):
        length, names = int(_numbers(parts[3], order)[0]), bytes(parts[4][1])
        for k, (_, field) in enumerate(parts[5:]):
            title = names[k * length : (k + 1) * length].split(b"\0")[0].decode("latin-1")
            yield from _variable(field, order, f"{path}.{title}", title)
    elif form == _TEXT:
        yield NamedArray(path, name, np.broadcast_to(np.array("", dtype="U1"), shape))
    elif form in _NUMERIC:
        values = _numbers(parts[3], order)
        if flags & _COMPLEX:
            values = values + 1j * _numbers(parts[4], order)
        yield NamedArray(path, name, values.reshape(shape, order="F"))


def _numbers(part: tuple[int, memoryview], order: str) -> NDArray[Any]:
    """Numbers of a MATLAB 5 element, shape (K,)."""
    return np.frombuffer(part[1], dtype=order + _STORED[part[0]])
