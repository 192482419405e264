"""What Matsui's voltage and current model share in integers: what a period showed."""

from __future__ import annotations

import math
from typing import Any, Generic

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.fixed_control.transforms import Codes, rotation
from dqforge.optimizer.fixed_observers.fixed_method import TrackedState
from dqforge.optimizer.fixed_observers.fixed_sampled_machine import (
    FixedSampled,
    entries_at,
    limited_speed,
    next_currents,
)
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    WIDTH,
    difference,
    predicted,
    quotient,
    saturated,
    saturated_pair,
    times,
)
from dqforge.optimizer.fixed_observers.scales import Scales, code, gain
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui import ShownGains

# Full scale of a voltage difference is 2^3 times that of the voltage: noise of the currents, over a
# period, makes much of it.
VOLT_BITS = 3
ANGLE_ROOM = 16.0  # Full scale in rad of an angle error of one sample.
SPEED_ROOM = 8.0  # Full scale of a speed error of one sample over that of the speed.
RATIO_BITS = 27  # Fractional bits of a voltage difference over a flux linkage, both per unit.
_MOST_SHARE_BITS = 28
_PRODUCT_SHIFT = 28


@dataclass(frozen=True, slots=True)
class FixedShown:
    """What tells the errors: ``salient`` and ``psi_pm`` to and in codes of the flux linkage, square
    of the least speed, fractional ``bits`` of omega / (omega^2 + least^2), and gains from ratios to
    errors of angle and speed, 2^31 codes of `ANGLE_ROOM` and of `SPEED_ROOM`.
    """

    salient: FixedGain
    psi_pm: int
    least: int
    bits: int
    angle: FixedGain
    slip: FixedGain


def fixed_shown(shown: ShownGains, scales: Scales) -> FixedShown:
    """The gains in integers.

    Args:
        shown: In double precision.
        scales: Full scales of the control.
    """
    least = shown.omega_min_2 / scales.speed**2
    # The share is largest, 1/(2 sqrt(least)), at the least speed.
    bits = min(_MOST_SHARE_BITS, math.floor(31.0 + 0.5 * math.log2(max(4.0 * least, 1e-15)) - 1e-9))
    speed = 2.0**VOLT_BITS * scales.voltage / (scales.flux * scales.speed)
    # Ratio and share leave 2^(RATIO_BITS + bits) codes, of which a shift takes its part.
    left = RATIO_BITS + bits - _PRODUCT_SHIFT
    return FixedShown(
        salient=gain("L_d - L_q", shown.salient * scales.current / scales.flux),
        psi_pm=code("psi_pm", shown.psi_pm / scales.flux),
        least=max(1, round(least * ONE)),
        bits=bits,
        angle=gain("angle that shows", speed * ONE / 2.0**left / ANGLE_ROOM),
        slip=gain("speed that shows", speed * ONE / 2.0**RATIO_BITS / SPEED_ROOM),
    )


def shown_errors(
    o: Arithmetic[N, Any], shown: FixedShown, omega: N, v: Pair[N], i: Pair[N]
) -> tuple[N, N]:
    """Errors of angle and speed that a voltage difference shows."""
    cross = saturated(o, scaled(o, "cross flux", shown.salient, i.y))
    active = saturated(
        o,
        o.total("active flux", scaled(o, "active flux", shown.salient, i.x), o.const(shown.psi_pm)),
    )
    size = o.total(
        "square of the flux", times(o, "flux^2", active, active), times(o, "flux^2", cross, cross)
    )
    across = o.total(
        "flux v",
        o.product("flux v", cross, v.y),
        o.negative(o.product("flux v", active, v.x)),
    )
    along = o.total("flux v", o.product("flux v", active, v.y), o.product("flux v", cross, v.x))

    def ratio(value: N) -> N:
        part = saturated(o, rounded(o, "flux v", value, WIDTH - 1))
        return quotient(o, "v / flux", part, size, RATIO_BITS)

    square = o.total("omega^2 + least^2", times(o, "omega^2", omega, omega), o.const(shown.least))
    share = quotient(o, "1 / omega", omega, square, shown.bits)
    fine = saturated(
        o, rounded(o, "angle ratio", o.product("angle ratio", ratio(across), share), _PRODUCT_SHIFT)
    )
    return (
        saturated(o, scaled(o, "angle error", shown.angle, fine)),
        saturated(o, scaled(o, "speed error", shown.slip, ratio(along))),
    )


@dataclass(frozen=True, slots=True)
class ShownGap(Generic[N]):
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn,
    current gap.
    """

    theta: N
    now: Pair[N]
    entries: list[N]
    turn: Pair[N]
    gap: Pair[N]


def shown_gap(
    o: Arithmetic[N, Any],
    model: FixedSampled,
    half_turn: FixedGain,
    state: TrackedState[N],
    v: Pair[N],
    i: Pair[N],
) -> ShownGap[N]:
    """What the period before a sample showed.

    Args:
        o: The arithmetic.
        model, half_turn: The sampled machine, and what makes the angle of half a period, 2^31 codes
            of a radian.
        state: Before the sample; its first two words are the last current.
        v, i: Voltage that acted over the period, current at its end, in codes.
    """
    codes = Codes(o, WIDTH)
    turn = rotation(o, WIDTH, state.theta)
    theta = predicted(o, model.advance, state.theta, state.omega)
    now = park(codes, i, rotation(o, WIDTH, theta))
    x = limited_speed(o, model, state.omega)
    e = entries_at(o, model.entries, x)
    last = park(codes, Pair(*state.words[:2]), turn)
    foretold = next_currents(o, model.entries.shift, e, last, park(codes, v, turn))
    half = saturated(o, scaled(o, "half of the turn", half_turn, x))
    square = o.shifted(times(o, "half^2", half, half), 1)
    cosine = saturated(o, o.total("cosine of half the turn", o.const(ONE), o.negative(square)))
    gap = saturated_pair(o, difference(o, "gap of the current", now, foretold))
    return ShownGap(theta, now, e, Pair(cosine, half), gap)


def half_turn_gain(scales: Scales) -> FixedGain:
    """From codes of the speed to the angle of half a period in codes of a radian."""
    return gain("angle of half a period", 0.5 * scales.turn)
