"""What is proven of the margins of a design's current loops, axis by axis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.axis_margins.box_cells import AxisBox, rational
from dqforge.optimizer.axis_margins.loop_polynomials import AxisGains
from dqforge.optimizer.axis_margins.margin_claims import (
    Claim,
    decide,
    phase_claim,
    sensitivity_claim,
)
from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
from dqforge.optimizer.loops.robustness import LoopRobustness
from dqforge.optimizer.loops.tolerance_box import BoxPoints, DriveBox

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from flint import fmpq

# Most cells per claim, of some 0.3 ms each. A loop whose gain stays near 1 over decades would take
# far more for its phase margin, and is left without a bound of it.
_BITS = 80
_SENSITIVITY_CELLS, _PHASE_CELLS = 1500, 600
_SENSITIVITY = (1.005, 1.02, 1.1)

# What is claimed: the largest M_s found times these, the least phase margin less these.
_PHASE = tuple(math.radians(value) for value in (0.25, 1.0, 3.0))


@dataclass(frozen=True, slots=True)
class ProvenMargins:
    """What holds for every drive of the box and every frequency.

    Args:
        stable: Whether all drives are proven stable.
        max_sensitivity: Bound of M_s, None where none was proven.
        phase_margin: Bound of the phase margin in rad, None where none was proven.
        cells: Cells that all of it took.
    """

    stable: bool
    max_sensitivity: float | None
    phase_margin: float | None
    cells: int


def _reach(deviations: FloatArray) -> tuple[float, float]:
    return float(np.min(deviations)), float(np.max(deviations))


def _factors(deviations: FloatArray) -> tuple[fmpq, fmpq]:
    low, high = _reach(deviations)
    return 1 + rational(low), 1 + rational(high)


def axis_box(box: DriveBox, gains: LoopGains) -> AxisBox:
    """The drives that the loop of one axis depends on.

    Args:
        box: The drive with its tolerances.
        gains: A current loop, with the inductance that it is meant for.
    """
    from flint import arb, fmpq

    design, points, name = box.design, *_points(box, gains.loop)
    r_s, t_s = rational(design.machine.r_s), rational(design.control.t_s)
    dead, sides = (fmpq(0), fmpq(0)), _reach(points.of("dead_time"))
    if sides != (0.0, 0.0):
        ohm = rational(design.inverter.f_sw) * rational(design.inverter.v_dc)
        ohm *= 4 / (rational(box.tolerances.low_current) * r_s)
        balls = [arb(ohm * rational(side)) / arb.pi() for side in sides]
        dead = balls[0].lower().fmpq(), balls[1].upper().fmpq()
    return AxisBox(
        rho=r_s * t_s / rational(_inductance(gains)),
        resistance=_factors(points.of("r_s")),
        inductance=_factors(points.of(name)),
        gain=_factors(points.of("v_dc")),
        dead_time=dead,
    )


def _points(box: DriveBox, loop: LoopName) -> tuple[BoxPoints, str]:
    """Corners of what a loop depends on, and the name of its inductance among them."""
    if loop == "i_0":
        return box.zero_points(), "l_0"
    return (
        (box.current_points("i_d"), "l_d") if loop == "i_d" else (box.current_points("i_q"), "l_q")
    )


def _inductance(gains: LoopGains) -> float:
    assert gains.inductance is not None
    return gains.inductance


def axis_gains(gains: LoopGains) -> AxisGains:
    """The gains of an axis's loop without unit.

    Args:
        gains: A current loop, with the inductance that it is meant for.
    """
    scale = rational(gains.t_s) / rational(_inductance(gains))
    return AxisGains(scale * rational(gains.kp), scale * rational(gains.ki_ts))


def nominal_is_stable(box: AxisBox, gains: AxisGains) -> bool:
    """Whether the drive of the data is stable, by Jury's conditions of its three poles.

    Args:
        box: The drives.
        gains: The loop's gains.
    """
    from flint import fmpq

    one = fmpq(1), fmpq(1)
    (a_low, a_high), (gamma_low, gamma_high) = box.sampled(one, one)
    a, gamma = _ball(a_low, a_high), _ball(gamma_low, gamma_high)
    first, second = -(1 + a), a + gamma * (gains.p + gains.q)
    last = -gamma * gains.p
    at_one, at_minus_one = 1 + first + second + last, -1 + first - second + last
    inner = (1 - last * last) - abs(second - first * last)
    return bool(at_one > 0 and at_minus_one < 0 and inner > 0 and abs(last) < 1)


def _ball(low: fmpq, high: fmpq) -> Any:
    from flint import arb

    return arb(low).union(arb(high))


def prove_margins(box: DriveBox, gains: LoopGains, found: LoopRobustness) -> ProvenMargins:
    """Bounds of M_s and phase margin of a current loop over the box, near what was found.

    M_s that is finite everywhere leaves no pole on the unit circle; the box is connected, and one
    of its drives is stable: so all are.

    Args:
        box: The drive with its tolerances.
        gains: A current loop, with the inductance that it is meant for.
        found: What corners and samples found.
    """
    from flint import ctx

    before = ctx.prec
    ctx.prec = _BITS
    try:
        drives, of_loop = axis_box(box, gains), axis_gains(gains)
        sensitivities = [_raised(found.max_sensitivity.value * more) for more in _SENSITIVITY]
        phases = [found.phase_margin.value - less for less in _PHASE]
        bound, cells = _first(
            drives,
            _SENSITIVITY_CELLS,
            sensitivities,
            lambda value: sensitivity_claim(of_loop, value),
        )
        stable = bound is not None and nominal_is_stable(drives, of_loop)
        if not stable:
            return ProvenMargins(False, None, None, cells)
        margin, more = _first(
            drives,
            _PHASE_CELLS,
            [value for value in phases if value > 0.0],
            lambda value: phase_claim(of_loop, value),
        )
    finally:
        ctx.prec = before
    return ProvenMargins(True, bound, margin, cells + more)


def _raised(value: float) -> float:
    """A bound of M_s with three decimals, none smaller."""
    return math.ceil(1e3 * value) / 1e3


def _first(
    box: AxisBox, most: int, values: Sequence[float], claim: Callable[[float], Claim]
) -> tuple[float | None, int]:
    """The first of some bounds that is proven, and the cells that it took."""
    cells = 0
    for value in values:
        decision = decide(claim(value), box, most)
        cells += decision.cells
        if decision.outcome == "proven":
            return value, cells
    return None, cells
