"""A part of a study as bytes: one Parquet file, the same bytes wherever it is made, sealed so that
every change of it is found.

Checksums of pages say nothing of the footer, of the headers of pages, or of a part that was put in
the place of another. The seal does: a SHA-256 over the whole file, which stands in the metadata of
the file itself and counts as zeros while it is computed. A part needs no list beside it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import KEY_BYTES, STATES, ColumnSpec, RowBlock
from dqforge.reports.operating_system.host_compiler import (
    FolderTakenError,
    flush_folder,
    lock_folder,
)

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
        digest: SHA-256 of what its rows depend on (`dqforge.reports.exploration.part_store`).
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
        raise PartError("it is truncated, or not a part")
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
        raise PartError("it is not part of a study") from error
    return _about(found.metadata, found.num_rows)


def _about(texts: Mapping[bytes, bytes] | None, count: int) -> PartAbout:
    try:
        found = texts or {}
        audited = json.loads(found[_AUDITED])
        return PartAbout(found[_STUDY].decode("ascii"), int(found[_FIRST]), count, audited)
    except (KeyError, TypeError, ValueError) as error:
        raise PartError("it is not part of a study") from error


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


# Files of an explored folder: written whole or not at all, read only where they are files, and
# taken away only where a study wrote them.

PARTS = "parts"
FRONT, SENSITIVITY, REPORT = "front.parquet", "sensitivity.json", "report.html"
BESIDE = (FRONT, SENSITIVITY, REPORT)  # What stands beside ``study.json`` when a study is done.
WINNERS = "winners"  # Folder in which each row that is exported has one.
LARGEST_PART = 2_000_000_000  # Bytes of the largest part that is read.

# Flags of opening: no links, no waiting for a pipe, and bytes as they are.
_PART = re.compile(r"part-(\d{6,9})\.parquet")
_LEFTOVER = re.compile(r"\.(?:part-\d{6,9}\.parquet|[a-z][a-z-]*\.(?:json|parquet|html))\.new")
_FULL = (errno.ENOSPC, errno.EDQUOT)
_PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


class StoreError(DqforgeError):
    """What is computed cannot be kept, or what was kept cannot be read; parts that are finished
    stay.
    """


def part_name(part: int) -> str:
    """Name of a part's file in its folder."""
    return f"part-{part:06d}.parquet"


def part_files(folder: Path, parts: Collection[int] | None = None) -> dict[int, Path]:
    """Files that have the name of a part, by its number, links and folders left out.

    Args:
        folder: Of the study.
        parts: Those that are looked for, None for all.
    """
    if parts is not None:
        paths = {part: folder / PARTS / part_name(part) for part in sorted(parts)}
        return {
            part: path for part, path in paths.items() if path.is_file() and not path.is_symlink()
        }
    found = {}
    for entry in _entries(folder / PARTS):
        match = _PART.fullmatch(entry.name)
        if (
            match
            and part_name(int(match[1])) == entry.name
            and entry.is_file(follow_symlinks=False)
        ):
            found[int(match[1])] = Path(entry.path)
    return dict(sorted(found.items()))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read the folder {folder}: {error.strerror}") from error


def remove_leftovers(folder: Path) -> None:
    """Remove files that a run was writing when it ended."""
    for place in (folder, folder / PARTS):
        for entry in _entries(place):
            if _LEFTOVER.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                Path(entry.path).unlink(missing_ok=True)


def read_whole(path: Path) -> bytes:
    """A file of a study; links are not followed.

    Raises:
        OSError: It cannot be read, or is no regular file.
    """
    _refuse_link(path)  # which Windows would follow
    descriptor = os.open(path, os.O_RDONLY | _PLAIN)
    with os.fdopen(descriptor, "rb") as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST_PART:
            raise OSError(errno.EINVAL, "no file of a study")
        return file.read()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it: flushed, renamed, and the folder flushed.

    Raises:
        StoreError: It cannot be written; the old one, if any, is there as it was.
    """
    temporary = path.parent / f".{path.name}.new"
    try:
        _refuse_link(path)
        temporary.unlink(missing_ok=True)
        _fill(temporary, content)
        temporary.replace(path)
        flush_folder(path.parent)
    except OSError as error:
        refuse_write(path, error)


def _refuse_link(path: Path) -> None:
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link")


def write_below(folder: Path, name: str, content: bytes) -> None:
    """Write a file into a folder of the study, which is made if missing; raises as
    `write_whole`, and `StoreError` where a link leads out of the study.
    """
    path = folder / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse_write(path, error)
    if not Path(os.path.realpath(path.parent)).is_relative_to(os.path.realpath(folder)):
        raise StoreError(f"cannot write {path}: a link leads out of {folder}; take another -o")
    write_whole(path, content)


def _fill(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _PLAIN, 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        path.unlink(missing_ok=True)
        raise


def refuse_write(path: Path, error: OSError) -> NoReturn:
    """Say in one line that a file cannot be written, and what to do."""
    reason = error.strerror or str(error)
    advice = "make room" if error.errno in _FULL else "make it writable"
    raise StoreError(
        f"cannot write {path}: {reason}; {advice} and run the same command again, finished parts "
        "are kept"
    ) from error


def keep_folder(folder: Path) -> int:
    """Keep other runs from a folder, until the process ends or closes what comes back.

    Raises:
        InputError: Another run has it.
    """
    try:
        return lock_folder(folder)
    except FolderTakenError as error:
        raise InputError(
            f"{folder} is being written by another run; wait for it, or take another -o"
        ) from error


def own_files(folder: Path, names: tuple[str, ...]) -> Iterator[Path]:
    """Files that a study wrote: its parts, then those of ``names`` that are there."""
    yield from part_files(folder).values()
    for name in names:
        path = folder / name
        if path.is_file() and not path.is_symlink():
            yield path


# Columns of a part as arrays, in the words of the study.


@dataclass(frozen=True, slots=True, eq=False)
class PartColumns:
    """Some columns of one part.

    Args:
        about: What the part says of itself.
        columns: Those that were asked for: numbers (n,) in SI units, of choices the places in their
            words, int32, -1 for none.
        states: Places in `STATES`, int8 (n,).
        keys: Hash of each row's resolved design, uint8 (n, 16); (0, 16) where not asked for.
        messages: Empty texts for rows that ended well; an empty tuple where not asked for.
    """

    about: PartAbout
    columns: Mapping[str, FloatArray | NDArray[np.int32]]
    states: NDArray[np.int8]
    keys: NDArray[np.uint8]
    messages: tuple[str, ...]

    @property
    def first(self) -> int:
        """Index of the first row."""
        return self.about.first

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.about.count


def part_columns(data: bytes, names: Sequence[str], specs: Sequence[ColumnSpec]) -> PartColumns:
    """Columns of a part.

    Args:
        data: The file.
        names: Columns of the study, or `KEY`, `MESSAGE`.
        specs: Columns of the study.

    Raises:
        PartError: The part was changed, or has no such column or word.
    """
    about, table = part_table(data, [*dict.fromkeys([STATE, *names])])
    described = {spec.name: spec for spec in specs}
    columns: dict[str, FloatArray | NDArray[np.int32]] = {}
    for name in names:
        if name in described:
            array = _one(table, name)
            choice = described[name].kind == "choice"
            columns[name] = (
                _places(array, described[name].choices) if choice else _stored_numbers(array)
            )
    states = _places(_one(table, STATE), STATES).astype(np.int8)
    keys = _stored_keys(_one(table, KEY)) if KEY in names else np.empty((0, KEY_BYTES), np.uint8)
    messages = _messages(_one(table, MESSAGE)) if MESSAGE in names else ()
    return PartColumns(about, columns, states, keys, messages)


def _one(table: pa.Table, name: str) -> pa.Array:
    return table.column(name).combine_chunks()


def _stored_numbers(array: pa.Array) -> FloatArray:
    return np.array(array.to_numpy(zero_copy_only=False), dtype=np.float64)


def _places(array: pa.Array, words: Sequence[str]) -> NDArray[np.int32]:
    """Places of words in those of the study, -1 where there is none."""
    known = {word: place for place, word in enumerate(words)}
    found = array.dictionary.to_pylist()
    strange = [word for word in found if word not in known]
    if strange:
        raise PartError("it holds a word unknown to the study")
    places = np.array([*(known[word] for word in found), -1], dtype=np.int32)
    codes: NDArray[np.int32] = array.indices.fill_null(len(found)).to_numpy(zero_copy_only=False)
    return np.asarray(places[codes])


def _stored_keys(array: pa.Array) -> NDArray[np.uint8]:
    content = array.buffers()[1]
    count, start = len(array), array.offset * KEY_BYTES
    flat = np.frombuffer(content, np.uint8, count * KEY_BYTES, start)
    return flat.reshape(count, KEY_BYTES).copy()


def _messages(array: pa.Array) -> tuple[str, ...]:
    return tuple("" if text is None else str(text) for text in array.to_pylist())
