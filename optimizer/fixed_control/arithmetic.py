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

from dataclasses import field
from math import isqrt
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import C, N

CodeArray = NDArray[np.int64]


BoolArray = NDArray[np.bool_]


class Arithmetic(Protocol[N, C]):
    """Operations on numbers N with conditions C.

    ``name`` says what a result is that could overflow.
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


@dataclass(slots=True)
class Integers:
    """Arithmetic on arrays of int64, any shapes that fit together: the model of the emitted C.

    With ``seen``, the least and largest value of every named quantity is kept there.
    """

    seen: dict[str, tuple[int, int]] | None = None

    def _note(self, name: str, a: CodeArray) -> CodeArray:
        if self.seen is not None:
            low, high = self.seen.get(name, (0, 0))
            self.seen[name] = (min(low, int(np.min(a))), max(high, int(np.max(a))))
        return a

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
class Ranges:
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
