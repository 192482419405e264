"""Figures 2.3 to 3.2 and 6.4 to 6.9 of paper 002, drawn from their definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper002 import DriveCurves

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


def plot_drive(drive: DriveCurves) -> Figure:
    """Frame angles, factors, currents of phase a and their harmonics of the shipped drive:
    Figures 6.4 to 6.9.
    """
    count = drive.currents.shape[1]
    degrees = 360.0 * np.arange(count) / count
    angles = drive.angles
    with style():
        figure = new_figure(
            "paper-002-drive", 4.6, "Angles, factors, currents and harmonics of the shipped drive"
        )
        places = ((0.08, 0.58), (0.57, 0.58), (0.08, 0.1), (0.57, 0.1))
        first, second, third, fourth = (figure.add_axes((x, y, 0.4, 0.33)) for x, y in places)
        first.plot(degrees, np.degrees(np.unwrap(angles.theta_x)), color=ORANGE, label="$\u03b8_x$")
        first.plot(degrees, np.degrees(np.unwrap(angles.theta_y)), color=BLUE, label="$\u03b8_y$")
        first.set(title="Figure 6.4: angles of the frames", ylabel="deg")
        second.plot(degrees, angles.a_x, color=ORANGE, label="$a_x$")
        second.plot(degrees, angles.a_y, color=BLUE, label="$a_y$")
        second.set(title="Figure 6.5: factors of the frames")
        for values, colour, label in zip(
            drive.currents, (ORANGE, BLUE), ("dqx", "dqy"), strict=True
        ):
            third.plot(degrees, values, color=colour, label=label)
        third.axhline(drive.i_qy, color=TEAL, linewidth=1.0, linestyle="dashed", label="$i_{qy}$")
        third.set(title="Figures 6.6, 6.9: phase a at 1 N m, and $i_{qy}$", ylabel="A")
        orders = np.arange(1, 14)
        for place, (lines, colour) in enumerate(zip(drive.harmonics, (ORANGE, BLUE), strict=True)):
            fourth.bar(orders + 0.36 * (place - 0.5), 1e3 * lines[1:14], 0.34, color=colour)
        fourth.set(
            title="Figure 6.7: harmonics of that current", xlabel="Order", ylabel="mA", yscale="log"
        )
        fourth.set(ylim=(1.0, None), xticks=orders[::2])
        for axes in (first, second, third):
            axes.set(
                xlim=(0.0, 360.0), xticks=np.arange(0, 361, 60), xlabel="Electrical angle in deg"
            )
            axes.legend(frameon=False, loc="best", ncols=3)
    return figure
