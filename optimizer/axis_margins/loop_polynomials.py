"""What a bound of a margin says, as a polynomial that must not be negative.

With a = exp(-rho), gamma = b (1 - a)/rho and c = cos(omega t_s) the loop of one axis is

    D_ol = z (z - 1) (z - a),      D_cl = D_ol + gamma ((p + q) z - p),      z = exp(j omega t_s)

p = kp t_s/L', q = ki t_s^2/L'; sensitivity D_ol/D_cl, open loop (D_cl - D_ol)/D_ol. Squares of the
moduli are polynomials in c (degree 3), a (2) and gamma (2). Those have their values between the
least and the largest of their 36 Bernstein coefficients over a cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass
from dqforge.optimizer.axis_margins.box_cells import Interval

if TYPE_CHECKING:
    from flint import fmpq, fmpq_mat

POWERS = (4, 3, 3)  # Coefficients along c, a and gamma.
Terms = dict[tuple[int, int, int], "fmpq"]


@dataclass(frozen=True, slots=True)
class AxisGains:
    """p = kp t_s/L' and q = ki t_s^2/L', without unit."""

    p: fmpq
    q: fmpq

    def open_squared(self) -> Terms:
        """|D_ol|^2 = (2 - 2 c) (1 + a^2 - 2 a c)."""
        from flint import fmpq

        numbers = {(0, 0): 2, (0, 2): 2, (1, 0): -2, (1, 1): -4, (1, 2): -2, (2, 1): 4}
        return {(i, j, 0): fmpq(value) for (i, j), value in numbers.items()}

    def cross(self) -> Terms:
        """Real part of gamma conj(D_ol) ((p + q) z - p), as cos 3x = 4 c^3 - 3 c."""
        p, q = self.p, self.q
        numbers = {
            (0, 0): -(2 * p + q),
            (0, 1): q,
            (1, 0): 2 * p - q,
            (1, 1): -(2 * p + q),
            (2, 0): 2 * (2 * p + q),
            (2, 1): 2 * p,
            (3, 0): -4 * p,
        }
        return {(i, j, 1): value for (i, j), value in numbers.items()}

    def control_squared(self) -> Terms:
        """Square of gamma |(p + q) z - p|."""
        p, total = self.p, self.p + self.q
        return {(0, 0, 2): total * total + p * p, (1, 0, 2): -2 * total * p}

    def closed_squared(self) -> Terms:
        """|D_cl|^2."""
        return weighted((1, self.open_squared()), (2, self.cross()), (1, self.control_squared()))


def weighted(*parts: tuple[fmpq | int, Terms]) -> Terms:
    """Sum of polynomials, each times a number."""
    total: Terms = {}
    for factor, terms in parts:
        for powers, value in terms.items():
            total[powers] = total.get(powers, 0) + factor * value
    return total


def tabled(terms: Terms) -> fmpq_mat:
    """Coefficients as a matrix: a row per power of c, a column per power of a and gamma."""
    from flint import fmpq, fmpq_mat

    rows, columns = POWERS[0], POWERS[1] * POWERS[2]
    entries = [fmpq(0)] * (rows * columns)
    for (i, j, k), value in terms.items():
        entries[i * columns + j * POWERS[2] + k] = value
    return fmpq_mat(rows, columns, entries)


def _of_two(low: fmpq, high: fmpq) -> list[list[fmpq]]:
    """Bernstein coefficients of 1, t, t^2 over an interval, a row each per coefficient."""
    return [
        [1, low, low * low],
        [1, (low + high) / 2, low * high],
        [1, high, high * high],
    ]


def _of_three(low: fmpq, high: fmpq) -> list[list[fmpq]]:
    """The same of 1, t, t^2, t^3."""
    return [
        [1, low, low**2, low**3],
        [1, (2 * low + high) / 3, (low * low + 2 * low * high) / 3, low * low * high],
        [1, (low + 2 * high) / 3, (2 * low * high + high * high) / 3, low * high * high],
        [1, high, high**2, high**3],
    ]


def bases(c: Interval, a: Interval, gamma: Interval) -> tuple[fmpq_mat, fmpq_mat]:
    """What turns `tabled` coefficients into those of Bernstein over a cell, from left and right."""
    from flint import fmpq_mat

    of_a, of_gamma = _of_two(*a), _of_two(*gamma)
    right = [
        [of_a[i][j] * of_gamma[k][n] for i in range(3) for k in range(3)]
        for j in range(3)
        for n in range(3)
    ]
    left = _of_three(*c)
    return (
        fmpq_mat(4, 4, [value for row in left for value in row]),
        fmpq_mat(9, 9, [value for row in right for value in row]),
    )
