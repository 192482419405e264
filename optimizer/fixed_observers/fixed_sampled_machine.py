"""The machine from one sample to the next in integers (`optimizer.observers.sampled_gains`)."""

from __future__ import annotations

import math
from typing import Any, Generic

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded, scaled
from dqforge.optimizer.fixed_control.transforms import Codes, rotation
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    WIDTH,
    FixedMethod,
    FixedPolynomials,
    Scales,
    TrackedState,
    code,
    code_limits,
    common_scale,
    difference,
    gain,
    odd_value_of,
    predicted,
    quotient,
    saturated,
    saturated_pair,
    speed_limit,
    times,
    turned_by,
    value_of,
    vector_words,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui import ShownGains
from dqforge.optimizer.observers.methods.matsui_current import MatsuiCurrentGains
from dqforge.optimizer.observers.sampled_machine import EVEN, SampledGains

_ENTRY_BITS = 29
_VOLTS, _AMPERES = (2, 3, 7, 8), (4, 9)


@dataclass(frozen=True, slots=True)
class FixedSampled:
    """Entries of the sampled machine between codes, the even ones first; largest speed; gain that
    makes the angle of a period.
    """

    entries: FixedPolynomials
    most: int
    advance: FixedGain


def fixed_sampled(model: SampledGains, scales: Scales) -> FixedSampled:
    """The sampled machine in integers.

    Args:
        model: In double precision.
        scales: Full scales of the control.
    """
    return FixedSampled(
        common_scale("sampled machine", entry_rows(model, scales), _ENTRY_BITS),
        speed_limit(model.x_max / model.t_s, scales),
        scales.advance,
    )


def entry_rows(model: SampledGains, scales: Scales) -> list[list[float]]:
    """Coefficients of the ten entries, per unit, of rising powers of the square of the speed."""
    rows = np.reshape(model.table, (2 * EVEN, 4)) * scales.turn ** (2.0 * np.arange(4))
    rows[EVEN:] *= scales.turn
    rows[list(_VOLTS)] *= scales.voltage / scales.current
    rows[list(_AMPERES)] /= scales.current
    found: list[list[float]] = rows.tolist()
    return found


def limited_speed(o: Arithmetic[N, Any], model: FixedSampled, omega: N) -> N:
    """The speed at which the entries are taken."""
    return o.clamp(omega, -model.most, model.most)


def entries_at(o: Arithmetic[N, Any], entries: FixedPolynomials, x: N) -> list[N]:
    """Mantissas of the ten entries at a speed."""
    square = times(o, "square of the speed", x, x)
    even = [value_of(o, row, square) for row in entries.rows[:EVEN]]
    return even + [odd_value_of(o, row, square, x) for row in entries.rows[EVEN:]]


def combined_currents(o: Arithmetic[N, Any], e: list[N], i: Pair[N], v: Pair[N]) -> Pair[N]:
    """Phi i + Gamma v + h of ten mantissas: codes times their scale."""
    one = o.const(ONE)

    def row(along: N, across: N, own: N, other: N, rest: N) -> N:
        return o.total(
            "next current",
            o.product("entry i", along, i.x),
            o.product("entry i", across, i.y),
            o.product("entry v", own, v.x),
            o.product("entry v", other, v.y),
            o.product("entry", rest, one),
        )

    return Pair(row(e[0], e[5], e[2], e[7], e[4]), row(e[6], e[1], e[8], e[3], e[9]))


def next_currents(o: Arithmetic[N, Any], shift: int, e: list[N], i: Pair[N], v: Pair[N]) -> Pair[N]:
    """Currents one sample after ``i`` under the voltage ``v``, saturated; ``e`` are mantissas."""
    found = combined_currents(o, e, i, v)
    return Pair(
        saturated(o, rounded(o, "next current", found.x, shift)),
        saturated(o, rounded(o, "next current", found.y, shift)),
    )


# What Matsui's voltage and current model share in integers: what a period showed.

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


# Matsui's current model in integers (`dqforge.optimizer.observers.methods.matsui_current`).

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
