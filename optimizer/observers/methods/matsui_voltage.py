"""Matsui's voltage model: gains and step."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from dqforge.machines.arrays import FloatArray
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
class MatsuiVoltageGains:
    """The sampled machine, what it shows of the errors, and what corrects them."""

    model: SampledGains
    shown: ShownGains
    k_p: Annotated[float, Member("speed per angle error", "1/s")]
    k_i: Annotated[float, Member("its increment per period", "1/s")]
    speed_share: Annotated[float, Member("share of the speed error per period")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]


def voltage_gains(observer: Matsui) -> MatsuiVoltageGains:
    """What the firmware needs of an estimator of the kind ``voltage``.

    Args:
        observer: The estimator.
    """
    return MatsuiVoltageGains(
        sampled_gains(observer.model),
        shown_gains(observer),
        observer.k_p,
        observer.k_i,
        observer.speed_share,
        observer.model.omega_max,
    )


def design_matsui_voltage(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiVoltageGains:
    """Angle poles by ``pll_bandwidth`` and ``damping``, that of the speed by
    ``bandwidth`` (both rad/s).
    """
    return voltage_gains(
        matsui(
            machine,
            t_s,
            "voltage",
            tuning.pll_bandwidth,
            damping=tuning.damping,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=omega_max,
        )
    )


def matsui_voltage_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s.

    Its vector is the last current; its scalars are the low-pass speed less omega_e,
    and the integral, both in rad/s.
    """
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, False, (zero, zero))


def matsui_voltage_sizes(scalars: FloatArray, omega: FloatArray) -> FloatArray:
    """Noticeable changes of the scalars of M estimators, shape (M, 2): both are speeds,
    nil in an ideal drive.
    """
    return np.maximum(np.abs(scalars), np.maximum(np.abs(omega), 1.0)[:, None])


def matsui_voltage_step(
    gains: MatsuiVoltageGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).
    """
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    o, found = maths, shown_gap(gains.model, state, v, i, maths)
    e, gap, half = found.entries, found.gap, found.half
    scale = o.let("scale", -1.0 / (e[2] * e[3] - e[7] * e[8]))
    voltage = o.let(
        "voltage",
        Dq(scale * (e[3] * gap.d - e[7] * gap.q), scale * (e[2] * gap.q - e[8] * gap.d)),
        "which makes the current gap, V",
    )
    difference = o.let(
        "difference",
        Dq(
            found.cosine * voltage.d + half * voltage.q,
            found.cosine * voltage.q - half * voltage.d,
        ),
        "seen from the middle of the period, V",
    )
    error = o.let("error", o.call(shown_errors, gains.shown, state.omega_e, difference, found.now))
    behind, integral = state.scalars
    lag = error.speed - behind
    speed = o.let("speed", (state.omega_e + behind) + gains.speed_share * lag, "low-pass, rad/s")
    summed = o.let("summed", integral + gains.k_i * error.angle)
    correction = o.let("correction", limited(o, summed, gains.omega_max), "of the speed, rad/s")
    wish = o.let("wish", speed + (gains.k_p * error.angle + correction))
    turning = o.let("turning", limited(o, wish, gains.omega_max), "speed of the angle, rad/s")
    return ObserverState((i,), found.theta, turning, True, (speed - turning, correction))


METHOD = ObserverMethod(
    name="matsui-voltage",
    code="matsui_voltage",
    title="Matsui's voltage model",
    design=design_matsui_voltage,
    start=matsui_voltage_start,
    step=matsui_voltage_step,
    usual=usual_matsui,
    searched=("pll_bandwidth", "bandwidth"),
    gains=MatsuiVoltageGains,
    scale=model_scale,
    settle=300,
    sizes=matsui_voltage_sizes,
    members=StateMembers(
        (("i", Member("last current", "A")),),
        (
            ("behind", Member("low-pass speed less omega_e", "rad/s")),
            ("integral", Member("correction of the speed", "rad/s")),
        ),
    ),
)
