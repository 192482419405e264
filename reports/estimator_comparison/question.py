"""Which estimators, and which pair to flash: the question of a design, with all that can be found
out on this computer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.optimizer.estimator_comparison.solve import (
    EstimatorComparison,
    compare_estimators,
    named,
    with_success,
)
from dqforge.reports.estimator_comparison.observer_errors import with_cost
from dqforge.reports.estimator_comparison.tried_starts import tried_starts
from dqforge.reports.pages.console import stage

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design

MOST_STARTS = 1000


def which_estimators(
    design: Design, only: str | None = None, starts: int = 0
) -> EstimatorComparison:
    """The comparison with the cost of each step on the design's core.

    Args:
        design: The drive.
        only: Names of the estimators to compare, with commas in between; all of them when None.
        starts: How many starts each start-up is tried with per load; 0 for none.

    Raises:
        InputError, NoSolutionError: As `compare_estimators`, there is no estimator of that name, or
            too many starts are asked for.
    """
    if not 0 <= starts <= MOST_STARTS:
        raise InputError(f"--starts must lie between 0 and {MOST_STARTS}, got {starts}")
    chosen = None if only is None else named(only)
    found = compare_estimators(design, chosen, lambda name: stage(f"comparing {name}"))
    stage("counting cycles")
    found = with_cost(found)
    if not starts:
        return found
    return with_success(
        found, tried_starts(found, starts, lambda name: stage(f"starting by {name}"))
    )
