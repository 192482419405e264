"""Figure of the page on the comparison of estimators."""

from __future__ import annotations

from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.optimizer.estimator_comparison.solve import compare_estimators
from dqforge.reports.answers.estimators import plot_comparison
from dqforge.reports.pages.figures_style import save


def comparison(path: Path) -> None:
    """Who wins where on a machine with interior magnets, and the starts that lock."""
    save(plot_comparison(compare_estimators(catalogue.load("abb-ipmsm-2k2"))), path)
