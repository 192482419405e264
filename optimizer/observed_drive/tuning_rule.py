"""Speed loop and position observer chosen together, where a design leaves both open.

The speed that a phase-locked loop hands over is its integral: it follows the true speed as
w^2/(s^2 + 2 zeta w s + w^2), late by 2 zeta/w. The symmetrical optimum of the speed loop counts
that among its small delays, T = 1/omega_cc + ratio t_s/2 + filter time + 2 zeta/w. Methods without
such a loop are as late as their own phase is at the crossover 1/(a T) that the rule then has.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.plants.drive_motion import plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.pll import PllGains
from dqforge.optimizer.observers.steady_states import SteadyObserver, steady_observer

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.optimizer.sampled_systems import ComplexArray

_SHARE = 0.5  # of the largest speed, at which a lag is found


_PER_SECOND = 0.1  # acceleration over the largest speed in 1/s, small enough to change nothing else


_ROUNDS = 60


def has_loop(position: PositionObserver) -> bool:
    """Whether the speed of an observer is that of a phase-locked loop."""
    return isinstance(getattr(position.gains, "pll", None), PllGains)


def speed_lag(position: PositionObserver, delays: float, spread: float) -> float:
    """By how much a position observer tells a changing speed too late, in s.

    Args:
        position: The observer.
        delays: The other small delays of the speed loop in s.
        spread: That of the symmetrical optimum.
    """
    if has_loop(position):
        return 2.0 * position.tuning.damping / position.tuning.pll_bandwidth
    errors, lag = speed_errors(position), 0.0
    for _ in range(_ROUNDS):
        crossover = 1.0 / (spread * (delays + lag))
        phase = -float(np.angle(errors.following(np.array([crossover]))[0]))
        lag = 0.5 * (lag + max(phase, 0.0) / crossover)
    return lag


@dataclass(frozen=True, slots=True, eq=False)
class SpeedErrors:
    """Errors e of an observer at a changing speed, e[k] = J e[k-1] + g (omega[k] - omega[k-1]).

    ``jacobian`` J (n, n), ``by_change`` g (n,); the last of the errors is that of the speed.
    """

    t_s: float
    jacobian: FloatArray
    by_change: FloatArray

    def following(self, frequency: FloatArray) -> ComplexArray:
        """Estimated over true speed at frequencies in rad/s, shape (N,)."""
        one, back = np.eye(len(self.jacobian)), np.exp(-1j * frequency * self.t_s)
        matrices = one - back[:, None, None] * self.jacobian
        sides = np.broadcast_to(self.by_change[:, None], (len(back), len(one), 1))
        errors = np.linalg.solve(matrices, sides)[:, -1, 0]
        return np.asarray(1.0 + (1.0 - back) * errors, dtype=np.complex128)


@lru_cache(maxsize=8)
def speed_errors(position: PositionObserver) -> SpeedErrors:
    """Those of a position observer without current; a constant acceleration, in which they rest,
    tells g.
    """
    rest, up, down = (_steady(position, sign) for sign in (0.0, 1.0, -1.0))
    jacobian = rest.jacobian[0]
    per_sample = 2.0 * _PER_SECOND * position.omega_max * position.t_s
    change = (up.states[0] - down.states[0]) / per_sample
    return SpeedErrors(position.t_s, jacobian, (np.eye(len(jacobian)) - jacobian) @ change)


def _steady(position: PositionObserver, sign: float) -> SteadyObserver:
    return steady_observer(
        position.method, position.gains, position.t_s, plants(position.machine),
        np.zeros(1, dtype=np.complex128), np.array([_SHARE * position.omega_max]),
        sign * _PER_SECOND * position.omega_max,
    )  # fmt: skip
