"""Functions of torque and excess flux linkage for `check_surface.py`, in integers and fractions:
exact polynomials, their ranges on boxes, and what single precision makes of an expression of C.

It imports nothing but the standard library and `kit.py` beside it.
"""

from __future__ import annotations

import re
from fractions import Fraction
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit
else:  # run alone: it lies beside this one
    import kit

BITS, ONE, Fault = kit.BITS, kit.ONE, kit.Fault
Span = tuple[int, int]
Rows = list[list[int]]

# Numbers are integers in units of 2^-BITS. A polynomial on a box is held by its coefficients in
# Bernstein's basis: its values lie between the least and the largest of them, and those of either
# half of the box are means of neighbours (de Casteljau).


class Poly:
    """An exact polynomial: coefficients by the powers of t and x."""

    def __init__(self, terms: dict[tuple[int, int], Fraction]) -> None:
        self.terms = terms

    def __add__(self, other: Poly) -> Poly:
        terms = dict(self.terms)
        for power, c in other.terms.items():
            terms[power] = terms.get(power, Fraction(0)) + c
        return Poly(terms)

    def __neg__(self) -> Poly:
        return Poly({power: -c for power, c in self.terms.items()})

    def __sub__(self, other: Poly) -> Poly:
        return self + -other

    def __mul__(self, other: Poly) -> Poly:
        terms: dict[tuple[int, int], Fraction] = {}
        for (i, j), c in self.terms.items():
            for (k, m), e in other.terms.items():
                terms[i + k, j + m] = terms.get((i + k, j + m), Fraction(0)) + c * e
        return Poly(terms)

    def degree(self, axis: int) -> int:
        """Its largest power of t (0) or x (1)."""
        return max((power[axis] for power, c in self.terms.items() if c), default=0)

    def on(self, spans: tuple[Span, Span], degrees: tuple[int, int]) -> Rows:
        """Its coefficients on a box, rounded down: a row per power of t."""
        rows = [[Fraction(0)] * (degrees[1] + 1) for _ in range(degrees[0] + 1)]
        for (i, j), c in self.terms.items():
            if c:
                rows[i][j] = c
        columns = [based(list(column), spans[0]) for column in zip(*rows)]
        return [[kit.below(c) for c in based(list(row), spans[1])] for row in zip(*columns)]


def constant(value: Fraction | int) -> Poly:
    """A number."""
    return Poly({(0, 0): Fraction(value)})


T, X = Poly({(1, 0): Fraction(1)}), Poly({(0, 1): Fraction(1)})


def based(row: list[Fraction], span: Span) -> list[Fraction]:
    """Bernstein's coefficients on an interval, of rising ones."""
    start, width = Fraction(span[0], ONE), Fraction(span[1] - span[0], ONE)
    n = len(row) - 1
    for first in range(n):  # in powers of t - start
        for i in range(n - 1, first - 1, -1):
            row[i] += start * row[i + 1]
    row = [c * width**i / comb(n, i) for i, c in enumerate(row)]
    return [sum((comb(k, i) * row[i] for i in range(k + 1)), Fraction(0)) for k in range(n + 1)]


def halves(rows: Rows) -> tuple[Rows, Rows]:
    """The coefficients on both halves along the first axis."""
    left, right = [rows[0]], [rows[-1]]
    while len(rows) > 1:
        rows = [[x + y >> 1 for x, y in zip(*pair)] for pair in pairwise(rows)]
        left.append(rows[0])
        right.append(rows[-1])
    return left, right[::-1]


class Wide:
    """What single precision makes of an expression on a box: the exact values lie between ``low``
    and ``high``, the rounded ones within ``err`` of them.

    Each operation adds half a unit of its last place.
    """

    __slots__ = ("err", "high", "low")

    def __init__(self, low: int, high: int, err: int = 0) -> None:
        self.low, self.high, self.err = low, high, err

    def size(self) -> int:
        """No value, rounded or not, is larger in magnitude."""
        return max(abs(self.low), abs(self.high)) + self.err

    def rounded(self) -> Wide:
        self.err += kit.half_place(self.size())
        return self

    def __add__(self, other: Wide) -> Wide:
        return Wide(self.low + other.low, self.high + other.high, self.err + other.err).rounded()

    def __neg__(self) -> Wide:
        return Wide(-self.high, -self.low, self.err)

    def __sub__(self, other: Wide) -> Wide:
        return self + -other

    def __mul__(self, other: Wide) -> Wide:
        ends = [x * y >> BITS for x in (self.low, self.high) for y in (other.low, other.high)]
        err = kit.times(self.size(), other.err) + kit.times(other.size(), self.err)
        return Wide(min(ends), max(ends) + 1, err).rounded()


def wide(number: Fraction) -> Wide:
    """A literal, which single precision holds exactly."""
    return Wide(kit.below(number), kit.above(number))


_ASSIGNED = re.compile(r" ?(?:const float )?(\w+) = ([^;{}=?]+);")


def run(code: str, known: dict[str, Any], literal: Any) -> dict[str, Any]:
    """Runs assignments; what is known after them."""
    known, place = dict(known), 0
    while place < len(code.rstrip()):
        found = _ASSIGNED.match(code, place)
        if found is None:
            raise Fault(f"the header's C is not understood at '{code[place : place + 30]}'")
        known[found[1]] = kit.value(kit.parsed(found[2]), known, literal)
        place = found.end()
    return known


def horner(row: list[int], f: int) -> int:
    """A polynomial to its last bits."""
    total = 0
    for c in reversed(row):
        total = (total * f >> BITS) + c
    return total


def turn(rows: Rows) -> Rows:
    """Columns as rows."""
    return [list(column) for column in zip(*rows)]


class Box:
    """A part of a segment: ranges of t and x, and the coefficients there of a^2, psi^2, tau, |i|^2
    and p - x; where x is a single number the field is not weakened.
    """

    __slots__ = ("depth", "inside", "open", "rows", "t", "x")

    def __init__(self, t: Span, x: Span, rows: Rows, depth: int, still: tuple[str, ...]) -> None:
        self.t, self.x, self.rows, self.depth, self.open = t, x, rows, depth, still
        self.inside: Rows | None = None  # what is not negative in the domain

    def ends(self, which: int) -> Span:
        """Bounds of one of the polynomials."""
        found = [c for row in self.rows for c in row[which::5]]
        slack = 40 * self.depth + 2
        return min(found) - slack, max(found) + slack

    def cut(self, along: bool) -> list[Box]:
        """Both halves, across t or across x."""
        span, parts = (self.t if along else self.x), []
        middle = span[0] + span[1] >> 1
        rows = self.rows if along else turned(self.rows)
        for part, half in zip(halves(rows), ((span[0], middle), (middle, span[1]))):
            t, x = (half, self.x) if along else (self.t, half)
            parts.append(Box(t, x, part if along else turned(part), self.depth + 1, self.open))
        return parts


def turned(rows: Rows) -> Rows:
    """Coefficients with the other axis first."""
    return [[c for row in rows for c in row[j : j + 5]] for j in range(0, len(rows[0]), 5)]


def lacking(box: Box, rows: Rows, room: int) -> bool:
    """Whether a function with these coefficients may fall below a number in the domain.

    Less any multiple of what is not negative there it may not: with that one which leaves no slope
    along t or along x, nothing is lost where the box reaches beyond the limit.
    """
    if min(map(min, rows)) >= room:
        return False
    if box.inside is None:
        return True
    for one, other in ((rows, box.inside), (turn(rows), turn(box.inside))):
        run, fall = (sum(each[-1]) - sum(each[0]) for each in (one, other))
        if fall and run * fall > 0:
            m = (run << BITS) // fall
            if all(x - (m * y >> BITS) > room for pair in zip(one, other) for x, y in zip(*pair)):
                return False
    return True


def fitted(template: str, text: str, plain: set[str]) -> dict[str, str] | None:
    """What stands in the places of a template, of numbers but for those that are plain text; None
    where the text is another.
    """
    parts = re.split(r"\{(\w+)\}", template)
    pattern = "".join(
        re.escape(part)
        if n % 2 == 0
        else rf"(?P={part})"
        if part in parts[1:n:2]
        else rf"(?P<{part}>{'.*' if part in plain else kit.NUMBER.pattern})"
        for n, part in enumerate(parts)
    )
    found = re.fullmatch(pattern, text)
    return None if found is None else {name: found[name] for name in parts[1::2]}


def pieces(code: str, variable: str) -> list[tuple[Fraction, str]]:
    """Beginnings and assignments of the segments of a curve."""
    if not code.startswith("if ("):
        return [(Fraction(0), code)]
    found, start = [], Fraction(0)
    for branch in re.split(r" else (?=if |\{)", code):
        parts = re.fullmatch(rf"(?:if \({variable} < ([^ ]+)\) )?\{{ ([^{{}}]*) \}}", branch)
        if parts is None or (parts[1] is None) != branch.startswith("{"):
            raise Fault(f"the header's C is not understood at '{branch[:30]}'")
        found.append((start, parts[2]))
        if parts[1] is not None:
            end = kit.number(parts[1])
            if end <= start:
                raise Fault("breakpoints of the header do not ascend")
            start = end
    if branch.startswith("if"):
        raise Fault("the last segment of a curve ends")
    return found
