"""Rows of a changed study: those that earlier studies have are taken from there, the others are
computed.

What is taken was computed in a batch of other rows. Its last digits may therefore differ from those
that this study would have computed itself, so that a folder that reuses promises the same numbers
and not the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    STATES,
    ColumnSpec,
    Inputs,
    RowBlock,
    row_inputs,
    row_keys,
)
from dqforge.optimizer.exploration.row_outputs import study_outputs
from dqforge.optimizer.exploration.study_plan import StudyPlan, hold_limits, study_limits
from dqforge.reports.study_store.summary_files import EarlierOutputs, EarlierRows

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
