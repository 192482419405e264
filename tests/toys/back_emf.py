"""Back-EMF of a period, e = v - R i - L_q di/dt, before a phase-locked loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
    loop_scale,
)
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, Member, Pair, at_least


@dataclass(frozen=True, slots=True)
class BackEmfGains:
    """Voltage of a period, and a loop; psi_pm is for the scale alone and not in the firmware."""

    half_r: Annotated[float, Member("R / 2", "Ohm")]
    slope: Annotated[float, Member("L_q / t_s", "Ohm")]
    floor: Annotated[float, Member("least back-EMF that counts in full", "V")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    pll: PllGains


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> BackEmfGains:
    """Gains of a machine, sampled every ``t_s`` seconds."""
    floor = machine.psi_pm * tuning.omega_floor
    pll = pll_gains(tuning.pll_bandwidth, tuning.damping, t_s)
    return BackEmfGains(0.5 * machine.r_s, machine.l_q / t_s, floor, machine.psi_pm, pll)


def usual(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """A loop of a fifth of the usual bandwidth: nothing else smooths the EMF."""
    width = 0.2 * pll_bandwidth(t_s)
    return ObserverTuning(width, width, omega_floor=0.02 * omega_max)


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; its vector is the last current in A."""
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, started=False)


def step(
    gains: BackEmfGains, state: ObserverState, v: Pair, i: Pair, o: Arithmetic
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the instant of ``i`` in A."""
    if not state.started:
        return ObserverState((i,), state.theta_e, state.omega_e)
    (last,) = state.vectors
    x = o.let("x", gains.pll.t_s * state.omega_e, "angle of the period, rad")
    middle = o.rotation(o.wrap(state.theta_e + 0.5 * x))
    parts = (
        v[n] - (gains.half_r * (last[n] + i[n]) + gains.slope * (i[n] - last[n])) for n in (0, 1)
    )
    e = o.let("e", AlphaBeta(*parts), "back-EMF, V")
    size = o.let("size", o.root(e.alpha * e.alpha + e.beta * e.beta))
    along = o.let("along", -o.park(e, middle).d / at_least(o, size, gains.floor))
    error = o.let("error", o.choose(state.omega_e < 0.0, -along, along), "rad")
    theta = o.let("theta", predicted(state.theta_e, x, o), "foretold angle, rad")
    return ObserverState((i,), *corrected(gains.pll, theta, state.omega_e, error, o))


def in_words(tuning: ObserverTuning, gains: BackEmfGains, t_s: float) -> str:
    """By what numbers it is tuned."""
    return f"loop {tuning.pll_bandwidth:.5g} rad/s, damping {tuning.damping:.3g}"


METHOD = ObserverMethod(
    name="back-emf",
    code="back_emf",
    title="back-EMF of a period with phase-locked loop",
    design=design,
    start=start,
    step=step,
    usual=usual,
    searched=("pll_bandwidth",),
    gains=BackEmfGains,
    scale=loop_scale,
    in_words=in_words,
    members=StateMembers((("i", Member("last current", "A")),)),
)
