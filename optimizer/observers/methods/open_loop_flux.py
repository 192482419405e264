"""Open-loop flux estimator: voltage integrated by a low-pass filter whose
error is known and taken back.

Paper 001 integrates v - R i, (7.7) and (7.8), and notes that the integrator drifts and is
replaced by a filter. Here

    psi_f[k] = (psi_f[k-1] + dpsi) / (1 + kappa),   kappa = max(bandwidth t_s, speed_gain |x|),
        x = omega t_s

with dpsi the integral of v - R i over the period (`dqforge.optimizer.observers.methods.flux`). It
is a low-pass of corner kappa/t_s: an offset u of v - R i leaves u t_s/kappa, not a drift. A flux
linkage that turns with omega comes out as psi_f = psi / c, exactly, with

    c = 1 + kappa (1/2 - j/2 cot(x/2)),
        1/2 cot(x/2) = 1/x - x/12 - x^3/720 (relative error below x^6/15120)

so that psi = c psi_f. While kappa = speed_gain |x| the angle of c hardly depends on the speed. The
angle is that of the active flux psi - L_q i, followed by a phase-locked loop; L_d and psi_pm do not
enter it.

References
----------
Paper 001, 7.2.2; J. Hu, B. Wu, "New integration algorithms for estimating motor flux over a wide
speed range", IEEE Trans. Power Electronics 13 (5), 1998; M.-H. Shin et al., "An improved stator
flux estimation for speed sensorless stator flux orientation control", IEEE Trans. Power Electronics
15 (2), 2000 (corner that follows the speed).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.method import ObserverMethod, flux_in_words, loop_scale
from dqforge.optimizer.observers.methods.flux import (
    angle_error,
    flux_path,
    integrated,
    model_flux,
    start,
)
from dqforge.optimizer.observers.methods.flux_gains import FluxPath
from dqforge.optimizer.observers.parts import EXACT, Arithmetic, ObserverState, Pair, at_least
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning


@dataclass(frozen=True, slots=True)
class OpenLoopGains:
    """Voltage model; H and Wb; ``kappa_0``, ``kappa_1`` the corner; ``x_min`` the least |x|;
    ``floor`` in Wb; loop.
    """

    path: FluxPath
    l_d: float
    l_q: float
    psi_pm: float
    kappa_0: float
    kappa_1: float
    x_min: float
    floor: float
    pll: PllGains


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> OpenLoopGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises
    ------
    NoSolutionError
        The filter leaves too little of the flux linkage.
    """
    if (
        max(tuning.bandwidth / max(tuning.omega_floor, 1e-300), tuning.speed_gain) > 20.0
        or not omega_max > 0.0
    ):
        raise NoSolutionError(
            "control.observer: bandwidth is more than 20 times the lowest speed, or speed_gain "
            "above 20: the filter would leave too little of the flux linkage; write smaller ones"
        )
    return OpenLoopGains(
        path=flux_path(machine, t_s),
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        kappa_0=tuning.bandwidth * t_s,
        kappa_1=tuning.speed_gain,
        x_min=tuning.omega_floor * t_s,
        floor=0.1 * machine.psi_pm,
        pll=pll_gains(tuning.pll_bandwidth, tuning.damping, t_s),
    )


def _corner(gains: OpenLoopGains, x: Reals) -> Reals:
    """Relative corner kappa of the filter."""
    return at_least(gains.kappa_1 * np.where(x < 0.0, -x, x), gains.kappa_0)


def _compensation(gains: OpenLoopGains, kappa: Reals, x: Reals, maths: Arithmetic) -> Pair:
    """Real and imaginary part of c."""
    size = at_least(np.where(x < 0.0, -x, x), gains.x_min)
    square = size * size
    half_cot = maths.number(1.0) / size - size * (
        maths.number(0.0013888889) * square + maths.number(0.083333336)
    )
    imaginary = kappa * half_cot
    return maths.number(0.5) * kappa + maths.number(1.0), np.where(x < 0.0, imaginary, -imaginary)


def step(
    gains: OpenLoopGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are the filtered flux linkage in Wb and the last current in A. The
    first step takes the flux linkage of the current model, as the filter would have it.
    """
    x = gains.pll.t_s * state.omega_e
    kappa = _corner(gains, x)
    c = _compensation(gains, kappa, x, maths)
    if not state.started:
        psi = model_flux(
            gains.l_d, gains.l_q, gains.psi_pm, i, maths.rotation(state.theta_e), maths
        )
        share = maths.number(1.0) / (c[0] * c[0] + c[1] * c[1])
        filtered = (
            share * (c[0] * psi[0] + c[1] * psi[1]),
            share * (c[0] * psi[1] - c[1] * psi[0]),
        )
        return ObserverState((filtered, i), state.theta_e, state.omega_e)
    before, last = state.vectors
    theta_p = predicted(state.theta_e, x, maths)
    turn = maths.rotation(theta_p)
    psi = integrated(gains.path, before, v, last, i, x)
    keep = maths.number(1.0) / (maths.number(1.0) + kappa)
    filtered = (keep * psi[0], keep * psi[1])
    psi = (c[0] * filtered[0] - c[1] * filtered[1], c[0] * filtered[1] + c[1] * filtered[0])
    error = angle_error(psi, gains.l_q, i, turn, gains.floor, maths)
    theta, omega = corrected(gains.pll, theta_p, state.omega_e, error, maths)
    return ObserverState((filtered, i), theta, omega)


def usual_open_loop(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """A corner of 0.3 times the speed, and never below 1 % of the largest one."""
    return ObserverTuning(
        0.01 * omega_max, pll_bandwidth(t_s), speed_gain=0.3, omega_floor=0.02 * omega_max
    )


METHOD = ObserverMethod(
    name="open-loop-flux",
    code="open_loop_flux",
    title="open-loop flux estimator with phase-locked loop on the active flux",
    design=design,
    start=start,
    step=step,
    usual=usual_open_loop,
    searched=("pll_bandwidth", "bandwidth", "speed_gain"),
    gains=OpenLoopGains,
    scale=loop_scale,
    in_words=flux_in_words,
)
