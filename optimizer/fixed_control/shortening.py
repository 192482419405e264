"""A voltage shortened along its direction, and reciprocals, in integers without a division.

The least cores have no divider: a division by software takes them some 200 instructions. A
reciprocal and a reciprocal root by a polynomial and Newton's rule take some 30 each. Both numbers
are shifted to the left first, so that they keep the digits of their word:

::

    1/t        t = m / 2^(w-1), 1/2 to 1;      y <- y (2 - t y)
    1/sqrt(t)  t = s / 2^(2w-2), 1/2 to 2;     y <- y (3 - t y^2) / 2

A step of 16 bits squares the error of the polynomial (1.7e-3, 2.1e-3) once, one of 32 bits twice.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, larger, magnitude, rounded

RECIPROCAL_DEGREE, ROOT_DEGREE = 3, 4

_ROUNDS = 200  # of the weights of the fit; further ones change no integer


def newton_steps(width: int) -> int:
    """How often the error of a seed is squared."""
    return 1 if width == 16 else 2


@dataclass(frozen=True, slots=True)
class Seed:
    """A polynomial about ``centre`` by Horner's rule, highest coefficient first, in codes."""

    centre: int
    terms: tuple[int, ...]


def _relative_fit(values: FloatArray, x: FloatArray, degree: int) -> FloatArray:
    """Coefficients with nearly the least largest relative error, by Lawson's weights."""
    matrix = np.polynomial.polynomial.polyvander(x, degree) / values[:, None]
    weight: FloatArray = np.ones_like(x)
    found: FloatArray = np.zeros(degree + 1)
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        found = np.asarray(
            np.linalg.lstsq(matrix * root[:, None], root, rcond=None)[0], dtype=np.float64
        )
        weight = weight * np.abs(matrix @ found - 1.0)
        weight = weight / np.sum(weight)
    return found


def _seed(width: int, ends: tuple[float, float], centre: float, power: float, degree: int) -> Seed:
    """Seed of t^power in codes of 2^(width - 2); t is one of 2^(width - 1)."""
    t = np.linspace(*ends, 1001)
    found = _relative_fit(t**power, t - centre, degree)
    return Seed(
        round(centre * 2.0 ** (width - 1)),
        tuple(round(c * 2.0 ** (width - 2)) for c in found[::-1].tolist()),
    )


@cache
def reciprocal_seed(width: int) -> Seed:
    """Of 1/t."""
    return _seed(width, (0.5, 1.0), 0.75, -1.0, RECIPROCAL_DEGREE)


@cache
def root_seed(width: int) -> Seed:
    """Of 1/sqrt(t)."""
    return _seed(width, (0.5, 2.0), 1.25, -0.5, ROOT_DEGREE)


def _horner(o: Arithmetic[N, Any], seed: Seed, t: N, bits: int) -> N:
    """The polynomial of t, of which 2^bits codes are 1."""
    x = o.total("seed: from the centre", t, o.const(-seed.centre))
    value = o.const(seed.terms[0])
    for term in seed.terms[1:]:
        value = o.shifted(o.product("seed: product", value, x), bits)
        value = o.total("seed: sum", value, o.const(term))
    return value


def reciprocal(o: Arithmetic[N, Any], width: int, m: N) -> N:
    """2^(2 width - 3) / m for m from 2^(width - 2) to 2^(width - 1), nearly to nearest."""
    one = 1 << (width - 2)
    value = _horner(o, reciprocal_seed(width), m, width - 1)
    for _ in range(newton_steps(width)):
        # Changes no number: a range does not know that the polynomial nears 1/t, 1 to 2.
        value = o.clamp(value, one - (one >> 7), 2 * one + (one >> 7))
        lack = o.negative(o.product("reciprocal: t y", m, value))
        rest = o.total("reciprocal: 2 - t y", o.const(1 << (2 * width - 2)), lack)
        rest = rounded(o, "reciprocal: 2 - t y", rest, width - 2)
        value = rounded(o, "reciprocal", o.product("reciprocal", value, rest), width - 1)
    return o.clamp(value, one, 2 * one)  # changes no number


def inverse_root(o: Arithmetic[N, Any], width: int, s: N) -> N:
    """2^(2 width - 2) / sqrt(s) for s from 2^(2 width - 3) to 2^(2 width - 1)."""
    one = 1 << (width - 2)
    t = rounded(o, "inverse root: t", o.shifted(s, width - 2), 1)
    value = _horner(o, root_seed(width), t, width - 1)
    left = newton_steps(width)
    while left:
        # Changes no number: a range does not know that the polynomial nears 0.7 to 1.4.
        value = o.clamp(value, one * 11 // 16, one * 23 // 16)
        near = rounded(o, "inverse root: t y", o.product("inverse root: t y", t, value), width - 2)
        near = o.clamp(near, one * 11 // 8, one * 23 // 8)  # changes no number
        lack = o.negative(o.product("inverse root: t y^2", near, value))
        rest = o.total("inverse root: 3 - t y^2", o.const(3 << (2 * width - 3)), lack)
        rest = rounded(o, "inverse root: 3 - t y^2", rest, width - 1)
        left -= 1
        shift = width - 1 if left else width - 2
        value = rounded(o, "inverse root", o.product("inverse root", value, rest), shift)
    return o.clamp(value, one, 3 * one)  # changes no number


def longest(width: int) -> int:
    """Largest limit of `shortened`: its roundings, 3 codes at the most, stay below full scale."""
    return int(2 ** (width - 1) - 9)


def shortened(o: Arithmetic[N, Any], width: int, asked: Pair[N], limit: N) -> Pair[N]:
    """A voltage shortened along its direction to an amplitude of ``limit``, 0 to `longest`.

    ``asked`` are codes in words of twice the width; a voltage within the limit stays what it is.
    Both components are first halved together until they are codes of one word, so that the
    direction keeps its digits however large they are.
    """
    top = 2 ** (width - 1) - 1
    size = larger(o, magnitude(o, asked.x), magnitude(o, asked.y))
    places = o.halvings("limit: larger component", size, top - 1)
    coarse = [
        o.clamp(o.rounded_by("limit: coarse", x, places), -top, top)  # changes no number
        for x in asked
    ]
    square = o.total(
        "limit: square",
        o.product("limit: square", coarse[0], coarse[0]),
        o.product("limit: square", coarse[1], coarse[1]),
    )
    lowered = o.at_least(places, o.const(1))
    beyond = o.choose(lowered, o.const((1 << (2 * width - 1)) - 1), square)
    whole = o.at_least(o.product("limit: limit^2", limit, limit), beyond)
    positive = o.clamp(square, 1, (1 << (2 * width - 1)) - 1)
    s, doubled = o.normalised(positive, 1 << (2 * width - 3), 2)
    inverse = o.product("limit: share", limit, inverse_root(o, width, s))
    share = o.rounded_by(
        "limit: share",
        inverse,
        o.total("limit: places", o.const(width), o.negative(o.shifted(doubled, 1))),
    )
    share = o.clamp(share, 0, 1 << (width - 1))  # changes no number where the voltage is too long
    found = [
        o.choose(
            whole,
            o.clamp(x, -top, top),  # changes no number within the limit
            o.clamp(
                rounded(
                    o, "limit: shortened", o.product("limit: shortened", part, share), width - 2
                ),
                -top,
                top,
            ),
        )
        for x, part in zip(asked, coarse, strict=True)
    ]
    return Pair(found[0], found[1])
