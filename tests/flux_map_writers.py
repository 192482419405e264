"""Named arrays of a flux map written in the formats that are read."""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.io import savemat

from dqforge.machines.arrays import FloatArray

Arrays = Mapping[str, FloatArray]


def text(arrays: Arrays, mark: str = ";") -> bytes:
    rows = np.column_stack(list(arrays.values())).tolist()
    return "\n".join([mark.join(arrays), *(mark.join(map(repr, row)) for row in rows)]).encode()


def npz(arrays: Arrays) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def mat(arrays: Arrays) -> bytes:
    stream = io.BytesIO()
    savemat(stream, dict(arrays))
    return stream.getvalue()


def hdf5(arrays: Arrays) -> bytes:
    library = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with library.File(stream, "w") as file:
        for name, values in arrays.items():
            file[name] = values
    return stream.getvalue()


def case_table(arrays: Arrays) -> bytes:
    return "\n".join(
        ";".join([name, "", *map(repr, values.tolist())]) for name, values in arrays.items()
    ).encode()
