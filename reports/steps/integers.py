"""Expressions of C over integers: the numbers on which a step in fixed point is run where its text
is wanted.

Each knows the range of its values, and from that which types of C hold it; the same sum may be
written as int32_t, int64_t or, by the rules of unsigned integers, as uint32_t.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dqforge.machines.records import dataclass
from dqforge.optimizer.steps.integer_arithmetic import Range
from dqforge.reports.c_code.numbers import int32_literal, int64_literal
from dqforge.reports.steps.symbols import Expression

INT32, INT64, UINT32 = "int32_t", "int64_t", "uint32_t"
CODES = Range(-(2**31), 2**31 - 1)
WORD = Range(0, 2**32 - 1)  # Of uint32_t.


def holds(outer: Range, inner: Range) -> bool:
    """Whether a range lies within another one."""
    return outer.low <= inner.low and inner.high <= outer.high


class Number(Expression):
    """An integer of a step, as text.

    Args:
        text: In C, of the type ``kind``.
        kind: Type of C.
        range: What it can be.
        others: Text by other types, where it is not a conversion of ``text``.
        free: Whether it may be written twice, since it computes nothing.
        inner: Where it is a negative, of what.
    """

    __slots__ = ("free", "inner", "kind", "others", "range")

    def __init__(
        self,
        text: str,
        kind: str,
        range_: Range,
        *,
        atom: bool = True,
        free: bool = False,
        others: Mapping[str, str] | None = None,
        reads: frozenset[str] = frozenset(),
        whole: str = "",
        inner: Number | None = None,
    ) -> None:
        super().__init__(text, atom=atom, reads=reads, whole=whole)
        self.kind, self.range, self.free, self.inner = kind, range_, free, inner
        self.others = dict(others or {})

    @property
    def is_name(self) -> bool:
        """Whether it may be written twice."""
        return self.free

    @property
    def is_literal(self) -> bool:
        """Whether it is a constant."""
        start = self.text.lstrip("-(")
        return self.free and (start[:1].isdigit() or start.startswith("INT64_C"))

    def written(self, kind: str, *, operand: bool = False) -> str:
        """Text whose value has the type ``kind``, without counting it as a use.

        An atom of 32 bits may stand for one of 64, as it is widened where it stands.
        """
        if self.is_literal and self.range.low >= 0:
            return literal(self.range.low, UINT32 if kind == UINT32 else "").text
        if kind == self.kind or (kind == INT64 and self.kind == INT32 and self.atom):
            text, atom = self.text, self.atom
        elif kind in self.others:
            text, atom = self.others[kind], False
        else:
            return f"({kind}){self.text if self.atom else f'({self.text})'}"
        return f"({text})" if operand and not atom else text

    def is_wide(self) -> bool:
        """Whether what `written` gives for 64 bits has that type by itself."""
        return self.kind == INT64 or INT64 in self.others or self.kind == UINT32

    def plain(self) -> bool:
        """Whether a conversion may stand before it: it is computed by no operator."""
        return self.atom or self.is_literal

    def __neg__(self) -> Number:
        """The negative."""
        return negated(self)

    def __rlshift__(self, one: int) -> Number:
        """A power of two."""
        assert one == 1
        low, high = 1 << self.range.low, 1 << self.range.high
        text = f"(int64_t)1 << {self.text}"
        return Number(text, INT64, Range(low, high), atom=False, reads=self.reads, free=self.free)

    def __rshift__(self, bits: int) -> Number:
        """Shifted to the right."""
        found = Range(self.range.low >> bits, self.range.high >> bits)
        text = f"{self.written(self.kind, operand=True)} >> {bits}"
        return Number(text, self.kind, found, atom=False, reads=self.reads, free=self.free)

    def _bits(self, sign: str, other: int | Number, *, swapped: bool = False) -> Number:
        """A number of bits; those that are known are added up here."""
        right = other if isinstance(other, Number) else literal(other, UINT32)
        a, b = (right, self) if swapped else (self, right)
        low, high = (b.range.low, b.range.high) if sign == "+" else (-b.range.high, -b.range.low)
        found = Range(a.range.low + low, a.range.high + high)
        text = f"{a.written(UINT32, operand=True)} {sign} {b.written(UINT32, operand=True)}"
        return Number(text, UINT32, found, atom=False, free=self.free)

    def __add__(self, other: Any) -> Number:
        """The sum, of numbers of bits."""
        return self._bits("+", other)

    def __sub__(self, other: Any) -> Number:
        """The difference, of numbers of bits."""
        return self._bits("-", other)

    def __radd__(self, other: Any) -> Number:
        """The sum, of numbers of bits."""
        return self._bits("+", other, swapped=True)

    def __rsub__(self, other: Any) -> Number:
        """The difference, of numbers of bits."""
        return self._bits("-", other, swapped=True)


def literal(value: int, kind: str = "") -> Number:
    """A constant."""
    found = Range(value, value)
    if kind == UINT32:
        return Number(f"{value}U", UINT32, found, free=True)
    narrow = holds(CODES, found)
    text = int32_literal(value) if narrow else int64_literal(value)
    return Number(text, INT32 if narrow else INT64, found, free=True)


def number(value: int | Number) -> Number:
    """A number, or the constant."""
    return value if isinstance(value, Number) else literal(int(value))


def made(
    text: str,
    kind: str,
    range_: Range,
    parts: Sequence[Number],
    others: Mapping[str, str] | None = None,
    *,
    atom: bool = False,
) -> Number:
    """A number made of others, which are used here."""
    for part in parts:
        part.bare()
    return Number(
        text,
        kind,
        range_,
        atom=atom,
        free=bool(parts) and all(part.is_literal for part in parts),
        others=others,
        reads=frozenset[str]().union(*(part.reads for part in parts)),
    )


def wide_operands(parts: Sequence[Number]) -> list[str]:
    """Operands of which one of the first two has 64 bits by itself: the rest is widened to it."""
    texts = [part.written(INT64, operand=True) for part in parts]
    if not any(part.is_wide() for part in parts[:2]):
        at = 0 if not parts[0].is_literal or len(parts) == 1 else 1
        texts[at] = f"(int64_t){texts[at]}"
    return texts


def negated(a: Number) -> Number:
    """The negative of a number."""
    if a.is_literal:
        return literal(-a.range.low)
    if a.inner is not None:
        return a.inner
    found = Range(-a.range.high, -a.range.low)
    wide = f"-{wide_operands([a])[0]}"
    if a.kind == INT32 and holds(CODES, found):
        text, kind = f"-{a.written(INT32, operand=True)}", INT32
    else:
        text, kind = wide, INT64
    others = {} if kind == INT64 else {INT64: wide}
    if a.kind == INT32:
        others.setdefault(INT32, f"-{a.written(INT32, operand=True)}")
    return Number(
        text,
        kind,
        found,
        atom=False,
        others=others,
        reads=a.reads,
        inner=a,
        free=a.free,
    )


def product(a: Number, b: Number) -> Number:
    """The product, constants behind what they are multiplied with."""
    if a.is_literal:
        a, b = b, a
    corners = [x * y for x in (a.range.low, a.range.high) for y in (b.range.low, b.range.high)]
    found = Range(min(corners), max(corners))
    if b.is_literal and b.range.low == 1:
        return a
    wide, others = " * ".join(wide_operands([a, b])), dict[str, str]()
    if a.kind == b.kind == INT32:
        others[INT32] = " * ".join(part.written(INT32, operand=True) for part in (a, b))
    if INT32 in others and holds(CODES, found):
        return made(others[INT32], INT32, found, (a, b), {INT64: wide})
    return made(wide, INT64, found, (a, b), others)


@dataclass(frozen=True, slots=True)
class _Term:
    sign: str
    part: Number


def _terms(numbers: Sequence[Number]) -> list[_Term]:
    found = list[_Term]()
    for item in numbers:
        if item.is_literal and item.range.low < 0 and found:
            found.append(_Term("-", literal(-item.range.low)))
        elif item.inner is not None and found:
            found.append(_Term("-", item.inner))
        elif not (item.is_literal and item.range.low == 0):
            found.append(_Term("+", item))
    return found


def total(*numbers: Number) -> Number:
    """The sum, from the left."""
    partial, sums = numbers[0].range, list[Range]()
    for item in numbers[1:]:
        partial = Range(partial.low + item.range.low, partial.high + item.range.high)
        sums.append(partial)
    terms = _terms(numbers)
    if len(terms) < 2:
        return numbers[0] if not terms else terms[0].part
    parts = [term.part for term in terms]

    def joined(texts: Sequence[str]) -> str:
        rest = zip(terms[1:], texts[1:], strict=True)
        return texts[0] + "".join(f" {term.sign} {text}" for term, text in rest)

    texts = {INT64: joined(wide_operands(parts))}
    every = [*sums, *(part.range for part in parts)]
    fits = all(holds(CODES, each) for each in every)
    # Of two numbers the sum is that of all, which fits where it is asked for.
    if all(part.kind == INT32 for part in parts) and (fits or len(parts) == 2):
        texts[INT32] = joined([part.written(INT32, operand=True) for part in parts])
    if all(part.plain() or part.kind == UINT32 for part in parts):
        texts[UINT32] = joined([part.written(UINT32, operand=True) for part in parts])
    narrow = all(
        part.kind != INT64 and term.sign == "+" for term, part in zip(terms, parts, strict=True)
    )
    if INT32 in texts and fits:
        kind = INT32
    elif UINT32 in texts and narrow and all(holds(WORD, each) for each in every):
        kind = UINT32
    else:
        kind = INT64
    others = {name: text for name, text in texts.items() if name != kind}
    return made(texts[kind], kind, partial, parts, others)


def narrowed(a: Number, low: int, high: int) -> Number:
    """A number of which is known where it lies."""
    found = Range(min(max(a.range.low, low), high), min(max(a.range.high, low), high))
    kind = INT32 if INT32 in a.others and holds(CODES, found) else a.kind
    text = a.text if kind == a.kind else a.others[kind]
    others = {name: text for name, text in a.others.items() if name != kind}
    if kind != a.kind:
        others[a.kind] = a.text
    return Number(
        text, kind, found, atom=a.atom, free=a.free, others=others, reads=a.reads, inner=a.inner
    )
