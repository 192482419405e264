"""Extended-EMF observer in integers (`dqforge.optimizer.observers.methods.extended_emf`)."""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded, scaled
from dqforge.optimizer.fixed_control.transforms import Codes, rotation
from dqforge.optimizer.fixed_observers.kit import (
    WIDTH,
    FixedMethod,
    FixedPll,
    FixedPolynomials,
    Scales,
    TrackedState,
    code_limits,
    common_scale,
    corrected,
    gain,
    odd_value_of,
    predicted,
    saturated,
    scaled_pair,
    sine_of_angle,
    size_floor,
    speed_limit,
    times,
    value_of,
    vector_words,
    with_sign_of,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.extended_emf import EemfGains

_FACTOR_BITS = 30


@dataclass(frozen=True, slots=True)
class FixedEemf:
    """Filter pole, speed limit of the factors, factors of i[k], i[k-1] and v (real, odd part),
    EMF of the start, least EMF in codes of 16 bits, loop.
    """

    rho: FixedGain
    most: int
    now: FixedPolynomials
    last: FixedPolynomials
    volt: FixedPolynomials
    psi: FixedGain
    floor: int
    pll: FixedPll


def design(gains: EemfGains, scales: Scales) -> FixedEemf:
    """The observer in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.
    """
    emf = scales.emf(gains.x_max / scales.t_s)
    x = scales.turn

    def factor(name: str, real: Any, odd: Any, base: float) -> FixedPolynomials:
        rows = (
            [c * x ** (2 * k) * base / emf for k, c in enumerate(real)],
            [c * x ** (2 * k + 1) * base / emf for k, c in enumerate(odd)],
        )
        return common_scale(name, rows, _FACTOR_BITS)

    return FixedEemf(
        rho=gain("pole of the filter", gains.rho),
        most=speed_limit(gains.x_max / scales.t_s, scales),
        now=factor("factor of the current", gains.now_r, gains.now_m, scales.current),
        last=factor("factor of the last current", gains.last_r, gains.last_m, scales.current),
        volt=factor("factor of the voltage", gains.volt_r, gains.volt_m, scales.voltage),
        psi=gain("EMF of the start", gains.psi_pm * scales.speed / emf),
        floor=size_floor(gains.floor / emf),
        pll=scales.pll(gains.pll),
    )


def begin(
    o: Arithmetic[N, Any], gains: FixedEemf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The EMF of the given angle and speed without load."""
    del v
    turn = rotation(o, WIDTH, state.theta)
    size = saturated(o, scaled(o, "EMF of the start", gains.psi, state.omega))
    e = (
        o.negative(times(o, "EMF of the start", size, turn.y)),
        times(o, "EMF of the start", size, turn.x),
    )
    return TrackedState(state.theta, state.omega, (*e, i.x, i.y))


def _by_factor(
    o: Arithmetic[N, Any], part: FixedPolynomials, square: N, x: N, a: Pair[N]
) -> Pair[N]:
    real, odd = value_of(o, part.rows[0], square), odd_value_of(o, part.rows[1], square, x)
    first = o.total(
        "factor: real",
        o.product("factor", real, a.x),
        o.negative(o.product("factor", odd, a.y)),
    )
    second = o.total(
        "factor: imaginary", o.product("factor", real, a.y), o.product("factor", odd, a.x)
    )
    return Pair(
        rounded(o, "factor: rounded", first, part.shift),
        rounded(o, "factor: rounded", second, part.shift),
    )


def step(
    o: Arithmetic[N, Any], gains: FixedEemf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    codes = Codes(o, WIDTH)
    before, last = Pair(*state.words[:2]), Pair(*state.words[2:])
    x = o.clamp(state.omega, -gains.most, gains.most)
    square = times(o, "square of the speed", x, x)
    turn = predicted(o, gains.pll.advance, o.const(0), x)
    kept = scaled_pair(o, "rho e", gains.rho, park_inverse(codes, before, rotation(o, WIDTH, turn)))
    now = _by_factor(o, gains.now, square, x, i)
    past = _by_factor(o, gains.last, square, x, last)
    volt = _by_factor(o, gains.volt, square, x, v)
    e = Pair(
        saturated(o, o.total("EMF", kept.x, now.x, past.x, volt.x)),
        saturated(o, o.total("EMF", kept.y, now.y, past.y, volt.y)),
    )
    theta_p = predicted(o, gains.pll.advance, state.theta, state.omega)
    along = park(codes, e, rotation(o, WIDTH, theta_p)).x
    error = with_sign_of(o, state.omega, o.negative(sine_of_angle(o, along, e, gains.floor)))
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (e.x, e.y, i.x, i.y))


METHOD = FixedMethod(
    name="extended-emf",
    code="eemf",
    gains=FixedEemf,
    design=design,
    words=vector_words("e", "i"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)
