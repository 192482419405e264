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
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge import __version__
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import OUTPUT_COLUMN, STATES, ColumnSpec
from dqforge.optimizer.study_results.acceptance import NamedRow
from dqforge.reports.exploration.bars import Bar, BarChart, HistogramChart
from dqforge.reports.exploration.study_view import StudyView, shown_unit
from dqforge.reports.exploration.tables import (
    acceptance_table,
    audit_table,
    front_table,
    range_text,
    rows_text,
    sensitivity_table,
    share_cells,
)
from dqforge.reports.page_frame.file_list import ListedFile, files_table
from dqforge.reports.page_frame.page_scripts import FIGURES, FOLDING, page_scripts
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import count
from dqforge.reports.pages.page_figure import DataFile, data_file, panels_text
from dqforge.reports.pages.table import Table
from dqforge.reports.pages.templating import render
from dqforge.reports.study_store.column_texts import label, value_text

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
        panels: As of `dqforge.reports.pages.page_figure.PageFigure`.
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
    text += " them without anything to object to."
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
