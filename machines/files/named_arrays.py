"""Named arrays, which every file of a flux map is made of before anybody asks what they mean,
and their limits.
"""

from __future__ import annotations

import importlib
import io
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

MOST_BYTES = 256_000_000  # Decoded bytes of all arrays of a file.
MOST_POINTS = 4_000_000  # Values of one array of a file.
_MOST_LISTED = 20


@dataclass(frozen=True, slots=True)
class NamedArray:
    """One array of a file: where it stands, the last part of that, its values and its
    declared unit ('' if none).

    ``lines`` are the one-based lines of a text table that the values of a column stand in,
    shape (K,).
    """

    path: str
    name: str
    values: NDArray[Any]
    unit: str = ""
    lines: NDArray[np.intp] | None = None

    @property
    def group(self) -> str:
        """Where the array stands without its name."""
        return self.path.removesuffix(self.name)

    @property
    def labels(self) -> tuple[str, str, str]:
        """What a user may call the array."""
        return self.path, self.name, f"{self.name} [{self.unit}]"

    @property
    def title(self) -> str:
        """Path with shape, or with what the array holds instead of numbers."""
        path = f"{self.path} [{self.unit}]" if self.unit else self.path
        return f"{path} {self.values.shape}" if self.numeric else f"{path} ({self.held})"

    @property
    def numeric(self) -> bool:
        """Whether the array holds numbers."""
        return self.values.dtype.kind in "iufc"

    @property
    def held(self) -> str:
        """What the array holds, if not numbers."""
        names = {
            "O": "Python objects, cells or references",
            "U": "text",
            "S": "text",
            "b": "truth values",
        }
        return names.get(self.values.dtype.kind, "records")


def listed(arrays: Sequence[NamedArray]) -> str:
    """Names and shapes of arrays, in one line."""
    more = f" and {len(arrays) - _MOST_LISTED} more" if len(arrays) > _MOST_LISTED else ""
    return (
        ", ".join(array.title for array in arrays[:_MOST_LISTED]) + more
        if arrays
        else "no arrays at all"
    )


def check_bytes(total: int, source: str) -> None:
    """Refuse arrays that take too much memory once decoded, as those of a small archive may."""
    if total > MOST_BYTES:
        message = f"the arrays take more than {MOST_BYTES / 1e6:g} MB once decoded"
        raise InputError(f"{message}; save those of the map alone, or a coarser one", source=source)


@contextmanager
def reading(form: str, source: str) -> Iterator[None]:
    """Around a library's reader, which raises anything for a damaged file:
    that becomes one line for the user.

    Raises:
        InputError: What was raised within; of one that the library did not know as such its reason,
            and what to do.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"cannot read this {form} file ({reason}); save it again", source=source
        ) from error


# Arrays of NPZ archives and HDF5 files; what they claim is counted before anything is decoded.

# Bytes of one chunk of an HDF5 dataset, which is decoded whole even where a single value of it is
# asked for.
_MOST_CHUNK = 32_000_000


def arrays_of_npz(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of an NPZ archive; Python objects in it are never loaded."""
    found = []
    with reading("NPZ", source):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            check_bytes(sum(member.file_size for member in archive.infolist()), source)
            for member in archive.infolist():
                _check_claim(archive, member)
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    values = arrays[name]
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    values = np.empty((), dtype=object)
                if isinstance(values, np.ndarray):  # a member that is no array comes as bytes
                    found.append(NamedArray(name, name, values))
    return found


def _check_claim(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Refuse a member whose header claims more numbers than it has bytes:
    they would be allocated first.
    """
    with archive.open(member) as stream:
        if stream.read(6) != b"\x93NUMPY":
            return
        version = tuple(stream.read(2))
        form = np.lib.format
        read = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
        shape, _, kind = read(stream)
        if not kind.hasobject and math.prod(shape) * kind.itemsize > member.file_size:
            raise ValueError(f"{member.filename} claims more values than it holds")


def arrays_of_hdf5(content: bytes, source: str) -> list[NamedArray]:
    """Datasets of an HDF5 or MATLAB 7.3 file, wherever they stand in its tree."""
    try:
        h5py = importlib.import_module("h5py")
    except ImportError as error:
        name = "MAT 7.3" if source.lower().endswith(".mat") else "HDF5"
        message = f"reading {name} needs h5py; install it with: pip install dqforge[h5]"
        raise InputError(message, source=source) from error
    found: list[NamedArray] = []
    matlab, total = content[:10] == b"MATLAB 7.3", 0

    def visit(path: str, node: Any) -> None:
        nonlocal total
        # A dataset whose bytes lie in another file is not this file's;
        # '#refs#' are the contents of MATLAB's cells.
        if not isinstance(node, h5py.Dataset) or node.shape is None or path.startswith("#"):
            return
        if node.external or node.is_virtual or "MATLAB_empty" in node.attrs:
            return
        if _belongs(node):
            total += node.size * node.dtype.itemsize
            check_bytes(total, source)
            _check_chunk(path, node, source)
        values = _dataset(node)
        mirrored = matlab or "MATLAB_class" in node.attrs
        unit = node.attrs.get("units", node.attrs.get("unit", ""))
        shown = path.replace("/", ".") if matlab else path
        found.append(
            NamedArray(
                shown, path.rpartition("/")[2], values.T if mirrored else values, _text(unit)
            )
        )

    with reading("HDF5", source), h5py.File(io.BytesIO(content), "r") as file:
        file.visititems(visit)
    return found


def _numeric(node: Any) -> bool:
    """Whether an HDF5 dataset holds numbers, complex ones as pairs included."""
    return node.dtype.kind in "iufc" or node.dtype.names == ("real", "imag")


def _belongs(node: Any) -> bool:
    """Whether an HDF5 dataset may belong to a map and is worth decoding."""
    text = _text(node.attrs.get("MATLAB_class", "")) == "char"
    return _numeric(node) and not text and node.size <= MOST_POINTS


def _check_chunk(path: str, node: Any, source: str) -> None:
    size = math.prod(node.chunks or ()) * node.dtype.itemsize
    if size > _MOST_CHUNK:
        message = (
            f"{path} lies in chunks of {size / 1e6:.0f} MB, at most {_MOST_CHUNK / 1e6:g} MB can "
            "be read"
        )
        raise InputError(f"{message}; save it in smaller chunks or in one piece", source=source)


def _dataset(node: Any) -> NDArray[Any]:
    """Values of an HDF5 dataset; a stand-in of its shape without memory where
    they cannot belong to a map.
    """
    if _text(node.attrs.get("MATLAB_class", "")) == "char":
        return np.broadcast_to(np.array("", dtype="U1"), node.shape)
    if not _belongs(node):
        return np.broadcast_to(np.zeros((), dtype=float if _numeric(node) else object), node.shape)
    values: NDArray[Any] = np.asarray(node[()])
    if values.dtype.names:
        values = values["real"] + 1j * values["imag"]
    return values


def _text(attribute: Any) -> str:
    """An HDF5 attribute as text, '' where it is none."""
    if isinstance(attribute, np.ndarray) and attribute.size == 1:
        attribute = attribute.item()
    if isinstance(attribute, bytes):
        return attribute.decode("utf-8", errors="replace").strip()
    return attribute.strip() if isinstance(attribute, str) else ""


# Arrays of MATLAB 4 and 5 files; those of version 7.3 are HDF5.

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
                inflated = zlib.decompressobj().decompress(element, MOST_BYTES + 1 - total)
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
