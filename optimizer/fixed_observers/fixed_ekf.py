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
from typing import Annotated, Any

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import C, N, Pair
from dqforge.optimizer.fixed_control.codes import rotation
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
    to_rotor,
    turned_by,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.ekf import EkfGains
from dqforge.optimizer.observers.sampled_machine import EVEN
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, Range, rounded
from dqforge.optimizer.steps.step_arithmetic import Member

ANGLE_BITS = 2  # An angle of the covariance has 2^2 rad of full scale.
P_BITS = 54  # Fractional bits of the covariance.
LIMIT = 1 << (P_BITS + 1)  # Largest entry of the covariance; beyond, the filter begins anew.
K_BITS = 24  # Fractional bits of the filter's gains.
_SLOPE_BITS = 29
_SIZE_BITS = 27
_MOST_PART = 1 << 40
_P_THETA = 10.0
_COVARIANCE = "covariance of i_d, i_q, speed, angle: upper triangle, row by row"
_UPPER = tuple((n, m) for n in range(4) for m in range(n, 4))


@dataclass(frozen=True, slots=True)
class FixedEkf:
    """Extended Kalman filter in integers.

    Covariances have 2^54 codes of one squared full scale: of the current, of the speed, of an angle
    of 4 rad.
    """

    model: FixedSampled
    slopes: Annotated[FixedPolynomials, Member("derivatives of the entries by the speed")]
    turn: Annotated[int, Member("angle of a period at full speed, 2^31 codes of 4 rad")]
    q_i: Annotated[int, Member("process variance of a current per sample"), "int64_t"]
    q_22: Annotated[int, Member("of the speed"), "int64_t"]
    q_23: Annotated[int, Member("of speed and angle"), "int64_t"]
    q_33: Annotated[int, Member("of the angle"), "int64_t"]
    r: Annotated[int, Member("variance of a measured current"), "int64_t"]
    p_omega: Annotated[int, Member("variance of the first speed"), "int64_t"]
    p_theta: Annotated[int, Member("variance of the first angle"), "int64_t"]
    most_omega: Annotated[int, Member("largest variance of a speed"), "int64_t"]
    most_theta: Annotated[int, Member("and of an angle"), "int64_t"]
    angle: Annotated[FixedGain, Member("of a correction, to codes of a turn")]
    most: Annotated[int, Member("limit of the speed")]


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


def _slopes_at(o: Arithmetic[N, Any], slopes: FixedPolynomials, square: N, x: N) -> list[N]:
    odd = [odd_polynomial(o, row, square, x) for row in slopes.rows[:EVEN]]
    return odd + [o.call(polynomial, row, square) for row in slopes.rows[EVEN:]]


def weighted(o: Arithmetic[N, Any], name: str, p: N, factor: N, bits: int) -> N:
    """A covariance of 64 bits times a factor of 32 over 2^bits, without so many bits."""
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
    turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
    first = o.let("first", o.call(to_rotor, i, turn))
    diagonal = (gains.r, gains.r, gains.p_omega, gains.p_theta)
    rows = tuple(o.const(diagonal[n] if n == m else 0) for n, m in _UPPER)
    return TrackedState(state.theta, state.omega, (first.x, first.y, *rows))


def _jacobian(
    o: Arithmetic[N, Any], gains: FixedEkf, e: list[N], g: list[N], i: Pair[N], u: Pair[N]
) -> list[list[N]]:
    """Derivatives of the next currents by currents, speed and angle, mantissas of the entries."""
    slope = combined_currents(o, g, i, u)
    bits = gains.slopes.shift + WIDTH - 1 - gains.model.entries.shift

    def by_angle(own: N, other: N) -> N:
        part = o.total(
            "turned voltage",
            o.product("turned voltage", own, u.y),
            o.negative(o.product("turned voltage", other, u.x)),
        )
        return o.call(rounded, "turned voltage", part, WIDTH - 1 - ANGLE_BITS)

    return [
        [
            e[0],
            e[5],
            o.let("d_speed", o.call(rounded, "slope", slope.x, bits)),
            o.let("d_angle", by_angle(e[2], e[7])),
        ],
        [
            e[6],
            e[1],
            o.let("q_speed", o.call(rounded, "slope", slope.y, bits)),
            o.let("q_angle", by_angle(e[8], e[3])),
        ],
    ]


def _covariance_ahead(
    o: Arithmetic[N, Any], gains: FixedEkf, p: list[list[N]], f: list[list[N]]
) -> list[list[N]]:
    """Covariance one period on."""
    bits, turn = gains.model.entries.shift, o.const(gains.turn)

    def along(row: list[N], column: list[N]) -> N:
        parts = [o.call(weighted, "F P", column[k], row[k], bits) for k in range(4)]
        return o.total("F P", *parts)

    def later(own: N, rate: N) -> N:
        part = o.call(weighted, "turn P", rate, turn, WIDTH - 1)
        return o.total("P ahead", own, part)

    a = [
        [o.let(f"a_{n}{m}", along(f[n], [p[k][m] for k in range(4)])) for m in range(4)]
        for n in (0, 1)
    ]
    last = [o.let(f"a_3{m}", later(p[3][m], p[2][m])) for m in (2, 3)]
    new = [[o.const(0)] * 4 for _ in range(4)]

    def put(n: int, m: int, value: N) -> None:
        new[n][m] = new[m][n] = o.let(f"p_{n}{m}", value)

    put(0, 0, o.total("P ahead", along(f[0], a[0]), o.const(gains.q_i)))
    put(0, 1, along(f[1], a[0]))
    put(1, 1, o.total("P ahead", along(f[1], a[1]), o.const(gains.q_i)))
    for m in range(2):
        new[m][2] = new[2][m] = a[m][2]
        put(m, 3, later(a[m][3], a[m][2]))
    put(2, 2, o.total("P ahead", p[2][2], o.const(gains.q_22)))
    put(2, 3, o.total("P ahead", later(p[2][3], p[2][2]), o.const(gains.q_23)))
    put(3, 3, o.total("P ahead", later(last[1], last[0]), o.const(gains.q_33)))
    return new


def gain_of(o: Arithmetic[N, Any], h: N, inverse: N, places: N) -> N:
    """A gain of the filter, with 24 fractional bits, saturated."""
    part = o.let("part", o.clamp(o.shifted_by(h, places), -_MOST_PART, _MOST_PART))
    fine = weighted(o, "h / size", part, inverse, WIDTH - 1)
    return o.call(clipped, o.call(rounded, "h / size", fine, _SIZE_BITS - 1 - K_BITS))


def correction(o: Arithmetic[N, Any], k: N, innovation: N) -> N:
    """What a gain of the filter makes of an innovation."""
    part = o.product("K innovation", k, innovation)
    return o.call(clipped, o.call(rounded, "K innovation", part, K_BITS))


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
    bits, name = WIDTH - 1 - ANGLE_BITS, "dq"[axis]
    h = []
    for n in range(4):
        part = o.total("P C", p[n][axis], o.call(weighted, "P C", p[n][3], b, bits))
        h.append(o.let(f"h_{name}{n}", o.clamp(part, -LIMIT, LIMIT)))
    across = o.call(weighted, "C P C", h[3], b, bits)
    size = o.let(f"size_{name}", o.total("C P C", h[axis], across, o.const(gains.r)))
    places = o.let(f"places_{name}", o.halvings("size", size, (1 << _SIZE_BITS) - 1))
    small = o.known(o.shifted_by(size, places), -(2**62), (1 << _SIZE_BITS) - 1)
    short = o.let(f"short_{name}", small, "27 bits of it")
    # Changes no number of a sound filter, whose innovations vary by r at least.
    divisor = o.clamp(short, 1 << (_SIZE_BITS - 1), (1 << _SIZE_BITS) - 1)
    inverse = o.quotient("1 / size", o.const(1 << (_SIZE_BITS + 30)), divisor)
    over = o.let(f"over_{name}", inverse)
    k = [o.let(f"k_{name}{n}", o.call(gain_of, h[n], over, places)) for n in range(4)]
    for n in range(4):
        for m in range(n + 1):
            less = o.call(weighted, "K C P", h[n], k[m], K_BITS)
            after = o.total("P after", p[n][m], o.negative(less))
            held = o.clamp(after, -2 * LIMIT, 2 * LIMIT)
            p[m][n] = p[n][m] = o.let(f"p_{name}{m}{n}", held)
    return [o.let(f"x_{name}{n}", o.call(correction, part, innovation)) for n, part in enumerate(k)]


def step(
    o: Arithmetic[N, Any], gains: FixedEkf, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control. After a sample that leaves no covariance, or one beyond its limits, the filter
    begins anew by itself: at the angle foretold and the speed before, with the covariance of the
    start.
    """
    before = Dq(*state.words[:2])
    u = o.let("u", o.call(to_rotor, v, o.let("last", o.call(rotation, WIDTH, state.theta))))
    x = o.let("x", limited_speed(o, gains.model, state.omega))
    square = o.let("square", o.call(times, "square of the speed", x, x))
    e = o.let("e", entries_at(o, gains.model.entries, square, x))
    g = o.let("g", _slopes_at(o, gains.slopes, square, x))
    f = _jacobian(o, gains, e, g, before, u)
    p = _covariance_ahead(o, gains, _full(state.words[2:]), f)
    foretold = o.let("foretold", next_currents(o, gains.model.entries.shift, e, before, u))
    theta = o.let("theta", o.call(predicted, gains.model.advance, state.theta, state.omega))
    seen = o.let("seen", o.call(to_rotor, i, o.let("now", o.call(rotation, WIDTH, theta))))
    apart = o.call(clipped, o.total("innovation", seen.x, o.negative(foretold.x)))
    nu_d = o.let("nu_d", apart, "innovation")
    less = o.let("less", o.negative(foretold.y))
    first = _taken_in(o, gains, p, 0, less, nu_d)
    turned = o.product("i_d turn", foretold.x, first[3])
    rest = o.total(
        "innovation",
        seen.y,
        o.negative(foretold.y),
        o.negative(first[1]),
        o.negative(o.call(rounded, "i_d turn", turned, WIDTH - 1 - ANGLE_BITS)),
    )
    nu_q = o.let("nu_q", o.call(clipped, rest))
    second = _taken_in(o, gains, p, 1, foretold.x, nu_q)

    def corrected() -> TrackedState[N]:
        both = [o.total("correction", a, b) for a, b in zip(first, second, strict=True)]
        speed = o.clamp(o.total("speed", state.omega, both[2]), -gains.most, gains.most)
        return TrackedState(
            o.call(turned_by, gains.angle, theta, both[3]),
            speed,
            (
                o.call(clipped, o.total("current", foretold.x, both[0])),
                o.call(clipped, o.total("current", foretold.y, both[1])),
                # Beyond, the filter begins anew.
                *(o.known(p[n][m], -LIMIT, LIMIT) for n, m in _UPPER),
            ),
        )

    def anew() -> TrackedState[N]:
        return begin(o, gains, TrackedState(theta, state.omega, ()), i, i)

    return o.either(_sound(o, gains, p), corrected, anew)


def _sound(o: Arithmetic[N, C], gains: FixedEkf, p: list[list[N]]) -> C:
    """Whether a covariance is one, within its limits."""
    most = (LIMIT, LIMIT, gains.most_omega, gains.most_theta)
    held = []
    for n, m in _UPPER:
        held.append(o.at_least(o.const(most[n] if n == m else LIMIT), p[n][m]))
        held.append(o.at_least(p[n][m], o.const(1 if n == m else -LIMIT)))
    return o.every(*held)


def _limits(gains: FixedEkf) -> tuple[Range, ...]:
    return (*code_limits(2)(gains), *(Range(-LIMIT, LIMIT),) * len(_UPPER))


METHOD = FixedMethod(
    name="ekf",
    code="ekf",
    gains=FixedEkf,
    design=design,
    words=(
        Word("i.d", meaning="estimated current in the rotor's frame"),
        Word("i.q"),
        *(Word(f"p[{k}]", "int64_t", _COVARIANCE) for k in range(len(_UPPER))),
    ),
    limits=_limits,
    begin=begin,
    step=step,
)
