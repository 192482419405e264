"""The box of one axis in two parameters, and how it is cut into cells, in rational numbers.

The sampled loop of one axis knows its drive by two numbers without unit,

    b = g L'/L,        s = (R/R' + dead time)/g,        rho = s rho' b = R t_s/L,   rho' = R' t_s/L'

with the design's R' and L', the plant's R and L and the gain g of its voltage. A dead time t_e adds
a resistance in proportion to g, which stays in s as a constant. The same g is in both: a cell of
(b, s) belongs to the box where an interval of g is left, and is cut to what that interval allows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from flint import fmpq

Interval = tuple["fmpq", "fmpq"]

# Ends of cells are rounded outwards to multiples of its inverse, so that they stay short.
_FRACTION = 2**56


def rational(value: float) -> fmpq:
    """A double as the rational number that it is."""
    from flint import fmpq

    return fmpq(*value.as_integer_ratio())


def _down(value: fmpq) -> fmpq:
    from flint import fmpq

    return fmpq((value * _FRACTION).floor(), _FRACTION)


def _outwards(low: fmpq, high: fmpq) -> Interval:
    return _down(low), -_down(-high)


def _both(one: Interval, other: Interval) -> Interval:
    return max(one[0], other[0]), min(one[1], other[1])


@dataclass(frozen=True, slots=True)
class Cell:
    """Intervals of c = cos(omega t_s), b and s."""

    c: Interval
    b: Interval
    s: Interval

    def halves(self, name: str) -> tuple[Cell, Cell]:
        """Cut in the middle of one of its intervals."""
        low, high = getattr(self, name)
        middle = (low + high) / 2
        ends = {key: getattr(self, key) for key in ("c", "b", "s")}
        return Cell(**ends | {name: (low, middle)}), Cell(**ends | {name: (middle, high)})


@dataclass(frozen=True, slots=True)
class AxisBox:
    """All drives of one axis.

    Args:
        rho: R' t_s/L' of the design.
        resistance, inductance, gain: Intervals of R/R' without dead time, of L/L' and of g.
        dead_time: Interval of what the dead time adds to s.
    """

    rho: fmpq
    resistance: Interval
    inductance: Interval
    gain: Interval
    dead_time: Interval

    def root(self) -> Cell:
        """The cell around all drives and frequencies."""
        from flint import fmpq

        b = self.gain[0] / self.inductance[1], self.gain[1] / self.inductance[0]
        s = (
            self.resistance[0] / self.gain[1] + self.dead_time[0],
            self.resistance[1] / self.gain[0] + self.dead_time[1],
        )
        return Cell((fmpq(-1), fmpq(1)), _outwards(*b), _outwards(*s))

    def _gains(self, cell: Cell) -> Interval | None:
        """The gains g that drives of a cell may have, None where there are none."""
        by_b = cell.b[0] * self.inductance[0], cell.b[1] * self.inductance[1]
        low, high = _both(self.gain, by_b)
        least, most = cell.s[0] - self.dead_time[1], cell.s[1] - self.dead_time[0]
        if most <= 0:
            return None
        low = max(low, self.resistance[0] / most)
        high = min(high, self.resistance[1] / least) if least > 0 else high
        return (low, high) if low <= high else None

    def contracted(self, cell: Cell) -> Cell | None:
        """The cell cut to what drives of the box can reach, None where there is no drive."""
        gain = self._gains(cell)
        if gain is None:
            return None
        b = _both(cell.b, _outwards(gain[0] / self.inductance[1], gain[1] / self.inductance[0]))
        low = self.resistance[0] / gain[1] + self.dead_time[0]
        high = self.resistance[1] / gain[0] + self.dead_time[1]
        s = _both(cell.s, _outwards(low, high))
        return Cell(cell.c, b, s) if b[0] <= b[1] and s[0] <= s[1] else None

    def drive(self, cell: Cell, share: tuple[float, float]) -> tuple[fmpq, fmpq] | None:
        """(b, s) of a drive of the box at shares of a cell's sides, or as near as there is one."""
        gain = self._gains(cell)
        if gain is None:
            return None
        of_b, of_s = (rational(value) for value in share)
        g = (gain[0] + gain[1]) / 2
        b = cell.b[0] + of_b * (cell.b[1] - cell.b[0])
        s = cell.s[0] + of_s * (cell.s[1] - cell.s[0])
        b = min(max(b, g / self.inductance[1]), g / self.inductance[0])
        low, high = (self.resistance[side] / g + self.dead_time[side] for side in (0, 1))
        return b, min(max(s, low), high)

    def sampled(self, b: Interval, s: Interval) -> tuple[Interval, Interval]:
        """Intervals of a = exp(-rho) and gamma = b (1 - a)/rho, rounded outwards.

        gamma is the integral of exp(-s rho' b') over b' from 0 to b: it rises in b and falls in s,
        for either sign of s.
        """
        products = [x * y for x in b for y in s]
        a = _exponential(-self.rho * max(products))[0], _exponential(-self.rho * min(products))[1]
        return a, (self._share(b[0], s[1])[0], self._share(b[1], s[0])[1])

    def _share(self, b: fmpq, s: fmpq) -> Interval:
        from flint import arb

        rho = self.rho * b * s
        return _ends(arb(b) if rho == 0 else -arb(b) * (-arb(rho)).expm1() / arb(rho))


def _exponential(value: fmpq) -> Interval:
    from flint import arb

    return _ends(arb(value).exp())


def _ends(ball: object) -> Interval:
    return ball.lower().fmpq(), ball.upper().fmpq()  # type: ignore[attr-defined]
