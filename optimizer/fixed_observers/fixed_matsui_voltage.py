"""Matsui's voltage model in integers (`dqforge.optimizer.observers.methods.matsui_voltage`)."""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, Range, rounded, scaled
from dqforge.optimizer.fixed_observers.fixed_sampled_machine import (
    ANGLE_ROOM,
    SPEED_ROOM,
    VOLT_BITS,
    FixedSampled,
    FixedShown,
    fixed_sampled,
    fixed_shown,
    half_turn_gain,
    shown_errors,
    shown_gap,
)
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    FixedMethod,
    Scales,
    TrackedState,
    Word,
    code_limits,
    gain,
    quotient,
    saturated,
    speed_limit,
    times,
    vector_words,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui_voltage import MatsuiVoltageGains

MOST_BEHIND = 16 * ONE  # Limit in codes of the low-pass speed less the one that turns the frame.


@dataclass(frozen=True, slots=True)
class FixedMatsuiVoltage:
    """Sampled machine, half a turn, what shows the errors, correction of the speed by the angle
    error and its integral, shares of the speed error and of the speed behind, limit of the speed.
    """

    model: FixedSampled
    half_turn: FixedGain
    shown: FixedShown
    k_p: FixedGain
    k_i: FixedGain
    speed_share: FixedGain
    behind_share: FixedGain
    most: int


def design(gains: MatsuiVoltageGains, scales: Scales) -> FixedMatsuiVoltage:
    """The estimator in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.
    """
    return FixedMatsuiVoltage(
        model=fixed_sampled(gains.model, scales),
        half_turn=half_turn_gain(scales),
        shown=fixed_shown(gains.shown, scales),
        k_p=gain("speed by the angle error", gains.k_p * ANGLE_ROOM / scales.speed),
        k_i=gain("its integral", gains.k_i * ANGLE_ROOM / scales.speed),
        speed_share=gain("share of the speed error", gains.speed_share * SPEED_ROOM),
        behind_share=gain("share of the speed behind", gains.speed_share, MOST_BEHIND),
        most=speed_limit(gains.omega_max, scales),
    )


def begin(
    o: Arithmetic[N, Any], gains: FixedMatsuiVoltage, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The current alone."""
    del gains, v
    return TrackedState(state.theta, state.omega, (i.x, i.y, o.const(0), o.const(0)))


def step(
    o: Arithmetic[N, Any], gains: FixedMatsuiVoltage, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    behind, integral = state.words[2], state.words[3]
    found = shown_gap(o, gains.model, gains.half_turn, state, v, i)
    e, gap, shift = found.entries, found.gap, gains.model.entries.shift

    def less(name: str, a: tuple[N, N], b: tuple[N, N]) -> N:
        part = o.total(name, o.product(name, *a), o.negative(o.product(name, *b)))
        return rounded(o, name, part, shift)

    det = less("determinant", (e[2], e[3]), (e[7], e[8]))

    def volt(value: N) -> N:
        over = quotient(o, "gap / entries", saturated(o, value), det, shift - VOLT_BITS)
        return o.negative(over)

    v_d = volt(less("gap entries", (e[3], gap.x), (e[7], gap.y)))
    v_q = volt(less("gap entries", (e[2], gap.y), (e[8], gap.x)))
    turn = found.turn
    volts = Pair(
        saturated(
            o, o.total("turned", times(o, "turned", turn.x, v_d), times(o, "turned", turn.y, v_q))
        ),
        saturated(
            o,
            o.total(
                "turned",
                times(o, "turned", turn.x, v_q),
                o.negative(times(o, "turned", turn.y, v_d)),
            ),
        ),
    )
    angle, slip = shown_errors(o, gains.shown, state.omega, volts, found.now)
    share = scaled(o, "share of the speed error", gains.speed_share, slip)
    kept = scaled(o, "share of the speed behind", gains.behind_share, behind)
    speed = o.total("speed", state.omega, behind, share, o.negative(kept))
    integral = o.clamp(
        o.total("integral", integral, scaled(o, "k_i angle", gains.k_i, angle)),
        -gains.most,
        gains.most,
    )
    asked = o.total("turning", speed, scaled(o, "k_p angle", gains.k_p, angle), integral)
    turning = o.clamp(asked, -gains.most, gains.most)
    behind = o.clamp(o.total("behind", speed, o.negative(turning)), -MOST_BEHIND, MOST_BEHIND)
    return TrackedState(found.theta, turning, (i.x, i.y, behind, integral))


def _limits(gains: FixedMatsuiVoltage) -> tuple[Range, ...]:
    return (
        *code_limits(2)(gains),
        Range(-MOST_BEHIND, MOST_BEHIND),
        Range(-gains.most, gains.most),
    )


METHOD = FixedMethod(
    name="matsui-voltage",
    code="matsui_voltage",
    gains=FixedMatsuiVoltage,
    design=design,
    words=(*vector_words("i"), Word("behind", "int64_t"), Word("integral")),
    limits=_limits,
    begin=begin,
    step=step,
)
