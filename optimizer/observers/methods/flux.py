"""Flux observer: voltage model of the stator flux, corrected by the current model,
angle from the active flux.

    dpsi/dt = v - R i + g (psi_model - psi),
        psi_model = exp(j theta_hat) (psi_pm + L_d i_d + j L_q i_q)
    psi_a = psi - L_q i = exp(j theta) (psi_pm + (L_d - L_q) i_d)
        active flux, along the d axis
    g = bandwidth + speed_gain |omega|

Sampled: the voltage is held. The integral of the current is the trapezoid with its end correction,
in which the current moves as voltage, resistance and the turning active flux make it, L_q di/dt =
v - R i - j omega psi_a. Its error per period is of the order t_s^5 without saliency, t_s^3 (L_q -
L_d)/L_q with it:

    D = t_s v - R t_s (i[k-1] + i[k])/2,   I = i[k] - i[k-1],   x = omega t_s
    psi_p = psi[k-1] + D - R t_s/(12 L_q) (R t_s I + j x (D - L_q I))
    psi[k] = psi_p + alpha (psi_model(i[k], theta_p) - psi_p),
        alpha = 1 - exp(-bandwidth t_s) + speed_gain |x| (<= 1)

and a phase-locked loop (`dqforge.optimizer.observers.pll`) on psi_a. Without saliency and with a
fast loop the errors decay with -g/2 +- sqrt(g^2/4 - omega^2): the observer holds from some speed
upwards and keeps its flux, not its angle, at rest.

References
----------
I. Boldea, M. C. Paicu, G.-D. Andreescu, "Active flux concept for motion-sensorless unified AC
drives", IEEE Trans. Power Electronics 23 (5), 2008; M. Hinkkanen et al., the gains R (1/L_d +
1/L_q)/4 + 0.2 |omega| of motulator; paper 001 (7.7), (7.8).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.transforms import Reals, park, park_inverse
from dqforge.optimizer.observers.method import ObserverMethod, flux_in_words, loop_scale
from dqforge.optimizer.observers.methods.flux_gains import FluxGains, FluxPath
from dqforge.optimizer.observers.methods.lpv_certificate import certify_flux_observer
from dqforge.optimizer.observers.parts import EXACT, Arithmetic, ObserverState, Pair, at_least
from dqforge.optimizer.observers.pll import corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning

_PIECES, _BISECTIONS = 6, 3


def flux_path(machine: LinearMachine, t_s: float) -> FluxPath:
    """Voltage model of a machine, sampled every ``t_s`` seconds."""
    drop = machine.r_s * t_s
    return FluxPath(
        t_s=t_s, drop=drop, half_drop=0.5 * drop, end=drop / (12.0 * machine.l_q), l_q=machine.l_q
    )


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> FluxGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises
    ------
    NoSolutionError
        The correction reaches 1 within the speed range: the voltage model would no longer count.
    """
    alpha_0 = 1.0 - float(np.exp(-tuning.bandwidth * t_s))
    if alpha_0 + tuning.speed_gain * omega_max * t_s >= 1.0:
        raise NoSolutionError(
            f"control.observer: bandwidth {tuning.bandwidth:g} rad/s and speed_gain "
            f"{tuning.speed_gain:g} leave nothing of the voltage model at {omega_max:g} rad/s and "
            f"t_s = {t_s:g} s; write smaller ones"
        )
    return FluxGains(
        path=flux_path(machine, t_s),
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        alpha_0=alpha_0,
        alpha_1=tuning.speed_gain,
        floor=0.1 * machine.psi_pm,
        pll=pll_gains(tuning.pll_bandwidth, tuning.damping, t_s),
    )


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero), (zero, zero)), theta_e, omega_e, started=False)


def model_flux(
    l_d: float, l_q: float, psi_pm: float, i: Pair, turn: Pair, maths: Arithmetic
) -> Pair:
    """Stator flux linkage (alpha, beta) in Wb of the current model."""
    d, q = park(maths, i, turn)
    return park_inverse(maths, (l_d * d + psi_pm, l_q * q), turn)


def integrated(path: FluxPath, psi: Pair, v: Pair, last: Pair, i: Pair, x: Reals) -> Pair:
    """Flux linkage after a period by the voltage model; ``x`` is the angle of the period in rad."""
    first = tuple(path.t_s * v[n] - path.half_drop * (last[n] + i[n]) for n in (0, 1))
    change = (i[0] - last[0], i[1] - last[1])
    turning = (first[0] - path.l_q * change[0], first[1] - path.l_q * change[1])
    return (
        psi[0] + (first[0] - path.end * (path.drop * change[0] - x * turning[1])),
        psi[1] + (first[1] - path.end * (path.drop * change[1] + x * turning[0])),
    )


def angle_error(
    psi: Pair, l_q: float, i: Pair, turn: Pair, floor: float, maths: Arithmetic
) -> Reals:
    """Sine of the angle from the direction ``turn`` to the active flux psi - l_q i."""
    active = (psi[0] - l_q * i[0], psi[1] - l_q * i[1])
    across = park(maths, active, turn)[1]
    return across / at_least(np.sqrt(active[0] * active[0] + active[1] * active[1]), floor)


def step(
    gains: FluxGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are the stator flux linkage in Wb and the last current in A. The first
    step takes the flux linkage of the current model.
    """
    if not state.started:
        turn = maths.rotation(state.theta_e)
        psi = model_flux(gains.l_d, gains.l_q, gains.psi_pm, i, turn, maths)
        return ObserverState((psi, i), state.theta_e, state.omega_e)
    before, last = state.vectors
    x = gains.pll.t_s * state.omega_e
    theta_p = predicted(state.theta_e, x, maths)
    turn = maths.rotation(theta_p)
    psi = integrated(gains.path, before, v, last, i, x)
    model = model_flux(gains.l_d, gains.l_q, gains.psi_pm, i, turn, maths)
    alpha = gains.alpha_1 * np.where(x < 0.0, -x, x) + gains.alpha_0
    alpha = np.where(alpha < 1.0, alpha, maths.number(1.0))
    psi = (psi[0] + alpha * (model[0] - psi[0]), psi[1] + alpha * (model[1] - psi[1]))
    error = angle_error(psi, gains.l_q, i, turn, gains.floor, maths)
    theta, omega = corrected(gains.pll, theta_p, state.omega_e, error, maths)
    return ObserverState((psi, i), theta, omega)


def usual_flux(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """R/4 (1/L_d + 1/L_q) + 0.2 |omega|, as motulator has it, but at most 2 % of
    the largest speed at rest.

    In small machines R/L is as fast as the rotor turns; the current model would
    then rule the whole range.
    """
    bandwidth = min(0.25 * machine.r_s * (1.0 / machine.l_d + 1.0 / machine.l_q), 0.02 * omega_max)
    return ObserverTuning(
        bandwidth, pll_bandwidth(t_s), speed_gain=0.2, omega_floor=0.02 * omega_max
    )


def certified(gains: FluxGains, omega_low: float, omega_high: float, i_q: float) -> float:
    """Contraction that a common Lyapunov function proves, see `ObserverMethod`.

    Parameters
    ----------
    gains:
        Of `design`.
    omega_low, omega_high:
        Electrical speeds in rad/s.
    i_q:
        Largest |i_q| in A, at i_d = 0.
    """
    currents = (1j * i_q, -1j * i_q)
    return certify_flux_observer(
        gains, omega_low, omega_high, currents, pieces=_PIECES, bisections=_BISECTIONS
    ).contraction


METHOD = ObserverMethod(
    name="flux",
    code="flux",
    title="flux observer with phase-locked loop on the active flux",
    design=design,
    start=start,
    step=step,
    usual=usual_flux,
    searched=("pll_bandwidth", "bandwidth", "speed_gain"),
    gains=FluxGains,
    scale=loop_scale,
    in_words=flux_in_words,
    certify=certified,
)
