"""How long a tracker takes from an unknown angle at rest to one known but for half a turn."""

from __future__ import annotations

import math

from dqforge.optimizer.estimators.solve import TunedTracker

# Time constants of the loop: from beside the unstable rest at 90 degrees to within noise.
_SETTLED = 12.0


def settling_samples(tuned: TunedTracker) -> int:
    """Samples of ``t_s`` from the start at the angle 0, at rest and without current reference,
    after which the angle is that of the d axis or half a turn off.
    """
    gains = tuned.gains
    steps = float(getattr(gains, "period", 1.0))
    bandwidth = math.sqrt(float(gains.k_i) / (steps * tuned.t_s))
    return math.ceil(_SETTLED / (bandwidth * tuned.t_s))
