"""Figures of loss maps and missions: who loses least where, what each alternative loses,
how warm junctions become.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.mission_budget import MissionComparison
from dqforge.reports.losses.map_tables import alternative_text
from dqforge.reports.pages.figures_style import (
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
from dqforge.reports.pages.labels import part_label
from dqforge.reports.pages.map_drawing import OTHERS, WINNERS, cell_edges, draw_cells, inside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.losses.loss_map import LossMap


_RPM = 30.0 / math.pi
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
    speed, torque = cell_edges(found.omega_m) * _RPM, cell_edges(found.torque)
    draw_cells(axes, code, speed, torque)
    for k in named:
        mask = best == k
        if np.mean(mask) > 0.03:
            i, j = inside(mask)
            text = alternative_text(alternatives, k, plain=False).replace(", ", "\n")
            axes.text(
                found.omega_m[j] * _RPM,
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
        upper.set_title("Least total loss")
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
