"""Figures 4.1 to 4.3 of paper 002: the control structures, and their terms over the angle."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    style,
)
from dqforge.reports.papers.paper002_definitions.compensation import Compensation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = (BLUE, ORANGE, TEAL)


# Centre, width and text of the boxes of a row; all boxes of a diagram are as high.
_SIMPLE = (
    (0.17, 0.2, "transforms and\nequations\nT → currents"),
    (0.42, 0.17, "current\ncontroller"),
    (0.65, 0.14, "inverter"),
    (0.87, 0.14, "machine"),
)


_FORWARD = (
    (0.125, 0.155, "(4.4)-(4.6)\ni_qy = T/(p φ_m √1.5)\ni_dy = i_0y = 0"),
    (0.325, 0.11, "PI dy, qy, 0y"),
    (0.505, 0.14, "(4.8), (4.9)\na_y (T_dqy T_dqx)⁻¹\nT_\u03b1β0⁻¹"),
    (0.7, 0.13, "modulator,\ninverter"),
    (0.89, 0.12, "machine"),
)


_BACK = (
    (0.325, 0.2, "(4.7)\n1/a_y T_dqy T_dqx"),
    (0.7, 0.13, "T_\u03b1β0"),
)


_TABLE = (0.505, 0.12, "table over θ_r\na_y, θ_x, θ_y")


_UPPER, _MIDDLE, _LOWER = 0.82, 0.5, 0.17


_HEIGHT = 0.24


def _box(axes: Axes, centre: float, height: float, width: float, text: str, edge: str) -> None:
    from matplotlib.patches import Rectangle

    corner = (centre - 0.5 * width, height - 0.5 * _HEIGHT)
    axes.add_patch(
        Rectangle(corner, width, _HEIGHT, facecolor="white", edgecolor=edge, linewidth=1.0)
    )
    axes.text(centre, height, text, ha="center", va="center", fontsize=6.0, color=INK)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "color": MUTED, "linewidth": 0.8}
    )


def _line(axes: Axes, *points: tuple[float, float]) -> None:
    across, up = zip(*points, strict=True)
    axes.plot(across, up, color=MUTED, linewidth=0.8)


def _row(axes: Axes, boxes: Any, height: float) -> None:
    for centre, width, text in boxes:
        _box(axes, centre, height, width, text, BLUE)
    for (left, wide, _), (right, next_wide, _) in pairwise(boxes):
        _arrow(axes, (left + 0.5 * wide, height), (right - 0.5 * next_wide, height))


def _note(axes: Axes, across: float, up: float, text: str) -> None:
    axes.text(across, up, text, ha="center", va="bottom", fontsize=6.0, color=MUTED)


def _diagram(figure: Figure, place: tuple[float, float, float, float], title: str) -> Axes:
    axes = figure.add_axes(place)
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), xticks=(), yticks=(), title=title)
    axes.grid(visible=False)
    for side in axes.spines.values():
        side.set_edgecolor(FAINT)
    axes.spines[["top", "right"]].set_visible(True)
    return axes


def _simple(axes: Axes) -> None:
    _row(axes, _SIMPLE, 0.65)
    _arrow(axes, (0.0, 0.65), (0.07, 0.65))
    _note(axes, 0.035, 0.67, "T*")
    _line(axes, (0.87, 0.65 - 0.5 * _HEIGHT), (0.87, 0.2), (0.17, 0.2))
    _arrow(axes, (0.17, 0.2), (0.17, 0.65 - 0.5 * _HEIGHT))
    _note(axes, 0.52, 0.21, "i_abc, θ_r")


def _dqy(axes: Axes, *, decoupled: bool) -> None:
    half = 0.5 * _HEIGHT
    _row(axes, _FORWARD, _UPPER)
    _arrow(axes, (0.0, _UPPER), (0.0475, _UPPER))
    _note(axes, 0.02, _UPPER + 0.02, "T*")
    for centre, width, text in _BACK:
        _box(axes, centre, _LOWER, width, text, BLUE)
    centre, width, text = _TABLE
    _box(axes, centre, _MIDDLE, width, text, TEAL)
    _arrow(axes, (centre, _MIDDLE + half), (centre, _UPPER - half))
    _arrow(axes, (centre - 0.03, _MIDDLE - half), (0.41, _LOWER + half))
    _line(axes, (0.89, _UPPER - half), (0.89, _LOWER))
    _arrow(axes, (0.89, _LOWER), (0.765, _LOWER))
    _note(axes, 0.825, _LOWER + 0.02, "i_abc")
    _arrow(axes, (0.635, _LOWER), (0.425, _LOWER))
    _note(axes, 0.54, _LOWER + 0.02, "i_\u03b1β0")
    _arrow(axes, (0.235, _LOWER + half), (0.235, _UPPER - 0.02))
    _note(axes, 0.21, 0.36, "i_dqy")
    axes.plot(0.235, _UPPER, marker="o", markersize=5.0, color="white", markeredgecolor=BLUE)
    _note(axes, 0.245, _UPPER - 0.14, "\u2212")
    if decoupled:
        _box(axes, 0.325, _MIDDLE, 0.13, "A to F, G to I\n(4.10)-(4.18)", ORANGE)
        _arrow(axes, (0.235, _MIDDLE), (0.26, _MIDDLE))
        _line(axes, (0.39, _MIDDLE), (0.407, _MIDDLE))
        _arrow(axes, (0.407, _MIDDLE), (0.407, _UPPER - 0.02))
        axes.plot(0.407, _UPPER, marker="o", markersize=5.0, color="white", markeredgecolor=ORANGE)


def plot_structures() -> Figure:
    """The three control structures as diagrams."""
    with style():
        figure = new_figure(
            "paper-002-structures", 6.6, "Control structures: simplified, dqy, dqy with decoupling"
        )
        titles = (
            "Figure 4.1: the parts of the control",
            "Figure 4.2: dqy control",
            "Figure 4.3: dqy control with decoupling and compensation",
        )
        first, second, third = (
            _diagram(figure, (0.03, 0.71 - 0.34 * row, 0.94, 0.245), title)
            for row, title in enumerate(titles)
        )
        _simple(first)
        _dqy(second, decoupled=False)
        _dqy(third, decoupled=True)
    return figure


def plot_terms(machines: tuple[Compensation, ...]) -> Figure:
    """References, back-EMF and coupling over the angle, a column per machine."""
    with style():
        figure = new_figure(
            "paper-002-terms", 5.4, "References, back-EMF and coupling in dqy over the angle"
        )
        for column, found in enumerate(machines):
            degrees = np.degrees(found.theta)
            first, second, third = (
                figure.add_axes((0.08 + 0.5 * column, 0.725 - 0.315 * row, 0.4, 0.21))
                for row in range(3)
            )
            constant = np.full_like(degrees, found.i_qy)
            first.plot(degrees, constant, color=ORANGE, label="i_qy")
            first.plot(degrees, 0.0 * degrees, color=BLUE, label="i_dy, i_0y")
            first.set(title=f"{found.name}\nFigure 4.2: references", ylabel="A", ylim=(-1.0, 9.5))
            second.plot(degrees, found.emf, color=ORANGE)
            second.set(title="Figure 4.3: back-EMF on qy", ylabel="V", ylim=(90.0, 200.0))
            for values, colour, label in zip(
                found.coupling, _COLOURS, ("dy", "qy", "0y"), strict=True
            ):
                third.plot(degrees, values, color=colour, label=label)
            third.set(title="Figure 4.3: coupling", ylabel="V", ylim=(-32.0, 26.0))
            for axes in (first, third):
                axes.legend(frameon=False, loc="upper right", ncols=3)
            for axes in (first, second, third):
                axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 60))
            third.set(xlabel="Electrical angle in deg")
    return figure
