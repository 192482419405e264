"""Arrays of NPZ archives and HDF5 files; what they claim is counted before anything is decoded."""

from __future__ import annotations

import importlib
import io
import math
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import MOST_POINTS, NamedArray, check_bytes, reading

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
