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

References:
    I. Boldea, M. C. Paicu, G.-D. Andreescu, "Active flux concept for motion-sensorless unified AC
    drives", IEEE Trans. Power Electronics 23 (5), 2008; M. Hinkkanen et al., the gains R (1/L_d +
    1/L_q)/4 + 0.2 |omega| of motulator; paper 001 (7.7), (7.8).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.flux_gains import FluxGains, FluxPath
from dqforge.optimizer.observers.methods.lpv_certificate import certify_flux_observer
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
    flux_in_words,
    loop_scale,
)
from dqforge.optimizer.observers.pll import corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import (
    EXACT,
    AlphaBeta,
    Arithmetic,
    Dq,
    Member,
    Pair,
    at_least,
)

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

    Raises:
        NoSolutionError: The correction reaches 1 within the speed range: the voltage model would no
            longer count.
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


def flux_of_current(
    o: Arithmetic, l_d: float, l_q: float, psi_pm: float, i: Pair, turn: Pair
) -> AlphaBeta:
    """Stator flux linkage in Wb of the current model."""
    current = o.let("current", o.park(i, turn))
    psi = o.let("psi", Dq((l_d * current.d) + psi_pm, l_q * current.q))
    return o.park_inverse(psi, turn)


def flux_of_voltage(
    o: Arithmetic, path: FluxPath, psi: Pair, v: Pair, last: Pair, i: Pair, x: Reals
) -> AlphaBeta:
    """Stator flux linkage in Wb after a period by the voltage model; x = omega t_s in rad."""

    def integral(axis: int) -> Reals:
        return (path.t_s * v[axis]) - (path.half_drop * (last[axis] + i[axis]))

    first = o.let("first", AlphaBeta(integral(0), integral(1)))
    change = o.let("change", AlphaBeta(i[0] - last[0], i[1] - last[1]))
    turning = o.let(
        "turning",
        AlphaBeta(first.alpha - (path.l_q * change.alpha), first.beta - (path.l_q * change.beta)),
    )
    return AlphaBeta(
        psi[0] + (first.alpha - path.end * (path.drop * change.alpha - x * turning.beta)),
        psi[1] + (first.beta - path.end * (path.drop * change.beta + x * turning.alpha)),
    )


def flux_error(o: Arithmetic, psi: Pair, l_q: float, i: Pair, turn: Pair, least: float) -> Reals:
    """Sine of the angle from the estimated d axis to the active flux psi - L_q i."""
    active = o.let("active", AlphaBeta(psi[0] - l_q * i[0], psi[1] - l_q * i[1]))
    size = o.let("size", o.root(active.alpha * active.alpha + active.beta * active.beta))
    return o.park(active, turn).q / at_least(o, size, least)


def step(
    gains: FluxGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are the stator flux linkage in Wb and the last current in A. The first
    step takes the flux linkage of the current model.
    """
    o, model = maths, (gains.l_d, gains.l_q, gains.psi_pm)
    if not state.started:
        psi = o.call(flux_of_current, *model, i, o.rotation(state.theta_e))
        return ObserverState((psi, i), state.theta_e, state.omega_e)
    before, last = state.vectors
    x = o.let("x", gains.pll.t_s * state.omega_e, "angle of the period, rad")
    theta = o.let("theta", predicted(state.theta_e, x, o), "foretold angle, rad")
    turn = o.let("turn", o.rotation(theta))
    drawn = o.let("drawn", o.call(flux_of_voltage, gains.path, before, v, last, i, x))
    known = o.let("known", o.call(flux_of_current, *model, i, turn))
    share = o.let("share", gains.alpha_1 * o.magnitude(x) + gains.alpha_0)
    alpha = o.let("alpha", o.choose(share < 1.0, share, o.full(1.0, share)), "of the current model")
    psi = o.let(
        "psi",
        AlphaBeta(
            drawn.alpha + alpha * (known.alpha - drawn.alpha),
            drawn.beta + alpha * (known.beta - drawn.beta),
        ),
    )
    error = o.let("error", o.call(flux_error, psi, gains.l_q, i, turn, gains.floor), "rad")
    return ObserverState((psi, i), *corrected(gains.pll, theta, state.omega_e, error, o))


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


def certified(
    gains: FluxGains, omega_low: float, omega_high: float, i_q: float
) -> tuple[float, FloatArray]:
    """Contraction that a common Lyapunov function proves, and its matrix, see `ObserverMethod`.

    Args:
        gains: Of `design`.
        omega_low, omega_high: Electrical speeds in rad/s.
        i_q: Largest |i_q| in A, at i_d = 0.
    """
    currents = (1j * i_q, -1j * i_q)
    found = certify_flux_observer(
        gains, omega_low, omega_high, currents, pieces=_PIECES, bisections=_BISECTIONS
    )
    return found.contraction, found.p


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
    members=StateMembers(
        (
            ("psi", Member("stator flux linkage", "Wb")),
            ("i", Member("last current", "A")),
        )
    ),
)
