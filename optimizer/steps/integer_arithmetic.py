"""Integer steps that can be run on numbers and on ranges of numbers,
so that one text serves as model and as proof.

The functions in fixed point (control, references, observers) are written once, with
the operations of `Arithmetic`. Run with `Integers` they are the model of the emitted C, on arrays
of int64; run with `Ranges` they are its interval analysis, in exact integers of any size, and every
named quantity leaves the range that it can take.

Intervals: R. E. Moore, R. B. Kearfott, M. J. Cloud, "Introduction to Interval Analysis", SIAM 2009,
chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import field, fields, is_dataclass, replace
from math import isqrt
from typing import Annotated, Any, Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import C, N
from dqforge.optimizer.steps.code_vectors import COUNT, Coded

CodeArray = NDArray[np.int64]


BoolArray = NDArray[np.bool_]

_T = TypeVar("_T")
_V = TypeVar("_V", bound=tuple[Any, ...])
_P = ParamSpec("_P")


class Factor(Protocol):
    """A number mantissa / 2^shift, and half of what the shift leaves."""

    @property
    def mantissa(self) -> int:
        """An integer."""

    @property
    def shift(self) -> int:
        """Bits."""

    @property
    def half(self) -> int:
        """Half of 2^shift, 0 without a shift."""


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

    def outside(
        self, kind: type[_V], name: str, function: Callable[..., Iterable[Any]], *args: Any
    ) -> _V:
        """A function of the firmware whose text stands elsewhere.

        Args:
            kind: The vector that it makes.
            name: In the firmware.
            function: What it computes, from the arithmetic and the arguments to the numbers of the
                vector.
            args: Numbers and vectors.
        """

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

    def some(self, *conditions: C) -> C:
        """Condition that one holds."""

    def cases(
        self,
        name: str | tuple[str, ...],
        *branches: tuple[C, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """What the first branch returns whose condition holds, else what ``otherwise`` returns; the
        firmware computes one of them.

        Args:
            name: Of the local variable that takes the number or vector, or of one for each; where
                it is empty, nothing is returned.
            branches: Conditions, and what is computed where they hold.
            otherwise: What is computed where none holds.
            changing: Records of a state whose members the branches set.
        """

    def either(self, condition: C, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """What ``then`` returns where the condition holds, else what ``otherwise`` returns: records
        of numbers and tuples of them, at the end of a step.

        The firmware computes one of them.
        """

    def const(self, value: int) -> N:
        """A constant."""

    def product(self, name: str, a: N, b: N) -> N:
        """The product a b."""

    def multiple(self, name: str, count: N, times: int) -> N:
        """A count so many times, kept in a word of a count by the firmware, unlike a product."""

    def total(self, name: str, *terms: N) -> N:
        """Sum of terms, added from the left."""

    def negative(self, a: N) -> N:
        """The number -a."""

    def shifted(self, a: N, bits: int) -> N:
        """floor(a / 2^bits): an arithmetic right shift."""

    def clamp(self, a: N, low: int | None, high: int | None) -> N:
        """The number nearest to a from low to high, of which one may be open."""

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

    def halvings(self, name: str, a: N, most: int, into: tuple[str, str] = ("", "")) -> N:
        """How often a, not negative, must be halved (downwards) until it is at most ``most``;
        ``into`` are names of a copy of a and of the count in the firmware.
        """

    def normalised(
        self, a: N, least: int, step: int, places: int, into: tuple[str, str] = ("", "")
    ) -> tuple[N, N]:
        """A 2^(n step) and ``places`` - n, the least n that makes the former at least ``least``;
        a is positive, ``into`` are names of both in the firmware.
        """

    def wrapped(self, a: N, bits: int) -> N:
        """The remainder of a by 2^bits, 0 to 2^bits - 1."""

    def entry(self, table: tuple[int, ...], index: N) -> N:
        """Entry of a table; the index is never outside it."""

    def widened(self, a: N) -> N:
        """The number a, which the firmware keeps in a word of twice as many bits."""

    def narrowed(self, name: str, a: N) -> N:
        """The number a, which the firmware keeps in a word of 32 bits."""

    def entries(
        self,
        names: Sequence[str],
        tables: Sequence[tuple[int, ...]],
        index: N,
        steps: Sequence[int],
    ) -> list[tuple[N, ...]]:
        """Entries of tables that are the members of an array of items, for some of these.

        Args:
            names: Of the items in the firmware.
            tables: One for each member.
            index: Of the first item.
            steps: From there to each item, the first one 0.
        """

    def neighbours(self, table: tuple[int, ...], index: N, names: tuple[str, str]) -> tuple[N, N]:
        """Entry of a table and the next one; ``names`` are those of the table and of the place in
        the firmware.
        """

    def at_least(self, a: N, b: N) -> C:
        """Condition that a >= b."""

    def above(self, a: N, b: N) -> C:
        """Condition that a > b."""

    def equal(self, a: N, b: N) -> C:
        """Condition that a = b."""

    def has_bit(self, a: N, bit: int) -> C:
        """Condition that a number, not negative, has a bit, given by its worth."""

    def choose(self, condition: C, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""

    def each(self, name: str, count: int, of: Callable[[Any], N]) -> tuple[N, ...]:
        """An array of so many numbers that a counted loop of the firmware fills; ``of`` has the
        place for its argument.
        """

    def at(self, array: Sequence[_T], place: Any) -> _T:
        """What stands at the place of a loop in an array."""

    def repeated(self, state: Any, count: int, of: Callable[[Any], None]) -> None:
        """A counted loop that changes the members of a record, which are variables of the firmware;
        ``of`` has the number of the round for its argument.
        """

    def search(self, name: str, cells: int, holds: Callable[[N], C]) -> N:
        """The last place below ``cells`` up to which a condition holds, 0 without one: in the
        firmware a loop that halves its step.

        Args:
            name: Of the place in the firmware.
            cells: A power of two.
            holds: From a place, 1 or more, to whether it holds there.
        """


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

    def outside(
        self,
        kind: type[_V],
        name: str,  # noqa: ARG002
        function: Callable[..., Iterable[Any]],
        *args: Any,
    ) -> _V:
        """The vector that the function makes."""
        return kind(*function(self, *args))

    def multiple(self, name: str, count: Any, times: int) -> Any:
        """The product."""
        own: Any = self
        return own.product(name, count, own.const(times))

    def widened(self, a: _T) -> _T:
        """The number."""
        return a

    def entries(
        self,
        names: Sequence[str],  # noqa: ARG002
        tables: Sequence[tuple[int, ...]],
        index: Any,
        steps: Sequence[int],
    ) -> list[tuple[Any, ...]]:
        """The entries of each item."""
        own: Any = self
        places = (own.total("node", index, own.const(step)) if step else index for step in steps)
        return [tuple(own.entry(table, place) for table in tables) for place in places]

    def neighbours(
        self,
        table: tuple[int, ...],
        index: Any,
        names: tuple[str, str],  # noqa: ARG002
    ) -> tuple[Any, Any]:
        """Two entries."""
        own: Any = self
        return own.entry(table, index), own.entry(table[1:], index)

    def remark(self, text: str) -> None:
        """Nothing."""

    def each(self, name: str, count: int, of: Callable[[Any], Any]) -> tuple[Any, ...]:  # noqa: ARG002
        """The numbers one after the other."""
        return tuple(map(of, range(count)))

    def at(self, array: Sequence[_T], place: Any) -> _T:
        """The item."""
        found: _T = array[place]
        return found

    def repeated(self, state: Any, count: int, of: Callable[[Any], None]) -> None:  # noqa: ARG002
        """The rounds one after the other."""
        for place in range(count):
            of(place)

    def search(self, name: str, cells: int, holds: Callable[[Any], Any]) -> Any:
        """The place."""
        own: Any = self
        found, step = own.const(0), cells >> 1
        while step:
            trial = own.total(name, found, own.const(step))
            found = own.choose(holds(trial), trial, found)
            step >>= 1
        return found

    def either(self, condition: Any, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """Both, of which each number is chosen."""
        found: _T = self._merged(condition, then(), otherwise())
        return found

    def cases(
        self,
        name: str | tuple[str, ...],  # noqa: ARG002
        *branches: tuple[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """All of them, of which each number is chosen."""
        places = [(record, each.name) for record in changing for each in fields(record)]
        before = [getattr(record, member) for record, member in places]

        def put(values: list[Any]) -> None:
            for (record, member), value in zip(places, values, strict=True):
                setattr(record, member, value)

        def ran(branch: Callable[[], _T]) -> tuple[_T, list[Any]]:
            value = branch()
            after = [getattr(record, member) for record, member in places]
            put(before)
            return value, after

        found, kept = ran(otherwise)
        for condition, branch in reversed(branches):
            value, after = ran(branch)
            found = self._merged(condition, value, found)
            kept = [self._merged(condition, x, y) for x, y in zip(after, kept, strict=True)]
        put(kept)
        return found

    def _merged(self, condition: Any, a: Any, b: Any) -> Any:
        if a is b:
            return a
        if isinstance(a, tuple):
            parts = [self._merged(condition, x, y) for x, y in zip(a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        if is_dataclass(a) and not isinstance(a, Range):
            names = [each.name for each in fields(a)]
            own = {n: self._merged(condition, getattr(a, n), getattr(b, n)) for n in names}
            return replace(a, **own)  # type: ignore[type-var]
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

    def narrowed(self, name: str, a: CodeArray) -> CodeArray:  # noqa: ARG002
        """The numbers."""
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

    def some(self, *conditions: BoolArray) -> BoolArray:
        """Whether one holds."""
        return np.asarray(np.logical_or.reduce(np.broadcast_arrays(*conditions)), dtype=np.bool_)

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

    def clamp(self, a: CodeArray, low: int | None, high: int | None) -> CodeArray:
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

    def halvings(
        self,
        name: str,
        a: CodeArray,
        most: int,
        into: tuple[str, str] = ("", ""),  # noqa: ARG002
    ) -> CodeArray:
        """How often each must be halved."""
        left, count = self._note(name, np.array(a)), np.zeros_like(a)
        while np.any(above := left > most):
            left, count = np.where(above, left >> 1, left), count + above
        return np.asarray(count)

    def normalised(
        self,
        a: CodeArray,
        least: int,
        step: int,
        places: int,
        into: tuple[str, str] = ("", ""),  # noqa: ARG002
    ) -> tuple[CodeArray, CodeArray]:
        """Each shifted to the left, and what is left of the places."""
        found, left = np.array(a), np.full_like(a, places)
        while np.any(below := found < least):
            found, left = np.where(below, found << step, found), left - below
        return found, np.asarray(left)

    def wrapped(self, a: CodeArray, bits: int) -> CodeArray:
        """Remainders by 2^bits."""
        return np.asarray(a & ((1 << bits) - 1))

    def entry(self, table: tuple[int, ...], index: CodeArray) -> CodeArray:
        """Entries of a table."""
        return np.array(table, dtype=np.int64)[index]

    def at_least(self, a: CodeArray, b: CodeArray) -> BoolArray:
        """Whether a >= b."""
        return np.asarray(a >= b)

    def above(self, a: CodeArray, b: CodeArray) -> BoolArray:
        """Whether a > b."""
        return np.asarray(a > b)

    def equal(self, a: CodeArray, b: CodeArray) -> BoolArray:
        """Whether a = b."""
        return np.asarray(a == b)

    def has_bit(self, a: CodeArray, bit: int) -> BoolArray:
        """Whether numbers have a bit."""
        return np.asarray((a & bit) != 0)

    def choose(self, condition: BoolArray, a: CodeArray, b: CodeArray) -> CodeArray:
        """Numbers a where the condition holds, else b."""
        return np.where(condition, a, b)


@dataclass(frozen=True, slots=True)
class Range:
    """All integers from ``low`` to ``high``.

    Raises:
        ValueError: There are none: what is proven of them would hold of no number.
    """

    low: int
    high: int

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError(f"no integer lies from {self.low} to {self.high}")

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

    def _note(self, name: str, a: Range, bits: int = 0) -> Range:
        name = f"{self.prefix}{name}"
        before = self.reaches.get(name)
        if before is None:
            self.reaches[name] = Reach(name, a, bits or 2 * self.width)
        elif a.low < before.range.low or a.high > before.range.high:
            self.reaches[name] = Reach(name, a.hull(before.range), before.bits)
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

    def some(self, *conditions: bool | None) -> bool | None:
        """True or False where the ranges decide it, else None."""
        if True in conditions:
            return True
        return None if None in conditions else False

    def narrowed(self, name: str, a: Range) -> Range:
        """The range, of a word of 32 bits."""
        return self._note(name, a, 32)

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

    def clamp(self, a: Range, low: int | None, high: int | None) -> Range:
        """Range between fixed limits."""
        ends = [a.low, a.high]
        ends = ends if low is None else [max(end, low) for end in ends]
        ends = ends if high is None else [min(end, high) for end in ends]
        return Range(*ends)

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

    def halvings(
        self,
        name: str,
        a: Range,
        most: int,
        into: tuple[str, str] = ("", ""),  # noqa: ARG002
    ) -> Range:
        """From how often the least to how often the largest must be halved."""
        self._note(name, a)
        return Range(_halvings(a.low, most), _halvings(a.high, most))

    def normalised(
        self,
        a: Range,
        least: int,
        step: int,
        places: int,
        into: tuple[str, str] = ("", ""),  # noqa: ARG002
    ) -> tuple[Range, Range]:
        """Everything from ``least`` on, and what the least and the largest leave of the places."""
        high = max(a.high, (least << step) - 1)
        left = [places - _doublings(end, least, step) for end in (a.low, a.high)]
        return Range(least, high), Range(*left)

    def wrapped(self, a: Range, bits: int) -> Range:  # noqa: ARG002
        """Every remainder."""
        return Range(0, (1 << bits) - 1)

    def at_least(self, a: Range, b: Range) -> bool | None:
        """True or False where the ranges decide it, else None."""
        if a.low >= b.high:
            return True
        return False if a.high < b.low else None

    def above(self, a: Range, b: Range) -> bool | None:
        """True or False where the ranges decide it, else None."""
        not_above = self.at_least(b, a)
        return None if not_above is None else not not_above

    def equal(self, a: Range, b: Range) -> bool | None:
        """True or False where the ranges decide it, else None."""
        if a.low == a.high == b.low == b.high:
            return True
        return None if a.low <= b.high and b.low <= a.high else False

    def has_bit(self, a: Range, bit: int) -> bool | None:
        """False where the range ends below the bit, else None."""
        return False if a.high < bit else None

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
    while a << (count * step) < least:
        count += 1
    return count


def larger(o: Arithmetic[N, Any], a: N, b: N) -> N:
    """The larger of two numbers."""
    return o.choose(o.at_least(a, b), a, b)


def magnitude(o: Arithmetic[N, Any], a: N) -> N:
    """The magnitude of a number."""
    return o.choose(o.at_least(a, o.const(0)), a, o.negative(a))


def rounded(o: Arithmetic[N, Any], name: str, x: N, bits: Annotated[Any, COUNT]) -> N:
    """A right shift that rounds to nearest, halves upwards.

    ``name`` is the sum with half of what the shift leaves.
    """
    return o.shifted(o.total(name, x, o.const((1 << bits) >> 1)), bits)


def saturated(o: Arithmetic[N, Any], width: int, x: N) -> Coded[N]:
    """The code nearest to x."""
    return o.clamp(x, -(1 << (width - 1)), (1 << (width - 1)) - 1)


def scaled(o: Arithmetic[N, C], name: str, gain: Factor, x: N) -> N:
    """The product with a gain, rounded to nearest."""
    product = o.product(name, o.const(gain.mantissa), x)
    return o.shifted(o.total(name, product, o.const(gain.half)), gain.shift)
