"""The figures of the command line and the report: results in, a figure or its bytes out; nothing is computed here."""

from __future__ import annotations

from dqforge.reports.figures_loops import plot_gains
from dqforge.reports.figures_losses import plot_losses
from dqforge.reports.figures_reference import plot_errors, plot_fit, plot_mtpa
from dqforge.reports.figures_style import save, to_svg

__all__ = ["plot_errors", "plot_fit", "plot_gains", "plot_losses", "plot_mtpa", "save", "to_svg"]
