"""Columns of a part as arrays, in the words of the study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import KEY_BYTES, STATES, ColumnSpec
from dqforge.reports.study_store.part_file import (
    KEY,
    MESSAGE,
    STATE,
    PartAbout,
    PartError,
    part_table,
)

if TYPE_CHECKING:
    import pyarrow as pa


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
            columns[name] = _places(array, described[name].choices) if choice else _numbers(array)
    states = _places(_one(table, STATE), STATES).astype(np.int8)
    keys = _keys(_one(table, KEY)) if KEY in names else np.empty((0, KEY_BYTES), np.uint8)
    messages = _messages(_one(table, MESSAGE)) if MESSAGE in names else ()
    return PartColumns(about, columns, states, keys, messages)


def _one(table: pa.Table, name: str) -> pa.Array:
    return table.column(name).combine_chunks()


def _numbers(array: pa.Array) -> FloatArray:
    return np.array(array.to_numpy(zero_copy_only=False), dtype=np.float64)


def _places(array: pa.Array, words: Sequence[str]) -> NDArray[np.int32]:
    """Places of words in those of the study, -1 where there is none."""
    known = {word: place for place, word in enumerate(words)}
    found = array.dictionary.to_pylist()
    strange = [word for word in found if word not in known]
    if strange:
        raise PartError("it holds a word that the study does not know")
    places = np.array([*(known[word] for word in found), -1], dtype=np.int32)
    codes: NDArray[np.int32] = array.indices.fill_null(len(found)).to_numpy(zero_copy_only=False)
    return np.asarray(places[codes])


def _keys(array: pa.Array) -> NDArray[np.uint8]:
    content = array.buffers()[1]
    count, start = len(array), array.offset * KEY_BYTES
    flat = np.frombuffer(content, np.uint8, count * KEY_BYTES, start)
    return flat.reshape(count, KEY_BYTES).copy()


def _messages(array: pa.Array) -> tuple[str, ...]:
    return tuple("" if text is None else str(text) for text in array.to_pylist())
