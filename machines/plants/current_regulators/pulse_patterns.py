"""Synchronous optimal pulse patterns: switching angles with the least distortion of the current.

The leg voltage over half the DC link is s(x) = +-1 with quarter-wave symmetry, of N angles in the
first quarter; its amplitudes of odd orders, all sines, are

    b_n = (4 sigma / (n pi)) (1 + 2 sum_i (-1)^i cos(n x_i)),    sigma = s(0+)

The currents of an inductive machine have the amplitudes b_n / n, those of orders that 3 divides
cancel with the star point isolated. The angles minimise the sum of their squares at a given b_1.

Sources: J. Holtz, B. Beyer, "The trajectory tracking approach - a new method for minimum distortion
PWM in dynamic high-power drives", IEEE Transactions on Industry Applications 30(4), 1994,
pp. 1048-1057. The sums here were derived anew.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass

_HIGHEST = 151
LEAST_WIDTH = math.radians(0.25)  # Least angle in rad between two commutations of a leg.
_STARTS = 16


@dataclass(frozen=True, slots=True)
class PulsePattern:
    """Switching of a leg over a period of the voltage's sine.

    Args:
        angles: Angles of the first quarter in rad, shape (N,), ascending.
        sign: Leg voltage just behind the angle 0 over half the DC link, 1 or -1.
    """

    angles: FloatArray
    sign: int

    @property
    def pulses(self) -> int:
        """Turn-ons of a leg in a period."""
        return 2 * self.angles.size + 1

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Angles in rad of all commutations of a period, ascending from 0, and the leg voltage
        behind each over half the DC link, shape (4 N + 2,) each.
        """
        x = self.angles
        half = np.concatenate([[0.0], x, math.pi - x[::-1]])
        levels = self.sign * (-1.0) ** np.arange(half.size)
        return np.concatenate([half, math.pi + half]), np.concatenate([levels, -levels])

    def amplitudes(self, orders: FloatArray) -> FloatArray:
        """Amplitudes over half the DC link of odd orders, shape (n,)."""
        return amplitudes(self.angles, self.sign, orders)


def amplitudes(angles: FloatArray, sign: int, orders: FloatArray) -> FloatArray:
    """b_n of the angles (N,) in rad of a quarter and the first level, of odd orders (n,)."""
    turn = (-1.0) ** np.arange(1, angles.size + 1)
    sums = 1.0 + 2.0 * np.cos(np.outer(orders, angles)) @ turn
    return np.asarray(4.0 * sign / (math.pi * orders) * sums)


def distortion_orders() -> FloatArray:
    """Odd orders from 5 on that 3 does not divide."""
    orders = np.arange(5, _HIGHEST + 1, 2)
    return np.asarray(orders[orders % 3 != 0], dtype=np.float64)


def distortion(angles: FloatArray, sign: int) -> float:
    """Root of the sum of (b_n / n)^2 over the orders of `distortion_orders`."""
    orders = distortion_orders()
    return float(np.sqrt(np.sum((amplitudes(angles, sign, orders) / orders) ** 2)))


@cache
def optimal_pattern(count: int, index: float) -> PulsePattern:
    """The pattern of ``count`` angles in a quarter that distorts the current least.

    Found by sequential quadratic programming from a fixed set of starts; the best of all is taken,
    which is a local optimum, as everywhere where such patterns are made.

    Args:
        count: N, at least 1.
        index: b_1: amplitude of the fundamental over half the DC link, 0 to below 4/pi.

    Raises:
        NoSolutionError: No start leads to the amplitude with the least widths.
    """
    found = []
    for sign in (1, -1):
        for start in _starts(count):
            angles = _improved(start, sign, index)
            if angles is not None:
                found.append((distortion(angles, sign), sign, angles))
    if not found:
        raise NoSolutionError(
            f"no pulse pattern of {2 * count + 1} pulses makes {index:.3g} of half the DC link; "
            "take fewer pulses or a higher DC-link voltage"
        )
    _, sign, angles = min(found, key=lambda entry: entry[0])
    return PulsePattern(angles, sign)


def _starts(count: int) -> list[FloatArray]:
    """Angles that lie even in the quarter, in its upper part, and anywhere, the same each time."""
    spread = (np.arange(count) + 0.75) / (count + 0.5)
    lows = np.linspace(0.0, 0.75, 4)
    drawn = np.random.default_rng(count).uniform(0.0, 1.0, (_STARTS, count))
    shares = [low + (1.0 - low) * spread for low in lows] + list(np.sort(drawn, axis=-1))
    return [0.5 * math.pi * share for share in shares]


def _improved(start: FloatArray, sign: int, index: float) -> FloatArray | None:
    from scipy.optimize import minimize

    orders = distortion_orders()
    turn = (-1.0) ** np.arange(1, start.size + 1)
    scale = 1e4

    def target(x: FloatArray) -> tuple[float, FloatArray]:
        voltage = amplitudes(x, sign, orders)
        slopes = -8.0 * sign / math.pi * np.sin(np.outer(orders, x)) * turn
        part = voltage / orders**2
        return scale * float(np.sum(part * voltage)), np.asarray(2.0 * scale * (part @ slopes))

    def error(x: FloatArray) -> float:
        return float(amplitudes(x, sign, np.ones(1))[0]) - index

    def widths(x: FloatArray) -> FloatArray:
        ends = np.concatenate([[0.0], x, [0.5 * math.pi]])
        gaps = np.diff(ends)
        gaps[-1] *= 2.0
        return np.asarray(gaps - LEAST_WIDTH)

    found = minimize(
        target,
        start,
        jac=True,
        method="SLSQP",
        constraints=[{"type": "eq", "fun": error}, {"type": "ineq", "fun": widths}],
        options={"maxiter": 200, "ftol": 1e-12},
    )
    good = found.success and abs(error(found.x)) < 1e-8 and np.all(widths(found.x) > -1e-9)
    return np.asarray(found.x) if good else None
