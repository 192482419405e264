"""The current loop of one axis over a sample, in flux linkage, while its inductance changes.

Deviations of the flux linkage obey d psi/dt = g v - R i with i = psi/L at every instant, L an
average of incremental inductances between two states. In phi = psi/(g t_s) only

    alpha = exp(-rho),   beta = integral of exp(-rho ..),   rho = R t_s/L averaged over the sample
    P = kp t_s g/L,   Q = ki t_s^2 g/L       at the sampling instant

depend on it. Parallel form: v+ = -(P + Q) phi + I, I+ = I - Q phi. This is affine in alpha, beta, P
and Q, each of which may take any value of an interval at every sample: corners say all.

Velocity form: v+ = v - (P + Q) phi + (kp now) i before. A gain that changes leaves kp now less kp
before, times i before, in the voltage for good.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from flint import fmpq

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LoopRange:
    """Intervals of what a loop may be at a sample.

    ``rho`` is R t_s/L. ``products`` are pairs (P, Q) whose convex hull holds all of them.
    """

    rho: Interval
    products: tuple[tuple[float, float], ...]

    def shares(self) -> tuple[Interval, Interval]:
        """Intervals of alpha and beta, rounded outwards."""
        low, high = self.rho
        return _outwards(_falling(low, high, _alpha)), _outwards(_falling(low, high, _beta))

    def corners(self) -> FloatArray:
        """Steps of (phi, v, I) at the corners, shape (V, 3, 3)."""
        alpha, beta = self.shares()
        found = [
            parallel_step(a, b, p, q)
            for a, b, (p, q) in itertools.product(alpha, beta, self.products)
        ]
        return np.array(found)


def _alpha(rho: Any) -> Any:
    return (-rho).exp()


def _beta(rho: Any) -> Any:
    return -(-rho).expm1() / rho if rho != 0 else rho + 1


def _falling(low: float, high: float, function: Any) -> tuple[Any, Any]:
    """Values of a falling function over an interval, as balls."""
    from flint import arb

    return function(arb(high)), function(arb(low))


def _outwards(balls: tuple[Any, Any]) -> Interval:
    low, high = float(balls[0].lower()), float(balls[1].upper())
    return float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))


def parallel_step(alpha: float, beta: float, p: float, q: float) -> list[list[float]]:
    """The step of (phi, v, I) with the parallel form, rows of a 3 x 3 matrix.

    Args:
        alpha, beta: What is left of the flux linkage, and what a voltage adds to it.
        p, q: kp t_s g/L and ki t_s^2 g/L.
    """
    return [[alpha, beta, 0.0], [-(p + q), 0.0, 1.0], [-q, 0.0, 1.0]]


def velocity_step(
    alpha: float, beta: float, share: float, gains: tuple[float, float]
) -> list[list[float]]:
    """The step of (phi, v, i before) with the velocity form, v + kp (e - e before) + ki t_s e.

    Args:
        alpha, beta: What is left of the flux linkage, and what a voltage adds to it.
        share: Current over phi, in some unit.
        gains: kp and ki t_s at this sample, over that unit.
    """
    kp, ki_ts = gains
    return [[alpha, beta, 0.0], [-(kp + ki_ts) * share, 1.0, kp], [share, 0.0, 0.0]]


def falls_exactly(matrix: FloatArray, corners: FloatArray) -> bool:
    """Whether P > 0 and P - A^T P A > 0 at every corner, in rational numbers.

    Args:
        matrix: P, shape (3, 3), symmetric to the bit.
        corners: A, shape (V, 3, 3).
    """
    from flint import fmpq_mat

    def exact(values: FloatArray) -> Any:
        entries = [_rational(value) for value in values.ravel().tolist()]
        return fmpq_mat(*values.shape, entries)

    p = exact(matrix)
    if not _positive(p):
        return False
    steps = (exact(corner) for corner in corners)
    return all(_positive(p - step.transpose() * p * step) for step in steps)


def _rational(value: float) -> fmpq:
    from flint import fmpq

    return fmpq(*value.as_integer_ratio())


def _positive(matrix: Any) -> bool:
    """Sylvester's criterion."""
    from flint import fmpq_mat

    for size in range(1, matrix.nrows() + 1):
        part = fmpq_mat(size, size, [matrix[i, j] for i in range(size) for j in range(size)])
        if part.det() <= 0:
            return False
    return True
