"""What `dqforge estimators` answers: estimators and start-ups of a drive, and the pair to flash."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.reports.estimator_comparison.observer_errors import estimator_tables, plain_comparison
from dqforge.reports.estimator_comparison.question import pair_files, which_estimators
from dqforge.reports.output.folder import ESTIMATORS
from dqforge.reports.pages.answer import Answer, Files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def answer_estimators(
    design: Design, only: str | None = None, starts: int = 0, *, write: bool
) -> Answer:
    """Compare the estimators and start-ups of a design.

    Raises:
        InputError: As `which_estimators`.
        NoSolutionError: Likewise, or there is no pair whose headers could be written.
    """
    found = which_estimators(design, only, starts)

    def figure() -> Figure:
        from dqforge.reports.estimator_comparison.figures import plot_comparison

        return plot_comparison(found)

    files = Files(pair_files(design, found), ESTIMATORS, design) if write else None
    tables = estimator_tables(design, found)
    return Answer(design.name, tables, {"estimators": plain_comparison(found)}, figure, files)
