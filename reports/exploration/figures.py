"""The figure of a study: its front among the rows, or how what is judged is spread."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.reports.exploration.study_view import StudyView, shown_unit
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PALE, TEAL, new_figure, style
from dqforge.reports.study_store.column_texts import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.study_results.acceptance import AcceptedRange

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
        figure = new_figure("study-yield", 2.6, "How the judged outputs are spread over the rows")
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
