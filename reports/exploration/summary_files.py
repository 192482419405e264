"""What stands beside the parts of a study that is done: the rows of its front, and what its
outputs depend on.
"""

from __future__ import annotations

import math
import mmap
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import field
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    KEY_BYTES,
    OUTPUT_COLUMN,
    STATES,
    ColumnSpec,
    Inputs,
    RowBlock,
    row_inputs,
    row_keys,
)
from dqforge.optimizer.exploration.row_outputs import study_outputs
from dqforge.optimizer.exploration.sensitivities import Sensitivities
from dqforge.optimizer.exploration.study_plan import StudyPlan, hold_limits, study_limits
from dqforge.reports.exploration.part_file import (
    KEY,
    MESSAGE,
    PartColumns,
    StoreError,
    encode_rows,
    part_files,
)
from dqforge.reports.exploration.part_store import PartStore, label
from dqforge.reports.pages.templating import to_text
from dqforge.reports.plain_data import PlainData, finite


def front_file(store: PartStore, index: NDArray[np.int64]) -> bytes:
    """``front.parquet``: whole rows, with the columns of the parts.

    Args:
        store: The study.
        index: Rows of the front (n,), ascending.

    Raises:
        StoreError: A part is damaged.
        ValueError: A row is not there.
    """
    header = store.header
    names = [column.name for column in header.columns]
    part_of_row = np.asarray(index, dtype=np.int64) // header.batch
    wanted = {int(part) for part in part_of_row}
    picked = [
        _picked(part, index[part_of_row == part.first // header.batch])
        for part in store.read([*names, KEY, MESSAGE], wanted)
    ]
    count = sum(block.count for block in picked)
    if count != len(index):
        raise ValueError(f"{len(index) - count} rows of the front are not there")
    columns: dict[str, Any] = {
        column.name: np.concatenate([_none(column.kind), *(b.columns[column.name] for b in picked)])
        for column in header.columns
    }
    whole = RowBlock(
        int(index[0]) if len(index) else 0,
        columns,
        np.concatenate([np.empty((0, KEY_BYTES), np.uint8), *(block.keys for block in picked)]),
        np.concatenate([np.empty(0, np.int8), *(block.states for block in picked)]),
        tuple(message for block in picked for message in block.messages),
    )
    return encode_rows(index, whole, header.columns, header.digest)


def _none(kind: str) -> NDArray[Any]:
    return np.empty(0, np.int32 if kind == "choice" else np.float64)


def _picked(part: PartColumns, index: NDArray[np.int64]) -> RowBlock:
    """Some rows of a part."""
    rows = index - part.first
    return RowBlock(
        part.first,
        {name: values[rows] for name, values in part.columns.items()},
        part.keys[rows],
        part.states[rows],
        tuple(part.messages[row] for row in rows),
    )


def sensitivity_file(name: str, digest: str, found: Sequence[Sensitivities]) -> bytes:
    """``sensitivity.json``, by the keys of docs/reference/json.md.

    Args:
        name: Title of the study.
        digest: SHA-256 of what its rows depend on.
        found: Per output.
    """
    plain = {"rows_sha256": digest, "sensitivities": [plain_sensitivities(one) for one in found]}
    return to_text("explore", name, plain).encode("ascii")


def plain_sensitivities(found: Sensitivities) -> PlainData:
    """What one output depends on, for ``sensitivity.json`` and for what the command answers."""
    total = [math.nan] * len(found.inputs) if found.total is None else found.total.tolist()
    columns = zip(
        found.inputs,
        found.first.tolist(),
        found.squared_correlation.tolist(),
        total,
        strict=True,
    )
    return {
        "output": label(found.output),
        "rows": found.rows,
        "bias": finite(found.bias),
        "inputs": [
            {
                "input": label(name),
                "first": finite(first),
                "squared_correlation": finite(squared),
                "total": finite(whole),
            }
            for name, first, squared, whole in columns
        ],
    }


# Rows of earlier studies by their key: what need not be computed again when a study changes.
#
# A value more in a grid moves every row behind it, so that no part of the old study is a part of
# the new one; the key of a row is that of its resolved design and stays.

BUCKETS = 16  # Into how many files the keys of many rows go, by their first four bits.
_IN_MEMORY = 2_000_000
_PARTS_KEPT = 4
_ROW_BITS = np.uint64(32)
_CRASHED = STATES.index("crashed")


@dataclass(frozen=True, slots=True, eq=False)
class EarlierOutputs:
    """What earlier studies know of rows.

    Args:
        found: Which rows, bool (n,).
        columns: Outputs of the rows, (n,): NaN, or -1 of choices, where a row was not found.
        states: Places in `STATES`, int8 (n,), -1 where a row was not found. Limits are no part of a
            key: whether a row is within those of now is to be judged anew.
        messages: Empty where a row was not found or ended well.
    """

    found: BoolArray
    columns: Mapping[str, FloatArray | NDArray[np.int32]]
    states: NDArray[np.int8]
    messages: tuple[str, ...]


Numbers = NDArray[np.uint64]


class _Bucket(NamedTuple):
    """Records sorted by key, (3, n): first and last eight bytes of the keys as numbers, and where
    the row lies, part number times 2^32 plus row; and the file that they are mapped from.
    """

    records: Numbers
    pages: mmap.mmap | None = None

    def find(self, high: Numbers, low: Numbers) -> NDArray[np.int32]:
        """As `_look_up`; the memory that a mapped file takes is given back."""
        found = _look_up(self.records, high, low)
        if self.pages is not None:
            self.pages.madvise(mmap.MADV_DONTNEED)
        return found


class _Source(NamedTuple):
    store: PartStore
    part: int


def _look_up(bucket: Numbers, high: Numbers, low: Numbers) -> NDArray[np.int32]:
    """Part and row of keys in one sorted bucket, (n, 2)."""
    place = np.searchsorted(bucket[0], high)
    found = np.full((len(high), 2), -1, dtype=np.int32)
    left = np.arange(len(high))
    while len(left):
        left = left[place[left] < bucket.shape[1]]
        there = place[left]
        same_high = bucket[0, there] == high[left]
        same = same_high & (bucket[1, there] == low[left])
        where = bucket[2, there[same]]
        found[left[same], 0] = where >> _ROW_BITS
        found[left[same], 1] = where & np.uint64(0xFFFFFFFF)
        # The same first half with another second one: the next record may have it.
        left = left[same_high & ~same]
        place[left] += 1
    return found


@dataclass(frozen=True, slots=True)
class EarlierRows:
    """An index of the keys in folders of earlier studies.

    Args:
        sources: Parts, by the number that stands in the records.
        buckets: Sorted records, one bucket per group of first bits; in files if they are many.
        folder: Holds the folder of these files; None where everything is in memory.
    """

    sources: tuple[_Source, ...]
    buckets: tuple[_Bucket, ...]
    folder: ExitStack | None = None
    _kept: OrderedDict[tuple[int, tuple[str, ...]], PartColumns] = field(
        default_factory=OrderedDict
    )

    @classmethod
    def of(cls, folders: Sequence[Path], columns: Sequence[ColumnSpec]) -> Self:
        """Index the rows of folders; of two rows with one key the first one counts.

        Args:
            folders: That 'dqforge explore' wrote; damaged parts of them are left out.
            columns: Those of the study that asks: a folder without one of its outputs is refused.

        Raises:
            InputError: A folder holds no study, or one without these outputs.
        """
        stores = [cls.require(folder, columns) for folder in folders]
        sources = tuple(
            _Source(store, part) for store in stores for part in sorted(part_files(store.folder))
        )
        most = sum(store.header.count for store in stores)
        if most <= _IN_MEMORY:
            whole = np.concatenate([np.empty((3, 0), np.uint64), *_records(sources)], axis=1)
            return cls(sources, (_Bucket(_by_key(whole)),))
        with ExitStack() as held:
            folder = held.enter_context(scratch_folder())
            return cls(sources, _in_files(sources, folder), held.pop_all())

    @staticmethod
    def require(folder: Path, columns: Sequence[ColumnSpec]) -> PartStore:
        """One folder of `of`; raises as that."""
        store = PartStore.existing(folder)
        _require_outputs(store, columns)
        return store

    def __len__(self) -> int:
        return sum(bucket.records.shape[1] for bucket in self.buckets)

    def find(self, keys: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Where rows lie.

        Args:
            keys: (n, 16).

        Returns:
            Number of the part and row in it, (n, 2); -1 where there is none.
        """
        found = np.full((len(keys), 2), -1, dtype=np.int32)
        high, low = _halves(keys)
        groups = _group(high, len(self.buckets))
        for number, bucket in enumerate(self.buckets):
            mine = np.flatnonzero(groups == number)
            if len(mine) and bucket.records.shape[1]:
                found[mine] = bucket.find(high[mine], low[mine])
        return found

    def outputs(self, keys: NDArray[np.uint8], columns: Sequence[ColumnSpec]) -> EarlierOutputs:
        """What earlier studies know of rows; rows in whose computation a process died count as not
        found.

        Args:
            keys: (n, 16).
            columns: Those of the study that asks.
        """
        asked = tuple(column for column in columns if column.name.startswith(OUTPUT_COLUMN))
        count = len(keys)
        values: dict[str, FloatArray | NDArray[np.int32]] = {
            column.name: np.full(count, -1, dtype=np.int32)
            if column.kind == "choice"
            else np.full(count, np.nan)
            for column in asked
        }
        states = np.full(count, -1, dtype=np.int8)
        messages = [""] * count
        places = self.find(keys)
        for part in np.unique(places[places[:, 0] >= 0, 0]):
            rows = np.flatnonzero(places[:, 0] == part)
            there = places[rows, 1]
            old = self._part(int(part), tuple(column.name for column in asked))
            words = {column.name: column for column in self.sources[part].store.header.columns}
            for column in asked:
                values[column.name][rows] = _translated(old, words[column.name], column)[there]
            states[rows] = old.states[there]
            for row, place in zip(rows, there, strict=True):
                messages[row] = old.messages[place]
        crashed = states == _CRASHED
        states[crashed] = -1
        return EarlierOutputs(
            states >= 0,
            values,
            states,
            tuple("" if lost else text for text, lost in zip(messages, crashed, strict=True)),
        )

    def _part(self, number: int, names: tuple[str, ...]) -> PartColumns:
        """Columns of a part; those that were asked for last are kept."""
        found = self._kept.pop((number, names), None)
        if found is None:
            source = self.sources[number]
            (found,) = source.store.read([*names, MESSAGE], [source.part])
        self._kept[number, names] = found
        while len(self._kept) > _PARTS_KEPT:
            self._kept.popitem(last=False)
        return found

    def close(self) -> None:
        """Remove the files of the index; `contextlib.closing` does at the end of a block."""
        if self.folder is not None:
            self.folder.close()


def _require_outputs(store: PartStore, columns: Sequence[ColumnSpec]) -> None:
    there = {column.name: column for column in store.header.columns}
    for column in columns:
        if column.name.startswith(OUTPUT_COLUMN):
            old = there.get(column.name)
            if old is None or (old.unit, old.kind) != (column.unit, column.kind):
                name = column.name.removeprefix(OUTPUT_COLUMN)
                raise InputError(
                    f"--reuse {store.folder}: it has no output {name}; omit the folder"
                )


def _records(sources: Sequence[_Source]) -> Iterator[Numbers]:
    """Keys and places (3, n) of every row that may be taken, part by part; damaged parts left
    out.
    """
    for number, source in enumerate(sources):
        try:
            (found,) = source.store.read([KEY], [source.part])
        except StoreError:
            continue
        rows = np.flatnonzero(found.keys.any(axis=1) & (found.states != _CRASHED))
        place = (np.uint64(number) << _ROW_BITS) + rows.astype(np.uint64)
        yield np.stack([*_halves(found.keys[rows]), place])


def _halves(keys: NDArray[np.uint8]) -> tuple[Numbers, Numbers]:
    """First and last eight bytes of keys as numbers, (n,) each."""
    pairs = np.ascontiguousarray(keys).reshape(-1, KEY_BYTES).view(">u8").astype(np.uint64)
    return pairs[:, 0], pairs[:, 1]


def _group(high: Numbers, buckets: int) -> Numbers:
    """Bucket of each key."""
    if buckets == 1:
        return np.zeros(len(high), dtype=np.uint64)
    return np.asarray(high >> np.uint64(60))


def _by_key(records: Numbers) -> Numbers:
    """Records sorted by key; of one key the first row comes first."""
    return np.ascontiguousarray(records[:, np.lexsort((records[1], records[0]))])


def _in_files(sources: Sequence[_Source], folder: Path) -> tuple[_Bucket, ...]:
    """Buckets in files: filled part by part, then sorted one by one."""
    paths = [folder / f"bucket-{number:02d}" for number in range(BUCKETS)]
    for path in paths:
        path.touch()
    for records in _records(sources):
        groups = _group(records[0], BUCKETS)
        for number in np.unique(groups):
            with paths[int(number)].open("ab") as file:
                file.write(records[:, groups == number].T.tobytes())
    return tuple(_sorted_in_file(path) for path in paths)


def _sorted_in_file(path: Path) -> _Bucket:
    found = _by_key(np.fromfile(path, dtype=np.uint64).reshape(-1, 3).T)
    if not found.size:
        return _Bucket(found)
    path.write_bytes(found.tobytes())
    with path.open("rb") as file:
        pages = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    return _Bucket(np.frombuffer(pages, np.uint64).reshape(found.shape), pages)


def _translated(
    old: PartColumns, theirs: ColumnSpec, ours: ColumnSpec
) -> FloatArray | NDArray[np.int32]:
    """A column in the words of the study that asks; -1 for words that it does not know."""
    values = old.columns[ours.name]
    if ours.kind != "choice" or theirs.choices == ours.choices:
        return values
    known = {word: place for place, word in enumerate(ours.choices)}
    table = np.array([*(known.get(word, -1) for word in theirs.choices), -1], dtype=np.int32)
    return np.asarray(table[values.astype(np.int64)])


# Rows of a changed study: those that earlier studies have are taken from there, the others are
# computed.
#
# What is taken was computed in a batch of other rows. Its last digits may therefore differ from
# those that this study would have computed itself, so that a folder that reuses promises the same
# numbers and not the same bytes.

_BEYOND = STATES.index("limit")


@dataclass(frozen=True, slots=True)
class ReusingRows:
    """A `RowSource` that computes what no earlier study has.

    Args:
        plan: The rows of the study.
        folders: Of earlier studies; every process that computes must see them.

    Raises:
        InputError: As `EarlierRows.of`, when the first rows are asked for.
    """

    plan: StudyPlan
    folders: tuple[Path, ...]
    _earlier: list[EarlierRows] = field(default_factory=list, init=False, compare=False)

    def __reduce__(self) -> tuple[type[ReusingRows], tuple[StudyPlan, tuple[Path, ...]]]:
        """Travel without the index, which every process makes of the folders."""
        return ReusingRows, (self.plan, self.folders)

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.plan.count

    @property
    def batch(self) -> int:
        """Rows per part."""
        return self.plan.batch

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block."""
        return self.plan.columns

    def inputs(self, first: int, end: int) -> Inputs:
        """What goes into rows first to end - 1.

        Args:
            first, end: Range of rows.
        """
        return self.plan.inputs(first, end)

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Keys of rows first to end - 1, shape (n, 16).

        Args:
            first, end: Range of rows.
        """
        return self.plan.keys(first, end)

    @property
    def earlier(self) -> EarlierRows:
        """The index of the earlier studies, made once per process."""
        if not self._earlier:
            self._earlier.append(EarlierRows.of(self.folders, self.columns))
        return self._earlier[0]

    def require(self) -> None:
        """Raise `InputError` where a folder holds no study, or one without these outputs."""
        for folder in self.folders:
            EarlierRows.require(folder, self.columns)

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1 of the study.

        Args:
            first, end: Range of rows, 0 <= first < end <= ``count``.
        """
        study = self.plan.study
        inputs = row_inputs(study, first, end)
        names = [spec.name.removeprefix(OUTPUT_COLUMN) for spec in self._outputs]
        keys = row_keys(study, inputs, names)
        if len(keys) != end - first:  # a study without anything that differs has one key
            return self.plan.rows(first, end)
        known = self.earlier.outputs(keys, self.columns)
        missing = np.flatnonzero(~known.found)
        if len(missing) == end - first:
            return self.plan.rows(first, end)
        whole = self._judged(known)
        computed = None
        if len(missing):
            some: Inputs = {name: values[missing] for name, values in inputs.items()}
            computed = self.plan.rows_of(some, first, len(missing))
        return _merged(self, inputs, keys, whole, missing, computed, first)

    @property
    def _outputs(self) -> tuple[ColumnSpec, ...]:
        return tuple(spec for spec in self.columns if spec.name.startswith(OUTPUT_COLUMN))

    def _judged(self, known: EarlierOutputs) -> BlockRows:
        """What is known, held against the limits of this study; rows without it are empty."""
        study, base = self.plan.study, self.plan.base
        block = BlockRows(len(known.found), study_outputs(study, base))
        for name, values in known.columns.items():
            block.columns[name.removeprefix(OUTPUT_COLUMN)] = values
        for row in np.flatnonzero(known.states > _BEYOND).tolist():
            block.end(row, STATES[known.states[row]], known.messages[row])
        hold_limits(block, study_limits(study, base))
        return block


def _merged(
    source: ReusingRows,
    inputs: Inputs,
    keys: NDArray[np.uint8],
    known: BlockRows,
    missing: NDArray[np.intp],
    computed: RowBlock | None,
    first: int,
) -> RowBlock:
    """A block of rows of which some were known and the others computed."""
    columns: dict[str, NDArray[Any]] = {}
    for spec in source.columns:
        name = spec.name
        output = name.startswith(OUTPUT_COLUMN)
        values = (
            known.columns[name.removeprefix(OUTPUT_COLUMN)]
            if output
            else inputs[name.removeprefix(INPUT_COLUMN)]
        )
        columns[name] = np.array(values)
        if output and computed is not None:
            columns[name][missing] = computed.columns[name]
    states, messages = known.states.copy(), list(known.messages)
    audited: Mapping[str, float] = {}
    if computed is not None:
        states[missing] = computed.states
        for row, message in zip(missing.tolist(), computed.messages, strict=True):
            messages[row] = message
        audited = computed.audited
    return RowBlock(first, columns, keys, states, tuple(messages), audited)
