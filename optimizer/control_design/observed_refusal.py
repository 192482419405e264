"""What is refused of a drive whose speed loop runs on a position observer or a tracker."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.observed_margins import CornerJudgement, ObservedLoop

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
        reached = f"{where} has a phase margin of {margin} at {at}, required are {required}"
        return f"{reached}; {found.advice or 'no slower loop of this method has them'}"
    parts = [f"{where} is unstable at {at} (margin {margin}, pole {found.radius[worst]:.4g})"]
    parts += [] if found.cycle is None else [found.cycle.words]
    ways = [found.stable_advice] if found.stable_advice else []
    if found.pll_least is not None:
        ways.append(f"with control.observer.pll_bandwidth = {_up(found.pll_least)} rad/s or more")
    if ways:
        parts.append(f"to be stable {', or '.join(ways)}")
    left = f"to have {required} {found.advice}" if found.advice else f"no slower one has {required}"
    return "; ".join([*parts, left])


def _up(value: float) -> str:
    """Three digits, rounded up."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return f"{np.ceil(value / unit - 1e-9) * unit:.6g}"


def _box(corners: CornerJudgement) -> str:
    if corners.named:
        return "of control.tolerances"
    return "of the usual tolerances (control.tolerances names none)"


def _require_corners(design: Design, gains: GainSet, found: ObservedLoop) -> None:
    """Refuse a loop that does not hold at every corner up to the top speed."""
    corners = found.corners
    if corners is None or corners.holds:
        return
    from dqforge.optimizer.control_design.observed_remedies import remedies

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
        least = f"{_up(low / pole_pairs * 30.0 / np.pi)} rpm"
        raise InputError(
            f"{key} is {_rpm(design, wanted.above * pole_pairs)}, but the speed loop on the "
            f"{found.observer} holds at all corners {box} from {least} on{failing}; write {least} "
            "or more"
        )
