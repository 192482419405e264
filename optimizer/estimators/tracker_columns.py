"""A tracker as columns of the state of a drive, seen from its true rotor: its phase-locked loop
with the age of what it measures, without the currents that it injects.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.drive_motion import ComplexArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimators.tracker import TrackerLoop


@dataclass(frozen=True, slots=True)
class TrackerEstimator:
    """A `TrackerLoop`: the angles whose errors it measures, from the latest to the oldest, angle
    error and electrical speed are its columns.

    A voltage that is asked for at a sample acts in the period after the next instant; the rotor
    turns meanwhile, up to the middle of that period (``ahead`` samples). The other measurements
    belong to the instant at which they were made.
    """

    loop: TrackerLoop

    @property
    def _oldest(self) -> int:
        return max(age for age, _ in self.loop.seen)

    def start(
        self,
        i: ComplexArray,  # noqa: ARG002
        v: ComplexArray,  # noqa: ARG002
        omega: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Columns of the steady state, which has no error, and their sizes."""
        turn = omega * self.loop.t_s
        columns = np.zeros((len(omega), self._oldest + 2))
        columns[:, -2], columns[:, -1] = -turn, omega
        # a direction asked for one sample ago still has half a period or more to go
        for age in range(1, self._oldest + 1):
            columns[:, age - 1] = max(self.loop.ahead - age, 0.0) * turn
        size = np.ones_like(columns)
        size[:, -1] = np.maximum(np.abs(omega), 1.0)
        return columns, size

    def step(
        self,
        columns: FloatArray,
        v: ComplexArray,  # noqa: ARG002
        i: ComplexArray,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Correct by the mean of the errors that are seen now."""
        loop, ahead = self.loop, columns[:, -2] + self.loop.t_s * columns[:, -1]
        error = np.zeros(len(columns))
        for age, share in loop.seen:
            error = error - share * (ahead if age == 0 else columns[:, age - 1])
        omega = columns[:, -1] + loop.k_i * error
        delta = ahead + loop.k_p * error
        now = delta + loop.ahead * loop.t_s * omega if loop.ahead > 0.0 else ahead
        kept = [now, *columns[:, : self._oldest - 1].T][: self._oldest]
        return np.stack([*kept, delta, omega], axis=1), delta, omega

    def turned(self, columns: FloatArray, turn: FloatArray) -> FloatArray:
        """The columns seen from the rotor one period later."""
        found = columns.copy()
        found[:, -2] -= turn
        for age in range(1, self._oldest + 1):
            # a direction leaves the rotor behind until the middle of the period in which it acts
            part = min(max(self.loop.ahead - (age - 1), 0.0), 1.0)
            found[:, age - 1] -= part * turn
        return found
