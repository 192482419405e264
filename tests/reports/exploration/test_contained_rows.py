"""An error inside a row stays in that row."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from study_rows import StudyRows

from dqforge.optimizer.exploration.row_block import STATES, RowBlock
from dqforge.reports.exploration.contained_rows import contained_rows, counted, joined
from dqforge.reports.exploration.part_file import encode_part


def encoded(block: RowBlock) -> bytes:
    return encode_part(block, StudyRows().columns, "0" * 64)


def test_a_row_that_raises_is_crashed_and_the_others_are_computed() -> None:
    block = contained_rows(StudyRows(raising=(3, 17)), 0, 20)
    crashed = [row for row in range(20) if STATES[block.states[row]] == "crashed"]
    assert crashed == [3, 17]
    assert block.messages[3] == "ZeroDivisionError: division by zero"
    assert np.isnan(block.columns["out.losses.total"][[3, 17]]).all()
    assert block.columns["in.inverter.device"][3] == -1
    assert not block.keys[3].any()
    assert block.keys[4].any()
    assert counted(block) == {"ok": 18, "crashed": 2}
    assert block.audited == {"losses.total": pytest.approx(1e-15 * 19)}


def test_halves_follow_from_the_range_alone() -> None:
    rows = StudyRows(raising=(3,))
    assert encoded(contained_rows(rows, 0, 20)) == encoded(contained_rows(rows, 0, 20))
    # The last digits show which ranges were computed: 0 to 2 in steps of 2 and 1, 5 to 9, 10 to 19.
    sizes = [2, 2, 1, 0, 1] + [5] * 5 + [10] * 10
    index = np.arange(20)
    expected = 0.01 * (1.0 + np.sin(index)) * 350.0**2 + np.array(sizes) * 2.0**-40
    found = contained_rows(rows, 0, 20).columns["out.losses.total"]
    assert np.array_equal(np.delete(found, 3), np.delete(expected, 3))


def test_blocks_are_joined_in_their_order() -> None:
    rows = StudyRows(refused=(4,))
    whole = joined([rows.rows(0, 3), rows.rows(3, 5), rows.rows(5, 9)])
    assert (whole.first, whole.count) == (0, 9)
    assert whole.messages[4] == "500 V is above 80 V"
    assert np.array_equal(whole.keys, rows.rows(0, 9).keys)


@dataclass(frozen=True)
class Named(StudyRows):
    """Rows that are known before they are computed; nothing is known of row 8."""

    def inputs(self, first: int, end: int) -> Mapping[str, NDArray[Any]]:
        if first <= 8 < end:
            raise ValueError(first)
        tame = StudyRows().rows(first, end).columns
        return {name: tame[f"in.{name}"] for name in ("machine.resistance", "inverter.device")}

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        return StudyRows().rows(first, end).keys


def test_a_row_that_crashed_is_named_by_its_inputs_and_its_key() -> None:
    block, tame = contained_rows(Named(raising=(3, 8)), 0, 10), StudyRows().rows(0, 10)
    for name in ("in.machine.resistance", "in.inverter.device"):
        assert block.columns[name][3] == tame.columns[name][3]
    assert np.array_equal(block.keys[3], tame.keys[3])
    assert np.isnan(block.columns["out.losses.total"][3])
    assert np.isnan(block.columns["in.machine.resistance"][8])
    assert not block.keys[8].any()
    assert counted(block) == {"ok": 8, "crashed": 2}


@dataclass(frozen=True)
class Memory(StudyRows):
    def rows(self, first: int, end: int) -> RowBlock:
        raise MemoryError(first, end)


@dataclass(frozen=True)
class Overflow(StudyRows):
    def rows(self, first: int, end: int) -> RowBlock:
        warnings.warn("an old habit", DeprecationWarning, stacklevel=1)
        if first <= 2 < end:
            warnings.warn("overflow in exp", RuntimeWarning, stacklevel=1)
        return super().rows(first, end)


def test_warnings_are_those_of_the_command_line() -> None:
    block = contained_rows(Overflow(), 0, 10)
    assert [message for message in block.messages if message] == ["RuntimeWarning: overflow in exp"]
    assert STATES[block.states[2]] == "crashed"


def test_memory_that_runs_out_is_not_the_rows_fault() -> None:
    with pytest.raises(MemoryError):
        contained_rows(Memory(), 0, 10)
