"""Figure of a six-step drive: the error of a commutation over the speed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    style,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.optimizer.six_step.design import SixStepDesign


def plot_blocks(found: SixStepDesign) -> Figure:
    """Parts of the error of a commutation over the electrical frequency, and their sum.

    Args:
        found: The six-step drive.
    """
    errors, limits = found.curve, found.limits
    hertz = errors.omega / (2.0 * math.pi)
    parts = (
        ("offset", errors.offset, BLUE),
        ("noise, 3 sigma", 3.0 * errors.noise, TEAL),
        ("grid of periods", errors.grid, ORANGE),
        ("saliency", errors.saliency, MUTED),
    )
    with style():
        figure = new_figure("six-step", 2.8, "Error of a commutation over the speed")
        axes = figure.subplots()
        for label, values, colour in parts:
            if np.any(values > 0.0):
                axes.plot(hertz, np.degrees(values), color=colour, linewidth=1.1, label=label)
        axes.plot(hertz, np.degrees(errors.largest), color=INK, linewidth=1.4, label="together")
        for edge in (limits.low, limits.high):
            axes.axvline(
                edge / (2.0 * math.pi),
                color=MUTED,
                linewidth=0.7,
                linestyle=":",
                label="_end of the range",
            )
        axes.set(
            xscale="log",
            xlabel="Electrical frequency in Hz",
            ylabel="Error in deg (electrical)",
            ylim=(0.0, 15.0),
        )
        axes.legend(frameon=False, fontsize=8)
        figure.subplots_adjust(left=0.09, right=0.985, top=0.97, bottom=0.17)
    return figure
