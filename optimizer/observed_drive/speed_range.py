"""From which speed on a drive on its observer holds at every corner of its box."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.observed_margins import (
    Corner,
    CornerJudgement,
    FailingCorner,
    SpeedRange,
)
from dqforge.optimizer.observed_drive.fixed_points import steady_drives
from dqforge.optimizer.observed_drive.tolerance_corners import CornerBox, cases_of

if TYPE_CHECKING:
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observed_drive.drive_model import ObservedDrive

LEAST_SHARE = 0.02

"""Lowest speed that is tried, over the largest."""


_SPEEDS = 9


_BISECTIONS = 5


@dataclass(frozen=True, slots=True)
class SpeedPi:
    """The speed controller: ``kp`` in N m s/rad, ``ki`` in N m/rad, current samples per sample."""

    kp: float
    ki: float
    ratio: int


def worst_corner(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    corners: tuple[Corner, ...],
    omega: float,
) -> FailingCorner:
    """The corner with the largest pole at an electrical speed in rad/s.

    Parameters
    ----------
    drive:
        Control and observer.
    machine:
        As the design has it.
    speed:
        The speed controller.
    corners:
        What is tried.
    """
    steady = steady_drives(drive, cases_of(machine, corners, omega))
    radius = steady.radius(speed.ratio, speed.kp, speed.ki)
    worst = int(np.argmax(radius))
    return FailingCorner(omega, corners[worst], float(radius[worst]))


def speed_range(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    box: CornerBox,
    top: float,
    *,
    dead_time: bool = False,
    braking: bool = False,
    least: float = 0.0,
) -> SpeedRange:
    """Speeds downwards from ``top`` in rad/s (electrical) at which all corners are stable.

    The first that fails below ends the range; it is narrowed down to two percent.

    Parameters
    ----------
    drive, machine, speed:
        As of `worst_corner`.
    box:
        Whose corners are tried.
    dead_time:
        Whether what the dead time costs counts as well.
    braking:
        Whether the loads drive the shaft.
    least:
        Electrical speed in rad/s below which nothing is tried, where that lies above
        `LEAST_SHARE` of ``top``.
    """
    corners = box.corners(dead_time=dead_time, braking=braking)

    def found(omega: float) -> FailingCorner:
        return worst_corner(drive, machine, speed, corners, omega)

    low = high = float("nan")
    last: FailingCorner | None = None
    for omega in np.geomspace(top, max(LEAST_SHARE * top, least), _SPEEDS).tolist():
        last = found(omega)
        if last.radius < 1.0:
            low, high = omega, omega if np.isnan(high) else high
        elif np.isfinite(low):
            break
    assert last is not None
    if np.isnan(low) or last.radius < 1.0:
        return SpeedRange(low, high, last if np.isnan(low) else None, len(corners))
    for _ in range(_BISECTIONS):
        middle = found(float(np.sqrt(low * last.omega)))
        low, last = (middle.omega, last) if middle.radius < 1.0 else (low, middle)
    return SpeedRange(low, high, last, len(corners))


def judge_corners(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    box: CornerBox,
    top: float,
    least: float = 0.0,
) -> CornerJudgement:
    """The range of speeds at which all corners hold, motoring and braking, without and with what
    the dead time costs.

    Parameters
    ----------
    drive, machine, speed, box, top, least:
        As of `speed_range`.
    """
    exact = speed_range(drive, machine, speed, box, top, least=least)
    braking = speed_range(drive, machine, speed, box, top, braking=True, least=least)
    lossy = None
    if box.lost:
        lossy = speed_range(drive, machine, speed, box, top, dead_time=True, least=least)
    return CornerJudgement(box.named, box.limits, box.loads, exact, box.lost, lossy, braking)
