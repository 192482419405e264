"""The bandwidth of a firmware that works out its gains from one: the largest up to what was asked
for with which its own loops keep their margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from dqforge.machines.design.design import Design
from dqforge.optimizer.firmware.firmware_method import Asked
from dqforge.optimizer.firmware.judge import JudgedFirmware

_LEAST_SHARE = 1e-4


_DIGITS = 4


def bandwidth_asked(asked: Asked) -> float:
    """Bandwidth in rad/s that the gains wished for have: kp/L of the slower axis.

    Parameters
    ----------
    asked:
        What is asked of the firmware, with both inductances.
    """
    l_d, l_q = asked.drive.l_d, asked.drive.l_q
    assert l_d is not None
    assert l_q is not None
    return min(asked.current_d.kp / l_d, asked.current_q.kp / l_q)


def held_bandwidth(
    wished: float, judged: Callable[[float], JudgedFirmware], design: Design
) -> float:
    """Largest bandwidth in rad/s, at most the one wished for, that keeps the phase margin and the
    sensitivity of the design's current loops; four digits, rounded down.

    Parameters
    ----------
    wished:
        In rad/s.
    judged:
        The loops with a bandwidth in rad/s.
    design:
        Its ``phase_margin_min`` must hold.
    """
    least = design.control.current_loop.phase_margin_min

    def holds(bandwidth: float) -> bool:
        found = judged(bandwidth)
        return all(
            loop is None or (loop.stable and loop.phase_margin >= least)
            for loop in (found.current_d, found.current_q)
        )

    top = rounded_down(wished)
    if holds(top):
        return top
    low, high = math.log(_LEAST_SHARE * wished), math.log(wished)
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(math.exp(middle)) else (low, middle)
    return rounded_down(math.exp(low))


def rounded_down(value: float) -> float:
    """A positive number with four digits, not above what it was.

    Parameters
    ----------
    value:
        Any positive number.
    """
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.floor(value / step * (1.0 + 1e-12)) * step:.{_DIGITS}g}")
