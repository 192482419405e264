"""Headers of the pair that a comparison advises: the estimators, and the start with the control
that it calls.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.estimator_comparison.compared import started_design
from dqforge.optimizer.solution import solve
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.observers.tracker_header import tracker_files
from dqforge.reports.simulation.design_run import controller_files, in_float32
from dqforge.reports.start_up.header import start_up_files

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.solve import EstimatorComparison


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
