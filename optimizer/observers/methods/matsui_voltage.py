"""Matsui's voltage model: gains and step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.method import ObserverMethod
from dqforge.optimizer.observers.methods.matsui import (
    ShownGains,
    shown_errors,
    shown_gains,
    shown_gap,
    usual_matsui,
)
from dqforge.optimizer.observers.models.matsui_model import Matsui, matsui
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair
from dqforge.optimizer.observers.sampled_gains import (
    SampledGains,
    limited,
    model_scale,
    sampled_gains,
)
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning


@dataclass(frozen=True, slots=True)
class MatsuiVoltageGains:
    """`dqforge.optimizer.observers.models.matsui_model.Matsui` of the kind
    ``voltage`` for the firmware.
    """

    model: SampledGains
    shown: ShownGains
    k_p: float
    k_i: float
    speed_share: float
    omega_max: float


def voltage_gains(observer: Matsui) -> MatsuiVoltageGains:
    """What the firmware needs of an estimator of the kind ``voltage``.

    Parameters
    ----------
    observer:
        The estimator.
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
    found = shown_gap(gains.model, state, v, i, maths)
    e, gap = found.entries, found.gap
    scale = -1.0 / (e[2] * e[3] - e[7] * e[8])
    v_d, v_q = scale * (e[3] * gap[0] - e[7] * gap[1]), scale * (e[2] * gap[1] - e[8] * gap[0])
    difference = found.cosine * v_d + found.half * v_q, found.cosine * v_q - found.half * v_d
    angle, slip = shown_errors(gains.shown, state.omega_e, difference, found.now)
    behind, integral = state.scalars
    speed = (state.omega_e + behind) + gains.speed_share * (slip - behind)
    integral = limited(integral + gains.k_i * angle, gains.omega_max)
    turning = limited(speed + (gains.k_p * angle + integral), gains.omega_max)
    return ObserverState((i,), found.theta, turning, True, (speed - turning, integral))


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
)
