"""How far a speed loop on an observer is from being stable: by its gains, or by the observer's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.names import OBSERVER_KEYS
from dqforge.optimizer.loops.pi_methods import largest_factor
from dqforge.optimizer.observed_drive.design_drive import position_estimator
from dqforge.optimizer.observed_drive.fixed_points import SteadyDrives, steady_drives
from dqforge.optimizer.observed_drive.tuning_rule import has_loop
from dqforge.optimizer.observers.pll import FASTEST
from dqforge.optimizer.observers.tuning import PositionObserver, retuned

if TYPE_CHECKING:
    from dqforge.optimizer.observed_drive.drive_cases import DriveCases
    from dqforge.optimizer.observed_drive.drive_model import ObservedDrive
    from dqforge.optimizer.observed_drive.speed_range import SpeedPi

_TRIALS = 24


def largest_stable_factor(
    steady: SteadyDrives, ratio: int, slower: Callable[[float], tuple[float, float]]
) -> float | None:
    """Largest factor below one at which a loop is stable in all steady states; None without one.

    Args:
        steady: Of the drives.
        ratio: Current samples per speed sample.
        slower: (kp, ki) of the loop slowed down by a factor.
    """

    def holds(factor: float) -> bool:
        gains = slower(factor)
        return min(gains) > 0.0 and bool(np.all(steady.radius(ratio, *gains) < 1.0))

    return largest_factor(holds)


def least_pll_bandwidth(
    drive: ObservedDrive, position: PositionObserver, cases: DriveCases, speed: SpeedPi
) -> float | None:
    """Least bandwidth in rad/s above the present one of the observer's phase-locked loop with
    which a speed loop as it is becomes stable; None without one.

    Args:
        drive: With the observer as it is.
        position: The observer.
        cases: Speeds at which the loop has to be stable.
        speed: The speed controller.
    """
    if not has_loop(position) or "pll_bandwidth" not in OBSERVER_KEYS[position.method.name]:
        return None

    def stable(bandwidth: float) -> bool:
        other = retuned(position, replace(position.tuning, pll_bandwidth=bandwidth))
        moved = replace(drive, estimator=position_estimator(other))
        steady = steady_drives(moved, cases)
        return bool(np.all(steady.radius(speed.ratio, speed.kp, speed.ki) < 1.0))

    low = position.tuning.pll_bandwidth
    most = FASTEST / position.t_s
    for high in np.geomspace(low, most, _TRIALS).tolist()[1:]:
        if stable(high * (1.0 - 1e-9)):
            break
        low = high
    else:
        return None
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return float(high)
