"""What a position observer is: its record, its estimates, and a run over samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.drive_motion import DriveMotion
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import (
    EXACT,
    Arithmetic,
    ObserverState,
    Pair,
    StateMembers,
    cast,
)
from dqforge.optimizer.observers.training import Training, TrainingBox
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning


def loop_in_words(tuning: ObserverTuning, _gains: Any, _t_s: float) -> str:
    """``in_words`` of a filter before a phase-locked loop.

    Args:
        tuning: Its numbers.
    """
    return (
        f"bandwidth {tuning.bandwidth:.5g} rad/s; loop {tuning.pll_bandwidth:.5g} rad/s, "
        f"damping {tuning.damping:.3g}"
    )


def flux_in_words(tuning: ObserverTuning, _gains: Any, _t_s: float) -> str:
    """``in_words`` of a flux linkage that is corrected before a phase-locked loop.

    Args:
        tuning: Its numbers.
    """
    return (
        f"bandwidth {tuning.bandwidth:.5g} rad/s, speed_gain {tuning.speed_gain:.4g}; loop "
        f"{tuning.pll_bandwidth:.5g} rad/s, damping {tuning.damping:.3g}"
    )


def loop_scale(gains: Any) -> tuple[float, float]:
    """``scale`` of gains that hold those of a phase-locked loop and the magnet flux linkage.

    Args:
        gains: With members ``pll`` and ``psi_pm``.
    """
    return float(gains.pll.t_s), float(gains.psi_pm)


@dataclass(frozen=True, slots=True)
class ObserverMethod:
    """One method of observing the position.

    Args:
        name: As in the design file; ``code`` is the part of C names, ``title`` says it in words.
        design: (machine, tuning, t_s, largest electrical speed in rad/s) -> gains, a frozen
            dataclass of floats.
        start, step: First and next state, see `dqforge.optimizer.observers.parts`.
        usual: (machine, t_s, largest electrical speed in rad/s) -> the tuning where the design
            leaves it open.
        searched: The tuning entries that ``tuning: optimised`` searches; none of a method that
            tunes itself.
        gains: The dataclass that ``design`` returns.
        scale: gains -> (sampling period in s, magnet flux linkage in Wb): the scale of what it
            sees.
        in_words: (tuning, gains, sampling period in s) -> by what numbers it is tuned.
        settle: Steps from the start after which Newton's method finds the steady state that is
            reached, and no other.
        sizes: (scalars of M states, shape (M, n), electrical speeds in rad/s, shape (M,)) -> how
            large a change of each scalar is noticeable, shape (M, n), positive. In a steady state
            many are nil, so that their own size tells nothing. None without scalars.
        certify: (gains, least and largest electrical speed in rad/s, largest |i_q| in A) -> factor
            by which a norm of a small error shrinks at least in every sample, however the speed
            changes in between; `NoSolutionError` where none is found. None for a method without
            such a proof.
        train: (gains of ``design``, machine, settings, box, largest electrical speed in rad/s) ->
            gains with what was learned in them, and what that gains. None for a method that learns
            nothing.
        members: What the firmware calls vectors and scalars of the state: the C of the method is
            written from ``step``. None of a method that has a template ``observers/<code>.j2``.
    """

    name: str
    code: str
    title: str
    design: Callable[[LinearMachine, ObserverTuning, float, float], Any]
    start: Callable[[Reals, Reals], ObserverState]
    step: Callable[[Any, ObserverState, Pair, Pair, Arithmetic], ObserverState]
    usual: Callable[[LinearMachine, float, float], ObserverTuning]
    searched: tuple[str, ...]
    gains: type[Any]
    scale: Callable[[Any], tuple[float, float]]
    in_words: Callable[[ObserverTuning, Any, float], str] = loop_in_words
    settle: int = 0
    sizes: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    certify: Callable[[Any, float, float, float], float] | None = None
    train: (
        Callable[[Any, LinearMachine, ObserverSettings, TrainingBox, float], tuple[Any, Training]]
        | None
    ) = None
    members: StateMembers | None = None


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

    Args:
        theta_0, omega_0: First estimates, scalars or shape (N,); None for the true values.
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
