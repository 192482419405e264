"""What is proven of a design's observer over its speed range."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.tuning import PositionObserver

_LEAST_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class ObserverProof:
    """Result of the search for a common Lyapunov function
    (`dqforge.optimizer.observers.methods.lpv_certificate`).

    Args:
        contraction: Factor by which the norm of a small error shrinks at least in every sample;
            None where none was found.
        omega_low, omega_high: Electrical speeds in rad/s between which the speed may change
            arbitrarily.
        i_q: Largest |i_q| in A, at i_d = 0.
        reason: Why there is none, empty otherwise.
        searched: Whether one was searched for: not where a package for it is missing.
    """

    contraction: float | None
    omega_low: float
    omega_high: float
    i_q: float
    reason: str = ""
    searched: bool = True


def prove(observer: PositionObserver | None) -> ObserverProof | None:
    """Search a proof from the least speed at which the observer holds to the largest of the drive.

    None for other methods, which have none. Where cvxpy or Clarabel is missing, the result says so.
    """
    if observer is None or observer.method.certify is None:
        return None
    low, high = observer.judgement.steady_low, observer.omega_max
    if not (np.isfinite(low) and low < high):
        low = _LEAST_SHARE * high
    i_q = observer.disturbances.i_load
    missing = [name for name in ("cvxpy", "clarabel") if find_spec(name) is None]
    if missing:
        reason = (
            f"the search needs {' and '.join(missing)}; install with: pip install "
            f"{' '.join(missing)}"
        )
        return ObserverProof(None, low, high, i_q, reason, searched=False)
    try:
        contraction = observer.method.certify(observer.gains, low, high, i_q)
    except NoSolutionError as error:
        return ObserverProof(None, low, high, i_q, error.message.removeprefix("no certificate: "))
    return ObserverProof(contraction, low, high, i_q)
