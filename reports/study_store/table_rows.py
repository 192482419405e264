"""Rows of a study that a query looks for, part by part: memory holds one part and what is shown."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.study_store.part_columns import PartColumns
from dqforge.reports.study_store.part_file import INDEX, KEY, MESSAGE, STATE
from dqforge.reports.study_store.part_store import PartStore
from dqforge.reports.study_store.study_header import StudyHeader
from dqforge.reports.study_store.table_query import Condition, TableQuery, fitting, spec_of

MOST_SORTED = 100_000  # Rows that are kept for sorting.
# Relative difference of numbers that count as equal: those of a grid have rounded ends.
_NEAR = 1e-9
Cells = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class FoundRows:
    """Rows that were found.

    Args:
        cells: By whole name of the column, (n,): numbers in SI units, places of words, of keys
            their hexadecimal digits, texts.
        matched: How many rows have what was asked.
        there: How many rows are computed.
        count: How many rows the study has.
    """

    cells: Cells
    matched: int
    there: int
    count: int

    @property
    def shown(self) -> int:
        """How many rows are among the cells."""
        return len(self.cells[INDEX])


def matching_parts(
    store: PartStore, query: TableQuery, parts: Collection[int] | None = None
) -> Iterator[tuple[int, Cells]]:
    """Number of rows of each part, and the cells of those that match, in their order; with the
    index whether it is shown or not. ``parts`` as of `PartStore.read`.
    """
    own = (INDEX, STATE)
    names = [name for name in query.needed if name not in own]
    kept = dict.fromkeys([INDEX, *query.columns, *(name for name, _ in query.order)])
    for part in store.read(names, parts):
        mask = np.ones(part.count, dtype=np.bool_)
        for condition in query.conditions:
            mask &= _holds(_cells(part, condition.name), condition, store.header)
        yield part.count, {name: _cells(part, name)[mask] for name in kept}


def find_rows(
    store: PartStore, query: TableQuery, parts: Collection[int] | None = None
) -> FoundRows:
    """The first rows of a query in its order, and how many match.

    Args:
        store: The study.
        query: What is looked for.
        parts: In which parts, None for all.

    Raises:
        InputError: More rows than can be sorted are asked for.
    """
    most = query.first or MOST_SORTED
    if most > MOST_SORTED:
        raise InputError(
            f"--first {most}: a table has at most {MOST_SORTED} rows; write --csv FILE"
        )
    kept: Cells | None = None
    matched = there = 0
    for count, cells in matching_parts(store, query, parts):
        there += count
        matched += len(cells[INDEX])
        kept = cells if kept is None else _joined(kept, cells, query, most)
        kept = _first(kept, query, most)
    if kept is None:
        kept = {name: np.empty(0) for name in dict.fromkeys([INDEX, *query.columns])}
    if query.order and query.first is None and matched > MOST_SORTED:
        raise InputError(
            f"{matched} rows match, of which {MOST_SORTED} can be sorted; write --first N"
        )
    return FoundRows(kept, matched, there, store.header.count)


def _joined(kept: Cells, cells: Cells, query: TableQuery, most: int) -> Cells:
    if not len(cells[INDEX]) or (not query.order and len(kept[INDEX]) >= most):
        return kept
    return {name: np.concatenate([kept[name], cells[name]]) for name in kept}


def _first(cells: Cells, query: TableQuery, most: int) -> Cells:
    """The first rows in the order of a query; what does not exist comes last."""
    if query.order:
        keys = [cells[INDEX]]
        for name, largest in reversed(query.order):
            values = cells[name]
            if values.dtype.kind not in "if":
                keys.append(np.unique(values, return_inverse=True)[1] * (-1 if largest else 1))
                continue
            lost = np.isnan(values) if values.dtype.kind == "f" else values < 0
            keys += [-values if largest else values, lost]
        chosen = np.lexsort(keys)[:most]
        return {name: values[chosen] for name, values in cells.items()}
    return {name: values[:most] for name, values in cells.items()}


def _cells(part: PartColumns, name: str) -> NDArray[Any]:
    if name == INDEX:
        return np.arange(part.first, part.first + part.count)
    if name == STATE:
        return part.states
    if name == KEY:
        return np.array([bytes(key).hex() for key in part.keys], dtype=object)
    if name == MESSAGE:
        return np.array(part.messages, dtype=object)
    return part.columns[name]


def _holds(values: NDArray[Any], condition: Condition, header: StudyHeader) -> BoolArray:
    """Which rows have what a condition asks; what does not exist never has."""
    spec = spec_of(header, condition.name)
    if spec.kind == "choice":
        wanted = condition.operator == "="
        table = np.array([found == wanted for found in fitting(spec.choices, condition)] + [False])
        return np.asarray(table[values.astype(np.int64)])
    if condition.name in (KEY, MESSAGE):
        found = fitting([str(value) for value in values], condition)
        return np.array([fits == (condition.operator == "=") for fits in found], dtype=np.bool_)
    return _compared(values.astype(np.float64), condition)


def _compared(values: NDArray[np.float64], condition: Condition) -> BoolArray:
    number = condition.number
    near = np.abs(values - number) <= _NEAR * abs(number)
    there = ~np.isnan(values)
    found: dict[str, BoolArray] = {
        "=": near,
        "!=": there & ~near,
        "<": (values < number) & ~near,
        "<=": (values < number) | near,
        ">": (values > number) & ~near,
        ">=": (values > number) | near,
    }
    return found[condition.operator]
