"""A part of a study whose process died: which of its rows is to blame.

Ranges are halved until single rows are left. What a part holds in the end follows from the rows
that kill and from nothing else: a range in which no row is found to blame is computed once more as
a whole, since it was a neighbour, or somebody from outside, that ended its process.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from dqforge.optimizer.exploration.row_block import RowBlock, RowSource
from dqforge.reports.study_engine.contained_rows import crashed_row, halfway, joined

# Deaths at which a single row, or a range without a row to blame, is given up; at the last one
# nothing else was running.
DEATHS = 3


@dataclass(slots=True, eq=False)
class SuspectRange:
    """A range of rows on its way to a block."""

    first: int
    end: int
    parent: SuspectRange | None = None
    halves: tuple[SuspectRange, ...] = ()
    block: RowBlock | None = None
    crashed: bool = False
    deaths: int = 0

    @property
    def alone(self) -> bool:
        """Whether it is to run with nothing else under way: a verdict hangs on it."""
        return self.deaths == DEATHS - 1 and (self.single or bool(self.halves))

    @property
    def single(self) -> bool:
        """Whether it is one row."""
        return self.end - self.first == 1


@dataclass(slots=True)
class SuspectPart:
    """Rows ``first`` to ``end`` - 1 of ``source``, which ended their process.

    Each step hands back the ranges that are to be run next.
    """

    part: int
    first: int
    end: int
    source: RowSource
    root: SuspectRange = field(init=False)

    def __post_init__(self) -> None:
        self.root = SuspectRange(self.first, self.end)

    @property
    def block(self) -> RowBlock | None:
        """All rows, once they are there."""
        return self.root.block

    def began(self) -> list[SuspectRange]:
        """What is run first: the part as a whole has died before."""
        return self.died(self.root, "")

    def computed(self, found: SuspectRange, block: RowBlock) -> list[SuspectRange]:
        """A range was computed."""
        found.block = block
        return self._settled(found)

    def died(self, found: SuspectRange, message: str) -> list[SuspectRange]:
        """A range ended its process; ``message`` says how, should it be the row's fault."""
        found.deaths += 1
        if (found.single or found.halves) and found.deaths < DEATHS:
            return [found]
        if found.single:
            found.block, found.crashed = crashed_row(self.source, found.first, message), True
            return self._settled(found)
        if found.halves:  # clean in pieces, dead as a whole: the pieces are what there is
            found.block = _of_halves(found)
            return self._settled(found)
        middle = halfway(found.first, found.end)
        found.halves = (
            SuspectRange(found.first, middle, found),
            SuspectRange(middle, found.end, found),
        )
        return list(found.halves)

    def _settled(self, found: SuspectRange) -> list[SuspectRange]:
        """A range has its block; the range that it is a half of may have one now, too."""
        above = found.parent
        if above is None or any(half.block is None for half in above.halves):
            return []
        if not any(half.crashed for half in above.halves):
            return [above]
        above.block, above.crashed = _of_halves(above), True
        return self._settled(above)


def _of_halves(found: SuspectRange) -> RowBlock:
    return joined([half.block for half in found.halves if half.block is not None])
