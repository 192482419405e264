"""How often each start-up of the comparison succeeds: the emitted state machine on machines drawn
from the design's own tolerances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.optimizer.estimator_comparison.candidate import TriedStarts
from dqforge.reports.start_up_bench.start_success import start_success

if TYPE_CHECKING:
    from dqforge.optimizer.estimator_comparison.compared import ComparedStart
    from dqforge.optimizer.estimator_comparison.solve import EstimatorComparison
    from dqforge.optimizer.start_up.solve import StartRate

LOADS = (0.0, 0.3)  # Friction over the torque of the current limit with which starts are tried.


def tried_starts(
    found: EstimatorComparison, count: int, told: Callable[[str], None]
) -> tuple[ComparedStart, ...]:
    """The start-ups of a comparison with the share of starts that succeed.

    Args:
        found: The comparison.
        count: Starts per load.
        told: Called with the name of each before it is tried.
    """
    return tuple(_tried(row, count, told) for row in found.starts)


def _tried(row: ComparedStart, count: int, told: Callable[[str], None]) -> ComparedStart:
    figures = row.figures
    if figures is None or figures.design is None:
        return row
    told(row.candidate.name)
    plain = replace(
        figures.design,
        losses=None,
        modulation_choice=None,
        weakening=None,
        simulation=None,
    )
    try:
        rates = start_success(plain, None, LOADS, count)
    except (InputError, NoSolutionError, VerificationError) as error:
        return replace(row, figures=replace(figures, untried=error.message))
    tried = tuple(
        TriedStarts(rate.load, rate.count, rate.succeeded, rate.interval, _named(rate))
        for rate in rates
    )
    return replace(row, figures=replace(figures, tried=tried))


def _named(rate: StartRate) -> dict[str, int]:
    return {str(name): often for name, often in rate.failures.items()}
