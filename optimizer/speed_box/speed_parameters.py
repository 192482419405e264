"""The box of drives as the speed loop sees it: four parameters without unit.

With the design's R', L', J' and the plant's R, L, J, the gain g of the voltage, f torque over
commanded torque, and what the feedforward leaves of the back-EMF,

    b = g L'/L,    c = (R/R' + dead time times g) L'/L,    j = f J'/J,    e = p psi_pm deviation/g

the same g and L being in several of them: a cell belongs to the box where intervals of both are
left, and is cut to what those allow. (c in place of c/b, since the loop depends on c alone where
b is far from its gains: what interpolation over a cell leaves out is a third of it.)
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.cell_queue import Cell

Interval = tuple[float, float]
PARAMETERS = ("b", "c", "j", "e")
_SLACK = 1e-12  # Share by which intervals are widened, far more than what doubles round.


def _divided(above: Interval, below: Interval) -> Interval:
    """Quotients by what is positive."""
    ends = [x / y for x in above for y in below]
    return min(ends), max(ends)


def _quotients(above: Interval, below: Interval) -> Interval:
    """Positive values x/y, where y of either sign may be small."""
    if below[0] > 0.0:
        return _divided(above, below)
    if below[1] < 0.0:
        return _divided(above, below)
    return 0.0, np.inf


def _common(one: Interval, other: Interval) -> Interval:
    """Values of both, the other one widened."""
    return max(one[0], other[0] * (1.0 - _SLACK)), min(one[1], other[1] * (1.0 + _SLACK))


@dataclass(frozen=True, slots=True)
class SpeedBox:
    """Intervals of R/R', L/L', g, what the dead time adds to R/R' per g, f, J'/J and e g.

    The last in V s/rad, all others without unit.
    """

    resistance: Interval
    inductance: Interval
    gain: Interval
    dead_time: Interval
    torque: Interval
    inertia: Interval
    back_emf: Interval

    def root(self) -> Cell:
        """The cell around all drives."""
        return self._reached(self.gain, self.inductance)

    def _reached(self, gain: Interval, inductance: Interval) -> Cell:
        """What drives with some gains of the voltage and inductances reach."""
        ohm = self._resistances(gain)
        ends = [side / g for side in self.back_emf for g in gain]
        sides = np.array(
            [
                _divided(gain, inductance),
                _divided(ohm, inductance),
                (self.torque[0] * self.inertia[0], self.torque[1] * self.inertia[1]),
                (min(ends), max(ends)),
            ]
        )
        moved = sides[:, 1] > sides[:, 0]  # what does not deviate stays one value
        slack = np.where(moved, _SLACK * np.max(np.abs(sides), axis=1), 0.0)
        return Cell(sides[:, 0] - slack, sides[:, 1] + slack)

    def _resistances(self, gain: Interval) -> Interval:
        dead = [side * g for side in self.dead_time for g in gain]
        return self.resistance[0] + min(dead), self.resistance[1] + max(dead)

    def _shares(self, cell: Cell) -> tuple[Interval, Interval] | None:
        """Gains of the voltage and inductances that drives of a cell may have, None without any."""
        (b_low, c_low, _, e_low), (b_high, c_high, _, e_high) = (
            cell.low.tolist(),
            cell.high.tolist(),
        )
        gain, inductance = self.gain, self.inductance
        if e_low > 0.0:  # only a deviation large enough over a gain small enough makes so much
            gain = gain[0], min(gain[1], self.back_emf[1] / e_low)
        if e_high < 0.0:
            gain = gain[0], min(gain[1], self.back_emf[0] / e_high)
        for _ in range(2):
            inductance = _common(inductance, (gain[0] / b_high, gain[1] / b_low))
            inductance = _common(inductance, _quotients(self._resistances(gain), (c_low, c_high)))
            gain = _common(gain, (b_low * inductance[0], b_high * inductance[1]))
            if gain[0] > gain[1] or inductance[0] > inductance[1]:
                return None
        return gain, inductance

    def contracted(self, cell: Cell) -> Cell | None:
        """The cell cut to what drives of the box can reach, None where there is none."""
        shares = self._shares(cell)
        if shares is None:
            return None
        reached = self._reached(*shares)
        low, high = np.maximum(cell.low, reached.low), np.minimum(cell.high, reached.high)
        return Cell(low, high) if bool(np.all(low <= high)) else None

    def drive(self, cell: Cell) -> FloatArray | None:
        """Parameters of a drive near the middle of a cell, None where there is none."""
        shares = self._shares(cell)
        if shares is None:
            return None
        g, inductance = (0.5 * (low + high) for low, high in shares)
        g = min(max(g, self.gain[0]), self.gain[1])
        inductance = min(max(inductance, self.inductance[0]), self.inductance[1])
        reached = self._reached((g, g), (inductance, inductance))
        return np.clip(cell.middle, reached.low, reached.high)

    def named(self, point: FloatArray) -> dict[str, float]:
        """Deviations of a drive with parameters (b, c, j, e), relative, as near as there is one."""
        shares = self._shares(Cell(point * (1.0 - _SLACK), point * (1.0 + _SLACK)))
        gain = self.gain if shares is None else shares[0]
        g = min(max(0.5 * (gain[0] + gain[1]), self.gain[0]), self.gain[1])
        inductance = g / float(point[0])
        ohm = float(point[1]) * inductance - 0.5 * g * (self.dead_time[0] + self.dead_time[1])
        named = {"r_s": ohm, "l_q": inductance, "v_dc": g, "torque over inertia": float(point[2])}
        return {name: value - 1.0 for name, value in named.items()}

    def samples(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Parameters of random drives of the box, shape (count, 4).

        Every share of the box is as likely as it is large in R, L, g, dead time, f, J and psi_pm.
        """
        names = (
            self.resistance,
            self.inductance,
            self.gain,
            self.dead_time,
            self.torque,
            (1.0 / self.inertia[1], 1.0 / self.inertia[0]),
            self.back_emf,
        )
        r, inductance, g, dead, f, mass, emf = (generator.uniform(*of, count) for of in names)
        return np.stack([g / inductance, (r + g * dead) / inductance, f / mass, emf / g], axis=1)
