"""What holds instead of a speed loop that fails at a corner of the tolerances on its observer."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.sections.observer import SPEED_GAIN
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import DqforgeError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.observed_margins import CornerJudgement

_METHODS: tuple[ObserverMethodName, ...] = ("flux", "extended-emf")


_TRIED_AT = (1.0, 0.4)  # shares of the top speed


_HALVINGS = 6


def remedies(design: Design, gains: GainSet, found: CornerJudgement) -> list[str]:
    """What to write, as far as it is found; each was tried.

    Args:
        design: With a speed loop that does not hold at every corner.
        gains: Its gains.
        found: Where they hold.
    """
    from dqforge.optimizer.control_design.measured_speed_loop import held_by_corners, slower_advice

    ways = []
    held, failing = found.binding, found.failing
    if held.any:
        most = format_quantity(np.floor(held.high / design.machine.pole_pairs), "rad/s", 4)
        ways.append(f"machine.max_speed of {most} or less")
    if failing is not None and failing.why == "speed-error":
        percent = np.ceil(1e3 * failing.speed_error) / 10.0
        ways.append(f"control.observer.max_speed_error of {percent:.4g} % or more")
    if gains.position is None:
        return ways
    settings, speed = design.control.speed_loop, gains.speed
    assert settings is not None
    assert speed is not None
    loops = (gains.i_d, gains.i_q, speed)
    if not settings.counts_observer:
        factor = held_by_corners(design, loops, gains.position)
        if factor is not None and factor < 1.0:
            ways.append(slower_advice(design, loops, gains.position, factor))
    share = _narrower(design, gains)
    if share > 0.0:
        ways.append(
            f"tolerances of {100.0 * share:.3g} % of these (control.tolerances) or narrower"
        )
    method = _other_method(design)
    return ways if method is None else [*ways, f"control.observer.method: {method}"]


def _narrower(design: Design, gains: GainSet) -> float:
    """Largest share of all tolerances at which the loop holds, 0 without one."""
    from dqforge.optimizer.observed_drive.design_drive import (
        observed_drive,
        position_estimator,
        top_speed,
    )
    from dqforge.optimizer.observed_drive.speed_range import SpeedPi, corner_box, worst_corner

    box, settings, speed = corner_box(design), design.control.speed_loop, gains.speed
    assert settings is not None
    assert speed is not None
    assert gains.position is not None
    drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
    pi = SpeedPi(speed.kp, speed.ki, settings.ratio)

    def holds(share: float) -> bool:
        limits = {name: (share * low, share * high) for name, (low, high) in box.limits.items()}
        narrow = replace(box, limits=limits)
        corners = (
            *narrow.corners(dead_time=False),
            *narrow.corners(dead_time=False, braking=True),
        )
        bounds = (np.inf, box.most_error)
        return all(
            worst_corner(
                drive, linearised(design.machine), pi, corners, part * top_speed(design), bounds
            ).why
            is None
            for part in _TRIED_AT
        )

    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _other_method(design: Design) -> ObserverMethodName | None:
    """A method of observing with which the design holds as it is; None without one."""
    from dqforge.optimizer.control_design.gain_set import solve_gains

    own = design.control.observer
    assert own is not None
    for method in _METHODS:
        gain = SPEED_GAIN if method == "flux" else None
        other = ObserverSettings(
            method=method, speed_gain=gain, max_speed_error=own.max_speed_error
        )
        if method == own.method:
            continue
        try:
            gains = solve_gains(replace(design, control=replace(design.control, observer=other)))
        except DqforgeError:
            continue
        observed = None if gains.speed is None else gains.speed.observed
        if observed is None or observed.corners is None:
            continue
        if observed.holds and observed.corners.holds:
            return method
    return None
