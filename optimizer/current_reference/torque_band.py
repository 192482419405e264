"""By how much the torque of a drive may differ from the requested one, as its machine differs from
its data.

The currents of the reference are fixed in the firmware; on a machine whose magnet flux linkage and
inductances are off by shares e the torque is

    T' = T + 3/2 p (e_psi psi_pm i_q + e_d (psi_d - psi_pm) i_q - e_q psi_q i_d)

with the flux linkages of the data at these currents: exact for constant inductances, and for a flux
map whose parts are scaled as a simulation scales them (`dqforge.machines.plants.scenario`). It is
linear in each share, so that the extremes lie at the corners of the tolerances.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ToleranceName, Tolerances
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.current_choice import OperatingPoints

# Least torque that is looked at, of the largest.
LEAST_TORQUE = 0.05


@dataclass(frozen=True, slots=True)
class TorquePart:
    """What one tolerance makes of the torque: largest shares below (negative or zero) and above."""

    name: ToleranceName
    low: float
    high: float

    @property
    def size(self) -> float:
        """The larger of both."""
        return max(-self.low, self.high)


@dataclass(frozen=True, slots=True)
class TorqueBand:
    """Shares of the requested torque, from `LEAST_TORQUE` of the largest one up.

    Args:
        low, high: Least and largest at all corners of the tolerances together.
        independent: Root of the sum of the squared parts: where the tolerances are 95 % intervals
            of independent values, the torque is within it at 95 %.
        parts: By tolerance, the largest first; those that change nothing are left out.
    """

    low: float
    high: float
    independent: float
    parts: tuple[TorquePart, ...]


def torque_band(
    machine: Machine, points: OperatingPoints, tolerances: Tolerances | None
) -> TorqueBand | None:
    """The band of a current reference, None where no tolerance changes the torque.

    Args:
        machine: As its data are.
        points: Currents of the reference over the torque.
        tolerances: Of the drive.
    """
    if tolerances is None:
        return None
    requested = np.asarray(machine.torque(points.i_d, points.i_q))
    seen = requested >= LEAST_TORQUE * np.max(requested)
    i_d, i_q = points.i_d[seen], points.i_q[seen]
    parts, lows, highs = [], np.zeros(i_d.size), np.zeros(i_d.size)
    for name, torque in torque_parts(machine, i_d, i_q).items():
        ends = np.multiply.outer(tolerances.limits(name), torque / requested[seen])
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        lows, highs = lows + low, highs + high
        found = TorquePart(name, float(np.min(low)), float(np.max(high)))
        if found.size > 0.0:
            parts.append(found)
    if not parts:
        return None
    parts.sort(key=lambda part: -part.size)
    return TorqueBand(
        low=float(np.min(lows)),
        high=float(np.max(highs)),
        independent=float(np.sqrt(np.sum([part.size**2 for part in parts]))),
        parts=tuple(parts),
    )


def torque_parts(
    machine: Machine, i_d: FloatArray, i_q: FloatArray
) -> dict[ToleranceName, FloatArray]:
    """Parts of the torque in N m by what scales them, shape of the currents.

    Args:
        machine: As its data are.
        i_d, i_q: Currents in A, shape (N,).
    """
    psi_d, psi_q = machine.flux(i_d, i_q)
    factor = 1.5 * machine.pole_pairs
    return {
        "psi_pm": factor * machine.psi_pm * i_q,
        "l_d": factor * (psi_d - machine.psi_pm) * i_q,
        "l_q": -factor * psi_q * i_d,
    }
