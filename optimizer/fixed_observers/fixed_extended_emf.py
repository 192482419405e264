"""Extended-EMF observer in integers (`dqforge.optimizer.observers.methods.extended_emf`)."""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.codes import rotation
from dqforge.optimizer.fixed_observers.kit import (
    WIDTH,
    FixedMethod,
    FixedPll,
    FixedPolynomials,
    Scales,
    TrackedState,
    clipped,
    clipped_vector,
    code_limits,
    common_scale,
    corrected,
    gain,
    odd_polynomial,
    polynomial,
    predicted,
    scaled_pair,
    sine_of_angle,
    size_floor,
    speed_limit,
    times,
    to_rotor,
    to_stator,
    vector_words,
    with_sign_of,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.extended_emf import EemfGains
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, rounded, scaled
from dqforge.optimizer.steps.step_arithmetic import Member

_FACTOR_BITS = 30


@dataclass(frozen=True, slots=True)
class FixedEemf:
    """Observer of the extended EMF in integers; factors are complex, the second polynomial is
    multiplied with the speed.
    """

    rho: Annotated[FixedGain, Member("pole of the filter")]
    most: Annotated[int, Member("largest speed of the factors")]
    now: Annotated[FixedPolynomials, Member("factor of i[k]")]
    last: Annotated[FixedPolynomials, Member("of i[k-1]")]
    volt: Annotated[FixedPolynomials, Member("of v")]
    psi: Annotated[FixedGain, Member("EMF without load, of the code of the speed")]
    floor: Annotated[int, Member("least EMF that counts in full, of 16 bits")]
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
    turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
    emf = o.call(scaled, "EMF of the start", gains.psi, state.omega)
    size = o.let("size", o.call(clipped, emf), "EMF without load")
    e = (
        o.negative(o.call(times, "EMF of the start", size, turn.y)),
        o.call(times, "EMF of the start", size, turn.x),
    )
    return TrackedState(state.theta, state.omega, (*e, i.x, i.y))


def by_factor(
    o: Arithmetic[N, Any], factor: FixedPolynomials, square: N, x: N, a: Pair[N]
) -> Pair[N]:
    """A vector times a factor at the speed x."""
    real = o.let("real", o.call(polynomial, factor.rows[0], square))
    odd = o.let("odd", odd_polynomial(o, factor.rows[1], square, x))
    first = o.total(
        "factor: real",
        o.product("factor", real, a.x),
        o.negative(o.product("factor", odd, a.y)),
    )
    second = o.total(
        "factor: imaginary", o.product("factor", real, a.y), o.product("factor", odd, a.x)
    )
    return Pair(
        o.call(rounded, "factor: rounded", first, factor.shift),
        o.call(rounded, "factor: rounded", second, factor.shift),
    )


def step(
    o: Arithmetic[N, Any], gains: FixedEemf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    before, last = Dq(*state.words[:2]), Pair(*state.words[2:])
    x = o.let("x", o.clamp(state.omega, -gains.most, gains.most))
    square = o.let("square", o.call(times, "square of the speed", x, x))
    advance = o.call(predicted, gains.pll.advance, o.const(0), x)
    back = o.let("back", o.call(rotation, WIDTH, advance), "the turn of a period")
    turned = o.let("turned", o.call(to_stator, o.let("before", before), back))
    kept = scaled_pair(o, "rho e", gains.rho, turned)
    now = o.let("now", o.call(by_factor, gains.now, square, x, i))
    past = o.let("past", o.call(by_factor, gains.last, square, x, last))
    volt = o.let("volt", o.call(by_factor, gains.volt, square, x, v))
    alpha = o.let("alpha", o.total("EMF", kept.x, now.x, past.x, volt.x))
    beta = o.let("beta", o.total("EMF", kept.y, now.y, past.y, volt.y))
    e = o.let("e", o.call(clipped_vector, alpha, beta))
    theta_p = o.let("theta", o.call(predicted, gains.pll.advance, state.theta, state.omega))
    turn = o.let("turn", o.call(rotation, WIDTH, theta_p))
    seen = o.let("seen", o.call(to_rotor, e, turn))
    sine = o.let("sine", o.call(sine_of_angle, seen.x, e, gains.floor))
    o.remark("the EMF turns its sign with the speed")
    error = o.let("error", with_sign_of(o, state.omega, o.negative(sine)))
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (e.x, e.y, i.x, i.y))


METHOD = FixedMethod(
    name="extended-emf",
    code="eemf",
    gains=FixedEemf,
    design=design,
    words=vector_words(e="extended EMF", i="last current"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)
