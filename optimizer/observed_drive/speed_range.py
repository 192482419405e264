"""From which speed on a drive on its observer holds at every corner of its box."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.observed_margins import (
    Corner,
    CornerJudgement,
    FailingCorner,
    Failure,
    SpeedRange,
)
from dqforge.optimizer.observed_drive.fixed_points import SteadyDrives, steady_drives
from dqforge.optimizer.observed_drive.tolerance_corners import CornerBox, cases_of

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observed_drive.drive_model import ObservedDrive

LEAST_SHARE = 0.02  # Lowest speed that is tried, over the largest.

# Least rates at which modes die away at every corner: those that swing over the bandwidth kp/J of
# the speed loop, all of them over the rate ki/kp of its integral. What takes longer does not hold.
SWINGING, CREEPING = 0.1, 0.3
_SPEEDS = 9
_BISECTIONS = 5


@dataclass(frozen=True, slots=True)
class SpeedPi:
    """The speed controller: ``kp`` in N m s/rad, ``ki`` in N m/rad, current samples per sample."""

    kp: float
    ki: float
    ratio: int


def settling(steady: SteadyDrives, speed: SpeedPi, inertia: float) -> FloatArray:
    """How fast the slowest mode dies away, over the least rate that counts as holding, shape (M,).

    Args:
        steady: Drives.
        speed: The speed controller.
        inertia: As the design has it, in kg m^2.
    """
    swings, every = steady.decay(speed.ratio, speed.kp, speed.ki)
    return np.minimum(
        swings * inertia / (SWINGING * speed.kp), every * speed.kp / (CREEPING * speed.ki)
    )


def worst_corner(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    corners: tuple[Corner, ...],
    omega: float,
    limits: tuple[float, float] = (np.inf, np.inf),
) -> FailingCorner:
    """The corner that fails at an electrical speed in rad/s; that with the largest pole where none
    does.

    Args:
        drive: Control and observer.
        machine: As the design has it.
        speed: The speed controller.
        corners: What is tried.
        limits: Phase amplitude in V that the link has, and largest relative error of the speed.
            Corners without the voltage count only where no other one is unstable.
    """
    steady = steady_drives(drive, cases_of(machine, corners, omega))
    radius = steady.radius(speed.ratio, speed.kp, speed.ki)
    rate = settling(steady, speed, machine.inertia or 1.0)
    volts = np.hypot(steady.states[:, 5], steady.states[:, 6])
    error = np.where(steady.found, np.abs(steady.speed_error) / omega, 0.0)
    lacking = steady.found & (volts > limits[0])
    reached, slow = np.where(lacking, 0.0, radius), np.where(lacking, np.inf, rate)
    worst = int(np.argmax(reached))
    why: Failure | None = None
    if reached[worst] >= 1.0:
        why = "unstable"
    elif np.min(slow) < 1.0:
        worst, why = int(np.argmin(slow)), "unstable"
    elif np.max(error) > limits[1]:
        worst, why = int(np.argmax(error)), "speed-error"
    elif np.any(lacking):
        worst, why = int(np.argmax(np.where(lacking, volts, 0.0))), "voltage"
    most = float(np.max(error))
    return FailingCorner(omega, corners[worst], float(radius[worst]), most, why, float(rate[worst]))


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
    """Speeds downwards from ``top`` in rad/s (electrical) at which all corners hold.

    The first that fails below ends the range; both ends are narrowed down to two percent.

    Args:
        drive, machine, speed: As of `worst_corner`.
        box: Whose corners are tried, with its limits of voltage and speed error.
        dead_time: Whether what the dead time costs counts as well.
        braking: Whether the loads drive the shaft.
        least: Electrical speed in rad/s below which nothing is tried, where that lies above
            `LEAST_SHARE` of ``top``.
    """
    corners = box.corners(dead_time=dead_time, braking=braking)
    limits = (box.v_max, box.most_error)

    def found(omega: float) -> FailingCorner:
        return worst_corner(drive, machine, speed, corners, omega, limits)

    below: FailingCorner | None = None
    failed: list[FailingCorner] = []
    held: list[FailingCorner] = []
    for omega in np.geomspace(top, max(LEAST_SHARE * top, least), _SPEEDS).tolist():
        tried = found(omega)
        if tried.why is None:
            held.append(tried)
        elif held:
            below = tried
            break
        else:
            failed.append(tried)
    if not held:
        return SpeedRange(np.nan, np.nan, failed[-1], len(corners), failed[0])
    high, low, above = held[0], held[-1], None
    if failed:
        high, above = _narrowed(found, high, failed[-1])
    if below is not None:
        low, below = _narrowed(found, low, below)
    error = max(each.speed_error for each in (high, low, *held))
    return SpeedRange(low.omega, high.omega, below, len(corners), above, error)


def _narrowed(
    found: Callable[[float], FailingCorner], inside: FailingCorner, outside: FailingCorner
) -> tuple[FailingCorner, FailingCorner]:
    """The end of a range between a speed that holds and one that fails, by bisection."""
    for _ in range(_BISECTIONS):
        middle = found(float(np.sqrt(inside.omega * outside.omega)))
        inside, outside = (middle, outside) if middle.why is None else (inside, middle)
    return inside, outside


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

    Args:
        drive, machine, speed, box, top, least: As of `speed_range`.
    """
    exact = speed_range(drive, machine, speed, box, top, least=least)
    braking = speed_range(drive, machine, speed, box, top, braking=True, least=least)
    lossy = None
    if box.lost:
        lossy = speed_range(drive, machine, speed, box, top, dead_time=True, least=least)
    return CornerJudgement(
        box.named,
        box.limits,
        box.loads,
        exact,
        box.lost,
        lossy,
        braking,
        most_error=box.most_error,
        pole_pairs=machine.pole_pairs,
    )
