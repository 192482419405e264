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

References:
    Paper 001, 7.2.2; J. Hu, B. Wu, "New integration algorithms for estimating motor flux over a
    wide speed range", IEEE Trans. Power Electronics 13 (5), 1998; M.-H. Shin et al., "An improved
    stator flux estimation for speed sensorless stator flux orientation control", IEEE Trans. Power
    Electronics 15 (2), 2000 (corner that follows the speed).
"""

from __future__ import annotations

from typing import Annotated

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.flux import (
    flux_error,
    flux_of_current,
    flux_of_voltage,
    flux_path,
    start,
)
from dqforge.optimizer.observers.methods.flux_gains import FluxPath
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
    flux_in_words,
    loop_scale,
)
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import (
    EXACT,
    AlphaBeta,
    Arithmetic,
    Member,
    Pair,
    at_least,
)


@dataclass(frozen=True, slots=True)
class OpenLoopFluxGains:
    """Voltage model, current model at the start, corner of the filter, and loop."""

    path: FluxPath
    l_d: Annotated[float, Member("inductance of the d axis", "H")]
    l_q: Annotated[float, Member("inductance of the q axis", "H")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    kappa_0: Annotated[float, Member("least corner of the filter times t_s")]
    kappa_1: Annotated[float, Member("corner over the speed")]
    x_min: Annotated[float, Member("least |omega| t_s of the compensation", "rad")]
    floor: Annotated[float, Member("least active flux that counts in full", "Wb")]
    pll: PllGains


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> OpenLoopFluxGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises:
        NoSolutionError: The filter leaves too little of the flux linkage.
    """
    too_slow = tuning.bandwidth > 20.0 * tuning.omega_floor or tuning.speed_gain > 20.0
    if too_slow or not omega_max > 0.0:
        raise NoSolutionError(
            "control.observer: bandwidth is more than 20 times the lowest speed, or speed_gain "
            "above 20: the filter would leave too little of the flux linkage; write smaller ones"
        )
    return OpenLoopFluxGains(
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


def _compensation(
    gains: OpenLoopFluxGains, kappa: Reals, x: Reals, turned: Reals, o: Arithmetic
) -> Pair:
    """Real and imaginary part of c."""
    size = o.let("size", at_least(o, turned, gains.x_min))
    half_cot = 1.0 / size - size * (0.0013888889 * (size * size) + 0.083333336)
    imaginary = o.let("imaginary", kappa * half_cot)
    c_r = o.let("c_r", 0.5 * kappa + 1.0, "psi = (c_r + j c_m) times the filtered one")
    return c_r, o.let("c_m", o.choose(x < 0.0, imaginary, -imaginary))


def step(
    gains: OpenLoopFluxGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are the filtered flux linkage in Wb and the last current in A. The
    first step takes the flux linkage of the current model, as the filter would have it.
    """
    o = maths
    x = o.let("x", gains.pll.t_s * state.omega_e, "angle of the period, rad")
    turned = o.let("turned", o.magnitude(x))
    corner = o.let("corner", gains.kappa_1 * turned)
    kappa = o.let("kappa", at_least(o, corner, gains.kappa_0), "corner of the filter times t_s")
    c_r, c_m = _compensation(gains, kappa, x, turned, o)
    if not state.started:
        turn = o.rotation(state.theta_e)
        psi = o.let("psi", o.call(flux_of_current, gains.l_d, gains.l_q, gains.psi_pm, i, turn))
        share = o.let("share", 1.0 / (c_r * c_r + c_m * c_m))
        filtered = AlphaBeta(
            share * (c_r * psi.alpha + c_m * psi.beta), share * (c_r * psi.beta - c_m * psi.alpha)
        )
        return ObserverState((filtered, i), state.theta_e, state.omega_e)
    before, last = state.vectors
    theta = o.let("theta", predicted(state.theta_e, x, o), "foretold angle, rad")
    total = o.let("total", o.call(flux_of_voltage, gains.path, before, v, last, i, x))
    keep = o.let("keep", 1.0 / (1.0 + kappa))
    filtered = o.let("filtered", AlphaBeta(keep * total.alpha, keep * total.beta))
    psi = o.let(
        "psi",
        AlphaBeta(
            c_r * filtered.alpha - c_m * filtered.beta, c_r * filtered.beta + c_m * filtered.alpha
        ),
    )
    turn = o.rotation(theta)
    error = o.let("error", o.call(flux_error, psi, gains.l_q, i, turn, gains.floor), "rad")
    return ObserverState((filtered, i), *corrected(gains.pll, theta, state.omega_e, error, o))


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
    gains=OpenLoopFluxGains,
    scale=loop_scale,
    in_words=flux_in_words,
    members=StateMembers(
        (
            ("psi", Member("filtered stator flux linkage", "Wb")),
            ("i", Member("last current", "A")),
        )
    ),
)
