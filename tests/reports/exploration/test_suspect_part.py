"""Which rows of a part end their process: found out by halves, the same whoever else died."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from study_rows import StudyRows

from dqforge.optimizer.exploration.row_block import STATES, RowBlock
from dqforge.reports.exploration.contained_rows import SuspectPart, contained_rows
from dqforge.reports.exploration.part_file import encode_part

ROWS = StudyRows(count=40, batch=40)


def resolved(
    killing: set[int], chance: float = 0.0, seed: int = 0
) -> tuple[RowBlock, Counter[str]]:
    """Resolve a part whose rows ``killing`` end their process; others do by ``chance``."""
    drawn = random.Random(seed)
    part = SuspectPart(0, 0, 40, ROWS)
    asked, done = part.began(), Counter[str]()
    while asked:
        each = asked.pop(0)
        done["runs"] += 1
        guilty = any(each.first <= row < each.end for row in killing)
        # At the verdict on a row nothing else runs: nobody dies for another.
        if guilty or (drawn.random() < chance and not each.alone):
            done["deaths"] += 1
            asked += part.died(each, "ended its process 3 times")
        else:
            asked += part.computed(each, contained_rows(ROWS, each.first, each.end))
    assert part.block is not None
    return part.block, done


def crashed(block: RowBlock) -> set[int]:
    return {row for row in range(block.count) if STATES[block.states[row]] == "crashed"}


@pytest.mark.parametrize("killing", [{0}, {17}, {39}, {3, 4}, {0, 19, 20, 39}, set(range(40))])
def test_rows_that_kill_are_found_and_no_others(killing: set[int]) -> None:
    block, done = resolved(killing)
    assert crashed(block) == killing
    assert {block.messages[row] for row in killing} == {"ended its process 3 times"}
    # Some two deaths for each halving of 40 rows, and three for each row.
    assert done["deaths"] <= len(killing) * (7 + 3)


@pytest.mark.parametrize("killing", [set(), {17}, {3, 31}])
@pytest.mark.parametrize("seed", range(5))
def test_deaths_by_chance_change_no_byte(killing: set[int], seed: int) -> None:
    quiet, _ = resolved(killing)
    block, done = resolved(killing, chance=0.1, seed=seed)
    assert crashed(block) == killing
    assert encode_part(block, ROWS.columns, "") == encode_part(quiet, ROWS.columns, "")
    assert done["deaths"] >= 3 * len(killing)


def test_a_part_that_only_dies_as_a_whole_is_put_together() -> None:
    part = SuspectPart(0, 0, 8, ROWS)
    first, second = part.began()
    assert part.computed(first, ROWS.rows(0, 4)) == []
    (whole,) = part.computed(second, ROWS.rows(4, 8))
    assert (whole.first, whole.end, whole.alone) == (0, 8, False)
    assert part.died(whole, "ran out of memory") == [whole]
    assert whole.alone
    assert part.died(whole, "ran out of memory") == []
    assert part.block is not None
    assert part.block.count == 8
    assert crashed(part.block) == set()
