"""What an estimator errs by per unit of each cause: derivatives of the steady errors by R, L_d,
L_q, psi and the voltage that a dead time takes.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.drive_motion import Plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.judgement import DEAD_TIME, PARAMETERS
from dqforge.optimizer.observers.steady_states import steady_observer
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.observers.tuning_numbers import Load

CAUSES = (*PARAMETERS, DEAD_TIME)
SLOPE_SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)  # Speeds over the largest one at which they are given.
_STEP = 1e-3  # of a parameter; of the voltage R i for the dead time


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives at one load.

    Args:
        omega: Electrical speeds in rad/s, shape (S,).
        angle: By cause the angle error in rad per relative change of the machine's parameter, and
            per V of lost voltage for the dead time, shape (S,); nan where the angle is lost.
        speed: The same of the speed error in rad/s.
    """

    omega: FloatArray
    angle: dict[str, FloatArray]
    speed: dict[str, FloatArray]


def slopes_of(observer: PositionObserver, load: Load, omega: FloatArray) -> Slopes:
    """Derivatives of the steady errors by central differences.

    Args:
        observer: The observer.
        load: Currents, and the machine there.
        omega: Electrical speeds in rad/s, shape (S,).
    """
    count, cases = len(omega), len(CAUSES)
    exact = np.array([observer.machine.r_s, load.l_d, load.l_q, load.psi_pm])
    current = complex(load.i_d, load.i_q)
    volt = observer.machine.r_s * abs(current)
    rows = np.repeat(exact[None, :], 2 * cases, axis=0)
    lost = np.zeros(2 * cases)
    for k, cause in enumerate(CAUSES):
        for row, sign in ((2 * k, 1.0), (2 * k + 1, -1.0)):
            if cause == DEAD_TIME:
                lost[row] = sign * _STEP * volt
            else:
                rows[row, k] *= 1.0 + sign * _STEP
    found = steady_observer(
        observer.method,
        observer.gains,
        observer.t_s,
        Plants(*np.repeat(rows, count, axis=0).T),
        np.full(2 * cases * count, current),
        np.tile(omega, 2 * cases),
        0.0,
        np.repeat(lost, count),
    )
    holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)

    def slopes(error: FloatArray) -> dict[str, FloatArray]:
        values = np.where(holds, error, np.nan).reshape(cases, 2, count)
        size = {DEAD_TIME: 2.0 * _STEP * volt}
        return {
            cause: (values[k, 0] - values[k, 1]) / size.get(cause, 2.0 * _STEP)
            for k, cause in enumerate(CAUSES)
        }

    return Slopes(omega, slopes(found.theta_error), slopes(found.omega_error))
