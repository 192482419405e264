"""Matsui's current model: gains and step."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.matsui import (
    ShownGains,
    shown_errors,
    shown_gains,
    shown_gap,
    usual_matsui,
)
from dqforge.optimizer.observers.methods.matsui_model import Matsui, matsui
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
)
from dqforge.optimizer.observers.sampled_machine import SampledGains, model_scale, sampled_gains
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, Member, Pair, limited


@dataclass(frozen=True, slots=True)
class MatsuiCurrentGains:
    """The sampled machine, what it shows of the errors, and what corrects them."""

    model: SampledGains
    shown: ShownGains
    g_d: Annotated[float, Member("voltage per current gap, d axis", "V/A")]
    g_q: Annotated[float, Member("voltage per current gap, q axis", "V/A")]
    l_theta: Annotated[float, Member("share of the angle error per period")]
    speed_share: Annotated[float, Member("share of the speed error per period")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]


def current_gains(observer: Matsui) -> MatsuiCurrentGains:
    """What the firmware needs of an estimator of the kind ``current``.

    Args:
        observer: The estimator.
    """
    g_d, g_q = (-1.0 / float(observer.model.table[row, 0]) for row in (4, 7))
    return MatsuiCurrentGains(
        sampled_gains(observer.model),
        shown_gains(observer),
        g_d,
        g_q,
        observer.l_theta,
        observer.speed_share,
        observer.model.omega_max,
    )


def usual_matsui_current(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """The speed as `usual_matsui`.

    The angle at 1000 rad/s or 1/5 of the sampling rate in rad/s, if less.

    What the speed errs by, by R or psi, costs the angle that over its pole (`closed_form_error`).
    """
    usual = usual_matsui(machine, t_s, omega_max)
    return ObserverTuning(usual.bandwidth, min(1000.0, 0.2 / t_s), omega_floor=usual.omega_floor)


def design_matsui_current(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiCurrentGains:
    """Angle pole by ``pll_bandwidth``, that of the speed by ``bandwidth`` (both rad/s)."""
    return current_gains(
        matsui(
            machine,
            t_s,
            "current",
            tuning.pll_bandwidth,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=omega_max,
        )
    )


def matsui_current_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s;
    its vector is the last current.
    """
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, started=False)


def matsui_current_step(
    gains: MatsuiCurrentGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).
    """
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    o, found = maths, shown_gap(gains.model, state, v, i, maths)
    gap, half = found.gap, found.half
    difference = o.let(
        "difference",
        Dq(
            gains.g_d * (found.cosine * gap.d - half * gap.q),
            gains.g_q * (found.cosine * gap.q + half * gap.d),
        ),
        "of the voltages in the middle of the period, V",
    )
    error = o.let("error", o.call(shown_errors, gains.shown, state.omega_e, difference, found.now))
    moved = gains.l_theta * (error.angle + (0.5 * gains.model.t_s) * error.speed)
    speed = o.let("speed", state.omega_e + gains.speed_share * error.speed)
    return ObserverState((i,), o.wrap(found.theta + moved), limited(o, speed, gains.omega_max))


def current_in_words(tuning: ObserverTuning, _gains: MatsuiCurrentGains, _t_s: float) -> str:
    """The poles of speed and angle.

    Args:
        tuning: Its numbers.
    """
    return (
        f"pole of the speed {tuning.bandwidth:.5g} rad/s, of the angle "
        f"{tuning.pll_bandwidth:.5g} rad/s"
    )


METHOD = ObserverMethod(
    name="matsui-current",
    code="matsui_current",
    title="Matsui's current model",
    design=design_matsui_current,
    start=matsui_current_start,
    step=matsui_current_step,
    usual=usual_matsui_current,
    searched=("pll_bandwidth", "bandwidth"),
    gains=MatsuiCurrentGains,
    scale=model_scale,
    in_words=current_in_words,
    settle=300,
    members=StateMembers((("i", Member("last current", "A")),)),
)
