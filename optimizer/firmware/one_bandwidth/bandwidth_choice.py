"""The bandwidth of a firmware that works out its gains from one: the largest up to what was asked
for with which its own loops keep their margins, from no current to the limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.firmware.configuration import DriveValues
from dqforge.optimizer.firmware.firmware_method import Asked
from dqforge.optimizer.firmware.profile import LoopProfile
from dqforge.optimizer.firmware.sampled_structure import Winding, current_loop
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import loop_margins

# Largest modulus of 1/(1 + L) of current loops whose bandwidth had to be lowered, as that of the
# optimised gains: a phase margin of some 60 deg where the winding's pole is cancelled.
MOST_SENSITIVITY = 1.6
_LEAST_SHARE = 1e-4
_STEP = 0.7
_RESOLUTION = 1e-3
_DIGITS = 4


def bandwidth_asked(asked: Asked) -> float:
    """Bandwidth in rad/s that the gains wished for have: kp/L of the slower axis.

    Args:
        asked: What is asked of the firmware, with both inductances.
    """
    l_d, l_q = asked.drive.l_d, asked.drive.l_q
    assert l_d is not None
    assert l_q is not None
    return min(asked.current_d.kp / l_d, asked.current_q.kp / l_q)


def drives_over_current(asked: Asked) -> tuple[DriveValues, ...]:
    """The drive with its inductances at no current, and where it saturates at the current limit.

    Args:
        asked: What is asked of the firmware.
    """
    drive, i_max = asked.drive, asked.drive.i_max
    if i_max is None:
        return (drive,)
    jet = asked.design.machine.jet(np.zeros(1), np.full(1, i_max))
    limit = replace(drive, l_d=float(jet.l_dd[0]), l_q=float(jet.l_qq[0]))
    return (drive,) if limit == drive or min(jet.l_dd[0], jet.l_qq[0]) <= 0.0 else (drive, limit)


def held_bandwidth(wished: float, loops: Callable[[float], LoopProfile], asked: Asked) -> float:
    """Largest bandwidth, at most the one wished for, with which both current loops keep the phase
    margin of the design and, at no current, a sensitivity of at most `MOST_SENSITIVITY`; four
    digits, rounded down.

    Args:
        wished: In the unit of the firmware.
        loops: The loops with a bandwidth in that unit.
        asked: What is asked of the firmware; the ``min_phase_margin`` of its design must hold.
    """
    from scipy.optimize import brentq

    least = asked.design.control.current_loop.min_phase_margin
    drives = [
        (Winding(drive.r_s, drive.l_d), Winding(drive.r_s, drive.l_q))
        for drive in drives_over_current(asked)
        if drive.r_s is not None and drive.l_d is not None and drive.l_q is not None
    ]

    @cache
    def spare(bandwidth: float) -> float:
        """What is left of margin and sensitivity, relative to what must hold; below zero where
        one of them does not.
        """
        current = loops(bandwidth).current
        return min(
            _spare(current_loop(winding, pi, current.delay), least, damped=index == 0)
            for index, pair in enumerate(drives)
            for winding, pi in zip(pair, (current.d, current.q), strict=True)
        )

    high = rounded_down(wished)
    low = high
    while spare(low) < 0.0:
        high, low = low, _STEP * low
        if low < _LEAST_SHARE * wished:
            raise NoSolutionError(
                f"no bandwidth of the current loops of {loops(low).firmware} keeps a phase margin "
                f"of {math.degrees(least):.4g} deg; lower control.current_loop.min_phase_margin"
            )
    if low == high:
        return high
    edge = rounded_down(float(brentq(spare, low, high, rtol=_RESOLUTION)))
    while spare(edge) < 0.0:
        edge = rounded_down((1.0 - _RESOLUTION) * edge)
    return edge


def _spare(loop: PiLoop, least: float, *, damped: bool) -> float:
    if abs(loop.closed.poles[0]) >= 1.0:
        return -1.0
    margins = loop_margins(loop.open_loop)
    margin = margins.phase_margin / max(least, 1e-6) - 1.0  # a design may ask for none
    return min(margin, MOST_SENSITIVITY / margins.max_sensitivity - 1.0) if damped else margin


def rounded_down(value: float) -> float:
    """A positive number with four digits, not above what it was.

    Args:
        value: Any positive number.
    """
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.floor(value / step * (1.0 + 1e-12)) * step:.{_DIGITS}g}")
