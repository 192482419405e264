"""Extended Kalman filter in integers (`dqforge.optimizer.observers.methods.ekf`).

The covariance is kept in words of 64 bits, 2^54 codes of one squared full scale (of the current,
of the speed, of an angle of 4 rad): what the filter starts from and what it comes to rest at lie
eight decades apart. Products of such a word and a code of 32 bits are made of two (`weighted`).

Both components of the measured current are taken in one after the other, which is the same as
together, as their noise is independent: no matrix is inverted, and the variance of an innovation
is brought to 27 bits before its reciprocal is taken.
"""

from __future__ import annotations

import math
from typing import Any

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, Range, rounded
from dqforge.optimizer.fixed_control.transforms import Codes, rotation
from dqforge.optimizer.fixed_observers.fixed_sampled_machine import (
    FixedSampled,
    combined_currents,
    entries_at,
    entry_rows,
    fixed_sampled,
    limited_speed,
    next_currents,
)
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    WIDTH,
    FixedMethod,
    FixedPolynomials,
    Scales,
    TrackedState,
    Word,
    clipped,
    code_limits,
    common_scale,
    gain,
    odd_polynomial,
    polynomial,
    predicted,
    speed_limit,
    times,
    turned_by,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.ekf import EkfGains
from dqforge.optimizer.observers.sampled_machine import EVEN

ANGLE_BITS = 2  # An angle of the covariance has 2^2 rad of full scale.
P_BITS = 54  # Fractional bits of the covariance.
LIMIT = 1 << (P_BITS + 1)  # Largest entry of the covariance; beyond, the filter begins anew.
K_BITS = 24  # Fractional bits of the filter's gains.
_SLOPE_BITS = 29
_SIZE_BITS = 27
_MOST_PART = 1 << 40
_STAGES = (16, 16, 8, 4, 2, 1)
_P_THETA = 10.0
_UPPER = tuple((n, m) for n in range(4) for m in range(n, 4))


@dataclass(frozen=True, slots=True)
class FixedEkf:
    """Sampled machine with the derivatives of its entries by the speed, angle of a period in codes
    of the covariance, variances in its codes, limits, gain from angles of the covariance to codes
    of a turn.
    """

    model: FixedSampled
    slopes: FixedPolynomials
    turn: int
    q_i: int
    q_22: int
    q_23: int
    q_33: int
    r: int
    p_omega: int
    p_theta: int
    most_omega: int
    most_theta: int
    angle: FixedGain
    most: int


def design(gains: EkfGains, scales: Scales) -> FixedEkf:
    """The filter in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.

    Raises:
        NoSolutionError: The noise of the current is too small for its full scale, or a quantity has
            no format.
    """
    speed, current, angle = scales.speed, scales.current, 2.0**ANGLE_BITS

    def variance(name: str, value: float) -> int:
        found = round(value * 2.0**P_BITS)
        if found > LIMIT:
            raise NoSolutionError(
                f"fixed point: observer, {name} is beyond its word; use larger bases in "
                "control.per_unit"
            )
        return found

    r = variance("noise of the current", gains.r / current**2)
    if r < 1 << (_SIZE_BITS - 1):
        raise NoSolutionError(
            "fixed point: observer, the noise of the current is too small for its full scale; use "
            "a smaller base in control.per_unit.current"
        )
    return FixedEkf(
        model=fixed_sampled(gains.model, scales),
        slopes=common_scale("slopes", _slope_rows(entry_rows(gains.model, scales)), _SLOPE_BITS),
        turn=round(scales.turn / angle * ONE),
        q_i=variance("noise of a current", gains.q_i / current**2),
        q_22=variance("noise of the speed", gains.q_22 / speed**2),
        q_23=variance("noise of speed and angle", gains.q_23 / (speed * angle)),
        q_33=variance("noise of the angle", gains.q_33 / angle**2),
        r=r,
        p_omega=variance("variance of the first speed", gains.p_omega / speed**2),
        p_theta=variance("variance of the first angle", gains.p_theta / angle**2),
        most_omega=min(LIMIT, round((gains.omega_max**2 + gains.p_omega) / speed**2 * 2.0**P_BITS)),
        most_theta=variance("variance of an angle", _P_THETA / angle**2),
        angle=gain("angle of a correction", angle / math.pi),
        most=speed_limit(gains.omega_max, scales),
    )


def _slope_rows(rows: list[list[float]]) -> list[list[float]]:
    """Coefficients of the derivatives by the speed: of the even entries over the speed."""
    found = [[2.0 * k * row[k] for k in (1, 2, 3)] + [0.0] for row in rows[:EVEN]]
    return found + [[(2.0 * k + 1.0) * row[k] for k in range(4)] for row in rows[EVEN:]]


def _slopes_at(o: Arithmetic[N, Any], slopes: FixedPolynomials, x: N) -> list[N]:
    square = times(o, "square of the speed", x, x)
    odd = [odd_polynomial(o, row, square, x) for row in slopes.rows[:EVEN]]
    return odd + [polynomial(o, row, square) for row in slopes.rows[EVEN:]]


def weighted(o: Arithmetic[N, Any], name: str, p: N, factor: N, bits: int) -> N:
    """floor(p factor / 2^bits) of a word of 64 bits and a factor of 32."""
    high = o.product(name, o.shifted(p, bits), factor)
    low = o.shifted(o.product(name, o.wrapped(p, bits), factor), bits)
    return o.total(name, high, low)


def _full(words: tuple[N, ...]) -> list[list[N]]:
    rows = [[words[0]] * 4 for _ in range(4)]
    for (n, m), value in zip(_UPPER, words, strict=True):
        rows[n][m] = rows[m][n] = value
    return rows


def begin(
    o: Arithmetic[N, Any], gains: FixedEkf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The measured current at the given angle, with the covariance of the start."""
    del v
    first = park(Codes(o, WIDTH), i, rotation(o, WIDTH, state.theta))
    diagonal = (gains.r, gains.r, gains.p_omega, gains.p_theta)
    rows = tuple(o.const(diagonal[n] if n == m else 0) for n, m in _UPPER)
    return TrackedState(state.theta, state.omega, (first.x, first.y, *rows))


def _jacobian(
    o: Arithmetic[N, Any], gains: FixedEkf, e: list[N], x: N, i: Pair[N], u: Pair[N]
) -> list[list[N]]:
    """Derivatives of the next currents by currents, speed and angle, mantissas of the entries."""
    shift = gains.model.entries.shift
    slope = combined_currents(o, _slopes_at(o, gains.slopes, x), i, u)
    bits = gains.slopes.shift + WIDTH - 1 - shift

    def by_angle(own: N, other: N) -> N:
        part = o.total(
            "turned voltage",
            o.product("turned voltage", own, u.y),
            o.negative(o.product("turned voltage", other, u.x)),
        )
        return rounded(o, "turned voltage", part, WIDTH - 1 - ANGLE_BITS)

    return [
        [e[0], e[5], rounded(o, "slope", slope.x, bits), by_angle(e[2], e[7])],
        [e[6], e[1], rounded(o, "slope", slope.y, bits), by_angle(e[8], e[3])],
    ]


def _covariance_ahead(
    o: Arithmetic[N, Any], gains: FixedEkf, p: list[list[N]], f: list[list[N]]
) -> list[list[N]]:
    """Covariance one period on."""
    bits, turn = gains.model.entries.shift, o.const(gains.turn)

    def along(row: list[N], column: list[N]) -> N:
        parts = [weighted(o, "F P", column[k], row[k], bits) for k in range(4)]
        return o.total("F P", *parts)

    def later(own: N, rate: N) -> N:
        return o.total("P ahead", own, weighted(o, "turn P", rate, turn, WIDTH - 1))

    a = [[along(f[n], [p[k][m] for k in range(4)]) for m in range(4)] for n in (0, 1)]
    a += [list(p[2]), [later(p[3][m], p[2][m]) for m in range(4)]]
    new = [[o.const(0)] * 4 for _ in range(4)]
    for n in range(2):
        for m in range(n + 1):
            total = along(f[n], a[m])
            if n == m:
                total = o.total("P ahead", total, o.const(gains.q_i))
            new[m][n] = new[n][m] = total
    for m in range(2):
        new[m][2] = new[2][m] = a[m][2]
        new[m][3] = new[3][m] = later(a[m][3], a[m][2])
    new[2][2] = o.total("P ahead", a[2][2], o.const(gains.q_22))
    new[2][3] = new[3][2] = o.total("P ahead", later(a[2][3], a[2][2]), o.const(gains.q_23))
    new[3][3] = o.total("P ahead", later(a[3][3], a[3][2]), o.const(gains.q_33))
    return new


def _gains_of(o: Arithmetic[N, Any], h: list[N], size: N) -> list[N]:
    """Filter gains h / size with K_BITS fractional bits, saturated; a positive size has 27 bits."""
    parts = h
    for stage in _STAGES:
        large = o.at_least(size, o.const(1 << (_SIZE_BITS - 1 + stage)))
        size = o.choose(large, o.shifted(size, stage), size)
        parts = [o.choose(large, o.shifted(part, stage), part) for part in parts]
    # Changes no number of a sound filter, whose innovations vary by r at least.
    size = o.clamp(size, 1 << (_SIZE_BITS - 1), (1 << _SIZE_BITS) - 1)
    inverse = o.quotient("1 / size", o.const(1 << (_SIZE_BITS + 30)), size)
    found = []
    for part in parts:
        limited = o.clamp(part, -_MOST_PART, _MOST_PART)
        fine = weighted(o, "h / size", limited, inverse, WIDTH - 1)
        found.append(clipped(o, rounded(o, "h / size", fine, _SIZE_BITS - 1 - K_BITS)))
    return found


def _taken_in(
    o: Arithmetic[N, Any],
    gains: FixedEkf,
    p: list[list[N]],
    axis: int,
    b: N,
    innovation: N,
) -> list[N]:
    """Take in one component of the current: corrections of the state; ``p`` is corrected.

    ``b`` is the derivative of the component by the angle, a code of the current.
    """
    bits = WIDTH - 1 - ANGLE_BITS
    h = []
    for n in range(4):
        part = o.total("P C", p[n][axis], weighted(o, "P C", p[n][3], b, bits))
        h.append(o.clamp(part, -LIMIT, LIMIT))
    size = o.total("C P C", h[axis], weighted(o, "C P C", h[3], b, bits), o.const(gains.r))
    k = _gains_of(o, h, size)
    for n in range(4):
        for m in range(n + 1):
            less = weighted(o, "K C P", h[n], k[m], K_BITS)
            after = o.total("P after", p[n][m], o.negative(less))
            p[m][n] = p[n][m] = o.clamp(after, -2 * LIMIT, 2 * LIMIT)
    return [
        clipped(o, rounded(o, "K innovation", o.product("K innovation", part, innovation), K_BITS))
        for part in k
    ]


def step(
    o: Arithmetic[N, Any], gains: FixedEkf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    codes, before = Codes(o, WIDTH), Pair(*state.words[:2])
    u = park(codes, v, rotation(o, WIDTH, state.theta))
    x = limited_speed(o, gains.model, state.omega)
    e = entries_at(o, gains.model.entries, x)
    p = _covariance_ahead(o, gains, _full(state.words[2:]), _jacobian(o, gains, e, x, before, u))
    foretold = next_currents(o, gains.model.entries.shift, e, before, u)
    theta_p = predicted(o, gains.model.advance, state.theta, state.omega)
    seen = park(codes, i, rotation(o, WIDTH, theta_p))
    nu_d = clipped(o, o.total("innovation", seen.x, o.negative(foretold.x)))
    first = _taken_in(o, gains, p, 0, o.negative(foretold.y), nu_d)
    turned = rounded(
        o, "i_d turn", o.product("i_d turn", foretold.x, first[3]), WIDTH - 1 - ANGLE_BITS
    )
    rest = o.total(
        "innovation", seen.y, o.negative(foretold.y), o.negative(first[1]), o.negative(turned)
    )
    second = _taken_in(o, gains, p, 1, foretold.x, clipped(o, rest))
    both = [o.total("correction", a, b) for a, b in zip(first, second, strict=True)]
    return _sound_or_anew(o, gains, state.omega, theta_p, i, foretold, both, p)


def _sound_or_anew(
    o: Arithmetic[N, Any],
    gains: FixedEkf,
    omega: N,
    theta: N,
    i: Pair[N],
    foretold: Pair[N],
    correction: list[N],
    p: list[list[N]],
) -> TrackedState[N]:
    """The corrected state, or a new beginning where the covariance is none."""
    sound, nil = o.const(1), o.const(0)
    most = (LIMIT, LIMIT, gains.most_omega, gains.most_theta)
    for n, m in _UPPER:
        top = most[n] if n == m else LIMIT
        sound = o.choose(o.at_least(o.const(top), p[n][m]), sound, nil)
        sound = o.choose(o.at_least(p[n][m], o.const(1 if n == m else -LIMIT)), sound, nil)
    good = o.at_least(sound, o.const(1))
    speed = o.clamp(o.total("speed", omega, correction[2]), -gains.most, gains.most)
    own = (
        turned_by(o, gains.angle, theta, correction[3]),
        speed,
        clipped(o, o.total("current", foretold.x, correction[0])),
        clipped(o, o.total("current", foretold.y, correction[1])),
        # Changes no number: beyond, the filter begins anew.
        *(o.clamp(p[n][m], -LIMIT, LIMIT) for n, m in _UPPER),
    )
    anew = begin(o, gains, TrackedState(theta, omega, ()), i, i)
    pairs = zip(own, (anew.theta, anew.omega, *anew.words), strict=True)
    chosen = [o.choose(good, a, b) for a, b in pairs]
    return TrackedState(chosen[0], chosen[1], tuple(chosen[2:]))


def _limits(gains: FixedEkf) -> tuple[Range, ...]:
    return (*code_limits(2)(gains), *(Range(-LIMIT, LIMIT),) * len(_UPPER))


METHOD = FixedMethod(
    name="ekf",
    code="ekf",
    gains=FixedEkf,
    design=design,
    words=(
        Word("i.d"),
        Word("i.q"),
        *(Word(f"p[{k}]", "int64_t") for k in range(len(_UPPER))),
    ),
    limits=_limits,
    begin=begin,
    step=step,
)
