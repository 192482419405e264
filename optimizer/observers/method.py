"""What a position observer is: its record, its estimates, and a run over samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.drive_motion import DriveMotion
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import EXACT, Arithmetic, ObserverState, Pair, cast
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning


@dataclass(frozen=True, slots=True)
class ObserverMethod:
    """One method of observing the position.

    Parameters
    ----------
    name:
        As in the design file; ``code`` is the part of C names, ``title`` says it in words.
    design:
        (machine, tuning, t_s, largest electrical speed in rad/s) -> gains,
        a frozen dataclass of floats.
    start, step:
        First and next state, see `dqforge.optimizer.observers.parts`.
    usual:
        (machine, t_s, largest electrical speed in rad/s) -> the tuning where
        the design leaves it open.
    keys:
        The tuning entries that the method uses, of bandwidth, speed_gain.
    gains:
        The dataclass that ``design`` returns.
    settle:
        Steps from the start after which Newton's method finds the steady state that is reached,
        and no other.
    sizes:
        (scalars of M states, shape (M, n), electrical speeds in rad/s, shape (M,)) -> how large a
        change of each scalar is noticeable, shape (M, n), positive. In a steady state many are nil,
        so that their own size tells nothing. None without scalars.
    """

    name: str
    code: str
    title: str
    design: Callable[[LinearMachine, ObserverTuning, float, float], Any]
    start: Callable[[Reals, Reals], ObserverState]
    step: Callable[[Any, ObserverState, Pair, Pair, Arithmetic], ObserverState]
    usual: Callable[[LinearMachine, float, float], ObserverTuning]
    keys: tuple[str, ...]
    gains: type[Any]
    settle: int = 0
    sizes: Callable[[FloatArray, FloatArray], FloatArray] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated electrical angle in rad (wrapped) and speed in rad/s at the samples, shape (steps,
    N).
    """

    theta_e: FloatArray
    omega_e: FloatArray

    def angle_error(self, motion: DriveMotion) -> FloatArray:
        """Estimated minus true angle in rad, wrapped to -pi to pi, shape (steps, N)."""
        gap = np.asarray(self.theta_e, dtype=np.float64) - motion.theta_e
        return np.asarray((gap + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def observe(
    method: ObserverMethod,
    gains: Any,
    motion: DriveMotion,
    theta_0: Any = None,
    omega_0: Any = None,
    maths: Arithmetic = EXACT,
) -> Estimates:
    """Run an observer over what N drives measured.

    Parameters
    ----------
    theta_0, omega_0:
        First estimates, scalars or shape (N,); None for the true values.
    """
    number, shape = maths.number, motion.theta_e.shape
    first = (
        motion.theta_e[0] if theta_0 is None else np.broadcast_to(np.asarray(theta_0), shape[1:])
    )
    speed = (
        motion.omega_e[0] if omega_0 is None else np.broadcast_to(np.asarray(omega_0), shape[1:])
    )
    seen = [
        part.astype(number)
        for part in (motion.v_alpha, motion.v_beta, motion.i_alpha, motion.i_beta)
    ]
    own = cast(gains, maths)
    state = method.start(maths.wrap(first.astype(number)), np.array(speed, dtype=number))
    theta, omega = np.empty(shape, dtype=number), np.empty(shape, dtype=number)
    for k in range(shape[0]):
        state = method.step(own, state, (seen[0][k], seen[1][k]), (seen[2][k], seen[3][k]), maths)
        theta[k], omega[k] = state.theta_e, state.omega_e
    return Estimates(theta, omega)
