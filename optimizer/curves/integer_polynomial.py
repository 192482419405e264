"""Piecewise polynomials in integer arithmetic: the step of the emitted C, over an `Arithmetic`,
whose readings are the model and the proven ranges.

A number of ``width`` bits stands for a fraction of full scale: 2^(width - 1) codes are 1.
One step of Horner's rule is

    acc = (acc * x + constant) >> shift

with a product of twice the width. The constant holds the coefficient at the scale of the product
and half of the last place that is left, so that a step costs one multiply-accumulate and one shift,
and rounds to nearest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import accumulate, combinations, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial

if TYPE_CHECKING:
    # Where there is no integer polynomial, nothing of this is loaded.
    from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, CodeArray, Range, Ranges

# Parts of a segment in the interval analysis: the bounds shrink towards the true ranges with their
# number.
_PARTS = 64


@dataclass(frozen=True, slots=True)
class FixedSegment:
    """One segment: ``start`` is the code of its first argument, from which x counts.

    ``leading`` is the highest coefficient; ``constants`` and ``shifts`` belong to the steps,
    highest power first.
    """

    start: int
    leading: int
    constants: tuple[int, ...]
    shifts: tuple[int, ...]

    def step(self, o: Arithmetic[N, Any], name: str, x: N) -> N:
        """Its result at an argument counted from ``start``, without saturation: a wide word.

        Args:
            o: The arithmetic.
            name: Of the result in the firmware.
            x: The argument.
        """
        value, degree = o.const(self.leading), len(self.constants)
        powers = range(degree, 0, -1)
        for power, constant, shift in zip(powers, self.constants, self.shifts, strict=True):
            kept = o.narrowed("value", value)
            if power < degree:
                kept = o.let(f"{name}_{power}", kept)
            product = o.product("product", kept, x)
            value = o.shifted(o.total("sum", product, o.const(constant)), shift)
        return value

    def evaluate(self, local: CodeArray) -> CodeArray:
        """Results at arguments counted from ``start``, any shape, without saturation."""
        from dqforge.optimizer.steps.integer_arithmetic import Integers

        found = self.step(Integers(), "", local)
        return found if found.shape == local.shape else np.full(local.shape, found)

    def ranges(self, length: int, width: int) -> tuple[Ranges, Range]:
        """Proven ranges in words of ``width`` bits for local arguments 0 to ``length``: those of
        products, sums and values between the steps, and that of the results.

        Interval arithmetic in exact integers on parts of the segment.
        """
        from dqforge.optimizer.steps.integer_arithmetic import Range, Ranges

        edges = sorted({length * part // _PARTS for part in range(_PARTS + 1)})
        found, result = Ranges(width), list[Range]()
        for low, high in list(pairwise(edges)) or [(0, 0)]:
            result.append(self.step(found, "", Range(low, high)))
        return found, Range(min(part.low for part in result), max(part.high for part in result))


@dataclass(frozen=True, slots=True)
class FixedPolynomial:
    """A piecewise polynomial in integers of ``width`` bits for codes 0 to ``end``.

    ``segments`` ascend by their starts, of which the first is 0. Results beyond
    +-(2^(width - 1) - 1) are saturated; the emitted C does that only where the ranges cannot
    exclude them.
    """

    segments: tuple[FixedSegment, ...]
    width: int
    end: int

    @property
    def largest(self) -> int:
        """Largest code, 2^(width - 1) - 1."""
        return int(2 ** (self.width - 1) - 1)

    @property
    def starts(self) -> tuple[int, ...]:
        """First code of each segment."""
        return tuple(segment.start for segment in self.segments)

    def lengths(self) -> tuple[int, ...]:
        """Largest local argument of each segment.

        The last code of one lies just before the start of the next.
        """
        lasts = [start - 1 for start in self.starts[1:]] + [self.end]
        return tuple(last - start for start, last in zip(self.starts, lasts, strict=True))

    def saturates(self) -> bool:
        """Whether the proven ranges reach beyond the largest code."""
        pairs = zip(self.segments, self.lengths(), strict=True)
        return any(s.ranges(n, self.width)[1].largest > self.largest for s, n in pairs)

    def overflows(self) -> bool:
        """Whether a product or sum may leave 2 ``width`` bits, or a value between two
        steps 32 bits.
        """
        return any(
            overflows(s, n, self.width) for s, n in zip(self.segments, self.lengths(), strict=True)
        )

    def evaluate(self, codes: CodeArray) -> CodeArray:
        """Codes of the results at codes from 0 to ``end``, any shape."""
        from dqforge.optimizer.steps.integer_arithmetic import Integers

        (found,) = in_code_segments(Integers(), {"y": self}, codes)
        return np.broadcast_to(found, codes.shape)


def in_code_segments(
    o: Arithmetic[N, Any], polynomials: Mapping[str, FixedPolynomial], x: N
) -> tuple[N, ...]:
    """The step of polynomials on the same segments: their codes at one from 0 to their end.

    Args:
        o: The arithmetic.
        polynomials: By the names of their results in the firmware.
        x: The code.
    """
    first, *_ = polynomials.values()
    saturating = {name for name, one in polynomials.items() if one.saturates()}

    def held(name: str, value: N) -> N:
        most = polynomials[name].largest
        found, end = value, o.const(most)
        if name in saturating:
            found = o.let(f"{name}_0", value)
        kept = o.narrowed(name, o.known(found, -most, most))
        if name in saturating:
            least = o.choose(o.above(o.const(-most), found), o.const(-most), kept)
            kept = o.narrowed(name, o.choose(o.above(found, end), end, least))
        return kept

    def within(number: int) -> Callable[[], tuple[N, ...]]:
        def found() -> tuple[N, ...]:
            start, length = first.starts[number], first.lengths()[number]
            local = o.known(x, start, start + length)
            if number:
                local = o.narrowed("local", o.total("local", local, o.const(-start)))
                local = o.let("local", local)
            parts = polynomials.items()
            return tuple(held(n, p.segments[number].step(o, n, local)) for n, p in parts)

        return found

    *branches, last = map(within, range(len(first.starts)))
    if not branches:
        return tuple(o.let(name, part) for name, part in zip(polynomials, last(), strict=True))
    ends = (o.above(o.const(start), x) for start in first.starts[1:])
    return o.cases(tuple(polynomials), *zip(ends, branches, strict=True), otherwise=last)


def overflows(segment: FixedSegment, length: int, width: int) -> bool:
    """Whether some local argument up to ``length`` may overflow: products 2 ``width`` bits,
    values 32 bits.
    """
    return segment.ranges(length, width)[0].overflowing() is not None


# Fits in integer arithmetic: scales for every step, then a search among the integers by
# the error that they make.
#
# The coefficients of the real fit are only the start. What is judged is the result of the integer
# steps at the codes of the argument, all of them for 16 bits: rounding is part of the error that is
# minimised, not something that comes after.

# Share of the accumulator that scales may fill; the interval analysis decides in the end.
_HEADROOM = 1.0 - 2.0**-9

# Sizes in codes below this one count as this one: scales are bounded long before.
_NOTHING = 1e-200

# Sizes of the trial changes of the search, in codes of the result.
_STEPS = (0.75, 0.5, 0.25, 0.125, 0.0625)
_BROKEN = 1e3  # Codes of error that one code of a broken side condition counts.

# Leading coefficients below this are tried one by one: their rounding would be seen.
_SHORT_LEADING = 2**11
_ROUNDING_SEEN = 2.0  # Errors in codes below which the rounding of every step is worth a look.
_LEADING_REACH = 2  # So many integers on either side of the real leading coefficient are tried.
_MOST_CODES = 2**16  # Codes of a segment that are all looked at; longer segments are sampled.
_SEAM_STEP = 1  # Largest step of a continuous fit across a breakpoint in codes.
_UPPER_WORD = 32  # A shift of a 64-bit product by this much is no work: the upper word is taken.


@dataclass(frozen=True, slots=True)
class CodeScale:
    """What full scale stands for: ``argument`` and ``result`` in their units are 2^(width - 1)
    codes.
    """

    argument: float
    result: float
    width: int

    @property
    def one(self) -> float:
        """Codes of full scale, 2^(width - 1)."""
        return float(2 ** (self.width - 1))

    def code(self, argument: float) -> int:
        """Nearest code of an argument."""
        return round(argument / self.argument * self.one)

    def arguments(self, codes: CodeArray) -> FloatArray:
        """Arguments in their unit, exact up to the rounding of doubles."""
        return np.asarray(codes * (self.argument / self.one), dtype=np.float64)

    def in_codes(self, row: FloatArray) -> FloatArray:
        """Ascending coefficients of result over argument, shape (n + 1,), as codes over codes."""
        powers = (self.argument / self.one) ** np.arange(row.size)
        return np.asarray(row * powers * (self.one / self.result), dtype=np.float64)


def _scales(row: FloatArray, length: int, width: int) -> list[int]:
    """Bits by which the values before steps n to 1 are scaled up, ascending with the power:
    g_1 to g_n.
    """
    x = np.linspace(0.0, length, 129)
    degree = row.size - 1
    partial = np.empty((degree + 1, x.size))
    partial[degree] = row[degree]
    for power in range(degree - 1, -1, -1):
        partial[power] = partial[power + 1] * x + row[power]
    room, word = _HEADROOM * 2.0 ** (2 * width - 1), _HEADROOM * 2.0 ** (min(2 * width, 32) - 1)
    apart, longest = (_UPPER_WORD if width > 16 else 0), 2 * width - 2
    # Without a bound a current that is next to nothing, or nothing at all,
    # would be scaled up without end.
    most = float(degree * longest)
    limits = []
    for power in range(1, degree + 1):
        product = max(
            np.max(np.abs(partial[power] * x)),
            np.max(np.abs(partial[power - 1])),
            abs(row[power - 1]),
        )
        value = np.max(np.abs(partial[power]))
        wanted = min(
            math.log2(room / max(product, _NOTHING)), math.log2(word / max(value, _NOTHING)), most
        )
        limits.append(math.floor(wanted))
    scales = [limits[-1]]
    for limit in limits[-2::-1]:
        scales.insert(0, min(limit, scales[0] - apart))
    lowest = 0
    for index, scale in enumerate(
        scales
    ):  # no shift to the left, and none by more than the product has bits
        scales[index] = lowest = min(max(scale, lowest), lowest + longest)
    return scales


def _rounded(row: FloatArray, scales: list[int], start: int) -> FixedSegment:
    """Integers of a polynomial in codes at given scales."""
    degree = row.size - 1
    levels = [0, *scales]
    shifts = tuple(levels[power] - levels[power - 1] for power in range(degree, 0, -1))
    constants = []
    for power, shift in zip(range(degree, 0, -1), shifts, strict=True):
        half = 2 ** (shift - 1) if shift > 0 else 0
        constants.append(round(math.ldexp(float(row[power - 1]), levels[power])) + half)
    return FixedSegment(
        start, round(math.ldexp(float(row[degree]), levels[degree])), tuple(constants), shifts
    )


def _safe_scales(row: FloatArray, length: int, width: int) -> list[int]:
    """The largest scales for which no overflow is proven.

    Raises:
        NoSolutionError: Some coefficient is too large for an integer even without a scale.
    """
    scales = _scales(row, length, width)
    while overflows(_rounded(row, scales, 0), length, width):
        if not any(scales):
            raise NoSolutionError(
                f"fit: a coefficient of {np.max(np.abs(row)):.3g} codes overflows integers of "
                f"{width} bits; write a smaller fit.degree, or more fit.segments"
            )
        lower = (max(scale - power - 1, 0) for power, scale in enumerate(scales))
        scales = list(accumulate(lower, max))  # no shift to the left
    return scales


def _changes(degree: int, length: int) -> FloatArray:
    """Chebyshev polynomials on 0 to ``length`` as ascending powers, shape (n + 1, n + 1):
    directions of the search.
    """
    rows = np.zeros((degree + 1, degree + 1))
    inner = np.polynomial.Polynomial([-1.0, 2.0 / max(length, 1)])
    for order in range(degree + 1):
        powers = np.polynomial.Polynomial(
            np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[order])
        )(inner).coef
        rows[order, : powers.size] = powers
    return rows


@dataclass(frozen=True, slots=True)
class _Segment:
    """What the integers of one segment are judged by.

    ``exact`` are the wanted results in codes at the codes ``local``, but for the last two of these:
    the first code and the one behind the last. ``seams`` are the real values there where a
    continuous fit has neighbours: each side of a breakpoint takes one of the two integers next to
    it. ``at_zero`` asks for nothing at the first code.
    """

    start: int
    length: int
    width: int
    scales: list[int]
    local: CodeArray
    exact: FloatArray
    seams: tuple[float | None, float | None]
    at_zero: bool

    def judge(self, row: FloatArray) -> tuple[float, FixedSegment]:
        """The integers of a real polynomial, and what they err by."""
        segment = _rounded(row, self.scales, self.start)
        return (self.error(segment) if self.held(segment) else math.inf), segment

    def held(self, segment: FixedSegment) -> bool:
        """Whether every integer has the width of its word or product; without that
        nothing can be evaluated.

        A change by a part of a code leaves them where the polynomial is next to nothing:
        its scales are large.
        """
        word, product = 2 ** (min(2 * self.width, 32) - 1), 2 ** (2 * self.width - 1)
        return abs(segment.leading) < word and all(
            abs(constant) < product for constant in segment.constants
        )

    def error(self, segment: FixedSegment) -> float:
        """Largest error in codes, raised where a side condition is broken."""
        value = segment.evaluate(self.local)
        error = float(np.max(np.abs(value[:-2] - self.exact)))
        for end, seam in zip(value[-2:].tolist(), self.seams, strict=True):
            if seam is not None and abs(end - seam) >= 1.0:
                error += _BROKEN * abs(end - seam)
        if self.at_zero:
            error += _BROKEN * abs(float(value[0]))
        return error

    def safe(self, segment: FixedSegment) -> bool:
        """Whether no overflow is proven."""
        return not overflows(segment, self.length, self.width)


def _descend(
    row: FloatArray, task: _Segment, directions: FloatArray
) -> tuple[float, FloatArray, FixedSegment]:
    """Integers that no change along one direction improves: their error, their real coefficients,
    and they.

    A change of the real coefficients, rounded anew, is kept where it lowers the largest error of
    the integer steps; the changes become smaller until they are lost in rounding.
    """
    least, best = task.judge(row)
    for step in _STEPS:
        improved = True
        while improved:
            improved = False
            for change in (
                sign * step * direction for direction in directions for sign in (1.0, -1.0)
            ):
                error, segment = task.judge(row + change)
                if error < least - 1e-9 and task.safe(segment):
                    row, least, best, improved = row + change, error, segment, True
    return least, row, best


def _search(row: FloatArray, task: _Segment) -> FixedSegment:
    """Integers near a real polynomial whose results at all codes err least.

    Every leading coefficient near the real one is held in turn, where it is so short that its
    rounding matters: the others make up for it along the Chebyshev polynomials of lower degree.
    """
    if task.length >= _MOST_CODES:
        return _rounded(
            row, task.scales, task.start
        )  # rounding is far below what a polynomial errs by
    degree = row.size - 1
    directions = _changes(degree, task.length)
    unit = 2.0 ** -task.scales[-1]
    nearest = round(row[degree] / unit)
    found = [_descend(row, task, directions)]
    if abs(nearest) < _SHORT_LEADING:
        for leading in range(nearest - _LEADING_REACH, nearest + _LEADING_REACH + 1):
            share = (leading * unit - row[degree]) / directions[degree, degree]
            held = row + share * directions[degree]
            found.append(_descend(held, task, _with_pairs(directions[:degree])))
    found = [result for result in found if task.safe(result[2])]
    _, row, _ = min(found, key=lambda result: result[0])
    found.append(_descend(row, task, _with_pairs(directions)))
    return min((_polish(segment, task) for _, _, segment in found), key=lambda result: result[0])[1]


def _polish(segment: FixedSegment, task: _Segment) -> tuple[float, FixedSegment]:
    """Integers that no change of one constant by a power of two improves, and their error.

    Only where rounding is a good part of the error: a constant that is changed by less than its
    shift drops decides where the steps of the result lie.
    """
    least = task.error(segment)
    improved = least < _ROUNDING_SEEN
    while improved:
        improved = False
        for index, shift in enumerate(segment.shifts):
            for power in range(max(shift - 6, 0), shift + 1):
                for change in (1 << power, -(1 << power)):
                    constants = list(segment.constants)
                    constants[index] += change
                    other = replace(segment, constants=tuple(constants))
                    error = task.error(other)
                    if error < least - 1e-9 and task.safe(other):
                        segment, least, improved = other, error, True
    return least, segment


def _with_pairs(directions: FloatArray) -> FloatArray:
    """Directions with the sums and differences of any two of them."""
    pairs = [a + sign * b for a, b in combinations(directions, 2) for sign in (1.0, -1.0)]
    return np.concatenate([directions, np.array(pairs).reshape(-1, directions.shape[1])])


def fit_fixed(
    piecewise: PiecewisePolynomial,
    curve: Callable[[FloatArray], FloatArray],
    scale: CodeScale,
    *,
    exact_at_zero: bool,
    continuous: bool,
) -> FixedPolynomial:
    """Integers of a piecewise polynomial, found by the error that they make.

    Args:
        piecewise: Real fit whose edges, but for the last, are arguments of whole codes.
        curve: What it approximates, argument and result in the units of ``scale``.
        scale: Full scale of argument and result, and the width of the numbers in bits.
        exact_at_zero, continuous: Side conditions: nothing at zero; a step of one code at most
            across a breakpoint.
    """
    starts = [scale.code(edge) for edge in piecewise.edges[:-1]]
    end = min(math.floor(piecewise.edges[-1] / scale.argument * scale.one), int(scale.one) - 1)
    lasts = [start - 1 for start in starts[1:]] + [end]
    segments: list[FixedSegment] = []
    for row, start, last in zip(piecewise.coefficients, starts, lasts, strict=True):
        length, in_codes = last - start, scale.in_codes(row)
        local = np.arange(length + 1) if length < _MOST_CODES else np.zeros(1, dtype=np.int64)
        task = _Segment(
            start=start,
            length=length,
            width=scale.width,
            scales=_safe_scales(in_codes, length, scale.width),
            local=np.append(local, [0, length + 1]),
            exact=curve(scale.arguments(start + local)) * (scale.one / scale.result),
            seams=(
                float(in_codes[0]) if segments and continuous else None,
                float(np.polynomial.polynomial.polyval(length + 1, in_codes))
                if continuous and last < end
                else None,
            ),
            at_zero=exact_at_zero and not segments and float(row[0]) == 0.0,
        )
        segments.append(_search(in_codes, task))
    return FixedPolynomial(tuple(segments), scale.width, end)
