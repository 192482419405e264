"""What a voltage R times the reference, added to a PI controller that cancels the winding's pole,
does to a step of the current.
"""

from __future__ import annotations

import math


def overshoot(share: float, ratio: float) -> float:
    """Largest excess of the current over a unit step of its reference, sampling left aside.

    The error of the step is A e^(-b t) + B e^(-t/tau) with the bandwidth b, the winding's time
    constant tau, B = -k/(b tau - 1) and A = 1 - B.

    Args:
        share: Part k of R times the reference that is added, 0..1.
        ratio: Bandwidth times the winding's time constant, positive.
    """
    if share <= 0.0:
        return 0.0
    if abs(ratio - 1.0) < 1e-6:
        ratio = 1.0 + 1e-6
    slow = -share / (ratio - 1.0)
    fast = 1.0 - slow
    # Time over tau at which e' = 0: -ratio fast e^(-ratio x) - slow e^(-x) = 0.
    inside = -ratio * fast / slow
    if inside <= 0.0:
        return 0.0
    x = math.log(inside) / (ratio - 1.0)
    error = fast * math.exp(-ratio * x) + slow * math.exp(-x)
    return max(-error, 0.0) if x > 0.0 else 0.0
