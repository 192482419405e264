"""All candidates of the comparison; a line per kind, which lists its own."""

from __future__ import annotations

from dqforge.optimizer.estimator_comparison.candidate import Candidate, StartCandidate
from dqforge.optimizer.estimator_comparison.observer_candidates import observer_candidates
from dqforge.optimizer.estimator_comparison.six_step_candidates import six_step_candidates
from dqforge.optimizer.estimator_comparison.start_candidates import start_candidates
from dqforge.optimizer.estimator_comparison.tracker_candidates import tracker_candidates


def estimators() -> tuple[Candidate, ...]:
    """Every estimator of the position, in the order in which they are shown."""
    return (*observer_candidates(), *tracker_candidates(), *six_step_candidates())


def starts() -> tuple[StartCandidate, ...]:
    """Every way to start."""
    return start_candidates()
