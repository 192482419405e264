"""What is shown of a study: its columns in the units of people, what its rows say together, and
some of its rows for pictures.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.acceptance import (
    Histogram,
    Share,
    StudyQuestion,
    StudySummary,
    WorstRow,
)
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, STATES, ColumnSpec
from dqforge.reports.exploration.part_store import label, people_unit
from dqforge.reports.exploration.summary_files import plain_sensitivities
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PALE, TEAL, new_figure, style
from dqforge.reports.plain_data import PlainData, finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.machines.exploration.study import Study
    from dqforge.optimizer.exploration.acceptance import AcceptedRange
    from dqforge.optimizer.exploration.row_block import RowBlock, RowSource
    from dqforge.reports.exploration.part_store import PartStore


MOST_PICTURED = 1500  # Rows of a picture besides those of the front: every n-th of the study.
MOST_OF_FRONT = 500


@dataclass(frozen=True, slots=True, eq=False)
class PicturedRows:
    """Some rows of a study.

    Args:
        index: Their indices, ascending, int64 (n,).
        states: Places in `dqforge.optimizer.exploration.row_block.STATES`, int8 (n,).
        columns: Numbers in SI units, of choices the places in their words, -1 for none, (n,).
        step: Every how manyth row is here, besides those of the front.
    """

    index: NDArray[np.int64]
    states: NDArray[np.int8]
    columns: Mapping[str, NDArray[np.float64]]
    step: int


@dataclass(frozen=True, slots=True, eq=False)
class StudyView:
    """Everything that a page or a table says of a study.

    Args:
        name, about: Words of its file.
        columns: All columns of its rows.
        rows: Rows of the study; ``summary.rows`` of them are computed.
        batch: Rows per part.
        summary: What the rows say together.
        pictured: Rows for pictures.
        audited: Largest relative deviation of the batch path from the single path, by output.
        computed_with: Versions of what computed it.
    """

    name: str
    about: str
    columns: tuple[ColumnSpec, ...]
    rows: int
    batch: int
    summary: StudySummary
    pictured: PicturedRows
    audited: Mapping[str, float]
    computed_with: Mapping[str, str]

    @property
    def question(self) -> StudyQuestion:
        """What was asked of the rows together."""
        return self.summary.question

    def spec(self, name: str) -> ColumnSpec:
        """The column of a whole name."""
        return next(column for column in self.columns if column.name == name)

    @property
    def varied(self) -> tuple[ColumnSpec, ...]:
        """Columns of inputs that are not the same in all pictured rows."""
        return tuple(
            column
            for column in self.columns
            if column.name.startswith(INPUT_COLUMN) and _changes(self.pictured.columns[column.name])
        )


def _changes(values: NDArray[np.float64]) -> bool:
    known = values[~np.isnan(values)]
    return bool(known.size and np.any(known != known[0]))


def shown_unit(spec: ColumnSpec, values: NDArray[np.float64]) -> tuple[str, float]:
    """Unit in which values of a column are drawn, and the factor from SI to it.

    Args:
        spec: A column of numbers.
        values: What is drawn, shape (n,); the largest one chooses the prefix.
    """
    finite = np.abs(values[np.isfinite(values)])
    plain = people_unit(spec)
    if plain == "" or not finite.size or not np.max(finite) > 0.0:
        return plain, 1.0
    largest = float(np.max(finite))
    figure, _, unit = format_quantity(largest, people_unit(spec), 15).partition(" ")
    factor = float(figure) / largest
    # Of a decimal prefix the factor is known exactly; the printed figure has 15 digits of it.
    power = 10.0 ** round(float(np.log10(factor)))
    return unit, power if abs(factor / power - 1.0) < 1e-9 else factor


def pictured_rows(
    store: PartStore, names: Sequence[str], front: Collection[int] = ()
) -> PicturedRows:
    """Rows for pictures: every n-th row of the study that is computed, and those of a front.

    Args:
        store: The study's folder; one part is in memory at a time.
        names: Whole names of the columns that are wanted.
        front: Indices of rows that are wanted in any case.
    """
    step = max(-(-store.header.count // MOST_PICTURED), 1)
    wanted = np.array(sorted(front)[:MOST_OF_FRONT], dtype=np.int64)
    index: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
    states: list[NDArray[np.int8]] = [np.empty(0, dtype=np.int8)]
    columns: dict[str, list[NDArray[np.float64] | NDArray[np.int32]]] = {name: [] for name in names}
    for part in store.read(names):
        own = part.first + np.arange(part.count, dtype=np.int64)
        kept = (own % step == 0) | np.isin(own, wanted)
        index.append(own[kept])
        states.append(part.states[kept])
        for name in names:
            columns[name].append(part.columns[name][kept])
    return PicturedRows(
        np.concatenate(index),
        np.concatenate(states),
        {name: _joined(found) for name, found in columns.items()},
        step,
    )


def _joined(pieces: list[NDArray[np.float64] | NDArray[np.int32]]) -> NDArray[np.float64]:
    """Pieces of one column, words' places as numbers."""
    return np.concatenate([np.empty(0), *pieces])


# The figure of a study: its front among the rows, or how what is judged is spread.

_BINS = 60
_WIDE = 8.0  # Ratio of the ends of an axis from which on it is logarithmic.


def plot_study(view: StudyView) -> Figure:
    """The first two goals of a study with its front, else what it accepts of its outputs.

    Args:
        view: The study.

    Raises:
        InputError: It has neither two goals nor anything that is accepted, or no row that can be
            drawn.
    """
    if view.summary.front is not None and len(view.question.goals) > 1:
        return _front(view)
    if view.question.accept:
        return _spread(view)
    raise InputError("--plot draws a front or a yield: the study needs two goals, or accept")


def _front(view: StudyView) -> Figure:
    rows, goals = view.pictured, view.question.goals[:2]
    found = view.summary.front
    assert found is not None
    scales = []
    for goal in goals:
        values = rows.columns[goal.column]
        unit, factor = shown_unit(view.spec(goal.column), values)
        scales.append((f"{label(goal.column)} in {unit}" if unit else label(goal.column), factor))
    across, up = (
        factor * rows.columns[goal.column] for goal, (_, factor) in zip(goals, scales, strict=True)
    )
    if not np.any(np.isfinite(across) & np.isfinite(up)):
        raise InputError("--plot: no row of the study has both goals")
    with style():
        figure = new_figure("study-front", 3.8, "Two goals of every row, and the front")
        axes = figure.add_axes((0.1, 0.13, 0.86, 0.82))
        for state, colour, words in (("limit", PALE, "beyond a limit"), ("ok", BLUE, "allowed")):
            own = rows.states == STATES.index(state)
            if np.any(own):
                axes.plot(across[own], up[own], ".", color=colour, markersize=4, label=words)
        ends = found.goals[np.argsort(found.goals[:, 0])][:, :2]
        signs = [(1.0 if goal.minimise else -1.0) for goal in goals]
        ends = ends * np.array(signs) * np.array([factor for _, factor in scales])
        axes.plot(*ends.T, "o-", color=TEAL, markersize=4, linewidth=1.0, label="front")
        axes.set(xlabel=scales[0][0], ylabel=scales[1][0])
        _scale_axes(axes, across, up)
        axes.legend(frameon=False)
    return figure


def _scale_axes(axes: Axes, across: FloatArray, up: FloatArray) -> None:
    """Ratios where values lie far apart: the few large ones would hide the front."""
    for name, values in (("x", across), ("y", up)):
        known = values[np.isfinite(values)]
        if known.min() > 0.0 and known.max() > _WIDE * known.min():
            axes.set(**{f"{name}scale": "log"})


def _spread(view: StudyView) -> Figure:
    accept = view.question.accept[:4]
    with style():
        figure = new_figure(
            "study-yield", 2.6, "How the evaluated outputs are spread over the rows"
        )
        width = 0.94 / len(accept)
        for place, each in enumerate(accept):
            box = (0.065 + place * width, 0.19, width - 0.075, 0.74)
            _draw_spread(figure.add_axes(box), view, each)
    return figure


def _draw_spread(axes: Axes, view: StudyView, each: AcceptedRange) -> None:
    spread = dict(zip(view.question.spread, view.summary.spread, strict=True))
    edges, counts = spread[each.column].coarser(_BINS)
    bounds = [bound for bound in (each.below, each.above) if bound is not None]
    unit, factor = shown_unit(view.spec(each.column), np.array([*edges, *bounds]))
    if counts.size:
        axes.stairs(100.0 * counts / np.sum(counts), factor * edges, fill=True, color=BLUE)
    for bound in bounds:
        axes.axvline(factor * bound, color=ORANGE, linewidth=1.2, label="_bound")
    axes.set(xlabel=f"{label(each.column)} in {unit}" if unit else label(each.column))
    axes.set(ylabel="rows in %")


# What `dqforge explore --dry-run` answers: how many rows, which ones, how long, how many bytes.

_TRIED_ROWS = 200
_TRIED_S = 10.0
_QUICK_S = 0.5


def estimated_study(study: Study, plan: RowSource) -> Answer:
    """What a study would be, from its first rows.

    Args:
        study: The study.
        plan: Its rows; of a search those of the first generation, since others follow from them.
    """
    search = study.search
    known = plan.count if search is None else search.population
    tried, seconds, size = _tried(study, plan, known)
    factor = plan.count / max(tried, 1)
    parts = -(-plan.count // plan.batch)
    places = {"first": 0} if search is not None else {"first": 0, "last": plan.count - 1}
    ends = {name: _inputs(plan, plan.rows(row, row + 1)) for name, row in places.items()}
    names = sorted({name for end in ends.values() for name in end})
    shown = list(ends.values())[: plan.count]
    rows = tuple((name, *(end.get(name, "") for end in shown)) for name in names)
    heads = ("input", "first row", "last row")[: 1 + len(shown)]
    price = f"{_span(seconds * factor)} on one core, {size * factor / 1e6:,.3g} MB"
    notes = [
        f"{plan.count:,} rows in {parts:,} parts of {plan.batch:,}",
        f"about {price} (from {tried:,} rows)",
    ]
    plain: PlainData = {"rows": plan.count, "rows_per_part": plan.batch, **ends}
    if search is not None:
        notes[0] += f", {search.generations:,} generations of {search.population:,} rows"
        plain |= {"generations": search.generations, "population": search.population}
    return Answer(
        study.name, [Table(study.name, heads, rows)], {"study": plain}, notes=tuple(notes)
    )


def _tried(study: Study, plan: RowSource, known: int) -> tuple[int, float, int]:
    """Rows that were tried, what they took in s, and their bytes; of ``known`` ones.

    What is done once in a process, such as imports and tables of breakpoints, is left out: a row
    comes first. Where some rows take no time, a whole part tells more.
    """
    from dqforge.reports.exploration.contained_rows import contained_rows
    from dqforge.reports.exploration.part_file import encode_part

    def timed(first: int, end: int) -> tuple[float, int]:
        began = time.perf_counter()
        block = contained_rows(plan, first, end)
        size = len(encode_part(block, plan.columns, study.digest))
        return time.perf_counter() - began, size

    stage("trying rows")
    timed(0, 1)
    first, seconds, size = 0, 0.0, 0
    step = min(plan.batch, _TRIED_ROWS)
    while first < min(_TRIED_ROWS, known) and seconds < _TRIED_S:
        end = min(first + step, known)
        took, added = timed(first, end)
        first, seconds, size = end, seconds + took, size + added
    if plan.batch > first and seconds < _QUICK_S:
        first = min(plan.batch, known)
        seconds, size = timed(0, first)
    return first, seconds, size


def _inputs(plan: RowSource, block: RowBlock) -> Mapping[str, str]:
    """What goes into the one row of a block, as it is printed."""
    from dqforge.optimizer.exploration.row_block import INPUT_COLUMN
    from dqforge.reports.exploration.part_store import label, value_text

    found = {}
    for column in plan.columns:
        if column.name.startswith(INPUT_COLUMN):
            value = float(block.columns[column.name][0])
            found[label(column.name)] = value_text(column, value)
    return found


def _span(seconds: float) -> str:
    """A time as people say it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


# What the rows of a study say together, as JSON holds it: SI units, every digit.

QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)


def plain_summary(view: StudyView) -> PlainData:
    """Shares with their intervals, the worst rows, the front, sensitivities and spreads.

    Args:
        view: The study.
    """
    summary, question = view.summary, view.question
    tally = summary.acceptance
    ranges = [
        {
            "output": each.label,
            "column": each.column,
            "below": each.below,
            "above": each.above,
            **_share(tally.share(place)),
            "worst": _worst(view, tally.worst[place] if tally.worst else None),
        }
        for place, each in enumerate(question.accept)
    ]
    return {
        "acceptance": {"ranges": ranges, "all": _share(tally.share_of_all())} if ranges else None,
        "front": _front_data(view),
        "sensitivities": [plain_sensitivities(each) for each in summary.sensitivities],
        "spread": [
            {"column": name} | _spread_data(histogram)
            for name, histogram in zip(question.spread, summary.spread, strict=True)
        ],
    }


def _share(share: Share) -> PlainData:
    low, high = share.interval
    return {
        "met": share.met,
        "rows": share.count,
        "share": finite(share.value),
        "interval": [low, high],
        "confidence": share.confidence,
    }


def _worst(view: StudyView, row: WorstRow | None) -> PlainData | None:
    if row is None:
        return None
    inputs: PlainData = {}
    for name, value in row.inputs.items():
        spec = view.spec(name)
        word = spec.kind == "choice"
        inputs[label(name)] = spec.choices[int(value)] if word and value >= 0 else finite(value)
    return {"row": row.index, "value": row.value, "inputs": inputs}


def _front_data(view: StudyView) -> PlainData | None:
    front = view.summary.front
    if front is None:
        return None
    signs = [1.0 if goal.minimise else -1.0 for goal in view.question.goals]
    return {
        "goals": [
            {"column": goal.column, "minimise": goal.minimise} for goal in view.question.goals
        ],
        "rows": front.index.tolist(),
        "values": [
            [sign * value for sign, value in zip(signs, row, strict=True)]
            for row in front.goals.tolist()
        ],
    }


def _spread_data(histogram: Histogram) -> PlainData:
    return {
        "rows": histogram.rows,
        "unknown": histogram.unknown,
        "least": finite(histogram.least),
        "largest": finite(histogram.largest),
        "quantiles": [[share, finite(histogram.quantile(share))] for share in QUANTILES],
    }
