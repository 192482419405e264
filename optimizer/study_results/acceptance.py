"""How many rows of a study meet what is accepted, and the one that is farthest from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import STATES, RowState
from dqforge.optimizer.exploration.verdicts import within
from dqforge.optimizer.study_results.intervals import CONFIDENCE, Share

NAMED = 20  # Rows of each bad ending that are named; all are counted.


class StudyRows(Protocol):
    """Some rows of a study, one part as it is read back."""

    @property
    def first(self) -> int:
        """Index of the first row."""
        ...

    @property
    def columns(self) -> Mapping[str, FloatArray | NDArray[np.int32]]:
        """Columns by name, shape (n,)."""
        ...

    @property
    def states(self) -> NDArray[np.int8]:
        """Places in `STATES`, shape (n,)."""
        ...

    @property
    def messages(self) -> tuple[str, ...]:
        """Why rows did not end well, or an empty tuple where nobody asked."""
        ...


@dataclass(frozen=True, slots=True)
class AcceptedRange:
    """What is accepted of an output: ``column`` of the rows, bounds in SI units; ``label`` is what
    the study calls it.
    """

    column: str
    label: str
    below: float | None = None
    above: float | None = None

    def excess(self, values: FloatArray) -> FloatArray:
        """How far values lie beyond a bound, in the unit of the output; negative within, shape
        (n,).
        """
        over = [np.full(values.shape, -np.inf)]
        over += [] if self.below is None else [values - self.below]
        over += [] if self.above is None else [self.above - values]
        return np.asarray(np.max(over, axis=0))

    def met(self, values: FloatArray) -> BoolArray:
        """Whether values are accepted, shape (n,); what is no number is not."""
        return within(values, self.below, self.above)


@dataclass(frozen=True, slots=True)
class WorstRow:
    """The row that is farthest beyond a bound, or nearest to it from within: its index, its value
    and its inputs by column.
    """

    index: int
    value: float
    excess: float
    inputs: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class NamedRow:
    """A row that ended badly."""

    index: int
    state: RowState
    message: str


@dataclass(frozen=True, slots=True)
class AcceptanceTally:
    """What is accepted, counted over the rows so far.

    Args:
        ranges: What is accepted.
        inputs: Columns of the inputs that are told of a worst row.
        rows: Rows so far. Those without a value meet nothing, whatever they ended by.
        met: Rows that meet each range.
        met_all: Rows that meet all of them.
        worst: Of each range, None as long as no row had a value.
        states: Rows by how they ended.
        named: The first `NAMED` rows of each bad ending.
    """

    ranges: tuple[AcceptedRange, ...]
    inputs: tuple[str, ...] = ()
    rows: int = 0
    met: tuple[int, ...] = ()
    met_all: int = 0
    worst: tuple[WorstRow | None, ...] = ()
    states: Mapping[RowState, int] = field(default_factory=dict)
    named: tuple[NamedRow, ...] = ()

    def plus(self, part: StudyRows, counted: BoolArray | None = None) -> AcceptanceTally:
        """With the rows of a further part; of shares those that ``counted`` says, shape (n,)."""
        every = np.ones(part.states.size, dtype=np.bool_) if counted is None else counted
        ended = np.isin(part.states, [STATES.index("ok"), STATES.index("limit")])
        met = [ended & each.met(np.asarray(part.columns[each.column])) for each in self.ranges]
        both = np.logical_and.reduce([ended, *met])
        old_met, old_worst = self.met or (0,) * len(met), self.worst or (None,) * len(met)
        return AcceptanceTally(
            ranges=self.ranges,
            inputs=self.inputs,
            rows=self.rows + int(np.sum(every)),
            met=tuple(
                old + int(np.sum(new & every)) for old, new in zip(old_met, met, strict=True)
            ),
            met_all=self.met_all + int(np.sum(both & every)),
            worst=tuple(
                _worse(old, self._worst_of(each, part, ended))
                for old, each in zip(old_worst, self.ranges, strict=True)
            ),
            states=_added(self.states, part.states),
            named=self.named + self._named_of(part),
        )

    def _worst_of(
        self, accepted: AcceptedRange, part: StudyRows, ended: BoolArray
    ) -> WorstRow | None:
        values = np.asarray(part.columns[accepted.column], dtype=np.float64)
        rows = np.flatnonzero(ended & ~np.isnan(values))
        if not rows.size:
            return None
        excess = accepted.excess(values[rows])
        row = int(rows[np.argmax(excess)])
        inputs = {name: float(part.columns[name][row]) for name in self.inputs}
        return WorstRow(part.first + row, float(values[row]), float(np.max(excess)), inputs)

    def _named_of(self, part: StudyRows) -> tuple[NamedRow, ...]:
        found = []
        for place, state in enumerate(STATES[2:], start=2):
            room = NAMED - self.states.get(state, 0)
            for row in np.flatnonzero(part.states == place)[: max(room, 0)].tolist():
                message = part.messages[row] if part.messages else ""
                found.append(NamedRow(part.first + row, state, message))
        return tuple(sorted(found, key=lambda each: each.index))

    def share(self, place: int, confidence: float = CONFIDENCE) -> Share:
        """Share of the rows that meet one range."""
        return Share(self.met[place] if self.met else 0, self.rows, confidence)

    def share_of_all(self, confidence: float = CONFIDENCE) -> Share:
        """Share of the rows that meet all ranges."""
        return Share(self.met_all, self.rows, confidence)


def _added(states: Mapping[RowState, int], places: NDArray[np.int8]) -> dict[RowState, int]:
    counts = np.bincount(places, minlength=len(STATES)).tolist()
    return {state: states.get(state, 0) + counts[place] for place, state in enumerate(STATES)}


def _worse(old: WorstRow | None, new: WorstRow | None) -> WorstRow | None:
    """The worse of two rows; of equal ones the one with the lower index."""
    if old is None or new is None:
        return new if old is None else old
    if new.excess == old.excess:
        return min(old, new, key=lambda each: each.index)
    return new if new.excess > old.excess else old
