"""Single-precision arithmetic as the emitted C performs it, operation by operation.

NumPy's float32 operations are IEEE 754 and rounded to nearest, as are those of a host compiler
without contraction. With contraction a compiler may fuse a product and the sum that follows; both
readings are modelled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from math import comb
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Rotation

_T = TypeVar("_T")
SingleArray = NDArray[np.float32]


MultiplyAdd = Callable[[SingleArray, SingleArray, SingleArray], SingleArray]


def multiply_add(factor: SingleArray, other: SingleArray, addend: SingleArray) -> SingleArray:
    """``factor * other + addend`` with both operations rounded, any broadcastable shapes."""
    return (factor * other) + addend


def fused_multiply_add(factor: SingleArray, other: SingleArray, addend: SingleArray) -> SingleArray:
    """``factor * other + addend`` rounded once, any broadcastable shapes; finite operands.

    The product of two floats is exact in double. Rounding the double sum to odd keeps the
    information that a second rounding to float needs, so that the result is the correctly rounded
    one (Boldo and Melquiond, 2008, doi:10.1109/TC.2007.70819).
    """
    product = factor.astype(np.float64) * other.astype(np.float64)
    summand = np.broadcast_to(addend, product.shape).astype(np.float64)
    total = product + summand
    virtual = total - product
    remainder = (product - (total - virtual)) + (summand - virtual)
    bits = total.view(np.int64)
    is_even = (bits & 1) == 0
    towards = np.where((remainder > 0.0) == (total > 0.0), 1, -1)
    odd = np.where((remainder != 0.0) & is_even, bits + towards, bits)
    return odd.view(np.float64).astype(np.float32)


class Contracted(Arithmetic):
    """Single precision of a compiler that rounds a product and the sum behind it once."""

    def multiply_add(self, a: Reals | float, b: Reals | float, c: Reals | float) -> Reals:
        """The number a b + c, rounded once."""
        parts = (np.asarray(part, dtype=np.float32) for part in (a, b, c))
        return fused_multiply_add(*np.broadcast_arrays(*parts))


def _wrapped(theta: Reals) -> Reals:
    from dqforge.optimizer.steps import angle_functions  # No reference asks for it.

    return angle_functions.wrap(SINGLE, theta)


def _rotated(theta: Reals) -> Rotation:
    from dqforge.optimizer.steps import angle_functions

    return angle_functions.rotation(SINGLE, theta)


# Steps as the emitted C has them, without and with contraction.
SINGLE = Arithmetic(np.float32, _wrapped, _rotated)
CONTRACTED = Contracted(np.float32, _wrapped, _rotated)


def compiled(*, fused: bool) -> Arithmetic:
    """Single precision without or with contraction of products and sums."""
    return CONTRACTED if fused else SINGLE


def horner(
    o: Arithmetic, row: Sequence[Any] | SingleArray, x: Reals, last: Reals | None = None
) -> Any:
    """A polynomial by Horner's rule from the highest power on; what is zero is not added.

    Args:
        o: The arithmetic.
        row: Ascending coefficients, at least two.
        x: The argument, any shape.
        last: What the last product takes instead of it.
    """
    *rest, value = (float(coefficient) for coefficient in row)
    found: Any = value
    for power in range(len(rest) - 1, -1, -1):
        by = last if power == 0 and last is not None else x
        found = o.multiply_add(found, by, rest[power]) if rest[power] != 0.0 else found * by
    return found


def in_segments(
    o: Arithmetic,
    name: str | tuple[str, ...],
    starts: SingleArray,
    t: Reals,
    of: Callable[[int, Reals], _T],
    end: Sequence[Any] = (),
) -> _T:
    """What one of several segments gives.

    Args:
        o: The arithmetic.
        name: As of `Arithmetic.cases`.
        starts: First edges of the segments, shape (S,); the first is 0.
        t: The argument, any shape.
        of: Of the number of a segment and its own variable, t - start.
        end: What holds in the last segment, a condition; further conditions with what they give;
            and what is given elsewhere. Empty where the last segment has no end.
    """

    def within(number: int) -> Callable[[], _T]:
        start = float(starts[number])
        return lambda: of(number, o.let("x", t - start) if number else t)

    conditions = [t < float(start) for start in starts[1:]]
    branches = [(holds, within(number)) for number, holds in enumerate(conditions)]
    last = within(len(starts) - 1)
    if end:
        inside, *further, otherwise = end
        branches += [(inside, last), *further]
    else:
        otherwise = last
    if branches:
        return cast("_T", o.cases(name, *branches, otherwise=otherwise))
    found: Any = last()
    if isinstance(name, tuple):
        return cast("_T", tuple(o.let(own, part) for own, part in zip(name, found, strict=True)))
    return cast("_T", o.let(name, found) if name else found)


# Straight lines between the places of a table over a turn, as steps of the firmware.


def within_turn(o: Arithmetic, turn: Reals) -> Reals:
    """A turn from 0 to below 1; 0 of others and of not-a-number."""
    return o.choose((turn >= 0.0) & (turn < 1.0), turn, 0.0)


def interval(o: Arithmetic, x: Reals, size: int) -> tuple[Any, Reals]:
    """The interval that a place lies in, and the place counted in intervals.

    Args:
        o: The arithmetic.
        x: Places from 0 to below 1, shape (M,).
        size: Number of intervals.
    """
    place = o.let("x", x * float(size))
    k = o.placed("k", place, size - 1)
    return k, place


def rest(o: Arithmetic, k: Any, place: Reals) -> Reals:
    """Where a place is in its interval, from 0 to 1."""
    return o.let("f", place - o.real(k))


def between(o: Arithmetic, f: Reals, low: Reals, high: Reals) -> Reals:
    """The number at a place from 0 to 1 between two."""
    return o.multiply_add(f, high - low, low)


def _round_in_turn(row: FloatArray, width: float) -> None:
    """Round ascending coefficients on [0, width] in place, the constant apart,
    which holds the value at the start.
    """
    for power in range(row.size - 1, 0, -1):
        rounded = float(np.float32(row[power]))
        change, row[power] = rounded - row[power], rounded
        row[1:power] += change * _monic_chebyshev(power, width)[1:power]


def _monic_chebyshev(degree: int, width: float) -> FloatArray:
    """Ascending coefficients on [0, width] of the monic polynomial with the least largest value,
    shape (n + 1,).
    """
    powers = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[degree])
    shifted = np.polynomial.Polynomial(powers)(np.polynomial.Polynomial([-1.0, 2.0 / width])).coef
    return np.asarray(shifted / shifted[-1], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class SinglePolynomial:
    """A piecewise polynomial with float32 coefficients, evaluated by Horner's rule in t - start.

    Args:
        starts: First edge of each segment, shape (S,); the first is 0.
        coefficients: Ascending powers, shape (S, n + 1). One that is zero is neither stored nor
            added in the emitted C.
    """

    starts: SingleArray
    coefficients: SingleArray

    @classmethod
    def from_double(cls, piecewise: PiecewisePolynomial) -> SinglePolynomial:
        """Floats for every edge and coefficient, the coefficients in turn.

        The highest is rounded first; those below make up for what that changed, along the Chebyshev
        polynomial of its degree, and are rounded after it. Segments that lack a power keep lacking
        it and are rounded plainly.
        """
        coefficients = piecewise.coefficients.copy()
        for row, width in zip(coefficients, np.diff(piecewise.edges).tolist(), strict=True):
            if np.all(row[1:] != 0.0):
                _round_in_turn(row, width)
        return cls(piecewise.edges[:-1].astype(np.float32), coefficients.astype(np.float32))

    def within(self, o: Arithmetic, number: int, x: Reals) -> Any:
        """The step of one segment: its value at ``x`` from its start, any shape."""
        return horner(o, self.coefficients[number], x)

    def odd_within(self, o: Arithmetic, number: int, x: Reals, t: Reals) -> Any:
        """The same, continued as an odd function of ``t``, the argument with its sign.

        Where the constant of the first segment is zero its last product takes the signed argument,
        elsewhere the result is negated.
        """
        row = self.coefficients[number]
        if number == 0 and row[0] == 0.0:
            return horner(o, row, x, t)
        size = o.let("size", horner(o, row, x))
        return o.choose(t < 0.0, -size, size)

    def step(self, o: Arithmetic, name: str, t: Reals) -> Any:
        """Its value at non-negative arguments, any shape, under a name."""
        return in_segments(o, name, self.starts, t, lambda number, x: self.within(o, number, x))

    def evaluate(self, argument: SingleArray, o: Arithmetic = SINGLE) -> SingleArray:
        """Value at non-negative float32 arguments, shape (N,), as it is compiled."""
        found: SingleArray = self.step(o, "", np.asarray(argument, dtype=np.float32))
        return found


# Piecewise polynomials on [0, end], each segment in its own variable x = t - start.
#
# The local variable is what the firmware evaluates, too: powers of t itself cancel badly on the
# later segments, where degree 6 in single precision would lose more than the fit gains.


@dataclass(frozen=True, slots=True)
class PiecewisePolynomial:
    """A polynomial per segment.

    Args:
        edges: Ascending segment limits, shape (S + 1,), from 0 to the end of the domain.
        coefficients: Ascending powers of x = t - edges[s], shape (S, n + 1).
    """

    edges: FloatArray
    coefficients: FloatArray

    @property
    def segments(self) -> int:
        """Number of segments S."""
        return int(self.coefficients.shape[0])

    @property
    def degree(self) -> int:
        """Degree n of every segment."""
        return int(self.coefficients.shape[1]) - 1

    @property
    def breakpoints(self) -> FloatArray:
        """Inner edges, shape (S - 1,)."""
        return self.edges[1:-1]

    def __call__(self, argument: FloatArray) -> FloatArray:
        """Value at ``argument`` of any shape; a breakpoint itself belongs to
        the segment on its right.
        """
        argument = np.asarray(argument, dtype=np.float64)
        segment = np.searchsorted(self.breakpoints, argument, side="right")
        local = argument - self.edges[segment]
        rows = self.coefficients[segment]
        value = rows[..., -1]
        for power in range(self.degree - 1, -1, -1):
            value = value * local + rows[..., power]
        return np.asarray(value)

    def jumps(self) -> FloatArray:
        """Right minus left limit at each breakpoint, shape (S - 1,)."""
        width = np.diff(self.edges)[:-1]
        left: FloatArray = np.array(
            [
                np.polynomial.polynomial.polyval(w, c)
                for w, c in zip(width, self.coefficients, strict=False)
            ]
        )
        return self.coefficients[1:, 0] - left


@cache
def _chebyshev_to_local(degree: int) -> FloatArray:
    """Matrix from a Chebyshev series in s to ascending powers of s + 1, shape (n + 1, n + 1),
    rows by T_k.
    """
    powers = np.zeros((degree + 1, degree + 1))
    for order in range(degree + 1):
        unit = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[order])
        powers[order, : unit.size] = unit
    shift: FloatArray = np.array(
        [
            [comb(j, k) * (-1.0) ** (j - k) if k <= j else 0.0 for k in range(degree + 1)]
            for j in range(degree + 1)
        ]
    )
    matrix: FloatArray = powers @ shift
    return matrix


def power_of_series(degree: int, power: int) -> FloatArray:
    """Row that gives the coefficient of (s + 1)^power from a Chebyshev series in s,
    shape (n + 1,).
    """
    row: FloatArray = _chebyshev_to_local(degree)[:, power]
    return row


def local_coefficients(chebyshev: FloatArray, edges: FloatArray) -> FloatArray:
    """Convert Chebyshev series on each segment, shape (S, n + 1), to ascending powers of t -
    edges[s].
    """
    degree = chebyshev.shape[1] - 1
    half_width = 0.5 * np.diff(edges)[:, np.newaxis]
    # With s in [-1, 1] on the segment, t - start = half_width * (s + 1).
    converted: FloatArray = (
        chebyshev @ _chebyshev_to_local(degree) / half_width ** np.arange(degree + 1)
    )
    return converted
