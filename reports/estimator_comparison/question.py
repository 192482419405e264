"""Which estimators, and which pair to flash: the question of a design, with all that can be found
out on this computer.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.estimator_comparison.compared import started_design
from dqforge.optimizer.estimator_comparison.solve import (
    EstimatorComparison,
    compare_estimators,
    named,
    with_success,
)
from dqforge.optimizer.solution import solve
from dqforge.reports.estimator_comparison.observer_errors import with_cost
from dqforge.reports.estimator_comparison.tried_starts import tried_starts
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.observers.tracker_header import tracker_files
from dqforge.reports.pages.answer import stage
from dqforge.reports.simulation.design_run import controller_files, in_float32
from dqforge.reports.start_up.header import start_up_files

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


# Headers of the pair that a comparison advises: the estimators, and the start with the control
# that it calls.


def pair_files(design: Design, found: EstimatorComparison) -> dict[str, bytes]:
    """Names and bytes of the headers of the pair.

    Args:
        design: The drive.
        found: The comparison.

    Raises:
        InputError, NoSolutionError: No estimator holds anywhere, so that there is nothing to write,
            or the control of the start cannot be emitted.
    """
    pair = found.pair
    if pair.start is not None:
        return _with_start(found)
    figures = None if pair.at_speed is None else found.estimator(pair.at_speed).figures
    if figures is not None and figures.observer is not None:
        return observer_files(design, figures.observer)
    if figures is not None and figures.tracker is not None:
        return tracker_files(design, figures.tracker)
    raise NoSolutionError(
        "there is no pair to write: no estimator that has a header of its own holds at speed; "
        "leave -o out to see why"
    )


def _with_start(found: EstimatorComparison) -> dict[str, bytes]:
    """Control, both estimators and the state machine of the start, with the hand-over of the
    pair.
    """
    start = next(row for row in found.starts if row.candidate.name == found.pair.start)
    made = started_design(found.asked, start.candidate.method, found.pair.up)
    plain = replace(made, losses=None, modulation_choice=None, weakening=None, simulation=None)
    solution = in_float32(solve(plain))
    assert solution.start_up is not None
    return controller_files(solution) | start_up_files(solution, solution.start_up)
