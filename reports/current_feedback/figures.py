"""Figure of the six regulators over speed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.reports.pages.figures_style import SERIES, new_figure, style

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from dqforge.optimizer.current_feedback.regulator_runs import RegulatorRun


def plot_regulators(runs: Sequence[RegulatorRun]) -> Figure:
    """Switching frequency, r.m.s. error, distortion and total loss over speed."""
    labels = (
        "Mean switching frequency in kHz",
        "Error of a phase in A r.m.s.",
        "Distortion in %",
        "Total loss in W",
    )
    with style():
        figure = new_figure(
            "current-feedback",
            4.6,
            "Frequency, error, distortion and loss of six regulators",
        )
        panels = figure.subplots(2, 2, sharex=True).ravel()
        figure.subplots_adjust(
            left=0.075, right=0.985, top=0.92, bottom=0.095, hspace=0.12, wspace=0.2
        )
        for run, colour in zip(runs, SERIES, strict=False):
            rpm = run.points.omega_m * 30.0 / math.pi
            shown = (
                run.frequency / 1e3,
                run.rms_error,
                100.0 * run.distortion,
                run.budget.total,
            )
            for axes, values in zip(panels, shown, strict=True):
                axes.plot(rpm, values, "o-", color=colour, label=run.plan.method, markersize=3)
        for axes, label in zip(panels, labels, strict=True):
            axes.set(ylabel=label, ylim=(0.0, None))
        for axes in panels[2:]:
            axes.set_xlabel("Speed in rpm")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="upper center", ncols=6, frameon=False, fontsize=7.5)
    return figure
