"""Ball arithmetic over whole arrays: midpoints and radii in doubles,
with every rounding error put into the radius.

Each operation is done on the midpoints, rounded to nearest: its error is at most 2^-53 of the
result (and far less than `_LEAST` where it underflows). Radii are sums and products of a few
non-negative numbers, so that what their own rounding takes away is at most some 2^-50 of them,
which a factor makes up for. S. M. Rump, "Fast and parallel interval arithmetic", BIT 39 (1999).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

_UNIT = 2.0**-52  # Twice the rounding error of one operation.
_MORE = 1.0 + 2.0**-47  # Makes up for the rounding of a radius, which some ten operations make.
_LEAST = 1e-290  # Above what underflow may take from a result.


@dataclass(frozen=True, slots=True, eq=False)
class Balls:
    """Arrays of real numbers of which each is known to lie within ``rad`` of ``mid``.

    Any broadcastable shapes.

    Sums and products take other balls, arrays and numbers (which are exact) and balls of
    python-flint. The number 0 is an exact zero, which products keep: derivatives that vanish then
    cost nothing.
    """

    mid: FloatArray
    rad: FloatArray

    __array_ufunc__: ClassVar[None] = None  # arrays leave operators to this class

    @classmethod
    def exact(cls, values: Any) -> Balls:
        """Doubles as they are."""
        mid = np.asarray(values, dtype=np.float64)
        return cls(mid, np.zeros_like(mid))

    @classmethod
    def between(cls, low: Any, high: Any) -> Balls:
        """Balls that hold everything from ``low`` to ``high``."""
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        mid = 0.5 * low + 0.5 * high
        return cls(mid, np.maximum(high - mid, mid - low) * _MORE + _LEAST)

    @classmethod
    def of(cls, value: Any) -> Balls:
        """Whatever operators take."""
        if isinstance(value, cls):
            return value
        if hasattr(
            value, "abs_upper"
        ):  # a ball of python-flint: what its midpoint rounds to, and a wider radius
            mid = float(value.mid())
            inside = value.rad() == 0 and value == mid
            return cls(
                np.asarray(mid),
                np.asarray(0.0 if inside else float(value.rad()) * _MORE + abs(mid) * _UNIT),
            )
        return cls.exact(value)

    def __add__(self, other: Any) -> Balls:
        """Sum."""
        if isinstance(other, int | float) and other == 0:
            return self
        right = Balls.of(other)
        mid = self.mid + right.mid
        return Balls(mid, (self.rad + right.rad + np.abs(mid) * _UNIT) * _MORE)

    __radd__ = __add__

    def __neg__(self) -> Balls:
        """Exact."""
        return Balls(-self.mid, self.rad)

    def __sub__(self, other: Any) -> Balls:
        """Difference."""
        return self + (-Balls.of(other))

    def __rsub__(self, other: Any) -> Balls:
        """Difference."""
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Any:
        """Product; the number 0 stays an exact zero."""
        if isinstance(other, int | float) and other == 0:
            return 0
        right = Balls.of(other)
        mid = self.mid * right.mid
        spread = (np.abs(self.mid) + self.rad) * right.rad + self.rad * np.abs(right.mid)
        return Balls(mid, (spread + np.abs(mid) * _UNIT) * _MORE + _LEAST)

    __rmul__ = __mul__

    def __lt__(self, limit: float) -> bool:
        """Whether everything in all of the balls lies below a number."""
        return bool(np.all(self.upper() < limit))

    def squared(self) -> Balls:
        """Square, which is not negative."""
        low, high = self.abs_lower().mid, self.abs_upper().mid
        return Balls.between(low * low / _MORE, high * high * _MORE + _LEAST)

    def reciprocal(self) -> Balls:
        """One over balls that do not hold zero (elsewhere the result means nothing)."""
        low, high = self.lower(), self.upper()
        return Balls.between(
            1.0 / high - np.abs(1.0 / high) * _UNIT, 1.0 / low + np.abs(1.0 / low) * _UNIT
        )

    def upper(self) -> FloatArray:
        """Doubles not below anything in the balls."""
        high = self.mid + self.rad
        return np.asarray(high + np.abs(high) * _UNIT + _LEAST)

    def lower(self) -> FloatArray:
        """Doubles not above anything in the balls."""
        return -(-self).upper()

    def abs_upper(self) -> Balls:
        """Largest magnitudes, rounded up."""
        return Balls.exact((np.abs(self.mid) + self.rad) * _MORE + _LEAST)

    def abs_lower(self) -> Balls:
        """Least magnitudes, rounded down."""
        least = np.abs(self.mid) - self.rad
        return Balls.exact(np.maximum(least - np.abs(least) * _UNIT - _LEAST, 0.0))

    def widened(self, radius: FloatArray) -> Balls:
        """Balls with larger radii."""
        return Balls(self.mid, (self.rad + radius) * _MORE)

    def at(self, places: Any) -> Balls:
        """Some of the balls, or all of them broadcast."""
        return Balls(self.mid[places], self.rad[places])


def magnitude(value: Any) -> Any:
    """Largest magnitudes as doubles; 0 for the exact zero."""
    return value.abs_upper().mid if isinstance(value, Balls) else abs(value)


def most(value: Any) -> Any:
    """Largest values as doubles, 0 for the exact zero."""
    return value.upper() if isinstance(value, Balls) else value
