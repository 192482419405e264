"""Errors of a position observer on warm machines, and the starts from which it locks, as tables and
plain data.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.estimator_comparison.capture_range import LOCKED, CaptureMap
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.estimator_comparison.warm_machine import WarmErrors, WarmState
    from dqforge.reports.plain_data import PlainData

_TURN = 2.0 * math.pi

_NOTICED = 5e-4  # relative error of the speed that a cell names


def _load_name(share: float) -> str:
    if share == 0.0:
        return "no load"
    return f"{100.0 * abs(share):.0f} % {'motoring' if share > 0.0 else 'braking'}"


def _state_name(state: WarmState) -> str:
    return f"{state.winding:+.0f} K, {state.magnet:+.0f} K"


def _cell(angle: float, speed: float, omega: float, *, with_speed: bool) -> str:
    if not math.isfinite(angle):
        return "lost"
    text = f"{math.degrees(angle):+.3g}"
    return f"{text}, {100.0 * speed / omega + 0.0:+.2g} %" if with_speed else text


def warm_table(warm: WarmErrors) -> Table:
    """Steady errors over speed and load, on the coldest and the hottest machine.

    Args:
        warm: The errors.
    """
    finite = warm.speed[np.isfinite(warm.speed)]
    relative = np.abs(np.where(np.isfinite(warm.speed), warm.speed, 0.0)) / warm.omega
    with_speed = bool(finite.size and np.max(relative) > _NOTICED)
    rows = tuple(
        (
            _state_name(warm.states[t]),
            f"{omega / _TURN:.4g}",
            *(
                _cell(
                    float(warm.angle[t, m, s]),
                    float(warm.speed[t, m, s]),
                    omega,
                    with_speed=with_speed,
                )
                for m in range(len(warm.shares))
            ),
        )
        for t in warm.shown
        for s, omega in enumerate(warm.omega.tolist())
    )
    columns = ("winding, magnets", "electrical Hz", *(_load_name(s) for s in warm.shares.tolist()))
    changes = "; ".join(
        f"{_state_name(warm.states[t])}: R {100.0 * warm.states[t].r_s:+.3g} %, psi "
        f"{100.0 * warm.states[t].psi_pm:+.3g} %"
        for t in warm.shown
    )
    own = "angle, and the speed in % of it" if with_speed else "angle; the speed has none"
    return Table(
        "Position observer on the warm machine; steady errors in deg (electrical)",
        columns,
        rows,
        (f"{own}; {changes}", "nothing else is off; JSON has them with the dead time besides"),
    )


def plain_warm(warm: WarmErrors) -> PlainData:
    """The errors by the keys of docs/reference/json.md.

    Args:
        warm: The errors.
    """
    return {
        "states": [asdict(state) for state in warm.states],
        "torque_shares": warm.shares,
        "omega_rad_per_s": warm.omega,
        "angle_rad": warm.angle,
        "speed_rad_per_s": warm.speed,
        "angle_with_dead_time_rad": warm.angle_with_dead_time,
        "speed_with_dead_time_rad_per_s": warm.speed_with_dead_time,
    }


def _span(low: float, high: float) -> str:
    if math.isnan(low):
        return "none"
    return f"{math.degrees(low):+.0f} to {math.degrees(high):+.0f}"


def capture_table(found: CaptureMap) -> Table:
    """Starts that lock, a row per speed.

    Args:
        found: The map.
    """
    right, rest = found.angle_range(0.0), found.angle_range(-1.0)
    rows = []
    for s, omega in enumerate(found.omega.tolist()):
        times = found.lock_time[s][found.outcome[s] == LOCKED]
        slowest = f"{1e3 * float(np.max(times)):.3g}" if times.size else "-"
        rows.append(
            (
                f"{omega / _TURN:.4g}",
                _span(*right[s].tolist()),
                _span(*rest[s].tolist()),
                f"{100.0 * float(found.share[s]):.0f}",
                slowest,
            )
        )
    columns = (
        "electrical Hz",
        "right speed: angles deg",
        "speed 0: angles deg",
        "all starts %",
        "slowest ms",
    )
    speeds = f"{100.0 * found.speeds[0]:+.0f} to {100.0 * found.speeds[-1]:+.0f} %"
    off = f"starts with the angle off by up to 180 deg and the speed by {speeds}"
    ran = f"exact machine, half the largest torque; locked within {found.duration:.3g} s"
    notes = (f"{off}; {ran}",)
    return Table("Position observer: starts from which it locks", columns, tuple(rows), notes)


def plain_capture(found: CaptureMap) -> PlainData:
    """The map by the keys of docs/reference/json.md.

    Args:
        found: The map.
    """
    return {
        "omega_rad_per_s": found.omega,
        "start_angles_rad": found.angles,
        "start_speeds": found.speeds,
        "outcome": found.outcome.tolist(),
        "lock_time_s": found.lock_time,
        "duration_s": found.duration,
        "share": found.share,
        "angle_range_rad": found.angle_range(),
    }
