"""The page of a study: one file that asks for nothing outside itself, the same bytes for the same
parts. Its pictures are drawn by a script in the page, which also tells each row under the pointer
and gives the pictured rows as CSV; the page admits no other script.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge import __version__
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.acceptance import AcceptedRange, NamedRow, Share
from dqforge.optimizer.exploration.row_block import OUTPUT_COLUMN, STATES, ColumnSpec
from dqforge.reports.exploration.part_store import label, value_text
from dqforge.reports.exploration.study_view import StudyView, shown_unit
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import BLUE, RED, SKY
from dqforge.reports.pages.html_text import HtmlTable, Row, count
from dqforge.reports.pages.templating import DataFile, data_file, panels_text, render
from dqforge.reports.run_folder import FIGURES, FOLDING, ListedFile, files_table, page_scripts

if TYPE_CHECKING:
    from markupsafe import Markup


MOST_PANELS = 6  # Columns of the scatter matrix.
FILES = "What the study wrote beside this page"  # Caption of the table of files.
NOT_ACCEPTED = "not accepted"
ENDINGS = (*STATES, NOT_ACCEPTED)
_DIGITS = 7
# Numbers of a message, not those within names.
_NUMBER = re.compile(r"(?<![A-Za-z_])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def render_study(view: StudyView, files: Sequence[ListedFile] = ()) -> str:
    """The page.

    Args:
        view: The study.
        files: What lies beside the page; without any it says nothing of files.
    """
    tables = {
        "acceptance": _html(acceptance_table(view)),
        "front": _html(front_table(view), text_columns=0),
        "sensitivity": _html(sensitivity_table(view), text_columns=2),
        "audit": _html(audit_table(view), folded=True),
        "endings": _html(_endings(view), text_columns=3),
        "files": files_table(files, FILES) if files else None,
    }
    histograms = [_drawn(chart, "spread") for chart in histogram_charts(view)]
    return render(
        "exploration/study.html.j2",
        {
            "version": __version__,
            "name": view.name,
            "about": view.about,
            "scripts": page_scripts(FIGURES, FOLDING, "exploration/pictures.js.j2"),
            "sections": _contents(tables, spread=bool(histograms)),
            "data": _embedded(page_data(view)),
            "tiles": _tiles(view),
            "lead": _lead(view),
            "rows": data_file("rows.csv", pictured_table(view)),
            "sensitivities": [_drawn(chart, "sensitivity") for chart in sensitivity_charts(view)],
            "histograms": histograms,
            "tables": tables,
            "pictured": count(len(view.pictured.index)),
            "which": _which(view),
            "computed_with": dict(view.computed_with),
        },
    )


def _contents(tables: Mapping[str, HtmlTable | None], *, spread: bool) -> list[tuple[str, str]]:
    """Anchor and title of the sections that there are."""
    there = {
        ("summary", "Summary"): True,
        ("yield", "Yield"): tables["acceptance"] is not None,
        ("front", "Front"): tables["front"] is not None,
        ("sensitivity", "Sensitivities"): tables["sensitivity"] is not None,
        ("rows", "Rows"): True,
        ("spread", "Spread"): spread and tables["acceptance"] is None,
        ("files", "Files"): tables["files"] is not None,
        ("computed", "How it was computed"): True,
    }
    return [section for section, shown in there.items() if shown]


@dataclass(frozen=True, slots=True)
class DrawnChart:
    """A chart with its data and what a pointer needs to tell them.

    Attributes:
        chart: The chart.
        data: Its data.
        panels: As of `dqforge.reports.pages.templating.PageFigure`.
    """

    chart: BarChart | HistogramChart
    data: DataFile
    panels: Markup


def _drawn(chart: BarChart | HistogramChart, kind: str) -> DrawnChart:
    name = re.sub(r"[^A-Za-z0-9]+", "-", f"{kind}-{chart.title}")
    return DrawnChart(chart, data_file(f"{name}.csv", _csv(chart.table)), panels_text(chart.panels))


def _csv(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def pictured_table(view: StudyView) -> str:
    """The pictured rows as a table: their place in the study, how they ended, whether they are on
    the front, then the columns of `page_data` in the units of people.

    Args:
        view: The study.
    """
    plain, front = page_data(view), view.summary.front
    on_front = set() if front is None else set(front.index.tolist())
    heads = ["row", "state", "front"]
    heads += [
        f"{column['label']} [{column['unit']}]" if column["unit"] else column["label"]
        for column in plain["columns"]
    ]
    places = view.pictured.index.tolist()
    rows = zip(
        places,
        [ENDINGS[place] for place in _ended(view)],
        [int(row in on_front) for row in places],
        *(_cells(view, view.spec(name)) for name in _kept(view)),
        strict=True,
    )
    return _csv([heads, *rows])


def _embedded(plain: dict[str, Any]) -> str:
    """JSON that can stand inside a template element: nothing in it is read as markup."""
    text = json.dumps(plain, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _lead(view: StudyView) -> str:
    states = view.summary.acceptance.states
    fine = states.get("ok", 0)
    text = f"{count(view.summary.rows)} of {count(view.rows)} rows are computed, {count(fine)} of"
    text += " them without objection."
    bad = [f"{count(states[name])} {name}" for name in STATES[1:] if states.get(name)]
    return text + (f" Others: {', '.join(bad)}." if bad else "")


def _which(view: StudyView) -> str:
    """Which rows the pictures show."""
    step = view.pictured.step
    if step == 1:
        return "all that are computed"
    own = f"one of every {count(step)} of the study"
    return own if view.summary.front is None else f"{own}, and those of the front"


def _tiles(view: StudyView) -> list[tuple[str, str, str]]:
    """Title, value and detail of the key numbers."""
    found = [("Rows", count(view.summary.rows), f"of {count(view.rows)}")]
    if view.question.accept:
        share, interval = share_cells(view.summary.acceptance.share_of_all())
        found.append(("Yield", share, f"95 % interval {interval}"))
    front, goals = view.summary.front, view.question.goals
    if front is not None and front.count:
        best = int(np.argmin(front.goals[:, 0]))
        sign = 1.0 if goals[0].minimise else -1.0
        value = value_text(view.spec(goals[0].column), sign * float(front.goals[best, 0]))
        word = "Least" if goals[0].minimise else "Largest"
        title = f"{word} {label(goals[0].column)}"
        found.append(
            (title, value, f"row {front.index[best]}, {rows_text(front.count)} on the front")
        )
    return found


def _html(table: Table | None, text_columns: int = 1, *, folded: bool = False) -> HtmlTable | None:
    if table is None:
        return None
    rows = tuple(Row(cells) for cells in table.rows)
    return HtmlTable(table.title, table.columns, rows, text_columns, table.notes, folded)


def _endings(view: StudyView) -> Table | None:
    """The first row of each bad ending; messages that differ in numbers alone are of one kind."""
    first: dict[tuple[str, str], NamedRow] = {}
    for each in view.summary.acceptance.named:
        first.setdefault((each.state, _NUMBER.sub("0", each.message)), each)
    if not first:
        return None
    rows = tuple((str(each.index), each.state, each.message) for each in first.values())
    title = "Rows that did not end well, the first of each kind"
    return Table(title, ("first row", "state", "message"), rows)


def panel_columns(view: StudyView) -> tuple[ColumnSpec, ...]:
    """Columns of the scatter matrix: inputs that vary, then what is asked of the rows.

    Args:
        view: The study.
    """
    question = view.question
    asked = [each.column for each in question.accept] + [goal.column for goal in question.goals]
    asked += list(question.sensitivity)
    outputs = list(dict.fromkeys(asked or question.spread))[: MOST_PANELS // 2]
    inputs = [spec.name for spec in view.varied][: MOST_PANELS - len(outputs)]
    return tuple(view.spec(name) for name in (*inputs, *outputs))


def page_data(view: StudyView) -> dict[str, Any]:
    """What the script of the page is given beside `pictured_table`: its columns, and the goals.

    Args:
        view: The study.
    """
    kept = _kept(view)
    columns = [_column(view, view.spec(name)) for name in kept]
    places = {name: place for place, name in enumerate(kept)}
    goals = [
        {"column": places[goal.column], "minimise": goal.minimise}
        for goal in view.question.goals
        if goal.column in places
    ]
    return {
        "name": view.name,
        "endings": list(ENDINGS),
        "columns": columns,
        "panels": [places[spec.name] for spec in panel_columns(view) if spec.name in places],
        "goals": goals,
    }


def _kept(view: StudyView) -> list[str]:
    """Columns of the pictured rows: what varies, and all outputs."""
    names = [spec.name for spec in view.varied] + [
        spec.name for spec in view.columns if spec.name.startswith(OUTPUT_COLUMN)
    ]
    return [name for name in dict.fromkeys(names) if name in view.pictured.columns]


def _ended(view: StudyView) -> list[int]:
    """Places in `ENDINGS`: rows that ended well and are not accepted stand apart."""
    rows = view.pictured
    fine = np.ones(rows.states.shape, dtype=np.bool_)
    for each in view.question.accept:
        fine &= each.met(rows.columns[each.column])
    aside = (rows.states == STATES.index("ok")) & ~fine
    places = np.where(aside, ENDINGS.index(NOT_ACCEPTED), rows.states)
    return [int(place) for place in places]


def _column(view: StudyView, spec: ColumnSpec) -> dict[str, Any]:
    """Name and unit of a column, and the words that its cells may have."""
    if spec.kind == "choice":
        return {"label": label(spec.name), "unit": "", "words": list(spec.choices)}
    unit, _ = shown_unit(spec, np.asarray(view.pictured.columns[spec.name], dtype=np.float64))
    return {"label": label(spec.name), "unit": unit, "words": []}


def _cells(view: StudyView, spec: ColumnSpec) -> list[str]:
    """A column as it is printed; what there is none of is empty."""
    values = view.pictured.columns[spec.name]
    if spec.kind == "choice":
        return [spec.choices[int(value)] if value >= 0 else "" for value in values.tolist()]
    numbers = np.asarray(values, dtype=np.float64)
    _, factor = shown_unit(spec, numbers)
    found = (numbers * factor).tolist()
    return [f"{value:.{_DIGITS}g}" if math.isfinite(value) else "" for value in found]


def sensitivity_charts(view: StudyView) -> list[BarChart]:
    """Bars of first-order and total sensitivities, a chart for each output.

    Args:
        view: The study.
    """
    charts = []
    for found in view.summary.sensitivities:
        bars = []
        for place, name in enumerate(found.inputs):
            total = None if found.total is None else float(found.total[place])
            bars.append(Bar(label(name), float(found.first[place]), total))
        bars.sort(key=lambda bar: -bar.first if math.isfinite(bar.first) else math.inf)
        charts.append(BarChart(label(found.output), tuple(bars)))
    return charts


def histogram_charts(view: StudyView) -> list[HistogramChart]:
    """Histograms of what is accepted, with its bounds, and of what else is asked for.

    Args:
        view: The study.
    """
    charts = []
    for name, histogram in zip(view.question.spread, view.summary.spread, strict=True):
        if not histogram.rows:
            continue
        spec = view.spec(name)
        unit, factor = shown_unit(spec, np.array([histogram.least, histogram.largest]))
        edges, counts = histogram.coarser(48)
        edges = np.clip(edges, histogram.least, histogram.largest)
        ranges = [each for each in view.question.accept if each.column == name]
        bounds = [b for each in ranges for b in (each.below, each.above) if b is not None]
        words = "; ".join(f"{each.label} {range_text(view, each)}" for each in ranges)
        charts.append(
            HistogramChart(
                label(name),
                unit,
                tuple(float(edge) * factor for edge in edges.tolist()),
                tuple(int(each) for each in counts.tolist()),
                tuple(bound * factor for bound in bounds),
                words,
            )
        )
    return charts


# Bars and histograms of a study as places on a drawing, for the template that draws them.

WIDTH = 420.0  # Width of every drawing in its own units.
_LEFT, _RIGHT, _ROW, _HEIGHT, _FOOT = 170.0, 46.0, 30.0, 150.0, 34.0


def _figure(value: float | None) -> str:
    return f"{value:.6g}" if value is not None and math.isfinite(value) else ""


@dataclass(frozen=True, slots=True)
class Bar:
    """Sensitivity to one input: of first order, and total where that is known."""

    name: str
    first: float
    total: float | None


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle with what is told of it under the pointer."""

    x: float
    y: float
    width: float
    height: float
    told: str
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Words:
    """Text at a place; ``anchor`` as of SVG."""

    x: float
    y: float
    text: str
    anchor: str = "start"


@dataclass(frozen=True, slots=True)
class BarChart:
    """Bars of one output's sensitivities, from 0 to 1."""

    title: str
    bars: tuple[Bar, ...]
    width: float = WIDTH

    @property
    def height(self) -> float:
        """Height of the drawing."""
        return _ROW * len(self.bars) + _FOOT

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Total sensitivities behind those of first order."""
        found = []
        for place, bar in enumerate(self.bars):
            y = _ROW * place + 6.0
            told = f"{bar.name}: first order {bar.first:.3f}"
            if bar.total is not None and math.isfinite(bar.total):
                told += f", total {bar.total:.3f}"
                found.append(Rectangle(_LEFT, y, self._long(bar.total), 18.0, told, "total"))
            if math.isfinite(bar.first):
                found.append(Rectangle(_LEFT, y + 3.0, self._long(bar.first), 12.0, told, "first"))
        return tuple(found)

    @property
    def words(self) -> tuple[Words, ...]:
        """Names on the left, figures behind the bars, the axis below."""
        found = []
        for place, bar in enumerate(self.bars):
            y = _ROW * place + 19.0
            found.append(Words(_LEFT - 8.0, y, bar.name, "end"))
            longest = max(bar.first, bar.total or 0.0)
            text = f"{round(bar.first, 2) + 0.0:.2f}" if math.isfinite(bar.first) else "unknown"
            found.append(Words(_LEFT + self._long(longest) + 6.0, y, text))
        y = self.height - 8.0
        found += [Words(_LEFT + self._long(tick), y, f"{tick:g}", "middle") for tick in self.ticks]
        return tuple(found)

    @property
    def table(self) -> list[list[str]]:
        """Heads, and a row for each bar; what is unknown is empty."""
        rows = [
            [bar.name, *(_figure(value) for value in (bar.first, bar.total))] for bar in self.bars
        ]
        return [["input", "first order [1]", "total [1]"], *rows]

    @property
    def panels(self) -> list[dict[str, Any]]:
        """Where the bars lie, as `dqforge.reports.pages.figure_sheet` says it of figures."""
        count = len(self.bars)
        drawn = {
            "kind": "bars",
            "at": [0, 1, 2],
            "along": "y",
            "places": [place + 0.5 for place in range(count)],
            "colours": [BLUE, SKY],
        }
        return [
            {
                "box": [_LEFT, 0.0, _LEFT + self._long(1.0), _ROW * count],
                "x": {"name": "share", "unit": "", "from": 0.0, "to": 1.0},
                "y": {"name": "", "unit": "", "from": count, "to": 0},
                "row": 0,
                "drawn": [drawn],
            }
        ]

    @property
    def ticks(self) -> tuple[float, ...]:
        """Marks of the axis."""
        return (0.0, 0.25, 0.5, 0.75, 1.0)

    @property
    def lines(self) -> tuple[float, ...]:
        """Places of the marks."""
        return tuple(_LEFT + self._long(tick) for tick in self.ticks)

    def _long(self, value: float) -> float:
        known = value if math.isfinite(value) else 0.0
        return round(min(max(known, 0.0), 1.05) * (WIDTH - _LEFT - _RIGHT), 2)


@dataclass(frozen=True, slots=True)
class HistogramChart:
    """Counts of an output with the bounds of what is accepted, in the unit that is shown."""

    title: str
    unit: str
    edges: tuple[float, ...]
    counts: tuple[int, ...]
    bounds: tuple[float, ...]
    accepted: str
    width: float = WIDTH
    floor: float = _HEIGHT

    @property
    def height(self) -> float:
        """Height of the drawing."""
        return _HEIGHT + _FOOT

    @property
    def _ends(self) -> tuple[float, float]:
        """Values at the ends of the axis: those of the rows, and bounds that lie near them."""
        low, high = self.edges[0], self.edges[-1]
        span = (high - low) or abs(high) or 1.0
        near = [b for b in self.bounds if low - span <= b <= high + span]
        low, high = min([low, *near]), max([high, *near])
        pad = 0.02 * ((high - low) or abs(high) or 1.0)
        return low - pad, high + pad

    def _x(self, value: float) -> float:
        low, high = self._ends
        return round(10.0 + (value - low) / (high - low) * (WIDTH - 20.0), 2)

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """A bar for each bin."""
        largest = max(self.counts)
        found = []
        for place, rows in enumerate(self.counts):
            x, end = self._x(self.edges[place]), self._x(self.edges[place + 1])
            tall = round(rows / largest * (_HEIGHT - 12.0), 2)
            told = f"{self.edges[place]:.5g} to {self.edges[place + 1]:.5g} {self.unit}".rstrip()
            wide = max(round(end - x - 0.6, 2), 1.0)
            found.append(Rectangle(x, round(_HEIGHT - tall, 2), wide, tall, f"{told}: {rows} rows"))
        return tuple(found)

    @property
    def lines(self) -> tuple[tuple[float, str], ...]:
        """Places of the bounds within the drawing, with what they are."""
        low, high = self._ends
        return tuple(
            (self._x(bound), f"{bound:.5g} {self.unit}".rstrip())
            for bound in self.bounds
            if low <= bound <= high
        )

    @property
    def table(self) -> list[list[str]]:
        """Heads, a row for each bin, and the bounds beside the first of them."""
        unit = f" [{self.unit}]" if self.unit else " [1]"
        heads = [f"{self.title}: from{unit}", f"{self.title}: to{unit}", "rows [1]"]
        heads.append(f"{self.title}: bound{unit}")
        ends = zip(self.edges[:-1], self.edges[1:], self.counts, strict=True)
        cells = [[_figure(low), _figure(high), str(rows)] for low, high, rows in ends]
        found = zip_longest(cells, [_figure(bound) for bound in self.bounds], fillvalue="")
        return [heads, *([*(row or ["", "", ""]), bound] for row, bound in found)]

    @property
    def panels(self) -> list[dict[str, Any]]:
        """Where the bins lie, as `dqforge.reports.pages.figure_sheet` says it of figures."""
        low, high = self._ends
        most = max(self.counts)
        return [
            {
                "box": [10.0, 12.0, WIDTH - 10.0, _HEIGHT],
                "x": {"name": self.title, "unit": self.unit, "from": low, "to": high},
                "y": {"name": "rows", "unit": "", "from": 0, "to": most},
                "row": 0,
                "drawn": [
                    {"kind": "stairs", "at": [0, 1, 2], "colours": [BLUE]},
                    {"kind": "level", "at": [3], "colours": [RED]},
                ],
            }
        ]

    @property
    def words(self) -> tuple[Words, ...]:
        """Figures of the axis; one where all rows have the same value."""
        if f"{self.edges[0]:.4g}" == f"{self.edges[-1]:.4g}":
            text = f"{self.edges[0]:.4g} {self.unit}".rstrip()
            return (Words(self._x(self.edges[0]), _HEIGHT + 20.0, text, "middle"),)
        marks = [self.edges[0], 0.5 * (self.edges[0] + self.edges[-1]), self.edges[-1]]
        texts = [f"{mark:.4g} {self.unit}".rstrip() for mark in marks]
        anchors = ("start", "middle", "end")
        return tuple(
            Words(self._x(mark), _HEIGHT + 20.0, text, anchor)
            for mark, text, anchor in zip(marks, texts, anchors, strict=True)
        )


# Tables of a study for the terminal.

MOST_ROWS = 20  # Rows of the front that a terminal shows.


def study_tables(view: StudyView) -> list[Table]:
    """Every table that the study has something to say in.

    Args:
        view: The study.
    """
    found = [acceptance_table(view), front_table(view), sensitivity_table(view), audit_table(view)]
    return [table for table in found if table is not None]


def acceptance_table(view: StudyView) -> Table | None:
    """Shares that are accepted, None where nothing is asked.

    Args:
        view: The study.
    """
    tally, ranges = view.summary.acceptance, view.question.accept
    if not ranges:
        return None
    rows = []
    for place, each in enumerate(ranges):
        worst = tally.worst[place] if tally.worst else None
        spec = view.spec(each.column)
        rows.append(
            (
                each.label,
                range_text(view, each),
                *share_cells(tally.share(place)),
                "" if worst is None else value_text(spec, worst.value),
                "" if worst is None else f"{worst.index}",
            )
        )
    rows.append(("all of them", "", *share_cells(tally.share_of_all()), "", ""))
    heads = ("accepted", "bound", "share", "95 % interval", "worst", "row")
    return Table("Yield", heads, tuple(rows))


def range_text(view: StudyView, accepted: AcceptedRange) -> str:
    """Bounds of what is accepted.

    Args:
        view: The study.
        accepted: One range.
    """
    spec = view.spec(accepted.column)
    texts = [] if accepted.above is None else [f"above {value_text(spec, accepted.above)}"]
    texts += [] if accepted.below is None else [f"below {value_text(spec, accepted.below)}"]
    return " and ".join(texts)


def rows_text(count: int) -> str:
    """So many rows.

    Args:
        count: How many.
    """
    return "1 row" if count == 1 else f"{count} rows"


def share_cells(share: Share) -> tuple[str, str]:
    """A share and its interval in percent.

    Args:
        share: Rows that are accepted.
    """
    low, high = share.interval
    ends = f"{100.0 * low:.2f} to {100.0 * high:.2f} %"
    return (f"{100.0 * share.value:.2f} %" if share.count else "", ends)


def front_table(view: StudyView) -> Table | None:
    """The front by its first goal, None where there is none.

    Args:
        view: The study.
    """
    front, goals = view.summary.front, view.question.goals
    if front is None:
        return None
    signs = [1.0 if goal.minimise else -1.0 for goal in goals]
    specs = [view.spec(goal.column) for goal in goals]
    there = {int(row): place for place, row in enumerate(view.pictured.index.tolist())}
    order = sorted(range(front.count), key=lambda each: (*front.goals[each].tolist(), each))
    rows = []
    for each in order[:MOST_ROWS]:
        values = front.goals[each].tolist()
        goal_cells = [
            value_text(spec, sign * value)
            for spec, sign, value in zip(specs, signs, values, strict=True)
        ]
        place = there.get(int(front.index[each]))
        inputs = [
            "" if place is None else value_text(spec, view.pictured.columns[spec.name][place])
            for spec in view.varied
        ]
        rows.append((str(int(front.index[each])), *goal_cells, *inputs))
    heads = ("row", *(label(goal.column) for goal in goals), *(label(s.name) for s in view.varied))
    more = front.count - len(rows)
    notes = (f"{more} more rows lie on the front",) if more > 0 else ()
    return Table(f"Front of {rows_text(front.count)}", heads, tuple(rows), notes)


def sensitivity_table(view: StudyView) -> Table | None:
    """Sensitivities of every output asked for, None where none is.

    Args:
        view: The study.
    """
    found = view.summary.sensitivities
    if not found:
        return None
    total = any(each.total is not None for each in found)
    rows = []
    for each in found:
        for place, name in enumerate(each.inputs):
            cells = [_index(each.first[place]), _index(each.squared_correlation[place])]
            if total:
                cells.insert(1, "" if each.total is None else _index(each.total[place]))
            rows.append((label(each.output), label(name), *cells))
    heads = ("output", "input", "first order", *(("total",) * total), "squared correlation")
    return Table("Sensitivities", heads, tuple(rows))


def _index(value: float) -> str:
    return "" if np.isnan(value) else f"{round(value, 3) + 0.0:.3f}"


def audit_table(view: StudyView) -> Table | None:
    """How far rows computed together lie from those computed one by one, None where none is.

    Args:
        view: The study.
    """
    if not view.audited:
        return None
    differing = {name: value for name, value in view.audited.items() if value != 0.0}
    rows = tuple((name, format_quantity(value, "", 2)) for name, value in differing.items())
    same = len(view.audited) - len(differing)
    said = "1 output does not" if same == 1 else f"{same} outputs do not"
    notes = [f"{said} differ in a single bit"] if same else []
    if any(name.startswith("fit.error.") for name in differing):
        notes.append(
            "fits end near the least error of the currents, each at another one: errors of "
            "currents may differ by a quarter, those of the torque by more"
        )
    return Table(
        "Largest deviation of rows computed together from rows computed alone, every 1,000th row",
        ("output", "relative") if rows else (),
        rows,
        tuple(notes),
    )
