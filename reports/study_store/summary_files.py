"""What stands beside the parts of a study that is done: the rows of its front, and what its
outputs depend on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.optimizer.exploration.row_block import KEY_BYTES, RowBlock
from dqforge.optimizer.study_results.sensitivities import Sensitivities
from dqforge.reports.pages.envelope import to_text
from dqforge.reports.plain_data import PlainData, finite
from dqforge.reports.study_store.column_texts import label
from dqforge.reports.study_store.part_columns import PartColumns
from dqforge.reports.study_store.part_file import KEY, MESSAGE, encode_rows
from dqforge.reports.study_store.part_store import PartStore


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
