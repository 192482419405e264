"""What is refused of a drive whose speed loop runs on a position observer or a tracker, and what
holds instead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.sections.observer import SPEED_GAIN
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity, to_digits

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.observed_margins import CornerJudgement, ObservedLoop


# What is refused of a drive whose speed loop runs on a position observer or a tracker.

_ROUNDING = 1e-6


@on_design("control")
def require_observed(design: Design, gains: GainSet | None) -> None:
    """Refuse a speed loop that does not hold on its position observer, one that does not hold at
    every corner of the tolerances up to the top speed of the drive, and sensorless control below
    the speeds at which it does.

    Dead time is not counted: what it does to the loop is an indication.

    Args:
        design: What was tuned.
        gains: Its gains; None where it has none.

    Raises:
        NoSolutionError: The loop is unstable, has less margin than required or fails at a corner;
            says how it swings, or the corner, and what holds.
        InputError: `simulation.sensorless.above` lies below the lowest speed; names the corner.
    """
    speed = None if gains is None else gains.speed
    if gains is None or speed is None or speed.observed is None:
        return
    if gains.position is None and gains.tracker is None:
        return
    if not speed.observed.holds:
        raise NoSolutionError(_refused(design, speed.method, speed.observed))
    _require_corners(design, gains, speed.observed)
    _require_speeds(design, speed.observed, tracked=gains.tracker is not None)


def _rpm(design: Design, omega: float) -> str:
    return format_quantity(omega / design.machine.pole_pairs, "rpm", 3)


def _refused(design: Design, method: str, found: ObservedLoop) -> str:
    at, worst = _rpm(design, float(found.omega[found.worst])), found.worst
    margin = f"{np.degrees(found.phase_margin[worst]):.1f} deg"
    required = f"{np.degrees(found.required):.3g} deg"
    where = f"control.speed_loop: the speed loop by method '{method}' on the {found.observer}"
    if found.stable:
        reached = f"{where} has a phase margin of {margin} at {at}, required: {required}"
        return f"{reached}; {found.advice or 'no slower loop of this method has them'}"
    parts = [f"{where} is unstable at {at} (margin {margin}, pole {found.radius[worst]:.4g})"]
    parts += [] if found.cycle is None else [found.cycle.words]
    ways = [found.stable_advice] if found.stable_advice else []
    if found.pll_least is not None:
        least = to_digits(found.pll_least, 3, up=True)
        ways.append(f"with control.observer.pll_bandwidth = {least:.6g} rad/s or more")
    if ways:
        parts.append(f"to be stable {', or '.join(ways)}")
    left = f"to have {required} {found.advice}" if found.advice else f"no slower one has {required}"
    return "; ".join([*parts, left])


def _box(corners: CornerJudgement) -> str:
    if corners.named:
        return "of control.tolerances"
    return "of the usual tolerances (control.tolerances names none)"


def _require_corners(design: Design, gains: GainSet, found: ObservedLoop) -> None:
    """Refuse a loop that does not hold at every corner up to the top speed."""
    corners = found.corners
    if corners is None or corners.holds:
        return

    held, failing = corners.binding, corners.failing
    if held.any:
        span = f"holds from {_rpm(design, held.low)} to {_rpm(design, held.high)} only"
    else:
        span = "there is no speed at which it holds"
    at = "" if failing is None else f"; at {_rpm(design, failing.omega)} {failing.words}"
    ways = remedies(design, gains, corners)
    write = f"; write {', or '.join(ways)}" if ways else "; narrow the tolerances"
    raise NoSolutionError(
        f"control.observer: the speed loop on the {found.observer} does not hold at all corners "
        f"{_box(corners)}: {span}{at}{write}"
    )


def _require_speeds(design: Design, found: ObservedLoop, *, tracked: bool) -> None:
    """Refuse sensorless control where a corner is unstable."""
    wanted = None if design.simulation is None else design.simulation.sensorless
    corners = found.corners
    if wanted is None or corners is None:
        return
    key, box = "simulation.sensorless.above", _box(corners)
    low, below = corners.binding.low, corners.binding.below
    failing = "" if below is None else f"; below it fails {below.words}"
    pole_pairs = design.machine.pole_pairs
    if tracked and below is None:  # it may hold from rest, and nothing that is tried fails
        return
    if wanted.above * pole_pairs < low * (1.0 - _ROUNDING):
        least = f"{to_digits(in_rpm(low / pole_pairs), 3, up=True):.6g} rpm"
        raise InputError(
            f"{key} is {_rpm(design, wanted.above * pole_pairs)}, but the speed loop on the "
            f"{found.observer} holds at all corners {box} from {least} on{failing}; write {least} "
            "or more"
        )


# What holds instead of a speed loop that fails at a corner of the tolerances on its observer.

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
    from dqforge.optimizer.control_design.design_drive import (
        observed_drive,
        position_estimator,
        top_speed,
    )
    from dqforge.optimizer.control_design.speed_range import SpeedPi, corner_box, worst_corner

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
