"""Numbers of the C for `check_ranges.py`: ranges that remember what they were made of (part 1), and
two inequalities that ranges do not show (part 2).

It imports nothing but the standard library and `kit.py` beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import isqrt
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit
else:  # run alone: it lies beside this one
    import kit


# Part 1. Ranges that remember what they were made of.
#
# A Node is a value of the C on one way through a function: all integers from low to high, and the
# operation that made it. Where a condition is taken to hold, ranges become narrower, and with them
# those of what they were made of (narrow). So |d| <= 32766 tells of d, and x x <= 9 of x.


class Impossible(Exception):
    """No number takes this way through a function."""


class Node:
    """All integers from ``low`` to ``high``, of a type; made by ``op`` of nodes."""

    __slots__ = ("fact", "high", "kind", "lost", "low", "of", "op")

    def __init__(
        self, low: int, high: int, kind: str, op: str = "", of: tuple[Node, ...] = ()
    ) -> None:
        self.low, self.high, self.kind, self.op, self.of = low, high, kind, op, of
        self.lost = ""  # says where a conversion may have taken digits off
        self.fact: tuple[Node, Fraction] | None = None  # of part 2

    def narrow(self, low: int, high: int) -> None:
        """It is known to lie there, too."""
        low, high = max(low, self.low), min(high, self.high)
        if low > high:
            raise Impossible
        if (low, high) == (self.low, self.high):
            return
        self.low, self.high = low, high
        of = self.of
        match self.op:
            case "same":
                of[0].narrow(low, high)
            case "neg":
                of[0].narrow(-high, -low)
            case "+":
                of[0].narrow(low - of[1].high, high - of[1].low)
                of[1].narrow(low - of[0].high, high - of[0].low)
            case "-":
                of[0].narrow(low + of[1].low, high + of[1].high)
                of[1].narrow(of[0].low - high, of[0].high - low)
            case ">>" if of[1].low == of[1].high:
                of[0].narrow(low << of[1].low, (high + 1 << of[1].low) - 1)
            case "*" if of[0] is of[1]:
                of[0].narrow(-isqrt(max(high, 0)), isqrt(max(high, 0)))
                if low > 0 and (of[0].low >= 0 or of[0].high <= 0):
                    least = isqrt(low - 1) + 1
                    of[0].narrow(*((least, of[0].high) if of[0].low >= 0 else (of[0].low, -least)))
            case "*" if of[1].low == of[1].high > 0:
                of[0].narrow(-(-low // of[1].low), high // of[1].low)


class Pointer:
    """A place in an array: the array and the index of what it points to."""

    def __init__(self, array: list[Any], index: Node) -> None:
        self.array, self.index = array, index


def used(node: Node) -> Node:
    """A number whose value is asked for."""
    if node.lost:
        raise kit.Fault(node.lost)
    return node


def each(of: Callable[..., Any], first: Any, *others: Any) -> Any:
    """What a function makes of numbers, or of records and arrays of them, entry by entry."""
    if isinstance(first, dict):
        return {name: each(of, x, *(y[name] for y in others)) for name, x in first.items()}
    if isinstance(first, list):
        return [each(of, *column) for column in zip(first, *others)]
    return of(first, *others) if isinstance(first, Node) else first


def hull(*values: Node) -> Node:
    """What holds all numbers; it forgets what they were made of."""
    first = values[0]
    if all(x is first for x in values):
        return first
    low, high = min(used(x).low for x in values), max(used(x).high for x in values)
    return Node(low, high, first.kind)


def fresh(node: Node) -> Node:
    """The same number that knows nothing of what made it."""
    return node if node.low == node.high else Node(used(node).low, node.high, node.kind)


def given(node: Node) -> Node:
    """As `fresh`; what may not be set remains so."""
    if not node.lost:
        return fresh(node)
    found = Node(node.low, node.high, node.kind)
    found.lost = node.lost
    return found


def copied(value: Any) -> Any:
    """A copy whose members can change."""
    return each(lambda x: x, value)


def put(record: Any, after: Any) -> None:
    """Sets the members of a record, or the entries of an array, in place."""
    for name, value in after.items() if isinstance(after, dict) else enumerate(after):
        if isinstance(value, dict | list):
            put(record[name], value)
        elif isinstance(value, Node):
            record[name] = given(value)


def always(sign: str, a: Node, b: Node) -> bool:
    """Whether a comparison holds for all numbers of both ranges."""
    match sign:
        case "==":
            return a.low == a.high == b.low == b.high
        case "!=":
            return a.high < b.low or a.low > b.high
        case "<" | "<=":
            return a.high < b.low + (sign == "<=")
    return a.low + (sign == ">=") > b.high


def narrow(sign: str, a: Node, b: Node) -> None:
    """Leaves of both ranges what a comparison allows."""
    if sign == "!=":
        for one, other in ((a, b), (b, a)):
            if (x := other.low) == other.high:
                one.narrow(one.low + (one.low == x), one.high - (one.high == x))
    if sign in ("<", "<=", "=="):
        a.narrow(a.low, b.high - (sign == "<"))
        b.narrow(a.low + (sign == "<"), b.high)
    if sign in (">", ">=", "=="):
        a.narrow(b.low + (sign == ">"), a.high)
        b.narrow(b.low, a.high - (sign == ">"))


def spans(value: Any) -> Any:
    """Ranges alone: what a call is known by."""
    if isinstance(value, Pointer):
        return (id(value.array), spans(value.index))
    if isinstance(value, dict | list):
        return tuple(map(spans, value.values() if isinstance(value, dict) else value))
    if not isinstance(value, Node):
        return value
    return (value.low, value.high, value.lost) if value.lost else (value.low, value.high)


def corners(a: Node, b: Node, of: Callable[[int, int], int]) -> list[int]:
    """A function of two numbers that is monotone in each, at the ends of ranges."""
    return [of(x, y) for x in (a.low, a.high) for y in (b.low, b.high)]


# Part 2. Two inequalities that ranges do not show.


class Other(Exception):
    """It is made in another way than an inequality is about."""


def bare(node: Node) -> Node:
    """A node without conversions that keep it."""
    while node.op == "same":
        node = node.of[0]
    return node


def shifted(node: Node) -> tuple[Node, Fraction, int]:
    """What x, c, k make a node (x + c) >> k; c is a constant."""
    node = bare(node)
    if node.op != ">>" or node.of[1].low != node.of[1].high:
        raise Other
    k, inner = node.of[1].low, bare(node.of[0])
    if inner.op in ("+", "-") and inner.of[1].low == inner.of[1].high:
        return bare(inner.of[0]), Fraction(inner.of[1].low * (1 if inner.op == "+" else -1)), k
    return inner, Fraction(0), k


def product(node: Node) -> tuple[Node, Node, Fraction, int]:
    """What x, y, c, k make a node (x y + c) >> k."""
    inner, c, k = shifted(node)
    if inner.op != "*":
        raise Other
    return bare(inner.of[0]), bare(inner.of[1]), c, k


def found(bound: Callable[..., Any], *made: Any) -> Any:
    """A bound of what is made so; else None."""
    try:
        return bound(*made)
    except Other:
        return None


def bound_of_root(result: Node, s: Node) -> Fraction:
    """A bound of r sqrt(s) for the last step r of Newton's rule for 1/sqrt(s).

    A shift takes less than 1 off: with a = (t y + c3) >> k3, b = (C - a y + c2) >> k2 and
    r = (y b + c1) >> k1 and a >= t y/2^k3 - u

        r <= (C y - t y^3/2^k3)/2^(k1+k2) + (y (u y + c2)/2^k2 + c1)/2^k1 <= K/sqrt(t) + E

    since the first part is largest where y^2 = C 2^k3/(3 t), whatever the steps before found; and
    s <= 2^k t + m.
    """
    y, rest, c1, k1 = product(result)
    middle, c2, k2 = shifted(rest)
    if middle.op != "-" or y.low < 0 or not middle.of[0].low == middle.of[0].high > 0:
        raise Other
    steps = bare(middle.of[1])
    if steps.op != "*" or bare(steps.of[1]) is not y:
        raise Other
    t, same, c3, k3 = product(steps.of[0])
    m, k = below(t, bare(s))
    if same is not y or t.low <= 0:
        raise Other
    u = max(Fraction(0), 1 - Fraction(c3 + 1, 2**k3))
    off = (y.high * (u * y.high + max(c2, Fraction(0))) / 2**k2 + max(c1, Fraction(0))) / 2**k1
    squared = Fraction(4, 27) * middle.of[0].low ** 3 * 2**k3 / 4 ** (k1 + k2)
    bound: Fraction = root(squared * (2**k + m / t.low)) + off * root(Fraction(s.high))
    return bound


def root(value: Fraction) -> Fraction:
    """A square root, rounded up."""
    return Fraction(isqrt(value.numerator * 4**64 // value.denominator) + 1, 2**64)


def below(node: Node, s: Node) -> tuple[Fraction, int]:
    """Numbers m, k with s <= 2^k node + m, where the node is made of s by shifts."""
    if bare(node) is s:
        return Fraction(0), 0
    inner, c, by = shifted(node)
    m, k = below(inner, s)
    return m + 2**k * (2**by - 1 - c), k + by


def bound_of_product(node: Node) -> int:
    """A bound of |(x p + c) >> k| with p = (l r + c2) >> b, where r sqrt(w) is bounded and w is
    x^2 + y^2 times a square: |x| r <= r sqrt(w) over the root of the latter.
    """
    x, share, c, k = product(node)
    limit, reciprocal, c2, b = product(share)
    if share.low < 0 or reciprocal.fact is None or limit.low < 0:
        raise Other
    (whole, bound), times = reciprocal.fact, 1
    whole = bare(whole)
    while whole.op == "*" and whole.of[1].low == whole.of[1].high > 0:
        whole, times = bare(whole.of[0]), times * whole.of[1].low
    squares = [bare(z) for z in whole.of] if whole.op == "+" else []
    if isqrt(times) ** 2 != times or not all(z.op == "*" and z.of[0] is z.of[1] for z in squares):
        raise Other
    if not any(bare(z.of[0]) is x for z in squares):
        raise Other
    size = max(-x.low, x.high)
    most = (limit.high * bound / isqrt(times) + size * max(c2, Fraction(0))) / 2**b
    ends = [(end + c) // 2**k for end in (most, -most)]
    return int(max(ends[0], -ends[1]))


def bounds_of_rest(sign: str, a: Node, b: Node) -> tuple[int, int]:
    """Bounds of what a division leaves: x - q d, or of its whole part q d, where q is x / d.

    In C a quotient is rounded towards zero, so that q d lies between 0 and x, and x - q d between
    -(d - 1) and d - 1, with the sign of x.
    """
    a, b = bare(a), bare(b)
    if sign == "*":
        if a.op != "/" or bare(a.of[1]) is not b:
            raise Other
        x = a.of[0]
        return min(x.low, 0), max(x.high, 0)
    if sign != "-" or b.op != "*":
        raise Other
    whole = bare(b.of[0])
    if whole.op != "/" or bare(whole.of[0]) is not a or bare(whole.of[1]) is not bare(b.of[1]):
        raise Other
    most = whole.of[1].high - 1
    return max(-most, min(a.low, 0)), min(most, max(a.high, 0))
