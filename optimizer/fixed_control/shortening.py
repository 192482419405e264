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
from dqforge.machines.transforms import N
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, larger, magnitude, rounded

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
    x = o.let("x", o.total("seed: from the centre", t, o.const(-seed.centre)))
    value = o.const(seed.terms[0])
    for n, term in enumerate(seed.terms[1:], 1):
        value = o.shifted(o.product("seed: product", value, x), bits)
        value = o.let(f"p_{n}", o.total("seed: sum", value, o.const(term)))
    return value


def reciprocal(o: Arithmetic[N, Any], width: int, m: N) -> N:
    """2^(2 width - 3) / m for m from 2^(width - 2) to 2^(width - 1), nearly to nearest: a
    polynomial and Newton's rule.
    """
    one = 1 << (width - 2)
    value = _horner(o, reciprocal_seed(width), m, width - 1)
    for step in range(newton_steps(width)):
        # A range does not know that the polynomial nears 1/t, 1 to 2.
        value = o.known(value, one - (one >> 7), 2 * one + (one >> 7))
        value = o.let(f"y_{step}", value) if step else value
        lack = o.negative(o.product("reciprocal: t y", m, value))
        rest = o.total("reciprocal: 2 - t y", o.const(1 << (2 * width - 2)), lack)
        rest = o.call(rounded, "reciprocal: 2 - t y", rest, width - 2)
        product = o.product("reciprocal", value, rest)
        value = o.call(rounded, "reciprocal", product, width - 1)
    return o.known(value, one, 2 * one)


def inverse_root(o: Arithmetic[N, Any], width: int, s: N) -> N:
    """2^(2 width - 2) / sqrt(s) for s from 2^(2 width - 3) to 2^(2 width - 1): a polynomial and
    Newton's rule.
    """
    one = 1 << (width - 2)
    t = o.let("t", o.call(rounded, "inverse root: t", o.shifted(s, width - 2), 1))
    value = _horner(o, root_seed(width), t, width - 1)
    steps = newton_steps(width)
    for step in range(steps):
        # A range does not know that the polynomial nears 0.7 to 1.4.
        value = o.known(value, one * 11 // 16, one * 23 // 16)
        value = o.let(f"y_{step}", value) if step else value
        product = o.product("inverse root: t y", t, value)
        near = o.call(rounded, "inverse root: t y", product, width - 2)
        near = o.known(near, one * 11 // 8, one * 23 // 8)
        lack = o.negative(o.product("inverse root: t y^2", near, value))
        rest = o.total("inverse root: 3 - t y^2", o.const(3 << (2 * width - 3)), lack)
        rest = o.call(rounded, "inverse root: 3 - t y^2", rest, width - 1)
        shift = width - 1 if step < steps - 1 else width - 2
        product = o.product("inverse root", value, rest)
        value = o.call(rounded, "inverse root", product, shift)
    return o.known(value, one, 3 * one)


def longest(width: int) -> int:
    """Largest limit of `shortened`: its roundings, 3 codes at the most, stay below full scale."""
    return int(2 ** (width - 1) - 9)


def shortened(o: Arithmetic[N, Any], width: int, d: N, q: N, limit: N) -> Dq[N]:
    """A voltage in wide words shortened along its direction to an amplitude of limit, 0 to full
    scale less 8 codes; within the limit it stays what it is.

    Both components are first halved together until they are codes of one word, so that the
    direction keeps its digits however large they are.
    """
    top = 2 ** (width - 1) - 1
    size_d, size_q = o.let("size_d", magnitude(o, d)), o.let("size_q", magnitude(o, q))
    larger_one = larger(o, size_d, size_q)
    o.remark("To codes of one word: the direction keeps its digits.")
    places = o.halvings("limit: larger component", larger_one, top - 1, into=("size", "places"))
    coarse_d, coarse_q = (
        o.let(name, o.known(o.rounded_by("limit: coarse", x, places), -top, top))
        for name, x in (("coarse_d", d), ("coarse_q", q))
    )
    total = o.total(
        "limit: square",
        o.product("limit: square", coarse_d, coarse_d),
        o.product("limit: square", coarse_q, coarse_q),
    )
    square = o.let("square", total)
    limit_2 = o.product("limit: limit^2", limit, limit)
    beyond = o.some(o.above(places, o.const(0)), o.above(square, limit_2))

    def cut() -> tuple[N, ...]:
        s, bits = o.normalised(
            o.known(square, 1, (1 << (2 * width - 1)) - 1),
            1 << (2 * width - 3),
            2,
            width,
            into=("whole", "bits"),
        )
        inverse = o.product("limit: share", limit, o.call(inverse_root, width, s))
        share = o.rounded_by("limit: share", inverse, bits)
        # At most 1 where the voltage is too long.
        share = o.let("share", o.known(share, 0, 1 << (width - 1)))
        found = (
            o.call(rounded, "limit: shortened", o.product("limit: shortened", x, share), width - 2)
            for x in (coarse_d, coarse_q)
        )
        return tuple(o.known(x, -top, top) for x in found)

    names = ("short_d", "short_q")
    return Dq(*o.cases(names, (beyond, cut), otherwise=lambda: (coarse_d, coarse_q)))
