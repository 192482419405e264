"""Everything that the rows of a study say together, from its parts one after the other.

One part is in memory at a time; what is kept of the others does not grow with their number, but for
the front. The same parts in the same order give the same digits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from math import sqrt
from statistics import NormalDist
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.exploration.study import Bound, Study
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import OUTPUT_COLUMN, STATES, RowState, within
from dqforge.optimizer.exploration.row_outputs import bound_output
from dqforge.optimizer.exploration.sensitivities import (
    BinnedOutput,
    Sensitivities,
    binned_output,
    sensitivities,
)


@dataclass(frozen=True, slots=True)
class GoalColumn:
    """An output that is made small, or large where ``minimise`` is not set."""

    column: str
    minimise: bool = True


@dataclass(frozen=True, slots=True)
class StudyQuestion:
    """What is asked of the rows together, by the names of their columns.

    Args:
        accept: What is accepted.
        goals: Goals of the front; none for no front.
        inputs: Columns told of a worst row.
        drawn: Inputs that are drawn.
        sensitivity: Outputs whose sensitivity to them is asked for.
        spread: Outputs that have a histogram.
        saltelli: Whether rows are those of `dqforge.optimizer.exploration.row_block`, for
            first-order and total sensitivities. Then shares count the two independent samples
            alone: the others repeat all of their inputs but one.
    """

    accept: tuple[AcceptedRange, ...] = ()
    goals: tuple[GoalColumn, ...] = ()
    inputs: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()
    sensitivity: tuple[str, ...] = ()
    spread: tuple[str, ...] = ()
    saltelli: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that are needed, each once."""
        names = [each.column for each in self.accept] + [each.column for each in self.goals]
        drawn = self.drawn if self.sensitivity else ()
        return tuple(dict.fromkeys([*self.inputs, *drawn, *names, *self.sensitivity, *self.spread]))


@dataclass(frozen=True, slots=True)
class StudySummary:
    """What the rows say together.

    Args:
        question: What was asked.
        rows: All rows.
        acceptance: Shares, worst rows, rows by how they ended.
        front: The front of the rows in state ``ok``; None where no goal was asked for.
        sensitivities: Of each output asked for, in that order.
        spread: Histograms of outputs, in the order asked for.
    """

    question: StudyQuestion
    rows: int
    acceptance: AcceptanceTally
    front: Front | None
    sensitivities: tuple[Sensitivities, ...]
    spread: tuple[Histogram, ...]


def summarise(question: StudyQuestion, parts: Iterable[StudyRows]) -> StudySummary:
    """Go through the parts of a study once.

    Args:
        question: What is asked; a part holds `StudyQuestion.columns`.
        parts: Parts in their order.
    """
    rows = 0
    acceptance = AcceptanceTally(question.accept, question.inputs)
    front = empty_front(len(question.goals)) if question.goals else None
    binned: dict[str, BinnedOutput] = {}
    sums = {name: SaltelliSums(len(question.drawn)) for name in question.sensitivity}
    spread = {name: empty_histogram() for name in question.spread}
    for part in parts:
        counted = _independent(question, part)
        acceptance = acceptance.plus(part, counted)
        if front is not None:
            front = front.plus(_front_of_part(question.goals, part))
        _add_sensitivities(question, part, counted, binned, sums)
        for name in question.spread:
            spread[name] = spread[name].plus(_numbers(part, name)[counted])
        rows += part.states.size
    return StudySummary(
        question,
        rows,
        acceptance,
        front,
        _sensitivities(question, binned, sums),
        tuple(spread.values()),
    )


def _numbers(part: StudyRows, name: str) -> FloatArray:
    return np.asarray(part.columns[name], dtype=np.float64)


def _independent(question: StudyQuestion, part: StudyRows) -> BoolArray:
    """Rows that were drawn independently of each other."""
    size = part.states.size
    if not question.saltelli:
        return np.ones(size, dtype=np.bool_)
    return np.asarray((part.first + np.arange(size)) % (len(question.drawn) + 2) < 2)


def _front_of_part(goals: Sequence[GoalColumn], part: StudyRows) -> Front:
    fine = np.flatnonzero(part.states == STATES.index("ok"))
    index: NDArray[np.int64] = part.first + fine.astype(np.int64)
    signed = [
        _numbers(part, goal.column)[fine] * (1.0 if goal.minimise else -1.0) for goal in goals
    ]
    return front_of(index, np.column_stack(signed))


def _add_sensitivities(
    question: StudyQuestion,
    part: StudyRows,
    counted: BoolArray,
    binned: dict[str, BinnedOutput],
    sums: dict[str, SaltelliSums],
) -> None:
    """Add a part to the sums of every output; the bins' edges are those of the first part."""
    if not question.sensitivity or not question.drawn:
        return
    inputs = np.column_stack([_numbers(part, name)[counted] for name in question.drawn])
    for name in question.sensitivity:
        values = _numbers(part, name)
        if question.saltelli:
            sums[name] = sums[name].plus(values)
        if name not in binned:
            binned[name] = binned_output(inputs, values[counted])
        binned[name] = binned[name].plus(inputs, values[counted])


def _sensitivities(
    question: StudyQuestion, binned: dict[str, BinnedOutput], sums: dict[str, SaltelliSums]
) -> tuple[Sensitivities, ...]:
    found = []
    for name, bins in binned.items():
        by_bins = sensitivities(name, question.drawn, bins)
        if question.saltelli:
            indices = sums[name].indices()
            # Columns of the design stand in alphabetical order.
            places = [sorted(question.drawn).index(each) for each in question.drawn]
            by_bins = by_bins.designed(indices.first[places], indices.total[places])
        found.append(by_bins)
    return tuple(found)


# Pareto fronts: rows that no other row beats in every goal.
#
# A row beats another that is nowhere better and somewhere worse. Of rows with equal goals the one
# with the lowest index stays, so that a front does not depend on the order in which parts arrive.

_BLOCK = 512  # Rows that are held against a front at a time: of the order of a front's own size.


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """A front of rows, ascending by index.

    Args:
        index: Indices of the rows in the study, int64 (n,).
        goals: What is made small, shape (n, G); a goal that is to be large stands with its sign
            turned.
    """

    index: NDArray[np.int64]
    goals: FloatArray

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.index.size)

    def plus(self, other: Front) -> Front:
        """The front of both fronts: that of all rows which either came from."""
        index = np.concatenate([self.index, other.index])
        return front_of(index, np.concatenate([self.goals, other.goals]))


def empty_front(goals: int) -> Front:
    """A front of no rows.

    Args:
        goals: Number of goals G.
    """
    return Front(np.empty(0, dtype=np.int64), np.empty((0, goals)))


def front_of(index: NDArray[np.int64], goals: FloatArray) -> Front:
    """The front of rows; those with a goal that is no number are out. Goals that agree to 12 digits
    are equal: the last digits of a row depend on the rows that were computed with it.

    Args:
        index: Indices of the rows, shape (n,), each once.
        goals: What is made small, shape (n, G).
    """
    index, goals = np.asarray(index, dtype=np.int64), np.asarray(goals, dtype=np.float64)
    known = ~np.any(np.isnan(goals), axis=1)
    index, goals = index[known], goals[known] + 0.0  # -0 counts as 0
    if not index.size:
        return empty_front(goals.shape[1])
    # By the first goal, then the next, then the index: whoever beats a row stands before it.
    held = _to_twelve_digits(goals)
    order = np.lexsort((index, *held.T[::-1]))
    sorted_goals = held[order]
    kept = _by_steps(sorted_goals) if goals.shape[1] <= 2 else _by_blocks(sorted_goals)
    chosen = order[kept]
    by_index = chosen[np.argsort(index[chosen])]
    return Front(index[by_index], goals[by_index])


def _to_twelve_digits(goals: FloatArray) -> FloatArray:
    """Goals with 40 bits of their mantissa."""
    mantissa, exponent = np.frexp(goals)
    return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, 40)), exponent - 40))


def _by_steps(goals: FloatArray) -> IndexArray:
    """Places of the front among sorted rows with one or two goals: each step down of the last."""
    if goals.shape[1] == 1:
        return np.zeros(1, dtype=np.intp)
    last = goals[:, 1]
    before = np.concatenate([[np.inf], np.minimum.accumulate(last)[:-1]])
    steps = last < before
    steps[0] = True  # even if its last goal is infinite
    return np.flatnonzero(steps)


def _by_blocks(goals: FloatArray) -> IndexArray:
    """Places of the front among sorted rows with any goals.

    A block of rows is held against the front of all rows before it, then in itself; later rows beat
    no earlier one, so that what has come in stays.
    """
    front = np.empty((0, goals.shape[1]))
    kept: list[IndexArray] = []
    for start in range(0, len(goals), _BLOCK):
        rows = goals[start : start + _BLOCK]
        places = np.flatnonzero(~_beaten(rows, front))
        rest = rows[places]
        # Among equals the first one stays: only rows before it count.
        covered = np.all(rest[:, np.newaxis] <= rest[np.newaxis], axis=2)
        alone = ~np.any(np.triu(covered, 1), axis=0)
        kept.append(start + places[alone])
        front = np.concatenate([front, rest[alone]])
    return np.concatenate(kept)


def _beaten(rows: FloatArray, front: FloatArray) -> NDArray[np.bool_]:
    """Whether a row of the front is at most each row in every goal, shape (rows,).

    The front goes by in pieces: most rows are beaten by its beginning.
    """
    beaten = np.zeros(len(rows), dtype=np.bool_)
    for start in range(0, len(front), _BLOCK):
        open_rows = np.flatnonzero(~beaten)
        if not open_rows.size:
            break
        piece = front[start : start + _BLOCK]
        under = piece[:, np.newaxis, 0] <= rows[open_rows, 0]
        for goal in range(1, rows.shape[1]):
            under &= piece[:, np.newaxis, goal] <= rows[open_rows, goal]
        beaten[open_rows] = np.any(under, axis=0)
    return beaten


# First-order and total sensitivities by a design that is made for them.
#
# Of two independent samples A and B of n rows each, and D samples AB_i that are A with column i of
# B, the estimators of Saltelli and others (2010, doi:10.1016/j.cpc.2009.09.018) are
#
#     S_i = mean(f(B) (f(AB_i) - f(A))) / V,        T_i = mean((f(A) - f(AB_i))^2) / (2 V),
#
# with V the variance of f(A) and f(B) together and f counted from its mean. That takes n (D + 2)
# rows in the order of `dqforge.optimizer.exploration.row_block`; where the samples come from
# a Sobol sequence, a power of 2 is the best n.


@dataclass(frozen=True, slots=True, eq=False)
class SobolIndices:
    """First-order and total sensitivities of an output, arrays of shape (D,), from ``base`` rows of
    each sample; NaN of an output that does not change.
    """

    first: FloatArray
    total: FloatArray
    base: int


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class SaltelliSums:
    """What the estimators need of the rows so far.

    Args:
        inputs: Number of inputs D.
        centre: A value of the output from which it is counted; None before the first base row.
        base: Base rows so far; those with a row that is no finite number are left out.
        whole: Sums over A and B together: of the output, and of its square.
        changes, products, squares: Sums of f(AB_i) - f(A), of that times f(B), and of its square,
            shape (D,).
        left: Rows behind the last whole base row.
    """

    inputs: int
    centre: float | None = None
    base: int = 0
    whole: tuple[float, float] = (0.0, 0.0)
    changes: FloatArray = field(default_factory=_nothing)
    products: FloatArray = field(default_factory=_nothing)
    squares: FloatArray = field(default_factory=_nothing)
    left: FloatArray = field(default_factory=_nothing)

    def plus(self, output: FloatArray) -> SaltelliSums:
        """With the rows that follow, shape (n,)."""
        width = self.inputs + 2
        rows = np.concatenate([self.left, output])
        count = rows.size // width
        left = rows[count * width :].copy()
        table = rows[: count * width].reshape(count, width)
        table = table[np.all(np.isfinite(table), axis=1)]
        if not len(table):
            return replace(self, left=left)
        centre = float(np.mean(table)) if self.centre is None else self.centre
        table = table - centre
        both, change = table[:, :2], table[:, 2:] - table[:, :1]
        zero = np.zeros(self.inputs)
        return SaltelliSums(
            inputs=self.inputs,
            centre=centre,
            base=self.base + len(table),
            whole=(
                self.whole[0] + float(np.sum(both)),
                self.whole[1] + float(np.sum(both * both)),
            ),
            changes=(self.changes if self.base else zero) + np.sum(change, axis=0),
            products=(self.products if self.base else zero) + table[:, 1] @ change,
            squares=(self.squares if self.base else zero) + np.sum(change * change, axis=0),
            left=left,
        )

    def indices(self) -> SobolIndices:
        """The sensitivities."""
        unknown = np.full(self.inputs, np.nan)
        if self.base < 2:
            return SobolIndices(unknown, unknown, self.base)
        mean = self.whole[0] / (2 * self.base)
        variance = self.whole[1] / (2 * self.base) - mean * mean
        if not variance > 1e-28 * ((self.centre or 0.0) ** 2 + variance):
            return SobolIndices(unknown, unknown, self.base)
        first = (self.products - mean * self.changes) / (self.base * variance)
        return SobolIndices(first, self.squares / (2.0 * self.base * variance), self.base)


def sobol_indices(output: FloatArray, inputs: int) -> SobolIndices:
    """First-order and total sensitivities from the rows of the design in their order.

    Args:
        output: The output of each row, shape (n (D + 2),); rows behind the last whole base row, and
            base rows of which one row is no finite number, are left out.
        inputs: Number of inputs D.
    """
    return SaltelliSums(inputs).plus(np.asarray(output, dtype=np.float64)).indices()


# How an output is spread over the rows of a study: counts over bins that grow with what comes.

# Bins; at least a quarter of them lie within the values, so that a quantile is known to 1/128 of
# their range, mostly to 1/256.
BINS = 512


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Counts of an output's finite values.

    Args:
        low, width: Lower end of the first bin and width of each; the width is 0 while all values
            are equal.
        counts: Rows in each bin, int64 (BINS,).
        unknown: Rows without a finite value.
        least, largest: Of the values; infinite where there are none.
    """

    low: float
    width: float
    counts: NDArray[np.int64]
    unknown: int
    least: float
    largest: float

    @property
    def rows(self) -> int:
        """Rows with a finite value."""
        return int(np.sum(self.counts))

    def plus(self, values: FloatArray) -> Histogram:
        """With further rows, shape (n,)."""
        known = values[np.isfinite(values)]
        unknown = self.unknown + values.size - known.size
        if not known.size:
            return Histogram(self.low, self.width, self.counts, unknown, self.least, self.largest)
        least = min(self.least, float(np.min(known)))
        largest = max(self.largest, float(np.max(known)))
        low, width, counts = self._grown(least, largest)
        counts = counts + np.bincount(_places(known, low, width), minlength=BINS)
        return Histogram(low, width, counts, unknown, least, largest)

    def _grown(self, least: float, largest: float) -> tuple[float, float, NDArray[np.int64]]:
        """Bins that hold a range: two become one, upwards or downwards, until it fits."""
        low, width, counts = self.low, self.width, self.counts.copy()
        if width == 0.0:
            if largest == least:
                return least, 0.0, counts
            # So far all values were one; they go where that one lies among the new bins.
            width = max((largest - least) / (BINS // 2), np.spacing(max(abs(least), abs(largest))))
            spread = np.zeros_like(counts)
            if np.any(counts):
                spread[_places(np.array([low]), least, width)[0]] = np.sum(counts)
            return least, width, spread
        while largest > low + width * BINS or least < low:
            half = np.add.reduceat(counts, np.arange(0, BINS, 2))
            empty = np.zeros(BINS // 2, dtype=np.int64)
            if least < low:
                counts, low = np.concatenate([empty, half]), low - width * BINS
            else:
                counts = np.concatenate([half, empty])
            width *= 2.0
        return low, width, counts

    def quantile(self, share: float) -> float:
        """Value that a share of the rows lies below: evenly spread within its bin, NaN of no
        rows.
        """
        if not self.rows:
            return float("nan")
        if self.width == 0.0:
            return self.low
        sums = np.concatenate([[0], np.cumsum(self.counts)])
        place = int(np.clip(np.searchsorted(sums, share * self.rows, side="left") - 1, 0, BINS - 1))
        inside = (share * self.rows - sums[place]) / max(int(self.counts[place]), 1)
        value = self.low + self.width * (place + inside)
        return float(np.clip(value, self.least, self.largest))

    def coarser(self, bins: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Edges (B + 1,) and counts (B,) of at most about ``bins`` bins from the least to the
        largest value.
        """
        filled = np.flatnonzero(self.counts)
        if not filled.size:
            return np.zeros(1), np.zeros(0, dtype=np.int64)
        first, end = int(filled[0]), int(filled[-1]) + 1
        step = max(-(-(end - first) // bins), 1)
        starts = np.arange(first, end, step)
        counts = np.add.reduceat(self.counts[:end], starts)
        return self.low + self.width * np.append(starts, starts[-1] + step), counts


def empty_histogram() -> Histogram:
    """A histogram of no rows."""
    return Histogram(0.0, 0.0, np.zeros(BINS, dtype=np.int64), 0, np.inf, -np.inf)


def _places(values: FloatArray, low: float, width: float) -> NDArray[np.intp]:
    if width == 0.0:
        return np.zeros(values.size, dtype=np.intp)
    return np.clip(((values - low) / width).astype(np.intp), 0, BINS - 1)


# Shares with their intervals: how many of n rows, and how well n rows tell.

CONFIDENCE = 0.95  # Share of studies in which an interval holds the true share.


@dataclass(frozen=True, slots=True)
class Share:
    """``met`` of ``count`` rows.

    Args:
        met, count: Numbers of rows.
        confidence: Probability with which the interval holds the true share.
    """

    met: int
    count: int
    confidence: float = CONFIDENCE

    @property
    def value(self) -> float:
        """The share itself, NaN of no rows."""
        return self.met / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the true share."""
        return wilson(self.met, self.count, self.confidence)

    def plus(self, other: Share) -> Share:
        """Both together."""
        return Share(self.met + other.met, self.count + other.count, self.confidence)


def wilson(met: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson's score interval of a share (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    (p + z^2/2n +- z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n) with p = met/n. None of n rows, and
    all of them, have an interval with a width, too; of no rows it is everything from 0 to 1.

    Args:
        met, count: Numbers of rows.
        confidence: Probability with which the interval holds the true share.
    """
    if count == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    share, part = met / count, z * z / count
    middle = share + 0.5 * part
    half = z * sqrt(share * (1.0 - share) / count + 0.25 * part / count)
    low, high = (middle - half) / (1.0 + part), (middle + half) / (1.0 + part)
    return (0.0 if met == 0 else low), (1.0 if met == count else high)


# How many rows of a study meet what is accepted, and the one that is farthest from it.

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


# What a study asks of its rows, by the names of their columns.


def goal_columns(study: Study) -> tuple[GoalColumn, ...]:
    """Goals of a study.

    Args:
        study: The study.
    """
    return tuple(GoalColumn(OUTPUT_COLUMN + goal.output, goal.minimise) for goal in study.goals)


def bound_column(bound: Bound, design: Design) -> AcceptedRange:
    """A limit of a study, or what it accepts.

    Args:
        bound: As the study says it.
        design: The design that it starts from.
    """
    name = bound_output(bound, design)
    return AcceptedRange(OUTPUT_COLUMN + name, bound.output, bound.below, bound.above)
