"""Angle functions, Clarke and Park transforms and duty cycles in integers,
as the emitted C has them.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof. Codes of ``width`` bits are per unit, 2^(width - 1) of them are full scale; those of an angle
are a share of a turn, 2^width of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from dqforge.machines.names import ModulationName
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    Integers,
    N,
    Pair,
    Triple,
    larger,
    magnitude,
    rounded,
)

FIXED_MODULATORS: tuple[ModulationName, ...] = (
    "spwm",
    "thipwm6",
    "thipwm4",
    "svpwm",
    "dpwm0",
    "dpwm1",
    "dpwm2",
    "dpwm3",
    "dpwmmin",
    "dpwmmax",
    "ddt-gdpwm",
)

"""Modulators that there are in integers; GDPWM needs the angle of the
current and is not among them."""


_SINE_TERMS = {16: 4, 32: 6}
_SEED = 20_261_121


@dataclass(frozen=True, slots=True)
class SineSteps:
    """sin(pi/2 x) = x p(x^2) over a quarter turn, x = code / 2^(width - 2),
    by Horner's rule in integers.

    ``leading`` and every step's (constant, shift) as in `FixedSegment`; ``square`` is the shift
    that makes x^2 a code of 2^(width - 1), ``last`` the shift after the product with x.
    """

    width: int
    leading: int
    steps: tuple[tuple[int, int], ...]
    square: int
    last: int


@cache
def sine_steps(width: int) -> SineSteps:
    """Integers of the sine: a minimax-like fit at Chebyshev nodes, every coefficient at
    the finest scale that fits.

    With 4 terms the polynomial itself is within 1.1e-6 of the sine, with 6 within 2e-11,
    so that rounding decides.
    """
    terms = _SINE_TERMS[width]
    nodes = (
        np.cos((np.arange(8 * terms) + 0.5) * (math.pi / (8 * terms))) * 0.5 + 0.5
    )  # of x^2, 0 to 1
    root = np.sqrt(nodes)
    # Weighted by x: the error of the sine counts, not that of sin/x.
    matrix = np.polynomial.polynomial.polyvander(nodes, terms - 1) * root[:, None]
    found = np.linalg.lstsq(matrix, np.sin(0.5 * math.pi * root), rcond=None)[0].tolist()
    square = width - 1
    # The constant of a step stands at the scale of the product, which bounds the scale of
    # the value before the step.
    scales = [width if width == 16 else width - 2]
    scales += [width - math.ceil(math.log2(abs(value))) for value in found[:-1]]
    steps = []
    for k in range(terms - 2, -1, -1):
        shift = scales[k + 1] + square - scales[k]
        steps.append((round(found[k] * 2.0 ** (scales[k + 1] + square)) + (1 << shift >> 1), shift))
    leading = round(found[-1] * 2.0 ** scales[-1])
    return SineSteps(width, leading, tuple(steps), width - 3, scales[0] + width - 2 - (width - 1))


def quarter_sine(o: Arithmetic[N, Any], width: int, x: N) -> N:
    """Sine of codes of a quarter turn, 0 to 2^(width - 2), as codes of 2^(width - 1)."""
    made = sine_steps(width)
    square = rounded(o, "sine: x^2", o.product("sine: x^2", x, x), made.square)
    value = o.const(made.leading)
    for constant, shift in made.steps:
        value = o.shifted(
            o.total("sine: sum", o.product("sine: product", value, square), o.const(constant)),
            shift,
        )
    result = rounded(o, "sine: last product", o.product("sine: last product", value, x), made.last)
    return o.clamp(result, 0, 2 ** (width - 1) - 1)


def sine(o: Arithmetic[N, Any], width: int, angle: N) -> N:
    """Sine of an angle, 0 to 2^width - 1 codes; odd and symmetric to the last bit."""
    half_turn, quarter = o.const(2 ** (width - 1)), o.const(2 ** (width - 2))
    inside = o.wrapped(angle, width - 1)
    x = o.choose(
        o.at_least(inside, quarter), o.total("sine: fold", half_turn, o.negative(inside)), inside
    )
    x = o.clamp(x, 0, 2 ** (width - 2))  # changes no number; a range does not know that x is folded
    value = quarter_sine(o, width, x)
    return o.choose(o.at_least(angle, half_turn), o.negative(value), value)


def rotation(o: Arithmetic[N, Any], width: int, angle: N) -> Pair[N]:
    """Cosine and sine of an angle."""
    shifted = o.wrapped(o.total("rotation: quarter turn", angle, o.const(2 ** (width - 2))), width)
    return Pair(sine(o, width, shifted), sine(o, width, angle))


@cache
def sine_error(width: int) -> float:
    """Largest error of sine and cosine in codes: of all angles in 16 bits,
    of 200,000 in 32 bits.
    """
    angle = (
        np.arange(65_536)
        if width == 16
        else np.random.default_rng(_SEED).integers(0, 2**32, 200_000)
    )
    turn, one = rotation(Integers(), width, angle), 2.0 ** (width - 1)
    exact = angle * (2.0 * math.pi / 2.0**width)
    return float(
        max(
            np.max(np.abs(turn.x - one * np.cos(exact))),
            np.max(np.abs(turn.y - one * np.sin(exact))),
        )
    )


def full_scale(width: int) -> int:
    """The largest code, 2^(width - 1) - 1."""
    return int(2 ** (width - 1) - 1)


def clarke(o: Arithmetic[N, Any], width: int, phase: Triple[N]) -> Pair[N]:
    """Alpha = (2 a - b - c)/3 and beta = (b - c)/sqrt 3, saturated at full scale."""
    top, bits = full_scale(width), width - 1
    third, root = round(2**bits / 3), round(2**bits / math.sqrt(3.0))
    double = o.product("clarke: 2 a", o.const(2), phase.a)
    sums = o.total("clarke: 2 a - b - c", double, o.negative(phase.b), o.negative(phase.c))
    alpha = rounded(o, "clarke: alpha", o.product("clarke: alpha", sums, o.const(third)), bits)
    gap = o.total("clarke: b - c", phase.b, o.negative(phase.c))
    beta = rounded(o, "clarke: beta", o.product("clarke: beta", gap, o.const(root)), bits)
    return Pair(o.clamp(alpha, -top, top), o.clamp(beta, -top, top))


def clarke_inverse(o: Arithmetic[N, Any], width: int, vector: Pair[N]) -> Triple[N]:
    """A = alpha, b and c = -alpha/2 +- sqrt(3)/2 beta, saturated at full scale."""
    top, bits = full_scale(width), width - 1
    half = o.product("clarke inverse: alpha/2", vector.x, o.const(2 ** (bits - 1)))
    side = o.product("clarke inverse: beta", vector.y, o.const(round(2**bits * math.sqrt(0.75))))
    b = rounded(o, "clarke inverse: b", o.total("clarke inverse: b", side, o.negative(half)), bits)
    back = o.negative(side)
    c = rounded(o, "clarke inverse: c", o.total("clarke inverse: c", back, o.negative(half)), bits)
    return Triple(o.clamp(vector.x, -top, top), o.clamp(b, -top, top), o.clamp(c, -top, top))


def park(o: Arithmetic[N, Any], width: int, vector: Pair[N], turn: Pair[N]) -> Pair[N]:
    """D = alpha cos + beta sin, q = beta cos - alpha sin, saturated at full scale."""
    top, bits = full_scale(width), width - 1
    d = o.total(
        "park: d", o.product("park: d", vector.x, turn.x), o.product("park: d", vector.y, turn.y)
    )
    cross = o.product("park: q", vector.x, turn.y)
    q = o.total("park: q", o.product("park: q", vector.y, turn.x), o.negative(cross))
    found = rounded(o, "park: d", d, bits), rounded(o, "park: q", q, bits)
    return Pair(o.clamp(found[0], -top, top), o.clamp(found[1], -top, top))


def park_inverse(o: Arithmetic[N, Any], width: int, vector: Pair[N], turn: Pair[N]) -> Pair[N]:
    """Alpha = d cos - q sin, beta = d sin + q cos, saturated at full scale."""
    return park(o, width, vector, Pair(turn.x, o.negative(turn.y)))


def _third_harmonic(o: Arithmetic[N, Any], width: int, v: Triple[N], share: int) -> N:
    """V cos(3 alpha) / 4 of balanced phases = a b c / V^2, times 4 / share; 0 without voltage."""
    bits, top = width - 1, full_scale(width)
    squares = [o.product("third harmonic: square", value, value) for value in (v.a, v.b, v.c)]
    mean = [o.shifted(square, bits) for square in squares]
    total = o.total("third harmonic: V^2", *mean)
    # V^2 = 2/3 (a^2 + b^2 + c^2)
    length = o.shifted(
        o.product("third harmonic: V^2", total, o.const(round(2**bits * 2 / 3))), bits
    )
    cube = o.product(
        "third harmonic: a b c", o.shifted(o.product("third harmonic: a b", v.a, v.b), bits), v.c
    )
    ratio = o.clamp(
        o.quotient("third harmonic: ratio", cube, larger(o, length, o.const(1))), -top, top
    )
    if share == 4:
        return ratio
    scale = o.const(round(2**bits * 4 / share))
    return rounded(o, "third harmonic", o.product("third harmonic", ratio, scale), bits)


def _extremes(o: Arithmetic[N, Any], v: Triple[N], seen: Triple[N]) -> tuple[N, N, N, N]:
    """Highest and lowest phase, and what is seen of these two.

    Of equals the first is highest, the last lowest.
    """
    high, high_seen, low, low_seen = v.a, seen.a, v.a, seen.a
    for value, view in ((v.b, seen.b), (v.c, seen.c)):
        keeps, falls = o.at_least(high, value), o.at_least(low, value)
        high, high_seen = o.choose(keeps, high, value), o.choose(keeps, high_seen, view)
        low, low_seen = o.choose(falls, value, low), o.choose(falls, view, low_seen)
    return high, low, high_seen, low_seen


def _seen(
    o: Arithmetic[N, Any], modulation: ModulationName, v: Triple[N], i: Triple[N]
) -> Triple[N]:
    """What decides between the two rails: the larger magnitude of this rests."""
    if modulation == "ddt-gdpwm":
        return i
    if modulation == "dpwm0":  # the references 30 degrees later, apart from a factor
        other = Triple(v.b, v.c, v.a)
    elif modulation == "dpwm2":
        other = Triple(v.c, v.a, v.b)
    else:
        return v
    name = f"{modulation}: difference"
    return Triple(
        *(o.total(name, x, o.negative(y)) for x, y in zip(_three(v), _three(other), strict=True))
    )


def _three(v: Triple[N]) -> tuple[N, N, N]:
    return v.a, v.b, v.c


def zero_sequence(
    o: Arithmetic[N, Any], width: int, modulation: ModulationName, v: Triple[N], i: Triple[N]
) -> N:
    """Zero sequence from the negative rail as a share of the dc link, 2^(width - 1) is all of
    it.
    """
    half = o.const(2 ** (width - 2))
    if modulation == "spwm":
        return half
    if modulation in ("thipwm6", "thipwm4"):
        third = _third_harmonic(o, width, v, int(modulation[-1]))
        return o.total(f"{modulation}: zero sequence", half, o.negative(third))
    return _from_extremes(o, width, modulation, _extremes(o, v, _seen(o, modulation, v, i)))


def _from_extremes(
    o: Arithmetic[N, Any], width: int, modulation: ModulationName, found: tuple[N, N, N, N]
) -> N:
    """Zero sequence of the modulators that look at the highest and the lowest phase."""
    high, low, high_seen, low_seen = found
    upper = o.total(f"{modulation}: zero sequence", o.const(2 ** (width - 1)), o.negative(high))
    lower = o.negative(low)
    if modulation == "svpwm":
        return o.shifted(o.total("svpwm: zero sequence", upper, lower), 1)
    if modulation in ("dpwmmax", "dpwmmin"):
        return upper if modulation == "dpwmmax" else lower
    high_seen, low_seen = magnitude(o, high_seen), magnitude(o, low_seen)
    if modulation == "dpwm3":
        return o.choose(o.at_least(low_seen, high_seen), upper, lower)
    return o.choose(o.at_least(high_seen, low_seen), upper, lower)


def duties(
    o: Arithmetic[N, Any],
    width: int,
    modulation: ModulationName,
    scale: int,
    vector: Pair[N],
    v_dc: N,
    i: Triple[N],
) -> Triple[N]:
    """Duty cycles, 0 to 2^(width - 1), for a voltage vector and the dc link,
    whose full scale is 2^scale times larger.

    The vector is divided by the dc link (towards zero) and saturated at it;
    ``v_dc`` must be positive.
    """
    top, one = full_scale(width), 2 ** (width - 1)
    factor = o.const(2 ** (width - 1 - scale))
    share = [
        o.clamp(
            o.quotient("duties: v / v_dc", o.product("duties: v", value, factor), v_dc), -top, top
        )
        for value in (vector.x, vector.y)
    ]
    phase = clarke_inverse(o, width, Pair(*share))
    zero = zero_sequence(o, width, modulation, phase, i)
    return Triple(
        *(o.clamp(o.total("duties: sum", value, zero), 0, one) for value in _three(phase))
    )
