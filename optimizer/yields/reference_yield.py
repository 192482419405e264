"""A fixed current reference on other machines than it was made for: how far the torque is off,
and how much copper loss a reference of the machine's own would save.

The currents of the header flow in every machine. At a torque T* that is asked for,

    T = 3/2 p (psi_d(i_d, i_q) i_q - psi_q(i_d, i_q) i_d)

is made, with the flux linkage of the machine, be it constant inductances or a scaled flux map. The
error is |T - T*| over the full scale, the penalty |i|^2 / least |i|^2 - 1, where the least is that
of the same machine for the torque T that it makes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.scaled_machines import ScaledMachines
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.machine_batch.batch_currents import strategy_currents
from dqforge.optimizer.machine_batch.scaled_loci import currents_on_loci, scaled_loci
from dqforge.optimizer.yields.fixed_header import FixedHeader

TORQUES = 20  # Torques at which a header is judged, evenly spaced up to its full scale.
LEAST_SHARE = 0.05  # Share of the full scale at which they begin: below it both losses vanish.

# Many machines: with constant inductances, or over one flux map.
Machines = MachineBatch | ScaledMachines

# Largest current of a header by which loci go on: so far that rounding leaves no torque out.
_BEYOND = 1.001


@dataclass(frozen=True, slots=True)
class ReferencePoints:
    """What a header asks for at P torques, arrays of shape (P,): torque in N m, currents in A."""

    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def reference_points(header: FixedHeader, torque: FloatArray | None = None) -> ReferencePoints:
    """Currents of the header as its C returns them, without contraction.

    Args:
        header: The header.
        torque: Torques in N m, shape (P,); when None those at which a header is judged. Each is
            rounded to a number that the header's format has.
    """
    asked = np.linspace(LEAST_SHARE, 1.0, TORQUES) * header.torque_max if torque is None else torque
    reference = header.reference
    if isinstance(reference, FixedReference):
        has = reference.scale.arguments(np.minimum(reference.nearest(asked), reference.end))
    else:
        has = np.asarray(asked, dtype=np.float32).astype(np.float64)
    i_d, i_q = reference.currents(has)
    return ReferencePoints(has, i_d.astype(np.float64), i_q.astype(np.float64))


def produced_torque(points: ReferencePoints, machines: Machines) -> FloatArray:
    """Torque in N m that the header's currents make, shape (P, N).

    Args:
        points: Currents of the header at P torques.
        machines: N machines.
    """
    return machines.torque(points.i_d[:, np.newaxis], points.i_q[:, np.newaxis])


def torque_errors(header: FixedHeader, points: ReferencePoints, produced: FloatArray) -> FloatArray:
    """Largest torque error of each machine over the full scale, shape (N,).

    Args:
        header: The header.
        points: Currents of the header at P torques.
        produced: Torque in N m that they make, shape (P, N).
    """
    off = np.abs(produced - points.torque[:, np.newaxis])
    return np.asarray(np.max(off, axis=0) / header.torque_max)


def loss_penalties(points: ReferencePoints, machines: Machines, produced: FloatArray) -> FloatArray:
    """Largest excess of the copper loss over the least one, relative to it, of each machine,
    shape (N,); infinite where a torque is not made at all, NaN where a machine's optimum leaves the
    data of its flux map.

    Args:
        points: Currents of the header at P torques.
        machines: N machines.
        produced: Torque in N m that the currents make, shape (P, N).
    """
    square = (points.i_d**2 + points.i_q**2)[:, np.newaxis]
    own_d, own_q = _own_currents(points, machines, np.maximum(produced, 0.0))
    least = own_d * own_d + own_q * own_q
    made = least > 0.0  # neither without torque nor on a machine that makes none
    penalty = np.where(made, square / np.where(made, least, 1.0) - 1.0, np.inf)
    if isinstance(machines, ScaledMachines):
        penalty = np.where(np.isnan(least) & (produced > 0.0), np.nan, penalty)
    return np.asarray(np.max(penalty, axis=0))


def _own_currents(
    points: ReferencePoints, machines: Machines, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Currents in A of each machine's own optimum for torques >= 0 in N m, shape (P, N).

    The optimum for a torque that the header's current makes needs no more than that current.
    """
    if isinstance(machines, MachineBatch):
        return strategy_currents(machines, "mtpa", torque)
    largest = _BEYOND * float(np.max(np.hypot(points.i_d, points.i_q)))
    within = replace(machines, i_max=np.full(machines.count, largest))
    return currents_on_loci(within, scaled_loci(within), torque)
