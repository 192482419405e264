"""A study shown: the same numbers in tables, plain data and page, text that cannot break out of the
page, pictures whose script is the only one admitted.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import open_page
from figure_pages import page_tables, table_of
from matplotlib.patches import StepPatch
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.acceptance import (
    AcceptedRange,
    GoalColumn,
    StudyQuestion,
    summarise,
)
from dqforge.optimizer.exploration.row_block import STATES, ColumnSpec
from dqforge.reports.exploration.html import (
    HistogramChart,
    acceptance_table,
    audit_table,
    front_table,
    histogram_charts,
    page_data,
    pictured_table,
    render_study,
    sensitivity_charts,
    sensitivity_table,
    study_tables,
)
from dqforge.reports.exploration.study_view import (
    PicturedRows,
    StudyView,
    plain_summary,
    plot_study,
    shown_unit,
)
from dqforge.reports.run_folder import ListedFile

NASTY = "</script><script>alert(1)</script>\u2028&<b>"
COLUMNS = (
    ColumnSpec("in.machine.resistance", "Ohm"),
    ColumnSpec("in.inverter.device", "", "choice", (NASTY, "other")),
    ColumnSpec("out.losses.total", "W"),
    ColumnSpec("out.gains.phase_margin", "rad"),
)


class Part:
    """One part of a study, as it is read back."""

    def __init__(self, count: int = 400) -> None:
        draw = np.random.default_rng(5)
        resistance = draw.uniform(0.01, 0.02, count)
        self.first, self.count = 0, count
        self.states = np.zeros(count, dtype=np.int8)
        self.states[7] = STATES.index("no-solution")
        self.messages = tuple(NASTY if row == 7 else "" for row in range(count))
        losses = 4e4 * resistance + draw.normal(0.0, 20.0, count)
        losses[7] = np.nan
        self.columns: dict[str, NDArray[np.float64] | NDArray[np.int32]] = {
            "in.machine.resistance": resistance,
            "in.inverter.device": (np.arange(count) % 2).astype(np.float64),
            "out.losses.total": losses,
            "out.gains.phase_margin": np.radians(60.0 + 300.0 * resistance),
        }


def numbers(part: Part) -> dict[str, NDArray[np.float64]]:
    return {name: np.asarray(found, dtype=np.float64) for name, found in part.columns.items()}


@pytest.fixture(name="view", scope="module")
def _view() -> StudyView:
    part = Part()
    question = StudyQuestion(
        accept=(
            AcceptedRange("out.losses.total", "losses.total", below=600.0),
            AcceptedRange("out.gains.phase_margin", "gains.phase_margin", above=math.radians(64)),
        ),
        goals=(GoalColumn("out.losses.total"), GoalColumn("out.gains.phase_margin", False)),
        inputs=("in.machine.resistance", "in.inverter.device"),
        drawn=("in.machine.resistance",),
        sensitivity=("out.losses.total",),
        spread=("out.losses.total", "out.gains.phase_margin"),
    )
    summary = summarise(question, [part])
    pictured = PicturedRows(np.arange(part.count), part.states, numbers(part), 1)
    return StudyView(
        f"Study {NASTY}",
        f"About {NASTY}",
        COLUMNS,
        400,
        400,
        summary,
        pictured,
        {"losses.total": 3e-16, "gains.phase_margin": 0.0},
        {"dqforge": "0.1.0"},
    )


def test_shares_are_the_same_in_table_json_and_page(view: StudyView) -> None:
    part = Part()
    losses = part.columns["out.losses.total"]
    fine = part.states == 0
    met = int(np.sum(fine & (losses <= 600.0)))
    plain = plain_summary(view)["acceptance"]["ranges"][0]
    assert plain["met"] == met
    assert plain["share"] == met / 400
    table = acceptance_table(view)
    assert table is not None
    assert table.rows[0][2] == f"{100.0 * met / 400:.2f} %"
    assert f"{100.0 * met / 400:.2f} %" in render_study(view)
    low, high = plain["interval"]
    assert table.rows[0][3] == f"{100.0 * low:.2f} to {100.0 * high:.2f} %"


def test_worst_row_is_named_with_its_words(view: StudyView) -> None:
    worst = plain_summary(view)["acceptance"]["ranges"][0]["worst"]
    losses = Part().columns["out.losses.total"]
    assert worst["row"] == int(np.nanargmax(losses))
    assert worst["inputs"]["inverter.device"] in (NASTY, "other")


def test_front_is_that_of_brute_force(view: StudyView) -> None:
    part = Part()
    losses, margin = part.columns["out.losses.total"], part.columns["out.gains.phase_margin"]
    rows = [row for row in range(400) if part.states[row] == 0]
    front = [
        a
        for a in rows
        if not any(
            losses[b] <= losses[a]
            and margin[b] >= margin[a]
            and (losses[b] < losses[a] or margin[b] > margin[a])
            for b in rows
        )
    ]
    plain = plain_summary(view)["front"]
    assert plain["rows"] == front
    assert plain["values"][0][1] > 0.0  # what is made large has its own sign again
    table = front_table(view)
    assert table is not None
    assert {int(row[0]) for row in table.rows} <= set(front)


def test_text_cannot_leave_its_place_in_the_page(view: StudyView) -> None:
    page = render_study(view)
    assert "<script>alert" not in page
    assert page.count("</script>") == 3
    found = re.search(r'<template id="data">(.*?)</template>', page, re.S)
    assert found is not None
    assert json.loads(found[1])["name"] == f"Study {NASTY}"


def test_only_the_own_script_is_admitted(view: StudyView) -> None:
    page = render_study(view)
    scripts = re.findall(r"<script>(.*?)</script>", page, re.S)
    digests = [
        base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts
    ]
    admitted = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert f'script-src {admitted}"' in page.replace("&#39;", "'")
    assert not any("http" in script for script in scripts)


def test_page_is_the_same_twice_and_asks_for_nothing(view: StudyView) -> None:
    assert render_study(view) == render_study(view)
    assert not re.search(r'(?:src|href)="(?!#|data:text/csv)', render_study(view))


def test_files_beside_the_page_are_linked(view: StudyView) -> None:
    files = [ListedFile("parts/", "the rows", 3), ListedFile.of("a b:<i>.yaml", NASTY, b"abc")]
    page = render_study(view, files)
    assert 'href="parts/"' in page
    assert 'href="a%20b%3A%3Ci%3E.yaml"' in page
    assert hashlib.sha256(b"abc").hexdigest()[:12] in page
    assert '<a href="#files">' in page
    assert "<b>" not in page


def test_pictured_numbers_carry_the_unit_of_their_axis(view: StudyView) -> None:
    data = page_data(view)
    by_label = {column["label"]: column for column in data["columns"]}
    assert by_label["machine.resistance"]["unit"] == "mOhm"
    assert by_label["gains.phase_margin"]["unit"] == "deg"
    first = Part().columns["in.machine.resistance"][0]
    table = page_tables(render_study(view))["rows.csv"]
    assert float(table["machine.resistance [mOhm]"][0]) == pytest.approx(1e3 * first, rel=1e-6)
    assert table["losses.total [W]"][7] == ""
    assert table["inverter.device"][:2] == [NASTY, "other"]
    assert data["panels"]


def test_rows_that_are_not_accepted_stand_apart(view: StudyView) -> None:
    table, part = table_of(pictured_table(view)), Part()
    losses, margin = part.columns["out.losses.total"], part.columns["out.gains.phase_margin"]
    for row, ending in enumerate(table["state"]):
        accepted = losses[row] <= 600.0 and margin[row] >= math.radians(64.0)
        expected = STATES[part.states[row]] if part.states[row] else "ok"
        if expected == "ok" and not accepted:
            expected = "not accepted"
        assert ending == expected
    front = view.summary.front
    assert front is not None
    told = [int(row) for row, own in zip(table["row"], table["front"], strict=True) if own == "1"]
    assert told == sorted(front.index.tolist())


def test_charts_have_their_data_and_places(view: StudyView) -> None:
    tables = page_tables(render_study(view))
    losses, _ = histogram_charts(view)
    spread = tables["spread-losses-total.csv"]
    assert sum(int(rows) for rows in spread["rows [1]"]) == 399
    assert spread["losses.total: bound [W]"] == ["600"]
    assert [float(cell) for cell in spread["losses.total: from [W]"]] == pytest.approx(
        losses.edges[:-1], rel=1e-5
    )
    (chart,) = sensitivity_charts(view)
    shares = tables["sensitivity-losses-total.csv"]
    assert shares["input"] == [bar.name for bar in chart.bars]
    assert float(shares["first order [1]"][0]) == pytest.approx(chart.bars[0].first, rel=1e-5)
    (panel,) = losses.panels
    low, high = panel["x"]["from"], panel["x"]["to"]
    left, _, right, _ = panel["box"]
    bound = left + (600.0 - low) / (high - low) * (right - left)
    assert bound == pytest.approx(losses.lines[0][0], abs=0.01)


@pytest.mark.parametrize(
    ("unit", "value", "shown", "factor"),
    [("Hz", 8e4, "kHz", 1e-3), ("rad", 1.0, "deg", 180.0 / math.pi), ("", 3.0, "", 1.0),
     ("A", 0.002, "mA", 1e3), ("degC", 90.0, "degC", 1.0)],
)  # fmt: skip
def test_units_of_axes(unit: str, value: float, shown: str, factor: float) -> None:
    found = shown_unit(ColumnSpec("out.x", unit), np.array([value, 0.1 * value, np.nan]))
    assert found[0] == shown
    assert found[1] == pytest.approx(factor, rel=1e-12)


def test_histogram_holds_every_row_and_the_bounds(view: StudyView) -> None:
    losses, margin = histogram_charts(view)
    assert sum(losses.counts) == 399
    assert losses.bounds == (600.0,)
    assert losses.lines[0][1] == "600 W"
    assert margin.unit == "deg"
    assert margin.bounds[0] == pytest.approx(64.0)
    assert all(r.height >= 0.0 and 0.0 <= r.x <= losses.width for r in losses.rectangles)


def test_a_bound_far_from_all_rows_is_not_said_to_be_drawn(view: StudyView) -> None:
    part = Part()
    accept = (AcceptedRange("out.losses.total", "losses.total", below=1e6),)
    summary = summarise(StudyQuestion(accept=accept, spread=("out.losses.total",)), [part])
    far = replace(view, summary=summary)
    assert "losses.total below 600 W (red line)." in render_study(view)
    assert re.search(r"losses.total below 1 MW\.\s*<a ", render_study(far))


def test_one_value_has_one_figure() -> None:
    chart = HistogramChart("constant", "N m", (1.7282, 1.7282), (9,), (), "")
    assert [words.text for words in chart.words] == ["1.728 N m"]


def test_messages_that_differ_in_numbers_are_of_one_kind() -> None:
    part = Part(40)
    part.states[:30] = STATES.index("no-solution")
    part.messages = tuple(f"d.yaml:104:3: {190 + row / 10} N m cannot be had" for row in range(40))
    part.messages = ("x.csv: no i_d", *part.messages[1:9], "x.csv: no i_q", *part.messages[10:])
    summary = summarise(StudyQuestion(), [part])
    pictured = PicturedRows(np.arange(40), part.states, numbers(part), 1)
    page = render_study(StudyView("Plain", "", COLUMNS, 40, 40, summary, pictured, {}, {}))
    said = re.findall(r'<th scope="row">(\d+)</th><td>no-solution</td><td>([^<]*)</td>', page)
    assert [row for row, _ in said] == ["0", "1", "9"]
    assert said[1][1] == "d.yaml:104:3: 190.1 N m cannot be had"


def test_tables_say_what_there_is(view: StudyView) -> None:
    titles = [table.title for table in study_tables(view)]
    assert len(titles) == 4
    sensitivity, audit = sensitivity_table(view), audit_table(view)
    assert sensitivity is not None
    assert float(sensitivity.rows[0][2]) > 0.8
    assert audit is not None
    assert audit.rows == (("losses.total", "3e-16"),)
    assert audit.notes[0].startswith("1 output does not")


def test_page_without_anything_asked_stands(tmp_path: Path) -> None:
    part = Part(9)
    summary = summarise(StudyQuestion(), [part])
    pictured = PicturedRows(np.arange(9), part.states, numbers(part), 1)
    view = StudyView("Plain", "", COLUMNS, 9, 9, summary, pictured, {}, {})
    assert study_tables(view) == []
    assert "Front" not in render_study(view)
    assert plain_summary(view)["acceptance"] is None


def test_the_figure_of_a_study_shows_its_front_in_the_units_of_its_table(view: StudyView) -> None:
    (axes,) = plot_study(view).axes
    front = next(line for line in axes.lines if line.get_label() == "front")
    losses, margin = np.asarray(front.get_xdata()), np.asarray(front.get_ydata())
    found = view.summary.front
    assert found is not None
    order = np.argsort(found.goals[:, 0])
    np.testing.assert_allclose(losses, found.goals[order, 0])
    # The second goal is maximised, so that the front holds it with its sign turned.
    np.testing.assert_allclose(margin, np.degrees(-found.goals[order, 1]))
    assert axes.get_xlabel() == "losses.total in W"
    assert axes.get_ylabel() == "gains.phase_margin in deg"


def test_the_figure_of_a_yield_marks_what_is_accepted(view: StudyView) -> None:
    asked = replace(view.question, goals=())
    shown = replace(view, summary=replace(view.summary, question=asked, front=None))
    left, right = plot_study(shown).axes
    (bound,) = left.lines
    assert np.asarray(bound.get_xdata())[0] == pytest.approx(600.0)
    assert np.asarray(right.lines[0].get_xdata())[0] == pytest.approx(64.0)
    (steps,) = left.findobj(StepPatch)
    assert isinstance(steps, StepPatch)
    shares = np.asarray(steps.get_data()[0])
    assert np.sum(shares) == pytest.approx(100.0)


def test_a_study_without_goals_and_bounds_has_no_figure(view: StudyView) -> None:
    asked = replace(view.question, goals=(), accept=())
    shown = replace(view, summary=replace(view.summary, question=asked, front=None))
    with pytest.raises(InputError, match="two goals, or accept"):
        plot_study(shown)


@pytest.mark.slow
def test_a_browser_tells_bins_and_rows_as_the_data_have_them(
    view: StudyView, tmp_path: Path
) -> None:
    page = tmp_path / "study.html"
    page.write_text(render_study(view), encoding="utf-8")
    table = page_tables(page.read_text(encoding="utf-8"))["rows.csv"]
    with open_page(page, tmp_path) as tab:
        chart = "document.querySelector('#yield figure[data-panels]')"
        tab.show(chart)
        tab.value(f"{chart}.querySelector('.card').focus()")
        tab.press("ArrowRight")
        told = tab.value("document.querySelector('.told').textContent")
        assert re.match(r"losses.total [\d.]+ W to [\d.]+ Wrows +\d+", told), told
        front = "document.querySelector('canvas[data-picture=front]').parentElement"
        tab.show(front)
        tab.value(f"{front}.focus()")
        tab.press("Home")
        told = tab.value("document.getElementById('aloud').textContent")
        row = table["row"].index(told.split(":")[0].removeprefix("row "))
        losses = [float(cell) for cell in table["losses.total [W]"] if cell]
        assert float(table["losses.total [W]"][row]) == min(losses)
        assert table["state"][row] in told
        assert tab.complaints == []
