"""The machine from one sample to the next in integers (`optimizer.observers.sampled_gains`)."""

from __future__ import annotations

import math
from typing import Annotated, Any, Generic, NamedTuple

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.codes import rotation
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    WIDTH,
    FixedMethod,
    FixedPolynomials,
    Scales,
    TrackedState,
    clipped,
    code,
    code_limits,
    common_scale,
    difference,
    gain,
    odd_polynomial,
    polynomial,
    predicted,
    quotient,
    speed_limit,
    times,
    to_rotor,
    turned_by,
    vector_words,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.matsui import ShownGains
from dqforge.optimizer.observers.methods.matsui_current import MatsuiCurrentGains
from dqforge.optimizer.observers.sampled_machine import EVEN, SampledGains
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, rounded, scaled
from dqforge.optimizer.steps.step_arithmetic import Member

_ENTRY_BITS = 29
_VOLTS, _AMPERES = (2, 3, 7, 8), (4, 9)


@dataclass(frozen=True, slots=True)
class FixedSampled:
    """The machine from one sample to the next: ten entries between codes, the last five times the
    speed.
    """

    entries: FixedPolynomials
    most: Annotated[int, Member("largest speed of the entries")]
    advance: Annotated[FixedGain, Member("angle of a period, of the code of the speed")]


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


def entries_at(o: Arithmetic[N, Any], entries: FixedPolynomials, square: N, x: N) -> list[N]:
    """Mantissas of the ten entries at a speed with its square."""
    even = [o.call(polynomial, row, square) for row in entries.rows[:EVEN]]
    return even + [odd_polynomial(o, row, square, x) for row in entries.rows[EVEN:]]


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


def next_currents(o: Arithmetic[N, Any], shift: int, e: list[N], i: Pair[N], v: Pair[N]) -> Dq[N]:
    """Currents one sample after ``i`` under the voltage ``v``, saturated; ``e`` are mantissas."""
    found = combined_currents(o, e, i, v)
    return Dq(
        o.call(clipped, o.call(rounded, "next current", found.x, shift)),
        o.call(clipped, o.call(rounded, "next current", found.y, shift)),
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
    """What tells the errors that a voltage difference shows."""

    salient: Annotated[FixedGain, Member("L_d - L_q, to codes of the flux linkage")]
    psi_pm: int
    least: Annotated[int, Member("square of the speed below which the angle is corrected less")]
    bits: Annotated[int, Member("fractional bits of omega / (omega^2 + least)"), "uint32_t"]
    angle: Annotated[FixedGain, Member("error of the angle, 2^31 codes of 16 rad, of its ratio")]
    slip: Annotated[FixedGain, Member("error of the speed, 2^31 codes of 8 full scales")]


class Errors(NamedTuple, Generic[N]):
    """Errors of one sample."""

    angle: Annotated[N, Member("2^31 codes of 16 rad")]
    slip: Annotated[N, Member("2^31 codes of 8 full scales of the speed")]


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


def flux_ratio(o: Arithmetic[N, Any], value: N, size: N) -> N:
    """A product of flux linkage and voltage over the square of the flux linkage."""
    part = o.call(clipped, o.call(rounded, "flux v", value, WIDTH - 1))
    return o.call(quotient, "v / flux", part, size, RATIO_BITS)


def shown_errors(
    o: Arithmetic[N, Any], shown: FixedShown, omega: N, v: Dq[N], i: Dq[N]
) -> Errors[N]:
    """Errors of angle and speed that a voltage difference shows."""
    cross = o.let("cross", o.call(clipped, o.call(scaled, "cross flux", shown.salient, i.y)))
    own = o.call(scaled, "active flux", shown.salient, i.x)
    active = o.let("active", o.call(clipped, o.total("active flux", own, o.const(shown.psi_pm))))
    size = o.let(
        "size",
        o.total(
            "square of the flux",
            o.call(times, "flux^2", active, active),
            o.call(times, "flux^2", cross, cross),
        ),
    )
    across = o.total(
        "flux v",
        o.product("flux v", cross, v.y),
        o.negative(o.product("flux v", active, v.x)),
    )
    along = o.total("flux v", o.product("flux v", active, v.y), o.product("flux v", cross, v.x))
    least = o.const(shown.least)
    square = o.total("omega^2 + least^2", o.call(times, "omega^2", omega, omega), least)
    share = o.let("share", o.call(quotient, "1 / omega", omega, square, shown.bits))
    ratio = o.let("ratio", o.call(flux_ratio, across, size))
    fine = o.call(rounded, "angle ratio", o.product("angle ratio", ratio, share), _PRODUCT_SHIFT)
    angle = o.call(scaled, "angle error", shown.angle, o.call(clipped, fine))
    slip = o.call(scaled, "speed error", shown.slip, o.call(flux_ratio, along, size))
    return Errors(o.call(clipped, angle), o.call(clipped, slip))


@dataclass(frozen=True, slots=True)
class ShownGap(Generic[N]):
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn,
    current gap.
    """

    theta: N
    now: Dq[N]
    entries: list[N]
    turn: Pair[N]
    gap: Dq[N]


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
    before = o.let("before", o.call(rotation, WIDTH, state.theta))
    theta = o.let("theta", o.call(predicted, model.advance, state.theta, state.omega))
    ahead = o.let("ahead", o.call(rotation, WIDTH, theta))
    now = o.let("now", o.call(to_rotor, i, ahead))
    x = o.let("x", limited_speed(o, model, state.omega))
    square = o.let("square", o.call(times, "square of the speed", x, x))
    e = o.let("e", entries_at(o, model.entries, square, x))
    last = o.let("last", o.call(to_rotor, Pair(*state.words[:2]), before))
    u = o.let("u", o.call(to_rotor, v, before))
    foretold = o.let("foretold", next_currents(o, model.entries.shift, e, last, u))
    half = o.let("half", o.call(clipped, o.call(scaled, "half of the turn", half_turn, x)))
    fall = o.shifted(o.call(times, "half^2", half, half), 1)
    rest = o.total("cosine of half the turn", o.const(ONE), o.negative(fall))
    cosine = o.let("cosine", o.call(clipped, rest), "of half the turn")
    apart = difference(o, "gap of the current", now, foretold)
    gap = o.let("gap", Dq(o.call(clipped, apart.x), o.call(clipped, apart.y)))
    return ShownGap(theta, now, e, Pair(cosine, half), gap)


def half_turn_gain(scales: Scales) -> FixedGain:
    """From codes of the speed to the angle of half a period in codes of a radian."""
    return gain("angle of half a period", 0.5 * scales.turn)


# Matsui's current model in integers (`dqforge.optimizer.observers.methods.matsui_current`).

_TWO_CODES = 2 * ONE


@dataclass(frozen=True, slots=True)
class FixedMatsuiCurrent:
    """Matsui's current model in integers."""

    model: FixedSampled
    half_turn: Annotated[FixedGain, Member("angle of half a period, 2^31 codes of a radian")]
    shown: FixedShown
    g_d: Annotated[FixedGain, Member("voltages of a current gap")]
    g_q: FixedGain
    l_theta: Annotated[FixedGain, Member("share of the angle error")]
    speed_share: Annotated[FixedGain, Member("of the speed error")]
    ahead: Annotated[FixedGain, Member("angle of a speed error in half a period")]
    most: Annotated[int, Member("limit of the speed")]


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
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    found = shown_gap(o, gains.model, gains.half_turn, state, v, i)
    gap, turn = found.gap, found.turn
    d = o.total(
        "gap turned",
        o.call(times, "gap", turn.x, gap.x),
        o.negative(o.call(times, "gap", turn.y, gap.y)),
    )
    q = o.total(
        "gap turned", o.call(times, "gap", turn.x, gap.y), o.call(times, "gap", turn.y, gap.x)
    )
    volts = o.let(
        "volts",
        Dq(
            o.call(clipped, o.call(scaled, "voltage difference", gains.g_d, d)),
            o.call(clipped, o.call(scaled, "voltage difference", gains.g_q, q)),
        ),
    )
    error = o.let("error", o.call(shown_errors, gains.shown, state.omega, volts, found.now))
    ahead = o.call(scaled, "angle of the speed error", gains.ahead, error.slip)
    both = o.let("both", o.call(clipped, o.total("angle error", error.angle, ahead)))
    share = o.call(scaled, "share of the speed error", gains.speed_share, error.slip)
    omega = o.total("speed", state.omega, share)
    return TrackedState(
        o.call(turned_by, gains.l_theta, found.theta, both),
        o.clamp(omega, -gains.most, gains.most),
        (i.x, i.y),
    )


METHOD = FixedMethod(
    name="matsui-current",
    code="matsui_current",
    gains=FixedMatsuiCurrent,
    design=design,
    words=vector_words(i="last current"),
    limits=code_limits(2),
    begin=begin,
    step=step,
)
