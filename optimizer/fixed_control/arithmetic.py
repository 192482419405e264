"""Integer steps that can be run on numbers and on ranges of numbers,
so that one text serves as model and as proof.

The control functions in fixed point (`fixed_transforms`, `fixed_control`) are written once, with
the operations of `Arithmetic`. Run with `Integers` they are the model of the emitted C, on arrays
of int64; run with `Ranges` they are its interval analysis, in exact integers of any size, and every
named quantity leaves the range that it can take.

Intervals: R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to Interval Analysis", SIAM 2009,
chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, fields, is_dataclass, replace
from functools import cache
from math import isqrt
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import C, N, Pair
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise, rounded_mantissa
from dqforge.optimizer.loops.loop_gains import (
    LoopGains,
    analyse_current_loop,
    analyse_speed_loop,
    loop_bases,
    per_unit,
)

CodeArray = NDArray[np.int64]


BoolArray = NDArray[np.bool_]

_T = TypeVar("_T")
_P = ParamSpec("_P")


class Arithmetic(Protocol[N, C]):
    """Operations on numbers N with conditions C.

    ``name`` says what a result is that could overflow. Steps of which the C is written
    (`dqforge.reports.steps.integer_text`) use `let`, `call` and `remark`, too, which change
    nothing.
    """

    def let(self, name: str, value: _T, meaning: str = "") -> _T:
        """Give a value its name in the firmware; whatever is used twice needs one.

        Args:
            name: Of a local variable.
            value: A number, a vector, or a list of numbers, which get a name each.
            meaning: What it is.
        """

    def call(
        self,
        function: Callable[Concatenate[Arithmetic[N, Any], _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """Let a function be one of the firmware, too: ``function(self, ...)``."""

    def remark(self, text: str) -> None:
        """Say what comes next."""

    def known(self, a: N, low: int, high: int) -> N:
        """The number a, which lies from low to high for a reason that its range does not show; the
        firmware takes it as it is.
        """

    def shifted_by(self, a: N, bits: N) -> N:
        """floor(a / 2^bits) by a number of bits that is computed."""

    def every(self, *conditions: C) -> C:
        """Condition that all hold."""

    def either(self, condition: C, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """What ``then`` returns where the condition holds, else what ``otherwise`` returns: records
        of numbers and tuples of them, at the end of a step.

        The firmware computes one of them.
        """

    def const(self, value: int) -> N:
        """A constant."""

    def product(self, name: str, a: N, b: N) -> N:
        """The product a b."""

    def total(self, name: str, *terms: N) -> N:
        """Sum of terms, added from the left."""

    def negative(self, a: N) -> N:
        """The number -a."""

    def shifted(self, a: N, bits: int) -> N:
        """floor(a / 2^bits): an arithmetic right shift."""

    def clamp(self, a: N, low: int, high: int) -> N:
        """The number nearest to a from low to high."""

    def within(self, a: N, limit: N) -> N:
        """The number nearest to a from -limit to limit; limit is not negative."""

    def quotient(self, name: str, a: N, b: N) -> N:
        """Quotient a / b towards zero, b positive."""

    def root(self, a: N) -> N:
        """Largest integer whose square is not above a; a is not negative."""

    def rounded_by(self, name: str, a: N, bits: N) -> N:
        """Right shift by a number of bits that is computed, to nearest, halves upwards;
        ``name`` is the sum with half of what the shift leaves.
        """

    def halvings(self, name: str, a: N, most: int) -> N:
        """How often a, not negative, must be halved (downwards) until it is at most ``most``."""

    def normalised(self, a: N, least: int, step: int) -> tuple[N, N]:
        """A 2^n and n, the least multiple of ``step`` that makes a 2^n at least ``least``;
        a is positive.
        """

    def wrapped(self, a: N, bits: int) -> N:
        """The remainder of a by 2^bits, 0 to 2^bits - 1."""

    def entry(self, table: tuple[int, ...], index: N) -> N:
        """Entry of a table; the index is never outside it."""

    def at_least(self, a: N, b: N) -> C:
        """Condition that a >= b."""

    def choose(self, condition: C, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""


class _Unnamed:
    """Numbers and ranges have no names."""

    __slots__ = ()

    def let(self, name: str, value: _T, meaning: str = "") -> _T:  # noqa: ARG002
        """The value."""
        return value

    def call(
        self,
        function: Callable[Concatenate[Any, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """What the function returns."""
        return function(self, *args, **kwargs)

    def remark(self, text: str) -> None:
        """Nothing."""

    def either(self, condition: Any, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """Both, of which each number is chosen."""
        found: _T = self._merged(condition, then(), otherwise())
        return found

    def _merged(self, condition: Any, a: Any, b: Any) -> Any:
        if isinstance(a, tuple):
            return tuple(self._merged(condition, x, y) for x, y in zip(a, b, strict=True))
        if is_dataclass(a) and not isinstance(a, Range):
            names = [each.name for each in fields(a)]
            parts = {n: self._merged(condition, getattr(a, n), getattr(b, n)) for n in names}
            return replace(a, **parts)  # type: ignore[type-var]
        return self.choose(condition, a, b)  # type: ignore[attr-defined]


@dataclass(slots=True)
class Integers(_Unnamed):
    """Arithmetic on arrays of int64, any shapes that fit together: the model of the emitted C.

    With ``seen``, the least and largest value of every named quantity is kept there.
    """

    seen: dict[str, tuple[int, int]] | None = None

    def _note(self, name: str, a: CodeArray) -> CodeArray:
        if self.seen is not None:
            low, high = self.seen.get(name, (0, 0))
            self.seen[name] = (min(low, int(np.min(a))), max(high, int(np.max(a))))
        return a

    def known(self, a: CodeArray, low: int, high: int) -> CodeArray:
        """The numbers within the limits; the C would differ from others."""
        return self.clamp(a, low, high)

    def shifted_by(self, a: CodeArray, bits: CodeArray) -> CodeArray:
        """floor(a / 2^bits)."""
        return np.asarray(a >> bits)

    def every(self, *conditions: BoolArray) -> BoolArray:
        """Whether all hold."""
        return np.asarray(np.logical_and.reduce(np.broadcast_arrays(*conditions)), dtype=np.bool_)

    def const(self, value: int) -> CodeArray:
        """A constant, shape ()."""
        return np.array(value, dtype=np.int64)

    def product(self, name: str, a: CodeArray, b: CodeArray) -> CodeArray:
        """The product a b."""
        return self._note(name, np.asarray(a * b))

    def total(self, name: str, *terms: CodeArray) -> CodeArray:
        """Sum of terms, added from the left."""
        value = terms[0]
        for term in terms[1:]:
            value = self._note(name, np.asarray(value + term))
        return value

    def negative(self, a: CodeArray) -> CodeArray:
        """The numbers -a."""
        return np.asarray(-a)

    def shifted(self, a: CodeArray, bits: int) -> CodeArray:
        """floor(a / 2^bits)."""
        return np.asarray(a >> bits)

    def clamp(self, a: CodeArray, low: int, high: int) -> CodeArray:
        """The numbers nearest to a from low to high."""
        return np.clip(a, low, high)

    def within(self, a: CodeArray, limit: CodeArray) -> CodeArray:
        """The numbers nearest to a from -limit to limit."""
        return np.minimum(np.maximum(a, -limit), limit)

    def quotient(self, name: str, a: CodeArray, b: CodeArray) -> CodeArray:
        """Quotient towards zero."""
        return self._note(name, np.asarray(np.sign(a) * (np.abs(a) // b)))

    def root(self, a: CodeArray) -> CodeArray:
        """Largest integers whose squares are not above a."""
        estimate = np.floor(np.sqrt(a.astype(np.float64))).astype(np.int64)
        # The double may have rounded up to the next integer; one step down and
        # up again finds the floor.
        estimate = np.where(estimate * estimate > a, estimate - 1, estimate)
        return np.asarray(np.where((estimate + 1) * (estimate + 1) <= a, estimate + 1, estimate))

    def rounded_by(self, name: str, a: CodeArray, bits: CodeArray) -> CodeArray:
        """Right shifts to nearest."""
        half = np.left_shift(np.int64(1), bits) >> 1
        return np.asarray(self._note(name, np.asarray(a + half)) >> bits)

    def halvings(self, name: str, a: CodeArray, most: int) -> CodeArray:
        """How often each must be halved."""
        left, count = self._note(name, np.array(a)), np.zeros_like(a)
        while np.any(above := left > most):
            left, count = np.where(above, left >> 1, left), count + above
        return np.asarray(count)

    def normalised(self, a: CodeArray, least: int, step: int) -> tuple[CodeArray, CodeArray]:
        """Each shifted to the left, and by how many bits."""
        found, count = np.array(a), np.zeros_like(a)
        while np.any(below := found < least):
            found, count = np.where(below, found << step, found), count + step * below
        return found, np.asarray(count)

    def wrapped(self, a: CodeArray, bits: int) -> CodeArray:
        """Remainders by 2^bits."""
        return np.asarray(a & ((1 << bits) - 1))

    def entry(self, table: tuple[int, ...], index: CodeArray) -> CodeArray:
        """Entries of a table."""
        return np.array(table, dtype=np.int64)[index]

    def at_least(self, a: CodeArray, b: CodeArray) -> BoolArray:
        """Whether a >= b."""
        return np.asarray(a >= b)

    def choose(self, condition: BoolArray, a: CodeArray, b: CodeArray) -> CodeArray:
        """Numbers a where the condition holds, else b."""
        return np.where(condition, a, b)


@dataclass(frozen=True, slots=True)
class Range:
    """All integers from ``low`` to ``high``."""

    low: int
    high: int

    @property
    def largest(self) -> int:
        """Largest magnitude."""
        return max(abs(self.low), abs(self.high))

    def hull(self, other: Range) -> Range:
        """The smallest range that holds both."""
        return Range(min(self.low, other.low), max(self.high, other.high))


@dataclass(frozen=True, slots=True)
class Reach:
    """Range of a named quantity and the bits of the signed word that must hold it."""

    name: str
    range: Range
    bits: int

    @property
    def fits(self) -> bool:
        """Whether the word holds every value of the range."""
        limit = 1 << (self.bits - 1)
        return -limit <= self.range.low and self.range.high < limit

    @property
    def share(self) -> float:
        """Largest magnitude over that of the word."""
        return float(self.range.largest / (1 << (self.bits - 1)))


@dataclass(slots=True)
class Ranges(_Unnamed):
    """Arithmetic on ranges.

    ``reaches`` collects what every named quantity can take, in the order of evaluation.

    ``width`` is that of the numbers, 16 or 32 bits; products and sums have twice that.
    ``prefix`` stands before names.
    """

    width: int
    prefix: str = ""
    reaches: dict[str, Reach] = field(default_factory=dict)

    def _note(self, name: str, a: Range) -> Range:
        name = f"{self.prefix}{name}"
        before = self.reaches.get(name)
        hull = a if before is None else a.hull(before.range)
        self.reaches[name] = Reach(name, hull, 2 * self.width)
        return a

    def overflowing(self) -> Reach | None:
        """The first quantity that its word cannot hold."""
        return next((reach for reach in self.reaches.values() if not reach.fits), None)

    def shifted_by(self, a: Range, bits: Range) -> Range:
        """Range over every number of bits."""
        corners = [x >> y for x in (a.low, a.high) for y in (bits.low, bits.high)]
        return Range(min(corners), max(corners))

    def every(self, *conditions: bool | None) -> bool | None:
        """True or False where the ranges decide it, else None."""
        if False in conditions:
            return False
        return None if None in conditions else True

    def known(self, a: Range, low: int, high: int) -> Range:
        """The part of the range that lies there."""
        return self.clamp(a, low, high)

    def const(self, value: int) -> Range:
        """A constant."""
        return Range(value, value)

    def product(self, name: str, a: Range, b: Range) -> Range:
        """Range of the product."""
        corners = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
        return self._note(name, Range(min(corners), max(corners)))

    def total(self, name: str, *terms: Range) -> Range:
        """Range of the sum; every partial sum counts."""
        value = terms[0]
        for term in terms[1:]:
            value = self._note(name, Range(value.low + term.low, value.high + term.high))
        return value

    def negative(self, a: Range) -> Range:
        """Range of -a."""
        return Range(-a.high, -a.low)

    def shifted(self, a: Range, bits: int) -> Range:
        """Range after a right shift."""
        return Range(a.low >> bits, a.high >> bits)

    def clamp(self, a: Range, low: int, high: int) -> Range:
        """Range between fixed limits."""
        return Range(min(max(a.low, low), high), min(max(a.high, low), high))

    def within(self, a: Range, limit: Range) -> Range:
        """Range between limits that have a range themselves."""
        low = max(a.low, -limit.high) if a.low < 0 else min(a.low, limit.low)
        high = min(a.high, limit.high) if a.high > 0 else max(a.high, -limit.low)
        return Range(low, high)

    def entry(self, table: tuple[int, ...], index: Range) -> Range:
        """Range of the entries from the least to the largest index.

        Raises:
            IndexError: The index can leave the table.
        """
        if index.low < 0 or index.high >= len(table):
            raise IndexError(f"{index} leaves a table of {len(table)} entries")
        part = table[index.low : index.high + 1]
        return Range(min(part), max(part))

    def quotient(self, name: str, a: Range, b: Range) -> Range:
        """Range of the quotient."""
        corners = [
            abs(x) // y * (1 if x >= 0 else -1) for x in (a.low, a.high) for y in (b.low, b.high)
        ]
        return self._note(name, Range(min(corners), max(corners)))

    def root(self, a: Range) -> Range:
        """Range of the root."""
        return Range(isqrt(a.low), isqrt(a.high))

    def rounded_by(self, name: str, a: Range, bits: Range) -> Range:
        """Range over every number of bits."""
        found: Range | None = None
        for count in range(bits.low, bits.high + 1):
            half = (1 << count) >> 1
            self._note(name, Range(a.low + half, a.high + half))
            shifted = Range((a.low + half) >> count, (a.high + half) >> count)
            found = shifted if found is None else found.hull(shifted)
        assert found is not None
        return found

    def halvings(self, name: str, a: Range, most: int) -> Range:
        """From how often the least to how often the largest must be halved."""
        self._note(name, a)
        return Range(_halvings(a.low, most), _halvings(a.high, most))

    def normalised(self, a: Range, least: int, step: int) -> tuple[Range, Range]:
        """Everything from ``least`` on, and from how far the largest to how far the least is
        shifted.
        """
        high = max(a.high, (least << step) - 1)
        return Range(least, high), Range(
            _doublings(a.high, least, step), _doublings(a.low, least, step)
        )

    def wrapped(self, a: Range, bits: int) -> Range:  # noqa: ARG002
        """Every remainder."""
        return Range(0, (1 << bits) - 1)

    def at_least(self, a: Range, b: Range) -> bool | None:
        """True or False where the ranges decide it, else None."""
        if a.low >= b.high:
            return True
        return False if a.high < b.low else None

    def choose(self, condition: bool | None, a: Range, b: Range) -> Range:
        """Both, where the condition is open."""
        if condition is None:
            return a.hull(b)
        return a if condition else b


def _halvings(a: int, most: int) -> int:
    count = 0
    while a >> count > most:
        count += 1
    return count


def _doublings(a: int, least: int, step: int) -> int:
    count = 0
    while a << count < least:
        count += step
    return count


def larger(o: Arithmetic[N, Any], a: N, b: N) -> N:
    """The larger of two numbers."""
    return o.choose(o.at_least(a, b), a, b)


def magnitude(o: Arithmetic[N, Any], a: N) -> N:
    """The magnitude of a number."""
    return o.choose(o.at_least(a, o.const(0)), a, o.negative(a))


def rounded(o: Arithmetic[N, Any], name: str, a: N, bits: int) -> N:
    """Right shift that rounds to nearest, halves upwards.

    ``name`` is the sum with half of what the shift leaves.
    """
    return o.shifted(o.total(name, a, o.const((1 << bits) >> 1)), bits)


# A voltage shortened along its direction, and reciprocals, in integers without a division.
#
# The least cores have no divider: a division by software takes them some 200 instructions. A
# reciprocal and a reciprocal root by a polynomial and Newton's rule take some 30 each. Both numbers
# are shifted to the left first, so that they keep the digits of their word:
#
# ::
#
#     1/t        t = m / 2^(w-1), 1/2 to 1;      y <- y (2 - t y)
#     1/sqrt(t)  t = s / 2^(2w-2), 1/2 to 2;     y <- y (3 - t y^2) / 2
#
# A step of 16 bits squares the error of the polynomial (1.7e-3, 2.1e-3) once, one of 32 bits twice.

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


# What rounding gains to integers (`dqforge.optimizer.loops.integer_gains`) does to the loop.


def scaled(o: Arithmetic[N, C], name: str, gain: FixedGain, argument: N) -> N:
    """Gain times argument, rounded to nearest, as the emitted C computes it."""
    product = o.product(name, o.const(gain.mantissa), argument)
    return rounded(o, name, product, gain.shift)


def velocity_integers(kp: float, ki_ts: float, width: int = 16) -> tuple[FixedGain, FixedGain]:
    """Integers of q0 = kp + ki t_s and q1 = -kp with one shift, d[k] = d[k-1] + q0 e[k] + q1
    e[k-1] (paper 001, (8.9)).

    The integral gain is the small difference q0 + q1, so that it loses the digits that both share.
    """
    coarse = quantise(kp + ki_ts, width, 2**width - 1)
    return coarse, FixedGain(rounded_mantissa(-kp, coarse.shift), coarse.shift, -kp)


@dataclass(frozen=True, slots=True)
class QuantisedLoop:
    """One loop with the gains that integers make.

    Args:
        kp, ki_ts: The integers, per unit.
        q0, q1: Those of the velocity form with two products.
        exact, found: Evidence for the real gains and for those of ``kp`` and ``ki_ts``.
        velocity: Evidence for the gains that ``q0`` and ``q1`` make; None where their integral gain
            is not positive.
    """

    kp: FixedGain
    ki_ts: FixedGain
    q0: FixedGain
    q1: FixedGain
    exact: LoopGains
    found: LoopGains
    velocity: LoopGains | None

    @property
    def velocity_ki_error(self) -> float:
        """Relative error of the integral gain q0 + q1."""
        return (self.q0.realised + self.q1.realised) / self.ki_ts.value - 1.0


def quantised_loop(
    design: Design,
    gains: LoopGains,
    integers: tuple[FixedGain, FixedGain],
    width: int = 16,
    current_gains: LoopGains | None = None,
) -> QuantisedLoop:
    """Poles and margins of a loop with its gains in integers.

    Args:
        design: Machine, sampling and bases.
        gains: The loop with real gains.
        integers: kp and ki t_s per unit.
        width: Bits of q0 and q1.
        current_gains: Gains of the q axis, for the speed loop.

    Raises:
        NoSolutionError: The loop with these integers is unstable or has less than the required
            phase margin.
    """
    kp, ki_ts = integers
    q0, q1 = velocity_integers(kp.value, ki_ts.value, width)
    found = _analysed(design, gains, (kp.realised, ki_ts.realised), current_gains)
    velocity_ki = q0.realised + q1.realised
    velocity = (
        None
        if velocity_ki <= 0.0
        else _analysed(design, gains, (-q1.realised, velocity_ki), current_gains)
    )
    _require(design, found, kp, ki_ts)
    return QuantisedLoop(kp, ki_ts, q0, q1, gains, found, velocity)


def real_pi(design: Design, gains: LoopGains) -> tuple[float, float]:
    """Per-unit (kp, ki t_s) of a loop of the design."""
    return per_unit(gains, *loop_bases(design.control.bases, gains.loop))


def _analysed(
    design: Design, gains: LoopGains, found: Sequence[float], current_gains: LoopGains | None
) -> LoopGains:
    base_in, base_out = loop_bases(design.control.bases, gains.loop)
    kp, ki = found[0] * base_out / base_in, found[1] * base_out / base_in / gains.t_s
    if gains.loop == "speed":
        assert current_gains is not None
        return analyse_speed_loop(
            design.machine, current_gains, design.control, kp, ki, gains.method, respond=False
        )
    inductance = gains.inductance or design.machine.l_q
    return analyse_current_loop(
        design.machine.r_s, inductance, gains.t_s, kp, ki, gains.method, gains.loop, respond=False
    )


def _require(design: Design, found: LoopGains, kp: FixedGain, ki_ts: FixedGain) -> None:
    control = design.control
    loop = control.speed_loop if found.loop == "speed" else control.current_loop
    section = "speed_loop" if found.loop == "speed" else "current_loop"
    required = 0.0 if loop is None else loop.min_phase_margin
    if found.stable and abs(found.phase_margin) >= required:
        return
    raise NoSolutionError(
        (
            f"control.{section}: with kp = {kp.text()} and ki t_s = {ki_ts.text()} the "
            f"{found.loop} loop "
        )
        + ("misses its phase margin" if found.stable else "is unstable")
        + f" (rounded by {kp.error:+.2%} and {ki_ts.error:+.2%}); write q_formats: auto"
    )
