"""Sliding-mode observer in integers (`dqforge.optimizer.observers.methods.smo`).

Codes of the current error have their own full scale, at least four times the boundary layer and
that of the current; those of the filter end where the switched voltage can bring it.
"""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.codes import rotation
from dqforge.optimizer.fixed_observers.fixed_extended_emf import by_factor
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
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
    difference,
    gain,
    odd_polynomial,
    polynomial,
    predicted,
    quotient_by_length,
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
from dqforge.optimizer.observers.methods.smo import SmoGains
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, scaled
from dqforge.optimizer.steps.step_arithmetic import Member

_FACTOR_BITS = 30
_TWO_CODES = 2 * ONE
_ROOM = 4.0  # Full scale of the current error over the larger of layer and current.
_WORD = 2**15  # Codes of 16 bits of full scale.
_FILTER_ROOM = 1.25  # Full scale of the filter over what the switched voltage can make it.
_TWELFTH = round(ONE / 12)


@dataclass(frozen=True, slots=True)
class FixedDrop:
    """The factor R + j omega (L_q - L_d) times t_s / L_d."""

    real: Annotated[FixedGain, Member("real part")]
    turn: Annotated[FixedGain, Member("imaginary part, of the code of the speed")]


@dataclass(frozen=True, slots=True)
class FixedSmo:
    """A switched current model in integers, its filter, what takes their lag back, and a loop."""

    most: Annotated[int, Member("largest speed of the factors")]
    half_current: Annotated[FixedGain, Member("mean current, of the sum of two")]
    current: Annotated[FixedGain, Member("change of the current")]
    volt: Annotated[FixedGain, Member("current error of a voltage")]
    drop: FixedDrop
    turn: Annotated[FixedGain, Member("angle of a period in rad, of the code of the speed")]
    keep: Annotated[FixedGain, Member("of the current error")]
    switched: Annotated[FixedGain, Member("current error by the largest switched voltage")]
    layer: Annotated[int, Member("boundary layer, of 16 bits")]
    rho: Annotated[FixedGain, Member("pole of the filter")]
    share: Annotated[FixedGain, Member("of the switched voltage in the filter")]
    lag: Annotated[FixedPolynomials, Member("what takes the lag back")]
    psi: Annotated[FixedGain, Member("EMF without load, of the code of the speed")]
    begun: Annotated[FixedGain, Member("current error of the start, of what the filter took in")]
    floor: Annotated[int, Member("least EMF that counts in full, of 16 bits")]
    pll: FixedPll


def design(gains: SmoGains, scales: Scales) -> FixedSmo:
    """The observer in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.
    """
    omega_max = gains.x_max / scales.t_s
    # The layer is a whole number of codes of 16 bits: its slope is that of the loop.
    layer = max(1, int(_WORD * gains.layer / (_ROOM * max(gains.layer, scales.current))))
    current = gains.layer * _WORD / layer
    emf = max(scales.emf(omega_max), gains.switched)
    q = 1.0 - gains.volt / gains.slope
    filtered = _FILTER_ROOM * gains.share * gains.switched / (1.0 - gains.rho)
    x = scales.turn
    rows = (
        [c * x ** (2 * k) * filtered / emf for k, c in enumerate(gains.lag_r)],
        [c * x ** (2 * k + 1) * filtered / emf for k, c in enumerate(gains.lag_m)],
    )
    return FixedSmo(
        most=speed_limit(omega_max, scales),
        half_current=gain("mean current", 0.5 * scales.current / current, _TWO_CODES),
        current=gain("change of the current", scales.current / current, _TWO_CODES),
        volt=gain("current of a voltage", gains.volt * scales.voltage / current),
        drop=FixedDrop(gain("drop", gains.drop), gain("saliency", gains.saliency * x)),
        turn=gain("angle of a period", x),
        keep=gain("kept current error", gains.keep),
        switched=gain("switched voltage", gains.volt * gains.switched / current),
        layer=layer,
        rho=gain("pole of the filter", gains.rho),
        share=gain("share in the filter", gains.share * gains.switched / filtered),
        lag=common_scale("lag", rows, _FACTOR_BITS),
        psi=gain("EMF of the start", gains.psi_pm * scales.speed / emf),
        begun=gain("start", _FILTER_ROOM * q * gains.layer / ((1.0 - gains.rho) * current)),
        floor=size_floor(gains.floor / emf),
        pll=scales.pll(gains.pll),
    )


def begin(
    o: Arithmetic[N, Any], gains: FixedSmo, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """What a steady drive without load would have left at the given angle and speed."""
    del v
    turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
    emf = o.call(scaled, "EMF of the start", gains.psi, state.omega)
    size = o.let("size", o.call(clipped, emf), "EMF without load")
    x = o.let("x", o.clamp(state.omega, -gains.most, gains.most))
    square = o.let("square", o.call(times, "square of the speed", x, x))
    real = o.let("real", o.call(polynomial, gains.lag.rows[0], square))
    odd = o.let("odd", odd_polynomial(o, gains.lag.rows[1], square, x))
    lag = o.total("|c|^2", o.product("|c|^2", real, real), o.product("|c|^2", odd, odd))
    most = 1 << (2 * WIDTH - 2)
    whole = o.let("whole", o.shifted(lag, gains.lag.shift))
    over = o.let("over", o.clamp(whole, 1, most), "squared lag")
    e_alpha = o.let("e_alpha", o.negative(o.call(times, "EMF of the start", size, turn.y)))
    e_beta = o.let("e_beta", o.call(times, "EMF of the start", size, turn.x))
    along = o.total("conj(c) e", o.product("c e", real, e_alpha), o.product("c e", odd, e_beta))
    across = o.total(
        "conj(c) e", o.product("c e", real, e_beta), o.negative(o.product("c e", odd, e_alpha))
    )
    filtered = o.let(
        "filtered",
        o.call(clipped_vector, o.quotient("e / c", along, over), o.quotient("e / c", across, over)),
    )
    o.remark("what came into the filter in the last period")
    advance = o.call(predicted, gains.pll.advance, o.const(0), o.negative(x))
    back = o.let("back", o.call(rotation, WIDTH, advance), "the turn of a period, backwards")
    before = o.let("before", o.call(to_stator, o.let("own", Dq(*filtered)), back))
    kept = scaled_pair(o, "rho e", gains.rho, before)
    apart = difference(o, "taken in", filtered, kept)
    taken = o.let("taken", o.call(clipped_vector, apart.x, apart.y))
    gap = scaled_pair(o, "current error of the start", gains.begun, taken)
    rest = o.let("rest", o.call(clipped_vector, gap.x, gap.y))
    return TrackedState(state.theta, state.omega, (rest.x, rest.y, *filtered, i.x, i.y))


def dropped(
    o: Arithmetic[N, Any], drop: FixedDrop, omega: N, name: str, vector: Pair[N]
) -> Pair[N]:
    """A vector times the factor of the voltage drop at a speed."""
    own = scaled_pair(o, f"drop of {name}", drop.real, vector)
    with_speed = Pair(
        o.call(times, f"omega {name}", omega, vector.x),
        o.call(times, f"omega {name}", omega, vector.y),
    )
    across = scaled_pair(o, f"turned drop of {name}", drop.turn, with_speed)
    return o.call(
        clipped_vector,
        o.total(f"drop of {name}", own.x, o.negative(across.y)),
        o.total(f"drop of {name}", own.y, across.x),
    )


def mean_emf(
    o: Arithmetic[N, Any], gains: FixedSmo, omega: N, v: Pair[N], last: Pair[N], i: Pair[N]
) -> Pair[N]:
    """Mean EMF of a period in codes of the current error that it makes."""
    both = Pair(o.total("both currents", last.x, i.x), o.total("both currents", last.y, i.y))
    half = scaled_pair(o, "mean current", gains.half_current, both)
    mean = o.let("mean", o.call(clipped_vector, half.x, half.y))
    apart = difference(o, "change of the current", i, last)
    own = scaled_pair(o, "change of the current, scaled", gains.current, apart)
    change = o.let("change", o.call(clipped_vector, own.x, own.y))
    lost = o.let("lost", o.call(dropped, gains.drop, omega, "mean", mean))
    volts = scaled_pair(o, "current of the voltage", gains.volt, v)
    first = o.let(
        "first",
        o.call(
            clipped_vector,
            o.total("first", volts.x, o.negative(lost.x), o.negative(change.x)),
            o.total("first", volts.y, o.negative(lost.y), o.negative(change.y)),
        ),
    )
    bent = o.let("bent", o.call(dropped, gains.drop, omega, "change", change))
    around = scaled_pair(
        o,
        "turned by a period",
        gains.turn,
        Pair(
            o.call(times, "omega first", omega, first.x),
            o.call(times, "omega first", omega, first.y),
        ),
    )
    ends = o.let(
        "ends",
        o.call(
            clipped_vector,
            o.total("ends", bent.x, o.negative(around.y)),
            o.total("ends", bent.y, around.x),
        ),
    )
    end = o.let("end", o.call(dropped, gains.drop, omega, "ends", ends))
    twelfth = o.const(_TWELFTH)
    return o.call(
        clipped_vector,
        o.total("mean EMF", first.x, o.negative(o.call(times, "end / 12", end.x, twelfth))),
        o.total("mean EMF", first.y, o.negative(o.call(times, "end / 12", end.y, twelfth))),
    )


def step(
    o: Arithmetic[N, Any], gains: FixedSmo, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    rest, before, last = (Pair(*state.words[k : k + 2]) for k in (0, 2, 4))
    x = o.let("x", o.clamp(state.omega, -gains.most, gains.most))
    u = o.let("u", o.call(mean_emf, gains, x, v, last, i))
    alpha, beta = o.total("gap", rest.x, u.x), o.total("gap", rest.y, u.y)
    gap = o.let("gap", o.call(clipped_vector, alpha, beta), "modelled minus measured current")
    z = o.let(
        "z", o.call(quotient_by_length, gap, gains.layer), "switched voltage over the largest"
    )
    taken = scaled_pair(o, "share z", gains.share, z)
    kept = scaled_pair(o, "rho e", gains.rho, before)
    filtered = o.let(
        "filtered",
        o.call(
            clipped_vector,
            o.total("filter", kept.x, taken.x),
            o.total("filter", kept.y, taken.y),
        ),
    )
    square = o.let("square", o.call(times, "square of the speed", x, x))
    whole = o.let("whole", o.call(by_factor, gains.lag, square, x, filtered))
    e = o.let("e", o.call(clipped_vector, whole.x, whole.y))
    theta_p = o.let("theta", o.call(predicted, gains.pll.advance, state.theta, state.omega))
    turn = o.let("turn", o.call(rotation, WIDTH, theta_p))
    seen = o.let("seen", o.call(to_rotor, e, turn))
    sine = o.let("sine", o.call(sine_of_angle, seen.x, e, gains.floor))
    o.remark("the EMF turns its sign with the speed")
    error = o.let("error", with_sign_of(o, state.omega, o.negative(sine)))
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    own = scaled_pair(o, "kept current error", gains.keep, gap)
    driven = scaled_pair(o, "switched voltage", gains.switched, z)
    after = difference(o, "rest", own, driven)
    left = o.let("left", o.call(clipped_vector, after.x, after.y))
    return TrackedState(theta, omega, (left.x, left.y, *filtered, i.x, i.y))


METHOD = FixedMethod(
    name="smo",
    code="smo",
    gains=FixedSmo,
    design=design,
    words=vector_words(
        rest="what is left of the current error",
        filtered="filtered switched voltage",
        i="last current",
    ),
    limits=code_limits(6),
    begin=begin,
    step=step,
)
