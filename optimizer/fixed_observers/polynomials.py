"""Polynomials of the speed in integers: mantissas of one scale, by Horner's rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic
from dqforge.optimizer.fixed_observers.kit import times

_MOST_SHIFT = 60


@dataclass(frozen=True, slots=True)
class FixedPolynomials:
    """Polynomials p(s) = sum of ``rows[n][k]`` s^k / 2^shift of the square of a speed per unit,
    0 <= s <= 1; their values are mantissas of that ``shift``.
    """

    rows: tuple[tuple[int, ...], ...]
    shift: int


def common_scale(
    name: str, rows: Sequence[Sequence[float]], bits: int, weights: Sequence[float] | None = None
) -> FixedPolynomials:
    """Coefficients at the finest common scale at which no value needs more than ``bits`` bits.

    Args:
        name: What the polynomials are, for the message.
        rows: Coefficients of rising powers of s per unit.
        bits: A value stays below 2^bits in magnitude.
        weights: Largest s^k of each power where that is less than 1.

    Raises:
        NoSolutionError: No scale holds them.
    """
    count = len(rows[0])
    most = weights if weights is not None else [1.0] * count
    largest = max(sum(abs(c) * w for c, w in zip(row, most, strict=True)) for row in rows)
    if not 0.0 < largest < 2.0**bits:
        raise NoSolutionError(
            f"fixed point: {name} has no scale of {bits} bits; use other bases in control.per_unit"
        )
    shift = min(_MOST_SHIFT, math.floor(bits - math.log2(largest) - 1e-9))
    # A coefficient beyond 32 bits of its own power would not be a mantissa.
    widest = max(abs(c) for row in rows for c in row)
    shift = min(shift, math.floor(31 - math.log2(widest) - 1e-9))
    if shift < 0:
        raise NoSolutionError(
            f"fixed point: {name} has no scale of 32 bits; use other bases in control.per_unit"
        )
    return FixedPolynomials(tuple(tuple(round(c * 2.0**shift) for c in row) for row in rows), shift)


def value_of(o: Arithmetic[N, Any], row: tuple[int, ...], square: N) -> N:
    """Mantissa of a polynomial at the code ``square``."""
    value = o.const(row[-1])
    for coefficient in row[-2::-1]:
        value = o.total("polynomial", times(o, "polynomial", value, square), o.const(coefficient))
    return value


def odd_value_of(o: Arithmetic[N, Any], row: tuple[int, ...], square: N, x: N) -> N:
    """Mantissa of x p(x^2) at the code ``x`` with its square."""
    return times(o, "odd polynomial", value_of(o, row, square), x)
