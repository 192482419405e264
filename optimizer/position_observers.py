"""The position observers by name: one entry per method, so that another one is one more entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.drive_motion import DriveMotion
from dqforge.machines.errors import InputError
from dqforge.machines.synchronous import FloatArray, LinearMachine
from dqforge.optimizer import eemf_observer, flux_observer, open_loop_flux, sampled_observers, sampled_steps
from dqforge.optimizer.observer_parts import EXACT, Arithmetic, ObserverState, Pair, Reals, cast
from dqforge.optimizer.observer_settings import ObserverTuning


@dataclass(frozen=True, slots=True)
class ObserverMethod:
    """One method of observing the position.

    Parameters
    ----------
    name:
        As in the design file; ``code`` is the part of C names, ``title`` says it in words.
    design:
        (machine, tuning, t_s, largest electrical speed in rad/s) -> gains, a frozen dataclass of floats.
    start, step:
        First and next state, see `dqforge.optimizer.observer_parts`.
    usual:
        (machine, t_s, largest electrical speed in rad/s) -> the tuning where the design leaves it open.
    keys:
        The tuning entries that the method uses, of bandwidth, speed_gain.
    gains:
        The dataclass that ``design`` returns.
    settle:
        Steps from the start after which Newton's method finds the steady state that is reached, and no other.
    sizes:
        (scalars of M states, shape (M, n), electrical speeds in rad/s, shape (M,)) -> how large a change of each
        scalar is noticeable, shape (M, n), positive. In a steady state many are nil, so that their own size tells
        nothing. None without scalars.
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


def _pll_bandwidth(t_s: float) -> float:
    """600 rad/s, a loop that follows the speed of common drives, or 1/20 of the sampling rate in rad/s if less."""
    return min(600.0, 0.05 / t_s)


def _usual_eemf(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """EMF filter four times faster than the loop, so that it costs the loop little phase."""
    width = _pll_bandwidth(t_s)
    return ObserverTuning(4.0 * width, width, omega_floor=0.02 * omega_max)


def _usual_flux(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """R/4 (1/L_d + 1/L_q) + 0.2 |omega|, as motulator has it, but at most 2 % of the largest speed at rest.

    In small machines R/L is as fast as the rotor turns; the current model would then rule the whole range.
    """
    bandwidth = min(0.25 * machine.r_s * (1.0 / machine.l_d + 1.0 / machine.l_q), 0.02 * omega_max)
    return ObserverTuning(bandwidth, _pll_bandwidth(t_s), speed_gain=0.2, omega_floor=0.02 * omega_max)


def _usual_open_loop(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """A corner of 0.3 times the speed, and never below 1 % of the largest one."""
    return ObserverTuning(0.01 * omega_max, _pll_bandwidth(t_s), speed_gain=0.3, omega_floor=0.02 * omega_max)


METHODS: dict[str, ObserverMethod] = {
    method.name: method
    for method in (
        ObserverMethod(
            "extended-emf",
            "eemf",
            "extended EMF with phase-locked loop",
            eemf_observer.design,
            eemf_observer.start,
            eemf_observer.step,
            _usual_eemf,
            ("bandwidth",),
            eemf_observer.EemfGains,
        ),
        ObserverMethod(
            "flux",
            "flux",
            "flux observer with phase-locked loop on the active flux",
            flux_observer.design,
            flux_observer.start,
            flux_observer.step,
            _usual_flux,
            ("bandwidth", "speed_gain"),
            flux_observer.FluxGains,
        ),
        ObserverMethod(
            "open-loop-flux",
            "open_loop_flux",
            "open-loop flux estimator with phase-locked loop on the active flux",
            open_loop_flux.design,
            open_loop_flux.start,
            open_loop_flux.step,
            _usual_open_loop,
            ("bandwidth", "speed_gain"),
            open_loop_flux.OpenLoopGains,
        ),
        ObserverMethod(
            "matsui-voltage",
            "matsui_voltage",
            "Matsui's voltage model",
            sampled_observers.design_matsui_voltage,
            sampled_steps.matsui_voltage_start,
            sampled_steps.matsui_voltage_step,
            sampled_observers.usual_matsui,
            ("bandwidth",),
            sampled_steps.MatsuiVoltageGains,
            300,
            sampled_steps.matsui_voltage_sizes,
        ),
        ObserverMethod(
            "matsui-current",
            "matsui_current",
            "Matsui's current model",
            sampled_observers.design_matsui_current,
            sampled_steps.matsui_current_start,
            sampled_steps.matsui_current_step,
            sampled_observers.usual_matsui_current,
            ("bandwidth",),
            sampled_steps.MatsuiCurrentGains,
            300,
        ),
        ObserverMethod(
            "ekf",
            "ekf",
            "extended Kalman filter",
            sampled_observers.design_ekf,
            sampled_steps.ekf_start,
            sampled_steps.ekf_step,
            sampled_observers.usual_ekf,
            (),
            sampled_steps.EkfGains,
            300,
            sampled_steps.ekf_sizes,
        ),
    )
}


def method_named(name: str) -> ObserverMethod:
    """The method of that name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in METHODS:
        raise InputError(f"control.observer.method: {name} is no position observer; write one of {', '.join(METHODS)}")
    return METHODS[name]


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated electrical angle in rad (wrapped) and speed in rad/s at the samples, shape (steps, N)."""

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
    first = motion.theta_e[0] if theta_0 is None else np.broadcast_to(np.asarray(theta_0), shape[1:])
    speed = motion.omega_e[0] if omega_0 is None else np.broadcast_to(np.asarray(omega_0), shape[1:])
    seen = [part.astype(number) for part in (motion.v_alpha, motion.v_beta, motion.i_alpha, motion.i_beta)]
    own = cast(gains, maths)
    state = method.start(maths.wrap(first.astype(number)), np.array(speed, dtype=number))
    theta, omega = np.empty(shape, dtype=number), np.empty(shape, dtype=number)
    for k in range(shape[0]):
        state = method.step(own, state, (seen[0][k], seen[1][k]), (seen[2][k], seen[3][k]), maths)
        theta[k], omega[k] = state.theta_e, state.omega_e
    return Estimates(theta, omega)
