"""By what numbers a correction works, in words."""

from __future__ import annotations

import math
from typing import Any

from dqforge.optimizer.observers.method import flux_in_words
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning


def in_words(tuning: ObserverTuning, gains: Any, t_s: float, what: str) -> str:
    """Numbers of the flux observer, then those of the correction.

    Args:
        gains: With a member ``frame``.
        t_s: Sampling period in s.
        what: What was learned.
    """
    frame = gains.frame
    words = flux_in_words(tuning, gains, t_s)
    if frame.share >= 1.0:
        return f"{words}; no correction is trained"
    filter_time = -t_s / math.log1p(-frame.share)
    return (
        f"{words}; correction: {what}, at most {math.degrees(frame.limit):.3g} deg, filter "
        f"{1e3 * filter_time:.3g} ms"
    )
