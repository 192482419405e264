"""A part of a study as bytes: one Parquet file, the same bytes wherever it is made, sealed so that
every change of it is found.

Checksums of pages say nothing of the footer, of the headers of pages, or of a part that was put in
the place of another. The seal does: a SHA-256 over the whole file, which stands in the metadata of
the file itself and counts as zeros while it is computed. A part needs no list beside it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import KEY_BYTES, STATES, ColumnSpec, RowBlock

if TYPE_CHECKING:
    import pyarrow as pa

INDEX, KEY, STATE, MESSAGE = "index", "key", "state", "message"
OWN_COLUMNS = (INDEX, KEY, STATE, MESSAGE)

_STUDY, _FIRST = b"dqforge.study", b"dqforge.first"
_COLUMNS, _AUDITED = b"dqforge.columns", b"dqforge.audited"
_SEAL = b"dqforge.sha256"
_DIGITS = 64
_BLANK = b"0" * _DIGITS
# How the footer writes the name of the seal: the next field is a text of 64 bytes.
_MARKER = _SEAL + b"\x18\x40"
_TAIL = 8
_PARQUET = b"PAR1"


@dataclass(frozen=True, slots=True)
class PartAbout:
    """What a part says of itself.

    Args:
        digest: SHA-256 of what its rows depend on (`dqforge.reports.study_store.study_header`).
        first: Index of its first row.
        count: Number of rows.
        audited: As `RowBlock.audited`.
    """

    digest: str
    first: int
    count: int
    audited: Mapping[str, float]


class PartError(ValueError):
    """A part is not as it was written; the text says in what."""


def encode_part(block: RowBlock, columns: Sequence[ColumnSpec], digest: str) -> bytes:
    """The file of a part.

    Args:
        block: Its rows.
        columns: Columns of the study, in their order.
        digest: SHA-256 of what the rows depend on, in hexadecimal.

    Returns:
        The same for the same rows, columns, digest and version of pyarrow.

    Raises:
        ValueError: The block does not have these columns, or columns of another length.
    """
    return encode_rows(np.arange(block.first, block.first + block.count), block, columns, digest)


def encode_rows(
    index: NDArray[np.int64], block: RowBlock, columns: Sequence[ColumnSpec], digest: str
) -> bytes:
    """A file of rows of any index; arguments and outcome as of `encode_part`.

    ``index`` are those of the rows of the block, (n,).
    """
    import pyarrow as pa
    from pyarrow import parquet

    table = _table(index, block, columns)
    words = [STATE, *(column.name for column in columns if column.kind == "choice")]
    sink = pa.BufferOutputStream()
    with parquet.ParquetWriter(
        sink,
        table.schema,
        version="2.6",
        data_page_version="1.0",
        compression="zstd",
        compression_level=3,
        use_dictionary=words,
        store_schema=False,
        write_page_checksum=True,
    ) as writer:
        writer.write_table(table, row_group_size=max(block.count, 1))
        writer.add_key_value_metadata(_metadata(block, columns, digest))
    return _sealed(sink.getvalue().to_pybytes())


def _metadata(block: RowBlock, columns: Sequence[ColumnSpec], digest: str) -> dict[bytes, bytes]:
    """What stands in the footer; the metadata of single columns would be lost without the schema
    of Arrow, so that units stand here.
    """
    described = {column.name: column.unit for column in columns}
    return {
        _STUDY: digest.encode("ascii"),
        _FIRST: str(block.first).encode("ascii"),
        _COLUMNS: _ascii_json(described),
        _AUDITED: _ascii_json({name: float(block.audited[name]) for name in sorted(block.audited)}),
        _SEAL: _BLANK,
    }


def _ascii_json(plain: Mapping[str, object]) -> bytes:
    return json.dumps(plain, separators=(",", ":")).encode("ascii")


def _table(index: NDArray[np.int64], block: RowBlock, columns: Sequence[ColumnSpec]) -> pa.Table:
    import pyarrow as pa

    names = [column.name for column in columns]
    if list(block.columns) != names:
        raise ValueError(f"a block has the columns {list(block.columns)}, its study {names}")
    arrays = {
        INDEX: pa.array(np.asarray(index, dtype=np.int64)),
        KEY: _keys(block.keys),
        STATE: _words(block.states, STATES),
    }
    for column in columns:
        values = block.columns[column.name]
        arrays[column.name] = (
            _words(values, column.choices) if column.kind == "choice" else _numbers(values)
        )
    arrays[MESSAGE] = pa.array([_text(message) for message in block.messages], pa.string())
    wrong = [name for name, array in arrays.items() if len(array) != block.count]
    if wrong:
        raise ValueError(f"columns of another length than {block.count}: {', '.join(wrong)}")
    fields = [
        pa.field(name, array.type, nullable=array.type not in (pa.int64(), pa.float64()))
        for name, array in arrays.items()
    ]
    return pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))


def _keys(keys: NDArray[np.uint8]) -> pa.Array:
    import pyarrow as pa

    count = len(keys)
    if keys.shape != (count, KEY_BYTES):
        raise ValueError(f"keys of shape {keys.shape}; expected ({count}, {KEY_BYTES})")
    content = pa.py_buffer(np.ascontiguousarray(keys, dtype=np.uint8).tobytes())
    return pa.FixedSizeBinaryArray.from_buffers(pa.binary(KEY_BYTES), count, [None, content])


def _numbers(values: FloatArray | NDArray[np.int32]) -> pa.Array:
    """Numbers with one NaN and one zero, whatever signs and payloads they came with."""
    import pyarrow as pa

    numbers = np.asarray(values, dtype=np.float64) + 0.0
    return pa.array(np.where(np.isnan(numbers), np.nan, numbers), pa.float64())


def _words(values: NDArray[Any], choices: Sequence[str]) -> pa.Array:
    """Words by their places; the dictionary holds those that occur, sorted."""
    import pyarrow as pa

    places = np.asarray(values, dtype=np.int64)
    used = [int(place) for place in np.unique(places[places >= 0])]
    order = sorted(used, key=lambda place: choices[place])
    rank = np.zeros(len(choices) + 1, dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    codes = pa.array(rank[places], pa.int32(), mask=places < 0)
    words = pa.array([_text(choices[place]) or "" for place in order], pa.string())
    return pa.DictionaryArray.from_arrays(codes, words)


def _text(text: str) -> str | None:
    """A text that UTF-8 can hold, None for an empty one."""
    return text.encode("utf-8", "replace").decode("utf-8") or None


def _seal_place(data: bytes) -> int:
    """Where the digits of the seal begin."""
    if len(data) < 2 * _TAIL or data[-4:] != _PARQUET:
        raise PartError("it is cut off, or no part")
    footer = int.from_bytes(data[-_TAIL:-4], "little")
    # The metadata of the file lie behind statistics, in which texts of rows stand: the last one.
    place = data.rfind(_MARKER, max(len(data) - _TAIL - footer, 0), len(data) - _TAIL)
    if place < 0:
        raise PartError("it has no seal of dqforge, or was changed")
    return place + len(_MARKER)


def _digits(data: bytes, place: int) -> bytes:
    """SHA-256 of a file with the digits of its seal as zeros, in hexadecimal."""
    digest = hashlib.sha256(memoryview(data)[:place])
    digest.update(_BLANK)
    digest.update(memoryview(data)[place + _DIGITS :])
    return digest.hexdigest().encode("ascii")


def _sealed(data: bytes) -> bytes:
    place = _seal_place(data)
    return data[:place] + _digits(data, place) + data[place + _DIGITS :]


def check_seal(data: bytes) -> None:
    """Hold a part against its seal.

    Raises:
        PartError: Something in it was changed, or it is none.
    """
    place = _seal_place(data)
    if data[place : place + _DIGITS] != _digits(data, place):
        raise PartError("it was changed since it was written")


def part_about(data: bytes) -> PartAbout:
    """What a part says of itself, its seal checked.

    Raises:
        PartError: As `check_seal`, or it is another kind of file.
    """
    import pyarrow as pa
    from pyarrow import parquet

    check_seal(data)
    try:
        found = parquet.read_metadata(pa.BufferReader(data))
    except (pa.ArrowException, OSError) as error:
        raise PartError("it is no part of a study") from error
    return _about(found.metadata, found.num_rows)


def _about(texts: Mapping[bytes, bytes] | None, count: int) -> PartAbout:
    try:
        found = texts or {}
        audited = json.loads(found[_AUDITED])
        return PartAbout(found[_STUDY].decode("ascii"), int(found[_FIRST]), count, audited)
    except (KeyError, TypeError, ValueError) as error:
        raise PartError("it is no part of a study") from error


def part_table(data: bytes, names: Sequence[str]) -> tuple[PartAbout, pa.Table]:
    """What a part says of itself, and columns of it; its seal and the checksums of its pages are
    checked.

    Raises:
        PartError: As `check_seal`, or a column is not there.
    """
    import pyarrow as pa
    from pyarrow import parquet

    check_seal(data)
    words = [name for name in names if name not in (INDEX, KEY)]
    try:
        file = parquet.ParquetFile(
            pa.BufferReader(data), page_checksum_verification=True, read_dictionary=words
        )
        missing = [name for name in names if name not in file.schema_arrow.names]
        if missing:
            raise PartError(f"it has no column {missing[0]}")
        table = file.read(columns=list(names), use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise PartError("it cannot be read") from error
    return _about(file.metadata.metadata, file.metadata.num_rows), table
