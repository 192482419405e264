"""Piecewise polynomials in integer arithmetic, step by step as the emitted C computes them,
with proven ranges.

A number of ``width`` bits stands for a fraction of full scale: 2^(width - 1) codes are 1.
One step of Horner's rule is

    acc = (acc * x + constant) >> shift

with a product of twice the width. The constant holds the coefficient at the scale of the product
and half of the last place that is left, so that a step costs one multiply-accumulate and one shift,
and rounds to nearest.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass

CodeArray = NDArray[np.int64]

# Parts of a segment in the interval analysis: the bounds shrink towards the true ranges with their
# number.
_PARTS = 64
Range = tuple[int, int]


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

    def evaluate(self, local: CodeArray) -> CodeArray:
        """Results at arguments counted from ``start``, any shape, without saturation."""
        value = np.full(local.shape, self.leading, dtype=np.int64)
        for constant, shift in zip(self.constants, self.shifts, strict=True):
            value = (value * local + constant) >> shift
        return value

    def ranges(self, length: int) -> tuple[Range, Range, Range]:
        """Proven ranges for local arguments 0 to ``length``: products and sums;
        values between steps; results.

        Interval arithmetic in exact integers on parts of the segment.
        """
        edges = sorted({length * part // _PARTS for part in range(_PARTS + 1)})
        pairs = list(pairwise(edges)) or [(0, 0)]
        found = [self._ranges(low, high) for low, high in pairs]
        products, values, results = (
            (min(part[kind][0] for part in found), max(part[kind][1] for part in found))
            for kind in range(3)
        )
        return products, values, results

    def _ranges(self, low: int, high: int) -> tuple[Range, Range, Range]:
        value = (self.leading, self.leading)
        widest, between = (0, 0), value
        for constant, shift in zip(self.constants, self.shifts, strict=True):
            between = (min(between[0], value[0]), max(between[1], value[1]))
            corners = [bound * x for bound in value for x in (low, high)]
            total = (min(corners) + constant, max(corners) + constant)
            widest = (min(widest[0], *corners, total[0]), max(widest[1], *corners, total[1]))
            value = (total[0] >> shift, total[1] >> shift)
        return widest, between, value


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
        ranges = [
            segment.ranges(n)[2] for segment, n in zip(self.segments, self.lengths(), strict=True)
        ]
        return any(low < -self.largest or high > self.largest for low, high in ranges)

    def overflows(self) -> bool:
        """Whether a product or sum may leave 2 ``width`` bits, or a value between two
        steps 2 ``width`` or 32 bits.
        """
        return any(
            overflows(s, n, self.width) for s, n in zip(self.segments, self.lengths(), strict=True)
        )

    def evaluate(self, codes: CodeArray) -> CodeArray:
        """Codes of the results at codes from 0 to ``end``, any shape."""
        starts = np.array(self.starts)
        which = np.searchsorted(starts[1:], codes, side="right")
        result = np.empty(codes.shape, dtype=np.int64)
        for index, segment in enumerate(self.segments):
            here = which == index
            result[here] = segment.evaluate(codes[here] - segment.start)
        return np.clip(result, -self.largest, self.largest)


def overflows(segment: FixedSegment, length: int, width: int) -> bool:
    """Whether some local argument up to ``length`` may overflow: products 2 ``width`` bits,
    values at most 32 bits.
    """
    products, values, _ = segment.ranges(length)
    return not (_fits(products, 2 * width) and _fits(values, min(2 * width, 32)))


def _fits(reach: Range, bits: int) -> bool:
    limit = 1 << (bits - 1)
    return -limit <= reach[0] and reach[1] < limit
