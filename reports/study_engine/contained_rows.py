"""Rows that are computed whatever one of them does: an error inside a row stays in that row."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    KEY_BYTES,
    STATES,
    ColumnSpec,
    KnownRows,
    RowBlock,
    RowSource,
)

Column = FloatArray | NDArray[np.int32]


def contained_rows(source: RowSource, first: int, end: int) -> RowBlock:
    """Rows ``first`` to ``end`` - 1 of ``source``.

    A range that ends in an error is halved, down to the row that is to blame, which becomes
    `crashed`. The halves follow from the range alone, so that every engine gets the same bytes.
    Warnings are those of the command line: numerical trouble is an error, the rest is silent.
    Memory that runs out is not the row's fault, and is raised.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", RuntimeWarning)
        return _contained(source, first, end)


def _contained(source: RowSource, first: int, end: int) -> RowBlock:
    try:
        return source.rows(first, end)
    except MemoryError:
        raise
    except Exception as error:  # whatever a row does, the others are computed
        if end - first == 1:
            return crashed_row(source, first, _in_words(error))
    middle = halfway(first, end)
    return joined((_contained(source, first, middle), _contained(source, middle, end)))


def _in_words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def halfway(first: int, end: int) -> int:
    """Where a range of rows is halved: by its ends alone."""
    return first + (end - first) // 2


def crashed_row(source: RowSource, index: int, message: str) -> RowBlock:
    """The row ``index`` that could not be computed: what went into it, no outputs, and why.

    A source that cannot tell inputs and key without computing the row has none of them; the key is
    then of zeros, which no design has.
    """
    inputs, keys = _known(source, index)
    given = {INPUT_COLUMN + name: values for name, values in inputs.items()}
    return RowBlock(
        first=index,
        columns={each.name: given.get(each.name, _nothing(each)) for each in source.columns},
        keys=keys,
        states=np.array([STATES.index("crashed")], np.int8),
        messages=(message,),
    )


def _known(source: RowSource, index: int) -> tuple[Mapping[str, Column], NDArray[np.uint8]]:
    """Inputs and key of one row."""
    nothing = np.zeros((1, KEY_BYTES), np.uint8)
    if not isinstance(source, KnownRows):
        return {}, nothing
    try:
        return source.inputs(index, index + 1), source.keys(index, index + 1)
    except Exception:  # the row may have crashed on just that
        return {}, nothing


def _nothing(column: ColumnSpec) -> Column:
    return np.full(1, np.nan) if column.kind == "number" else np.full(1, -1, np.int32)


def joined(blocks: Sequence[RowBlock]) -> RowBlock:
    """Blocks that follow upon each other as one."""
    if len(blocks) == 1:
        return blocks[0]
    names = blocks[0].columns
    audited: dict[str, float] = {}
    for block in blocks:
        for name, deviation in block.audited.items():
            audited[name] = max(deviation, audited.get(name, 0.0))
    return RowBlock(
        first=blocks[0].first,
        columns={name: np.concatenate([block.columns[name] for block in blocks]) for name in names},
        keys=np.concatenate([block.keys for block in blocks]),
        states=np.concatenate([block.states for block in blocks]),
        messages=tuple(message for block in blocks for message in block.messages),
        audited=audited,
    )


def counted(block: RowBlock) -> Mapping[str, int]:
    """Rows of a block by how they ended."""
    return Counter(STATES[state] for state in block.states)
