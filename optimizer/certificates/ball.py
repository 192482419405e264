"""Balls and Taylor polynomials: the little that the certificates need beyond the
library for ball arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flint import arb


Value = Any  # A ball, or a power series with balls as coefficients.
ORDER = 5  # Power of the remainder of the Taylor polynomials.
_TINY = 1e-300  # Least bound that is stated: smaller doubles have fewer digits.


def upper(value: Any) -> float:
    """A double not below a ball's magnitude; inf where it is not finite,
    and 0 only for what is exactly zero.
    """
    if value == 0:
        return 0.0
    size = float(value.abs_upper())
    return max(math.nextafter(size, math.inf), _TINY) if math.isfinite(size) else math.inf


@lru_cache(maxsize=4096)
def exactly(value: float) -> arb:
    """A double as a ball without radius."""
    from flint import arb

    return arb(value)


def as_ball(value: Any) -> arb:
    """A ball, from a ball or an integer."""
    return exactly(value) if isinstance(value, int) else value


def widened(ball: arb, radius: arb) -> arb:
    """A ball with a larger radius."""
    from flint import arb

    return ball + arb(0, radius)


def hull(balls: Sequence[arb]) -> arb:
    """The ball around several."""
    total = balls[0]
    for ball in balls[1:]:
        total = total.union(ball)
    return total


class Expansion:
    """Taylor polynomials of functions of the torque about the middle of an interval, with
    remainders over all of it.
    """

    def __init__(self, low: float, high: float) -> None:
        from flint import arb

        middle = 0.5 * (low + high)
        self.middle = arb(middle)
        # The middle is rounded, and so are ends that come from codes:
        # a narrow ball must not lose them.
        radius = math.nextafter(0.5 * (high - low) * (1.0 + 1e-15) + 1e-15 * abs(middle), math.inf)
        self.radius = arb(radius)
        self.step = arb(0, radius)
        self.ball = arb(middle, radius)

    def enclose(self, function: Callable[[Value], Sequence[Value]]) -> list[arb]:
        """Balls that hold everything that functions of the torque take on the interval.

        Raises:
            ZeroDivisionError: One of them is not finite.
        """
        from flint import arb_series

        try:
            at_middle = function(arb_series([self.middle, 1]))
            over_all = function(arb_series([self.ball, 1]))
        except ValueError as error:  # how a series says that it divides by what may vanish
            raise ZeroDivisionError from error
        found = []
        for here, everywhere in zip(at_middle, over_all, strict=True):
            value = everywhere[ORDER]
            for power in range(ORDER - 1, -1, -1):
                value = value * self.step + here[power]
            if not value.is_finite():
                raise ZeroDivisionError
            found.append(value)
        return found
