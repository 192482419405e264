"""What is shown of a study: its columns in the units of people, what its rows say together, and
some of its rows for pictures.
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.exploration.row_designs import design_text_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.acceptance import (
    Histogram,
    Share,
    StudyQuestion,
    StudySummary,
    WorstRow,
)
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    STATES,
    ColumnSpec,
    row_assignments,
    row_keys,
)
from dqforge.reports.exploration.part_file import FRONT, INDEX, KEY, WINNERS, StoreError, read_whole
from dqforge.reports.exploration.part_store import (
    PartStore,
    input_names,
    label,
    people_unit,
    study_from,
)
from dqforge.reports.exploration.summary_files import plain_sensitivities
from dqforge.reports.exploration.table_query import (
    Condition,
    TableQuery,
    find_rows,
    people_texts,
    short_name,
    usual_columns,
)
from dqforge.reports.output.folder import RUN, write_output
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PALE, TEAL, new_figure, style
from dqforge.reports.plain_data import PlainData, finite
from dqforge.reports.run import RunOutput, export_design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.exploration.acceptance import AcceptedRange
    from dqforge.optimizer.exploration.row_block import RowBlock, RowSource


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


# Winners of a study: their design files, and their headers by the exact path, proven as in `run`;
# and what ``explore --export`` answers.
#
# What a study computes by batches is no header. The design of a row is written with the comments
# of the design that the study starts from, read as a file, and solved, emitted and verified like
# any.

_MOST = 1000
_ROWS = re.compile(r"row:(\d{1,12}(?:,\d{1,12})*)")


@dataclass(frozen=True, slots=True)
class Winner:
    """A row that was exported.

    Args:
        index: Of the row.
        folder: Where its files lie.
        output: What was made.
    """

    index: int
    folder: Path
    output: RunOutput


def chosen_rows(store: PartStore, which: str) -> tuple[int, ...]:
    """Indices of the rows that ``--export`` means.

    Args:
        store: The study.
        which: A number of the best ones, ``row:INDEX`` (several with commas), or ``front``.

    Raises:
        InputError: It is none of these, there are no such rows, or the study has no goal to be best
            in.
    """
    named = _ROWS.fullmatch(which.strip())
    if named is not None:
        rows = tuple(dict.fromkeys(int(row) for row in named[1].split(",")))
        _require_rows(store, rows)
        return rows
    if which.strip() == "front":
        return _few(store, _winners_front(store))
    if re.fullmatch(r"[1-9]\d{0,8}", which.strip()):
        return _few(store, _best(store, int(which)))
    raise InputError(
        f"--export {which}: write a number of rows, row:INDEX (several with commas), or front"
    )


def _few(store: PartStore, rows: tuple[int, ...]) -> tuple[int, ...]:
    if not rows:
        raise InputError(f"{store.folder} has no row in state ok; there is nothing to export")
    if len(rows) > _MOST:
        raise InputError(f"--export: {len(rows)} rows, at most {_MOST} are written; name fewer")
    return rows


def _require_rows(store: PartStore, rows: Sequence[int]) -> None:
    header = store.header
    for row in rows:
        if row >= header.count:
            raise InputError(f"--export row:{row}: the study has {header.count} rows, from 0 on")
        if not list(store.read([], [row // header.batch])):
            raise InputError(f"--export row:{row}: it is not computed yet; continue the study")


def _goals(store: PartStore) -> tuple[tuple[str, bool], ...]:
    """Columns of the goals of a study, and whether the largest are the best."""
    goals = store.header.study["goals"]
    if not goals:
        raise InputError(
            "--export: the study requests no pareto, so no row is best; write row:INDEX"
        )
    return tuple((OUTPUT_COLUMN + goal["output"], not goal["minimise"]) for goal in goals)


def _best(store: PartStore, count: int) -> tuple[int, ...]:
    """The best rows by the only goal; of several goals those of the front, by the first one."""
    goals = _goals(store)
    if len(goals) > 1:
        return _winners_front(store)[:count]
    name = goals[0][0]
    most = min(count, _MOST + 1)
    ok = Condition("state", "=", words=("ok",))
    found = find_rows(store, TableQuery((INDEX, name), (ok,), goals, most))
    there = ~np.isnan(found.cells[name])
    return tuple(int(row) for row in found.cells[INDEX][there])


def _winners_front(store: PartStore) -> tuple[int, ...]:
    """Rows of the front in its file, by the first goal."""
    import pyarrow as pa
    from pyarrow import parquet

    (name, largest), *_ = _goals(store)
    path = store.folder / FRONT
    try:
        table = parquet.read_table(pa.BufferReader(read_whole(path)), columns=[INDEX, name])
        index, goal = table[INDEX].to_numpy(), table[name].to_numpy()
    except FileNotFoundError:
        raise InputError(f"{store.folder} has no {FRONT} yet; run the study to its end") from None
    except (pa.ArrowException, OSError, KeyError) as error:
        raise StoreError(f"{path}: it cannot be read; run the study again") from error
    order = np.lexsort([index, -goal if largest else goal])
    return tuple(int(row) for row in index[order])


def stored_study(store: PartStore) -> Study:
    """The study of a folder, from what lies in it.

    Raises:
        StoreError: A file is missing.
    """
    plain = store.header.study
    try:
        contents = {name: read_whole(store.folder / name) for name in input_names(plain)}
    except OSError as error:
        raise StoreError(
            f"{error.filename}: {error.strerror}; run the study again, which writes it again"
        ) from error
    return study_from(plain, contents)


def row_text(store: PartStore, study: Study, row: int) -> bytes:
    """The design file of a row.

    Raises:
        StoreError: What lies in the folder does not give the design that the row was computed for.
        InputError: A value of the row is none that a design may have.
    """
    header = store.header
    names = [column.name for column in header.columns]
    inputs = [name for name in names if name.startswith(INPUT_COLUMN)]
    (part,) = store.read([*inputs, KEY], [row // header.batch])
    place = row - part.first
    values = {
        name.removeprefix(INPUT_COLUMN): part.columns[name][place : place + 1] for name in inputs
    }
    outputs = [name.removeprefix(OUTPUT_COLUMN) for name in names if name not in inputs]
    key = row_keys(study, values, outputs)[0]
    if not np.array_equal(key, part.keys[place]):
        raise StoreError(
            f"row {row}: the design in {store.folder} is not the one that was computed; run the "
            "study again"
        )
    return design_text_of(study, row_assignments(study, values, 0))


def row_design(study: Study, text: bytes, source: str) -> Design:
    """A design file of a row, read like any file beside those that it names."""
    with tempfile.TemporaryDirectory(prefix="dqforge-") as copy:
        for name, content in study.named:
            path = Path(copy) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return load_text(text, source, Path(copy))


def export_row(store: PartStore, study: Study, row: int, *, verify: bool = True) -> Winner:
    """Write the design of a row and its headers into a folder of their own.

    Args:
        store, study: The folder and the study in it (`stored_study`).
        row: Index of the row.
        verify: Whether the compiled headers are compared with their models.

    Raises:
        DqforgeError: As `dqforge.reports.run.export_design`, with the row; as `row_text`.
    """
    stage(f"row {row}")
    folder = store.folder / WINNERS / f"row-{row:06d}"
    try:
        text = row_text(store, study, row)
        design = row_design(study, text, f"row {row}")
        output = export_design(design, verify=verify)
        write_output(folder, RUN, output.files, design)
    except DqforgeError as error:
        if f"row {row}" not in str(error):
            error.message = f"row {row}: {error.message}"
        raise
    return Winner(row, folder, output)


# What `dqforge explore OUT --export` answers: which rows were written where, and their proof.


def answer_export(folder: Path, which: str, *, verify: bool = True) -> Answer:
    """Write the designs and headers of rows of a study.

    Args:
        folder: Of the study.
        which: As of `dqforge.reports.exploration.study_view.chosen_rows`.
        verify: Whether the compiled headers are compared with their models.

    Raises:
        DqforgeError: As `chosen_rows` and `dqforge.reports.exploration.study_view.export_row`; what
            was written before stays.
    """
    store = PartStore.existing(folder)
    rows = chosen_rows(store, which)
    study = stored_study(store)
    winners = [export_row(store, study, row, verify=verify) for row in rows]
    one = len(winners) == 1
    what = "1 design, with its header" if one else f"{len(winners)} designs, with their headers"
    title = f"{store.header.name}: {what}"
    return Answer(
        store.header.name,
        (_table(store, winners, title),),
        {"winners": [_plain(winner) for winner in winners]},
        notes=tuple(f"written: {winner.folder}" for winner in winners),
    )


def _table(store: PartStore, winners: Sequence[Winner], title: str) -> Table:
    """What was exported as the study knows it."""
    header = store.header
    columns = usual_columns(header)
    texts: list[tuple[str, ...]] = []
    for winner in winners:
        one = Condition(INDEX, "=", winner.index)
        part = winner.index // header.batch
        cells = find_rows(store, TableQuery(columns, (one,)), [part]).cells
        texts += people_texts(header, columns, cells)
    return Table(title, tuple(short_name(header, name) for name in columns), tuple(texts))


def _plain(winner: Winner) -> PlainData:
    files = sorted(winner.output.files)
    return {
        "index": winner.index,
        "out": str(winner.folder),
        "verified": winner.output.verification is not None,
        "files": files,
    }
