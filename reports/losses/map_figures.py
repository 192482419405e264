"""Figures of loss maps and missions: who loses least where, what each alternative loses,
how warm junctions become.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.optimizer.losses.drive_comparison import Alternatives, MissionComparison, MissionRun
from dqforge.optimizer.losses.phase_comparison import LossComparison
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Draw, Passage, ReportPart, Rows, Tile
from dqforge.reports.losses.map_tables import (
    alternative_text,
    leg_notes,
    losses_tables,
    mission_mark,
    mission_tables,
    plain_losses,
    plain_mission,
    winner_reason,
)
from dqforge.reports.pages.figures_style import (
    FAINT,
    INK,
    MAP_INK,
    MUTED,
    PALE,
    PAPER,
    PART_COLOURS,
    label_in_unit,
    new_figure,
    style,
)
from dqforge.reports.pages.html_text import (
    NARROW,
    NOT_COMPARED,
    STRATEGY_LABELS,
    STRATEGY_TEXT,
    WITHOUT_BRIDGE,
    HtmlTable,
    Row,
    friction_text,
    heading_cells,
    known_texts,
    modulation_label,
    number,
    obstacle,
    part_label,
    point_text,
    share,
    shown_parts,
    symbols,
    watts,
)
from dqforge.reports.pages.templating import LOSSES as CHAPTER
from dqforge.reports.pages.templating import OTHERS, WINNERS, cell_edges, draw_cells, inside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.losses.loss_map import LossMap


BARS_SHOWN = 14  # Alternatives in a figure; a table has room for more.
_ROW = 0.22
_VISIBLE = 1e-4  # Share of the total from which a kind of loss is drawn.


def _draw_bars(
    axes: Axes,
    labels: list[str],
    energies: FloatArray,
    best: int,
    unit: str,
    notes: list[str] | None = None,
) -> None:
    """Stacked bars, the first on top; energies or powers (parts, A) in the unit named."""
    ends = np.sum(energies, axis=0)
    shown = [k for k in range(len(PARTS)) if np.any(energies[k] > _VISIBLE * ends)]
    for row in range(energies.shape[1]):
        left = 0.0
        for part in shown:
            width = float(energies[part, row])
            colour = PART_COLOURS[PARTS[part]]
            label = part_label(PARTS[part])
            axes.barh(
                -row,
                width,
                left=left,
                height=0.74,
                color=colour,
                edgecolor=PAPER,
                linewidth=0.5,
                label=label if row == 0 else f"_{label}",
            )
            left += width
        text = f"{ends[row]:.4g} {unit}" + (f", {notes[row]}" if notes and notes[row] else "")
        axes.annotate(
            f"{text}  \u25c0 least" if row == best else text,
            (left, -row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7.0,
            fontweight="bold" if row == best else "normal",
        )
    axes.set(
        xlim=(0.0, 1.45 * max(float(np.max(ends, initial=0.0)), 1e-9)),
        ylim=(-energies.shape[1] + 0.4, 0.6),
    )
    axes.set_yticks([-row for row in range(len(labels))], labels)
    axes.grid(visible=False, axis="y")
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=len(shown),
        frameon=False,
        fontsize=7.0,
        handlelength=1.0,
        borderaxespad=0.2,
        columnspacing=1.0,
        handletextpad=0.4,
    )


def _ranked(totals: FloatArray) -> list[int]:
    """Alternatives to show: those with the least totals, in that order."""
    order = [int(k) for k in np.argsort(totals, kind="stable") if np.isfinite(totals[k])]
    return order[:BARS_SHOWN]


def _draw_winners(axes: Axes, found: LossMap, alternatives: Alternatives) -> None:
    """Cells in the colour of the alternative that loses least, each large region with its name."""
    from matplotlib.patches import Patch

    best = found.comparison.best.reshape(found.torque.size, found.omega_m.size)
    names, counts = np.unique(best[best >= 0], return_counts=True)
    ranked = [int(k) for k in names[np.argsort(-counts, kind="stable")]]
    named, others = ranked[: len(WINNERS)], ranked[len(WINNERS) :]
    code = np.full(best.shape, -1)
    for place, k in enumerate(ranked):
        code[best == k] = min(place, len(WINNERS))
    speed, torque = in_rpm(cell_edges(found.omega_m)), cell_edges(found.torque)
    draw_cells(axes, code, speed, torque)
    for k in named:
        mask = best == k
        if np.mean(mask) > 0.03:
            i, j = inside(mask)
            text = alternative_text(alternatives, k, plain=False).replace(", ", "\n")
            axes.text(
                in_rpm(found.omega_m[j]),
                found.torque[i],
                text,
                ha="center",
                va="center",
                fontsize=7.5,
                color=MAP_INK,
            )
    handles = [
        Patch(color=WINNERS[place], label=alternative_text(alternatives, k))
        for place, k in enumerate(named)
    ]
    handles += [Patch(color=OTHERS, label="others")] if others else []
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        frameon=False,
        fontsize=7.0,
        handlelength=1.0,
        borderaxespad=0.0,
    )
    axes.set(xlim=(0.0, speed[-1]), ylim=(0.0, torque[-1]), xlabel="Speed in rpm")
    axes.grid(visible=False)


def plot_loss_map(found: LossMap) -> Figure:
    """Who loses least at each torque and speed, and the mean losses of each alternative below."""
    alternatives = found.comparison.alternatives
    means = found.mean_losses
    ranked = _ranked(np.sum(means, axis=0))
    below = max(len(ranked), 1) * _ROW + 0.75
    height = 3.6 + below
    with style():
        figure = new_figure(
            "loss-map", height, "Alternative with the least loss over torque and speed; mean losses"
        )
        upper = figure.add_axes((0.085, (below + 0.5) / height, 0.68, 2.75 / height))
        _draw_winners(upper, found, alternatives)
        compared = found.comparison.compared
        upper.set_title("Least total loss" if compared else NOT_COMPARED)
        label_in_unit(upper.yaxis, "Torque in {}", float(found.torque[-1]), "N m")
        lower = figure.add_axes((0.24, 0.4 / height, 0.74, (below - 0.75) / height))
        if ranked:
            labels = [alternative_text(alternatives, k) for k in ranked]
            _draw_bars(lower, labels, means[:, ranked], 0, "W")
        lower.set_xlabel(
            f"Mean loss in W over the {100.0 * float(np.mean(found.shared)):.0f} % of the map that "
            "all drive"
        )
    return figure


def plot_mission(found: MissionComparison) -> Figure:
    """Energy lost by every alternative, and the hottest junction over time of the
    best one beside the first.
    """
    runs = found.runs
    energies = np.array([[run.energy[part] for run in runs] for part in PARTS]) / 3600.0
    ranked = _ranked(np.array([run.total if run.steady else np.nan for run in runs]))
    above = max(len(ranked), 1) * _ROW + 0.75
    height = above + 2.6
    with style():
        figure = new_figure(
            "mission", height, "Energy lost over the mission, and junction temperature over time"
        )
        upper = figure.add_axes((0.24, 1.0 - (above - 0.3) / height, 0.74, (above - 0.65) / height))
        if ranked:
            labels = [alternative_text(found.alternatives, k) for k in ranked]
            best = ranked.index(found.best) if found.best in ranked else -1
            notes = ["" if runs[k].usable else "not usable" for k in ranked]
            _draw_bars(upper, labels, energies[:, ranked], best, "Wh", notes)
        upper.set_xlabel("Energy lost in Wh")
        lower = figure.add_axes((0.085, 0.42 / height, 0.895, 1.75 / height))
        _draw_courses(lower, found)
    return figure


def _draw_courses(axes: Axes, found: MissionComparison) -> None:
    shown = [(0, PALE)] if found.best != 0 else []
    shown += [(found.best, INK)] if found.best >= 0 else []
    last = 1.0
    for k, colour in shown:
        run = found.runs[k]
        if not (run.steady and math.isfinite(run.junction_max)):
            continue
        time = run.time - run.time[0]
        last = float(time[-1])
        label = f"{alternative_text(found.alternatives, k)}: at most {run.junction_max:.1f} \u00b0C"
        axes.plot(time, run.junction, color=colour, linewidth=1.0, label=label)
    axes.set(xlim=(0.0, last), xlabel="Time in s", ylabel="Junction in \u00b0C")
    if axes.lines:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
            fontsize=7.0,
            ncols=2,
            labelcolor=MUTED,
        )
    axes.set_title("Hottest junction")


# Figure of the loss comparison: one stacked bar for every strategy with every modulator,
# at each operating point.

POINTS_SHOWN = 8  # Operating points in the figure; a table has room for more.
_FIGURES_ROW = 0.23
_EDGE = 0.8
_LONG_NAMES = 5  # Kinds of loss up to which their names have room for the word loss.


def _draw_parts(
    axes: Axes, comparison: LossComparison, index: tuple[int, int, int], y: float, name: str
) -> float:
    """One bar of parts side by side.

    The end of it in W. What cannot be used is an empty bar with its text inside. ``name`` is that
    of the bar in the data.
    """
    budget = comparison.budget
    if not comparison.usable[index]:
        total = float(np.nan_to_num(budget.total[index]))
        axes.barh(
            y,
            total,
            height=0.72,
            facecolor=PAPER,
            edgecolor=FAINT,
            linewidth=0.8,
            label="_not usable",
            gid=name,
        )
        return 0.0
    left = 0.0
    for part in shown_parts(budget):
        width = float(getattr(budget, part)[index])
        axes.barh(
            y,
            width,
            left=left,
            height=0.72,
            facecolor=PART_COLOURS[part],
            edgecolor=PAPER,
            linewidth=0.6,
            label=f"_{part_label(part)}",
            gid=name,
        )
        left += width
    return left


def _bar_text(comparison: LossComparison, index: tuple[int, int, int], *, best: bool) -> str:
    budget = comparison.budget
    obstacle_text = obstacle(comparison, index)
    if obstacle_text:
        return obstacle_text
    junction = float(budget.junction_temperature[index])
    text = watts(float(budget.total[index])) + (
        f", {junction:.0f} \u00b0C" if math.isfinite(junction) else ""
    )
    return f"{text}  \u25c0 least" if best else text


def _draw_point(
    axes: Axes, comparison: LossComparison, point: int, top: float
) -> list[tuple[float, str]]:
    """All bars of an operating point below its heading.

    Their heights with the labels of the vertical axis.
    """
    axes.annotate(
        point_text(comparison.points[point]),
        (0.0, top),
        xytext=(0, 0),
        textcoords="offset points",
        fontweight="bold",
        va="center",
        fontsize=8,
    )
    best = (int(comparison.best_strategy[point]), int(comparison.best_modulation[point]))
    ticks: list[tuple[float, str]] = []
    for s, strategy in enumerate(comparison.strategies):
        for m, modulation in enumerate(comparison.modulations):
            y = top - 1.0 - len(ticks)
            label = f"{STRATEGY_LABELS[strategy]}, {modulation_label(modulation)}"
            name = f"{point_text(comparison.points[point])}: {label}"
            end = _draw_parts(axes, comparison, (s, m, point), y, name)
            axes.annotate(
                _bar_text(comparison, (s, m, point), best=best == (s, m)),
                (end, y),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                fontweight="bold" if best == (s, m) else "normal",
                color=INK if comparison.usable[s, m, point] else MUTED,
            )
            ticks.append((y, label))
    return ticks


def plot_losses(design: Design, comparison: LossComparison) -> Figure:
    """Every kind of loss of every alternative, with its total and its junction temperature.

    ``design`` is not needed for the bars themselves; all figures of a command are
    made from (design, result).
    """
    from matplotlib.patches import Patch

    del design
    shown, parts = min(len(comparison.points), POINTS_SHOWN), shown_parts(comparison.budget)
    word = " loss" if len(parts) <= _LONG_NAMES else ""
    rows = shown * (len(comparison.strategies) * len(comparison.modulations) + 1.6)
    height = rows * _FIGURES_ROW + _EDGE
    with style():
        figure = new_figure("losses", height, "Losses by kind of each alternative")
        axes = figure.add_axes((0.165, 0.5 / height, 0.815, 1.0 - _EDGE / height))
        ticks: list[tuple[float, str]] = []
        for point in range(shown):
            top = ticks[-1][0] - 1.6 if ticks else -0.5
            ticks += _draw_point(axes, comparison, point, top)
        totals = comparison.budget.total[..., :shown]
        largest = float(np.max(totals[np.isfinite(totals)], initial=1e-3))
        axes.set(xlim=(0.0, 1.27 * largest), ylim=(ticks[-1][0] - 0.6, 0.1), xlabel="Loss in W")
        for y, label in ticks:
            axes.annotate(
                label,
                (0.0, y),
                (-5, 0),
                textcoords="offset points",
                ha="right",
                va="center",
                fontsize=7.5,
            )
        axes.set_yticks([])
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.legend(
            handles=[
                Patch(color=PART_COLOURS[part], label=f"{part_label(part)}{word}") for part in parts
            ],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            borderaxespad=0.3,
            ncols=len(parts),
            columnspacing=1.1,
            frameon=False,
            fontsize=7.5,
            handlelength=1.2,
            handletextpad=0.5,
        )
    return figure


# Loss comparisons in the report.

_WATT_HOUR = 3600.0


_MOST_ROWS = 40


def _table(found: MissionComparison) -> HtmlTable:
    """Energies in Wh by kind; what is less than 0.01 % everywhere is in the total alone."""
    kinds = [
        part for part in PARTS if any(run.energy[part] > _VISIBLE * run.total for run in found.runs)
    ]
    rows = []
    for index, run in enumerate(found.runs[:_MOST_ROWS]):
        mark = mission_mark(run, best=index == found.best)
        rows.append(
            Row(_cells(run, kinds, mark), "best" if mark == "best" else "muted" if mark else "")
        )
    columns = ("", *(part_label(kind) for kind in kinds), "total", "hottest junction", "its swing")
    return HtmlTable("Energy lost over the mission by kind, in Wh", columns, tuple(rows))


def _cells(run: MissionRun, kinds: list[str], mark: str) -> tuple[str, ...]:
    label = f"{STRATEGY_TEXT[run.strategy]}, {modulation_label(run.modulation)}"
    name = symbols(f"{label}: {mark}" if mark not in {"", "best"} else label)
    if not (run.steady and math.isfinite(run.total)):
        return (name, *("\u2013" for _ in range(len(kinds) + 3)))
    energies = (*(run.energy[kind] for kind in kinds), run.total)
    warm = f"{run.junction_max:.1f}{NARROW}\u00b0C", f"{run.swing:.1f}{NARROW}K"
    if not math.isfinite(run.junction_max):
        warm = "\u2013", "\u2013"
    return (name, *(number(energy / _WATT_HOUR) for energy in energies), *warm)


def best_loss(comparison: LossComparison) -> tuple[str, str, str] | None:
    """(total, alternative, comparison) at the first operating point that
    has a feasible alternative; None where no point has one.
    """
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        if best is None:
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        alternative = f"{STRATEGY_TEXT[best[0]]} with {modulation_label(best[1])}"
        first = (
            f"{STRATEGY_TEXT[comparison.strategies[0]]} with "
            f"{modulation_label(comparison.modulations[0])}"
        )
        saving = float(comparison.saving[index]) / 100.0
        against = (
            f", {share(saving, 3)} below {first}" if math.isfinite(saving) and saving > 0.0 else ""
        )
        return (
            watts(float(comparison.budget.total[index])),
            alternative,
            f"at {point_text(point)}{against}",
        )
    return None


def loss_tables(comparison: LossComparison) -> list[HtmlTable]:
    """One table per operating point."""
    budget = comparison.budget
    kinds = shown_parts(budget)
    columns = (
        "",
        *(part_label(kind) for kind in kinds),
        "total",
        "saved",
        "junction",
        "phase voltage",
        "ripple current",
    )
    tables = []
    for p, point in enumerate(comparison.points):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                best = (comparison.best_strategy[p], comparison.best_modulation[p]) == (s, m)
                label = f"{STRATEGY_TEXT[strategy]}, {modulation_label(modulation)}"
                reason = obstacle(comparison, index)
                parts = (*(getattr(budget, kind) for kind in kinds), budget.total)
                cells = (
                    symbols(f"{label}: {reason}" if reason else label),
                    *(
                        watts(float(part[index])) if math.isfinite(part[index]) else "\u2013"
                        for part in parts
                    ),
                    f"{comparison.saving[index] + 0.0:.1f}{NARROW}%"
                    if math.isfinite(comparison.saving[index])
                    else "\u2013",
                    *known_texts(
                        (float(budget.junction_temperature[index]), "\u00b0C"),
                        (float(budget.voltage[index]), "V"),
                        (float(budget.ripple_current[index]), "A"),
                    ),
                )
                rows.append(Row(cells, "muted" if reason else "best" if best else ""))
        notes = [
            point_text(point),
            winner_reason(comparison, p),
            friction_text(comparison, p),
            "" if comparison.compared else NOT_COMPARED,
            "" if comparison.scope == "drive" else WITHOUT_BRIDGE,
            *leg_notes(comparison, p),
        ]
        title = ". ".join(note for note in notes if note)
        least = [row.cells[0] for row in rows if row.mark == "best"]
        tables.append(
            HtmlTable(
                title,
                heading_cells(*columns),
                tuple(rows),
                folded=p > 0,
                key="least: " + least[0] if least else "",
            )
        )
    return tables


# Losses at the operating points of a design and over its mission, as records.


def _watts(value: float) -> str:
    return f"{value:.0f} W" if value >= 99.95 else format_quantity(value, "W", 3)


def _summary(_: Solution, comparison: LossComparison) -> Rows:
    rows = []
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        label = f"losses at {point.torque:.4g} N m, {in_rpm(point.omega_m):.4g} rpm"
        if best is None:
            rows.append(
                (label, "no alternative is feasible" if comparison.compared else NOT_COMPARED)
            )
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        budget = comparison.budget
        known = comparison.scope == "drive"
        heat = (
            f", {budget.junction_temperature[index]:.0f} degC" if known else " without the bridge"
        )
        chosen = f"{_watts(float(budget.total[index]))}{heat}"
        first_loss = (
            _watts(float(budget.total[0, 0, p])) if comparison.usable[0, 0, p] else "not feasible"
        )
        first = f"{comparison.strategies[0]} with {comparison.modulations[0]}: {first_loss}"
        rows.append((label, f"{best[0]} with {best[1]}: {chosen} ({first})"))
    return rows


def _sentences(_: Solution, comparison: LossComparison) -> list[str]:
    best = best_loss(comparison)
    if best is None:
        return []
    return [f"The alternative of least loss is {best[1]}: {best[0]} {best[2]}."]


def _tiles(_: Solution, comparison: LossComparison) -> list[Tile]:
    best = best_loss(comparison)
    return (
        [] if best is None else [Tile("Least total loss", best[0], symbols(f"{best[1]} {best[2]}"))]
    )


def _figures(solution: Solution, comparison: LossComparison) -> Mapping[str, Draw]:

    return {"losses": lambda: plot_losses(solution.design, comparison)}


def _parts(_: Solution, comparison: LossComparison) -> list[ReportPart]:
    best = best_loss(comparison)
    key = "" if best is None else f"{best[0]} with {best[1]}"
    caption = (
        "Losses of every control strategy with every modulator; total and junction temperature at "
        "the end of each bar."
    )
    if len(comparison.points) > POINTS_SHOWN:
        caption += " The tables below have the other operating points, too."
    shown = Passage(drawings=[("losses", caption)], tables=loss_tables(comparison))
    return [shown.of(CHAPTER, symbols(key))]


def _mission_figures(_: Solution, found: MissionComparison) -> Mapping[str, Draw]:

    return {"mission": lambda: plot_mission(found)}


def _mission_parts(solution: Solution, found: MissionComparison) -> list[ReportPart]:
    (table,) = mission_tables(solution.design, found)
    caption = (
        "Top: energy lost by kind over the mission, least first. Bottom: hottest junction over "
        "time, of the best alternative and, pale, of the first."
    )
    shown = Passage(
        title=f"Mission {found.mission.source}",
        drawings=[("mission", caption)],
        tables=[_table(found)],
        notes=table.notes,
    )
    return [shown.of(CHAPTER)]


LOSSES = Capability(
    name="losses",
    title="losses by strategy and modulator",
    of=lambda outcome: outcome.solution.losses,
    plain=lambda _, comparison: plain_losses(comparison),
    summary=_summary,
    tables=lambda solution, comparison: losses_tables(solution.design, comparison),
    sentences=_sentences,
    tiles=_tiles,
    figures=_figures,
    parts=_parts,
)

MISSION = Capability(
    name="mission",
    title="losses over the mission",
    of=lambda outcome: outcome.solution.mission,
    plain=lambda _, found: plain_mission(found),
    tables=lambda solution, found: mission_tables(solution.design, found),
    figures=_mission_figures,
    parts=_mission_parts,
)
