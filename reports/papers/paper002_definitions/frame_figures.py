"""Figures 2.3 to 3.2 of paper 002: the back-EMF of four shapes in five frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_COLOURS = (BLUE, ORANGE, TEAL)


_AXES = {
    "2.3": ("a", "b", "c"),
    "2.4": ("$\u03b1$", "$\u03b2$", "0"),
    "2.5": ("d", "q", "0"),
    "2.6": ("dx", "qx", "0"),
    "3.2": ("dy", "qy", "0y"),
}


def plot_frames(curves: dict[str, dict[str, FloatArray]]) -> Figure:
    """Back-EMF of the four shapes (columns) in the five frames (rows): Figures 2.3 to 2.6 and
    3.2.
    """
    with style():
        figure = new_figure("paper-002-frames", 8.2, "Back-EMF of four shapes in five frames")
        for row, (number, names) in enumerate(_AXES.items()):
            for column, (name, components) in enumerate(curves[number].items()):
                axes = figure.add_axes((0.075 + 0.235 * column, 0.82 - 0.192 * row, 0.2, 0.135))
                theta = 2.0 * np.pi * np.arange(components.shape[1]) / components.shape[1]
                for values, colour, label in zip(components, _COLOURS, names, strict=True):
                    axes.plot(np.degrees(theta), values, color=colour, linewidth=1.0, label=label)
                axes.set(xlim=(0.0, 360.0), xticks=(0, 120, 240), ylim=(-1.8, 2.0))
                if row == 0:
                    axes.set_title(name, fontsize=7.0)
                if column == 0:
                    axes.set_ylabel(f"Figure {number}")
                    axes.legend(
                        frameon=False, loc="upper right", ncols=3, fontsize=6.0, handlelength=1.0
                    )
                else:
                    axes.set_yticklabels([])
                if row == len(_AXES) - 1:
                    axes.set_xlabel("Electrical angle in deg")
    return figure
