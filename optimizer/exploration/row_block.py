"""Rows of a study as columns: what went in, what came out, and how each row ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

RowState = Literal["ok", "limit", "no-solution", "refused", "crashed"]
STATES: tuple[RowState, ...] = get_args(RowState)
ColumnKind = Literal["number", "choice"]
INPUT_COLUMN, OUTPUT_COLUMN = "in.", "out."  # What the names of columns begin with.
KEY_BYTES = 16  # Length of a row's key.


@dataclass(frozen=True, slots=True)
class ColumnSpec:
    """A column of every part of a study: ``in.<key>`` or ``out.<name>``, its SI unit, and for a
    choice its words in sorted order.
    """

    name: str
    unit: str = ""
    kind: ColumnKind = "number"
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RowBlock:
    """Rows ``first`` to ``first + n - 1``.

    Args:
        first: Index of the first row in the study.
        columns: By name of the column, in the order of the study's `ColumnSpec`s: numbers (n,) in
            SI units, NaN for what does not exist; of choices the places in their words, int32, -1
            for none.
        keys: Hash of each row's resolved design, uint8 (n, 16).
        states: Places in `STATES`, int8 (n,).
        messages: What the single command would print, empty for rows that ended well.
        audited: Largest relative deviation of the batch path from the single path by output, of the
            rows of this block that were computed by both.
    """

    first: int
    columns: Mapping[str, FloatArray | NDArray[np.int32]]
    keys: NDArray[np.uint8]
    states: NDArray[np.int8]
    messages: tuple[str, ...]
    audited: Mapping[str, float] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.messages)


class RowSource(Protocol):
    """Where rows come from: what an engine runs and a store writes. Picklable; it is shipped once
    to each worker, and the same rows give the same block wherever they are computed.
    """

    @property
    def count(self) -> int:
        """Number of rows."""
        ...

    @property
    def batch(self) -> int:
        """Rows per part: fixed by the kind of the study, never by the number of workers."""
        ...

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block."""
        ...

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1, computed."""
        ...


@runtime_checkable
class KnownRows(Protocol):
    """What a `RowSource` may offer besides: which rows they are, without computing them. A row that
    crashes is then named by it.
    """

    def inputs(self, first: int, end: int) -> Mapping[str, FloatArray | NDArray[np.int32]]:
        """What goes into rows first to end - 1, by key (without ``in.``), shape (n,)."""
        ...

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Hash of each of these rows' resolved design, shape (n, 16)."""
        ...
