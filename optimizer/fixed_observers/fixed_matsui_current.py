"""Matsui's current model in integers (`dqforge.optimizer.observers.methods.matsui_current`)."""

from __future__ import annotations

import math
from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.fixed_observers.fixed_matsui import (
    ANGLE_ROOM,
    SPEED_ROOM,
    VOLT_BITS,
    FixedShown,
    fixed_shown,
    half_turn_gain,
    shown_errors,
    shown_gap,
)
from dqforge.optimizer.fixed_observers.fixed_method import (
    FixedMethod,
    TrackedState,
    code_limits,
    vector_words,
)
from dqforge.optimizer.fixed_observers.fixed_sampled_machine import FixedSampled, fixed_sampled
from dqforge.optimizer.fixed_observers.kit import ONE, saturated, times, turned_by
from dqforge.optimizer.fixed_observers.scales import Scales, gain, speed_limit
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui_current import MatsuiCurrentGains

_TWO_CODES = 2 * ONE


@dataclass(frozen=True, slots=True)
class FixedMatsuiCurrent:
    """Sampled machine, half a turn, what shows the errors, voltages of a current gap, shares of
    angle and speed, half a period's angle of a speed error, limit of the speed.
    """

    model: FixedSampled
    half_turn: FixedGain
    shown: FixedShown
    g_d: FixedGain
    g_q: FixedGain
    l_theta: FixedGain
    speed_share: FixedGain
    ahead: FixedGain
    most: int


def design(gains: MatsuiCurrentGains, scales: Scales) -> FixedMatsuiCurrent:
    """The estimator in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.
    """
    volts = scales.current / (scales.voltage * 2.0**VOLT_BITS)
    return FixedMatsuiCurrent(
        model=fixed_sampled(gains.model, scales),
        half_turn=half_turn_gain(scales),
        shown=fixed_shown(gains.shown, scales),
        g_d=gain("voltage of i_d", gains.g_d * volts, _TWO_CODES),
        g_q=gain("voltage of i_q", gains.g_q * volts, _TWO_CODES),
        l_theta=gain("share of the angle error", gains.l_theta * ANGLE_ROOM / math.pi),
        speed_share=gain("share of the speed error", gains.speed_share * SPEED_ROOM),
        ahead=gain("angle of a speed error", 0.5 * scales.turn * SPEED_ROOM / ANGLE_ROOM),
        most=speed_limit(gains.omega_max, scales),
    )


def begin(
    o: Arithmetic[N, Any], gains: FixedMatsuiCurrent, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The current alone."""
    del o, gains, v
    return TrackedState(state.theta, state.omega, (i.x, i.y))


def step(
    o: Arithmetic[N, Any], gains: FixedMatsuiCurrent, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    found = shown_gap(o, gains.model, gains.half_turn, state, v, i)
    gap, turn = found.gap, found.turn
    d = o.total(
        "gap turned", times(o, "gap", turn.x, gap.x), o.negative(times(o, "gap", turn.y, gap.y))
    )
    q = o.total("gap turned", times(o, "gap", turn.x, gap.y), times(o, "gap", turn.y, gap.x))
    volts = Pair(
        saturated(o, scaled(o, "voltage difference", gains.g_d, d)),
        saturated(o, scaled(o, "voltage difference", gains.g_q, q)),
    )
    angle, slip = shown_errors(o, gains.shown, state.omega, volts, found.now)
    ahead = scaled(o, "angle of the speed error", gains.ahead, slip)
    error = saturated(o, o.total("angle error", angle, ahead))
    omega = o.total(
        "speed", state.omega, scaled(o, "share of the speed error", gains.speed_share, slip)
    )
    return TrackedState(
        turned_by(o, gains.l_theta, found.theta, error),
        o.clamp(omega, -gains.most, gains.most),
        (i.x, i.y),
    )


METHOD = FixedMethod(
    name="matsui-current",
    code="matsui_current",
    gains=FixedMatsuiCurrent,
    design=design,
    words=vector_words("i"),
    limits=code_limits(2),
    begin=begin,
    step=step,
)
