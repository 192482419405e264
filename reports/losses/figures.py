"""Figure of the loss comparison: one stacked bar for every strategy with every modulator,
at each operating point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.reports.pages.figures_style import (
    FAINT,
    INK,
    MUTED,
    PAPER,
    PART_COLOURS,
    new_figure,
    style,
)
from dqforge.reports.pages.labels import (
    STRATEGY_LABELS,
    modulation_label,
    obstacle,
    part_label,
    point_text,
    shown_parts,
    watts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


POINTS_SHOWN = 8  # Operating points in the figure; a table has room for more.
_ROW = 0.23
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
    height = rows * _ROW + _EDGE
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
