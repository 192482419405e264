"""Matsui's voltage model in integers (`dqforge.optimizer.observers.methods.matsui_voltage`)."""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
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
    clipped,
    code_limits,
    gain,
    quotient,
    speed_limit,
    times,
    vector_words,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui_voltage import MatsuiVoltageGains
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, Range, rounded, scaled
from dqforge.optimizer.steps.step_arithmetic import Member

MOST_BEHIND = 16 * ONE  # Limit in codes of the low-pass speed less the one that turns the frame.


@dataclass(frozen=True, slots=True)
class FixedMatsuiVoltage:
    """Matsui's voltage model in integers."""

    model: FixedSampled
    half_turn: Annotated[FixedGain, Member("angle of half a period, 2^31 codes of a radian")]
    shown: FixedShown
    k_p: Annotated[FixedGain, Member("speed by the angle error")]
    k_i: Annotated[FixedGain, Member("and its integral")]
    speed_share: Annotated[FixedGain, Member("share of the speed error")]
    behind_share: Annotated[FixedGain, Member("and of what the low-pass speed is behind")]
    most: Annotated[int, Member("limit of the speed")]


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


def gap_voltage(o: Arithmetic[N, Any], value: N, determinant: N, shift: int) -> N:
    """The voltage that the gap of a current stands for."""
    part = o.call(clipped, o.call(rounded, "gap entries", value, shift))
    over = o.call(quotient, "gap / entries", part, determinant, shift - VOLT_BITS)
    return o.negative(o.let("over", over))


def step(
    o: Arithmetic[N, Any], gains: FixedMatsuiVoltage, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    behind, integral = state.words[2], state.words[3]
    found = shown_gap(o, gains.model, gains.half_turn, state, v, i)
    e, gap, shift = found.entries, found.gap, gains.model.entries.shift

    def less(name: str, a: tuple[N, N], b: tuple[N, N]) -> N:
        return o.total(name, o.product(name, *a), o.negative(o.product(name, *b)))

    det = o.let(
        "determinant",
        o.call(rounded, "determinant", less("determinant", (e[2], e[3]), (e[7], e[8])), shift),
    )
    along = less("gap entries", (e[3], gap.x), (e[7], gap.y))
    across = less("gap entries", (e[2], gap.y), (e[8], gap.x))
    v_d = o.let("v_d", o.call(gap_voltage, along, det, shift))
    v_q = o.let("v_q", o.call(gap_voltage, across, det, shift))
    turn = found.turn
    d = o.total(
        "turned", o.call(times, "turned", turn.x, v_d), o.call(times, "turned", turn.y, v_q)
    )
    q = o.total(
        "turned",
        o.call(times, "turned", turn.x, v_q),
        o.negative(o.call(times, "turned", turn.y, v_d)),
    )
    volts = o.let("volts", Dq(o.call(clipped, d), o.call(clipped, q)))
    error = o.let("error", o.call(shown_errors, gains.shown, state.omega, volts, found.now))
    share = o.call(scaled, "share of the speed error", gains.speed_share, error.slip)
    kept = o.call(scaled, "share of the speed behind", gains.behind_share, behind)
    speed = o.let("speed", o.total("speed", state.omega, behind, share, o.negative(kept)))
    raised = o.total("integral", integral, o.call(scaled, "k_i angle", gains.k_i, error.angle))
    integral = o.let("integral", o.clamp(raised, -gains.most, gains.most))
    ahead = o.call(scaled, "k_p angle", gains.k_p, error.angle)
    asked = o.total("turning", speed, ahead, integral)
    turning = o.let("turning", o.clamp(asked, -gains.most, gains.most))
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
    words=(
        *vector_words(i="last current"),
        Word("behind", "int64_t", "low-pass speed less the one that turns the frame"),
        Word("integral", meaning="of the angle error"),
    ),
    limits=_limits,
    begin=begin,
    step=step,
)
