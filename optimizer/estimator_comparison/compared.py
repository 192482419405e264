"""Candidates of the comparison with what was found of each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    EstimatorFigures,
    StartCandidate,
    StartFigures,
)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedEstimator:
    """An estimator with what was found; ``refusal`` says why nothing was, empty where it may be.

    Args:
        candidate: What it is.
        refusal: With the number.
        figures: None where it is refused.
        holds: Whether angle and speed stay within the limits, shape (S, L); None likewise.
        cycles, instructions, flash: Of a step of its C on the core of the design: cycles (low,
            high) and instructions in the mean, bytes; None where they were not measured.
    """

    candidate: Candidate
    refusal: str
    figures: EstimatorFigures | None = None
    holds: NDArray[np.bool_] | None = None
    cycles: tuple[float, float] | None = None
    instructions: float | None = None
    flash: int | None = None


@dataclass(frozen=True, slots=True)
class ComparedStart:
    """A start-up with what was found; ``refusal`` says why nothing was."""

    candidate: StartCandidate
    refusal: str
    figures: StartFigures | None = None
