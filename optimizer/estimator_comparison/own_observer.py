"""What is computed of a design's position observer when it is tuned: warm machines and starts."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.capture_range import CaptureMap, capture_map
from dqforge.optimizer.estimator_comparison.warm_machine import WarmErrors, warm_errors
from dqforge.optimizer.observers.conditions import loads_at
from dqforge.optimizer.observers.tuning import PositionObserver

_LOAD = 0.5  # torque of the capture map over the largest one


@dataclass(frozen=True, slots=True, eq=False)
class ObserverEvidence:
    """Steady errors on warm machines, and the starts from which the observer locks."""

    warm: WarmErrors
    capture: CaptureMap


def capture_of(design: Design, observer: PositionObserver) -> CaptureMap:
    """Starts from which an observer locks at half the largest torque.

    Args:
        design: The drive.
        observer: The observer.
    """
    load = loads_at(design, (_LOAD,))[0]
    return capture_map(observer, complex(load.i_d, load.i_q))


def observer_evidence(design: Design, observer: PositionObserver | None) -> ObserverEvidence | None:
    """Both of the design's own observer, None where it has none.

    Args:
        design: The drive.
        observer: As `solve_gains` tuned it.
    """
    if observer is None:
        return None
    return ObserverEvidence(warm_errors(design, observer), capture_of(design, observer))
