"""What the batched solver works on: one chunk of points, its solution as it grows,
and the names of the limits.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.mtpa_locus import MtpaLocus

IndexArray = NDArray[np.intp]


BoolArray = NDArray[np.bool_]


class Active(IntEnum):
    """What holds a point where it is; ``DATA`` that the flux map ends there."""

    NONE = 0
    VOLTAGE = 1
    CURRENT = 2
    BOTH = 3
    MTPV = 4
    UNREACHABLE = 5
    DATA = 6

    @property
    def label(self) -> str:
        """Name for tables: none, voltage, current, both, MTPV, unreachable, data."""
        return "MTPV" if self is Active.MTPV else self.name.lower()


@dataclass(frozen=True, slots=True)
class Problem:
    """One chunk with torque counted positive (the q axis mirrored where it was negative),
    arrays of shape (N,).

    ``region`` is where the data of the machine are, None where they limit nothing.
    """

    machine: Machine
    locus: MtpaLocus
    torque: FloatArray
    omega_e: FloatArray
    v_max: FloatArray
    i_max: float
    loss: LossCoefficients
    region: CurrentRegion | None = None

    @property
    def soft(self) -> float:
        """Current in A over which the tip of |i| is rounded."""
        return 1e-6 * self.i_max

    def take(self, index: IndexArray) -> Problem:
        """Some of the points."""
        return Problem(
            self.machine,
            self.locus,
            self.torque[index],
            self.omega_e[index],
            self.v_max[index],
            self.i_max,
            self.loss.take(index),
            self.region,
        )


@dataclass(slots=True)
class State:
    """Solution of a chunk as it grows, arrays of shape (N,)."""

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    least: BoolArray
