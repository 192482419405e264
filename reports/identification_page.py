"""The page of an identification: parameters first, then what the models leave of each run, the flux
map with its errors and holes, and which estimates move together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge import __version__
from dqforge.optimizer.identification.flux_points import FluxTable
from dqforge.optimizer.identification.identify import Identification
from dqforge.optimizer.identification.parameters import (
    Analysis,
    OverTemperature,
    RunResiduals,
)
from dqforge.reports.identification import NOT_HELD, identification_tables
from dqforge.reports.pages.answer import NUMBER_AND_UNIT, Table
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    MUTED,
    ORANGE,
    RED,
    new_figure,
    prefixed,
    style,
)
from dqforge.reports.pages.html_text import NARROW, HtmlTable, Row, symbols
from dqforge.reports.pages.templating import PageFigure, page_figure, render
from dqforge.reports.run_folder import FIGURES, FOLDING, page_scripts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "report.html"
# Runs whose residuals are drawn, and rows of each; the extreme ones of a longer run.
_MOST_RUNS, _MOST_ROWS = 6, 600
_SAME = 1e-6  # Currents that differ by less, as a share of the largest, are one.

Drawing = tuple[str, str, str, "PageFigure"]


def identification_page(found: Identification) -> bytes:
    """The page as HTML in UTF-8."""
    parameters, *others = identification_tables(found)
    named = {table.title: table for table in others}
    drawings = list(_drawings(found))
    sections = [("summary", "Parameters")]
    sections += [("remarks", "Remarks")] if found.remarks else []
    sections += [(key, title) for key, title, _, _ in drawings]
    context: dict[str, Any] = {
        "version": __version__,
        "name": found.bench.name,
        "about": found.bench.about,
        "scripts": page_scripts(FIGURES, FOLDING),
        "sections": [*sections, ("runs", "Runs")],
        "contradictions": [symbols(text) for text in found.contradictions],
        "remarks": [symbols(text) for text in found.remarks],
        "parameters": _html(parameters, 6),
        "not_held": _html(named[NOT_HELD], 3) if NOT_HELD in named else None,
        "moved": _moved(found),
        "runs": _html(named["Runs"], 3),
        "logs": _logs(found),
        "drawings": drawings,
    }
    return render("pages/identification.html.j2", context).encode()


def _html(table: Table, text_columns: int) -> HtmlTable:
    rows = tuple(
        Row(tuple(symbols(NUMBER_AND_UNIT.sub(NARROW, cell)) for cell in row)) for row in table.rows
    )
    heads = tuple(symbols(head) for head in table.columns)
    notes = tuple(symbols(note) for note in table.notes)
    return HtmlTable(table.title, heads, rows, text_columns, notes)


def _moved(found: Identification) -> HtmlTable | None:
    """The run without which each parameter moves most; None where no three runs hold one."""
    rows = [
        (one.label, one.moved[0], f"{one.moved[1]:+.1f}")
        for one in found.parameters
        if one.moved is not None
    ]
    heads = ("parameter", "run", "standard deviations")
    return _html(Table("Largest move without one run", heads, tuple(rows)), 2) if rows else None


def _logs(found: Identification) -> HtmlTable:
    rows = [Row((found.bench.source, "bench file", found.bench.digest))]
    rows += [
        Row((part.file, f"{run.name} ({run.kind})", part.sha256))
        for run in found.bench.runs
        for part in run.parts
    ]
    return HtmlTable("Files", ("File", "Run", "SHA-256"), tuple(rows), 3, folded=True)


def _drawings(found: Identification) -> list[Drawing]:
    drawn: list[tuple[str, str, str, Figure]] = []
    left = [one for analysis in found.analyses for one in analysis.residuals if one.values.size > 1]
    if left:
        text = "What the models leave of each row; lines: r.m.s. values."
        if len(left) > _MOST_RUNS:
            text += f" The first {_MOST_RUNS} of {len(left)}."
        drawn.append(("residuals", "Residuals", text, plot_residuals(left[:_MOST_RUNS])))
    for n, analysis in enumerate(found.analyses):
        if analysis.over_temperature is not None:
            text = "95 % interval, and what copper makes of the value in the middle."
            figure = plot_over_temperature(analysis.over_temperature)
            drawn.append((f"temperature-{n}", "Over the temperature", text, figure))
    if found.flux is not None:
        text = (
            "Standard deviation of each point, of both flux linkages together; crosses: currents "
            "of the grid without a point."
        )
        drawn.append(("map", "Flux map", text, plot_map_errors(found.flux.table)))
    for n, analysis in enumerate(one for one in found.analyses if _correlated(one).size):
        text = f"Correlation of the estimates of {analysis.name}: 1 and -1 move together."
        title = "Correlations" if n == 0 else f"Correlations, {analysis.name}"
        drawn.append((f"correlation-{n}", title, text, plot_correlation(analysis)))
    return [
        (key, title, text, page_figure(figure, f"identification-{key}"))
        for key, title, text, figure in drawn
    ]


def plot_residuals(left: list[RunResiduals]) -> Figure:
    """What the models leave of runs, a panel each."""
    with style():
        figure = new_figure(
            "residuals", 0.7 + 1.1 * len(left), "What the models leave of each run", arranged=True
        )
        panels = np.ravel(figure.subplots(len(left), 1, squeeze=False))
        for axes, one in zip(panels, left, strict=True):
            factor, unit = prefixed(float(np.max(np.abs(one.values))), one.unit)
            rows = _shown_rows(one.values)
            axes.plot(rows + 1, factor * one.values[rows], ".", color=BLUE, markersize=2.5)
            for side in (-1.0, 1.0):
                axes.axhline(side * factor * one.rms, color=MUTED, linewidth=0.7)
            # Two dollar signs would enclose a formula.
            axes.set_title(f"{one.run.replace('$', '')}: {one.quantity}")
            axes.set_ylabel(unit)
        panels[-1].set_xlabel("row")
    return figure


def _shown_rows(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Rows that are drawn: all, or evenly spaced ones with the largest."""
    if values.size <= _MOST_ROWS:
        return np.arange(values.size)
    even = np.linspace(0, values.size - 1, _MOST_ROWS).astype(int)
    return np.unique(np.append(even, np.argsort(-np.abs(values), kind="stable")[:20]))


def plot_over_temperature(line: OverTemperature) -> Figure:
    """A parameter over the temperature of the runs."""
    with style():
        figure = new_figure(
            "over-temperature", 2.6, f"{line.label} over the temperature", arranged=True
        )
        axes = figure.subplots()
        factor, unit = prefixed(float(line.value.max()), line.unit)
        band = factor * line.low, factor * line.high
        axes.fill_between(line.temperature, *band, color=FAINT, label="95 % interval")
        axes.plot(line.temperature, factor * line.value, color=BLUE, label="logs")
        look: dict[str, Any] = {"color": ORANGE, "linestyle": "--", "label": "copper"}
        axes.plot(line.temperature, factor * line.copper, **look)
        axes.set_xlabel("temperature in \u00b0C")
        axes.set_ylabel(f"{line.label} in {unit}")
        axes.legend(loc="upper left")
    return figure


def plot_map_errors(table: FluxTable) -> Figure:
    """Where a map has points, with the standard deviation of each, and where it has none."""
    sigma = np.hypot(table.sigma_d, table.sigma_q)
    factor, unit = prefixed(float(sigma.max()), "V s")
    with style():
        figure = new_figure(
            "map-errors", 3.4, "Points of the flux map and their errors", arranged=True
        )
        axes = figure.subplots()
        shown = axes.scatter(table.i_d, table.i_q, c=factor * sigma, s=18.0, cmap="viridis_r")
        figure.colorbar(shown, ax=axes, label=f"standard deviation in {unit}")
        holes = missing_points(table)
        if holes.size:
            axes.plot(*holes.T, "x", color=RED, markersize=5.0, label="no point")
            axes.legend()
        axes.set_xlabel("$i_d$ in A")
        axes.set_ylabel("$i_q$ in A")
    return figure


def missing_points(table: FluxTable) -> np.ndarray[Any, Any]:
    """Currents of the grid of a map at which it has no point, shape (H, 2); none where its points
    are no grid.
    """
    scale = _SAME * float(max(np.max(np.abs(table.i_d)), np.max(np.abs(table.i_q)), 1e-12))
    places = [np.round(axis / scale).astype(np.int64) for axis in (table.i_d, table.i_q)]
    axes = [np.unique(place) for place in places]
    if axes[0].size * axes[1].size > 4 * table.i_d.size:
        return np.empty((0, 2))
    there = set(zip(*(place.tolist() for place in places), strict=True))
    gone = [(d, q) for d in axes[0].tolist() for q in axes[1].tolist() if (d, q) not in there]
    return scale * np.array(gone, dtype=float).reshape(-1, 2)


def _correlated(analysis: Analysis) -> np.ndarray[Any, Any]:
    """Places of the parameters whose estimates have a covariance; empty for a single one."""
    covariance = np.atleast_2d(analysis.covariance)
    variance = np.diag(covariance)
    kept = np.flatnonzero(np.isfinite(variance) & (variance > 0.0))
    return kept if kept.size > 1 else kept[:0]


def plot_correlation(analysis: Analysis) -> Figure:
    """Correlation matrix of the estimates of an analysis."""
    kept = _correlated(analysis)
    covariance = analysis.covariance[np.ix_(kept, kept)]
    sigma = np.sqrt(np.diag(covariance))
    matrix = covariance / np.outer(sigma, sigma)
    names = [analysis.parameters[place].key.replace("_", " ") for place in kept]
    with style():
        figure = new_figure(
            f"correlation-{analysis.name}",
            1.2 + 0.42 * kept.size,
            f"Correlation of the estimates of {analysis.name}",
            arranged=True,
        )
        axes = figure.subplots()
        for (row, column), value in np.ndenumerate(matrix):
            colour = BLUE if value >= 0.0 else ORANGE
            axes.scatter([column], [row], s=330.0 * abs(value), color=colour, alpha=0.35)
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=7)
        ticks = range(kept.size)
        axes.set_xticks(ticks, names, rotation=30, ha="right")
        axes.set_yticks(ticks, names)
        axes.set_xlim(-0.6, kept.size - 0.4)
        axes.set_ylim(kept.size - 0.4, -0.6)
        axes.grid(visible=False)
    return figure
