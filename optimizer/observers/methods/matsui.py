"""Kalman filter and Matsui's estimators as methods of a design: how its few
numbers become their gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.observers.methods.matsui_model import Matsui, MatsuiModel, matsui
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair
from dqforge.optimizer.observers.sampled_gains import (
    SampledGains,
    limited,
    matrix_entries,
    next_currents,
    sampled_gains,
)
from dqforge.optimizer.observers.tuning_numbers import USUAL_WIDTH, ObserverTuning


def usual_matsui(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Angle and speed at 200 rad/s, or 1/20 of the sampling rate in rad/s if less:
    a voltage error costs less so.
    """
    width = min(USUAL_WIDTH, 0.05 / t_s)
    return ObserverTuning(width, width, omega_floor=0.02 * omega_max)


def usual_matsui_current(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """The speed as `usual_matsui`.

    The angle at 1000 rad/s or 1/5 of the sampling rate in rad/s, if less.

    What the speed errs by, by R or psi, costs the angle that over its pole (`closed_form_error`).
    """
    usual = usual_matsui(machine, t_s, omega_max)
    return ObserverTuning(usual.bandwidth, min(1000.0, 0.2 / t_s), omega_floor=usual.omega_floor)


def _matsui(
    machine: LinearMachine,
    tuning: ObserverTuning,
    t_s: float,
    omega_max: float,
    kind: MatsuiModel,
    damping: float = 1.0,
) -> MatsuiVoltageGains | MatsuiCurrentGains:
    return matsui_gains(
        matsui(
            machine,
            t_s,
            kind,
            tuning.pll_bandwidth,
            damping=damping,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=omega_max,
        )
    )


def design_matsui_voltage(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiVoltageGains:
    """Angle poles by ``pll_bandwidth`` and ``damping``, that of the speed by
    ``bandwidth`` (both rad/s).
    """
    found = _matsui(machine, tuning, t_s, omega_max, "voltage", damping=tuning.damping)
    assert isinstance(found, MatsuiVoltageGains)
    return found


def design_matsui_current(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiCurrentGains:
    """Angle pole by ``pll_bandwidth``, that of the speed by ``bandwidth`` (both rad/s)."""
    found = _matsui(machine, tuning, t_s, omega_max, "current", damping=1.0)
    assert isinstance(found, MatsuiCurrentGains)
    return found


@dataclass(frozen=True, slots=True)
class ShownGains:
    """What the machine shows of the errors: ``salient`` = L_d - L_q in H, ``psi_pm`` in Wb,
    (rad/s)^2.
    """

    salient: float
    psi_pm: float
    omega_min_2: float


@dataclass(frozen=True, slots=True)
class MatsuiVoltageGains:
    """`dqforge.optimizer.observers.methods.matsui_model.Matsui` of the kind
    ``voltage`` for the firmware.
    """

    model: SampledGains
    shown: ShownGains
    k_p: float
    k_i: float
    speed_share: float
    omega_max: float


@dataclass(frozen=True, slots=True)
class MatsuiCurrentGains:
    """`dqforge.optimizer.observers.methods.matsui_model.Matsui` of the kind ``current``.

    ``g_d``, ``g_q`` in V/A.
    """

    model: SampledGains
    shown: ShownGains
    g_d: float
    g_q: float
    l_theta: float
    speed_share: float
    omega_max: float


def matsui_gains(observer: Matsui) -> MatsuiVoltageGains | MatsuiCurrentGains:
    """What the firmware needs of an estimator."""
    model, machine = observer.model, observer.model.machine
    shown = ShownGains(machine.l_d - machine.l_q, machine.psi_pm, observer.omega_min**2)
    if observer.kind == "voltage":
        return MatsuiVoltageGains(
            sampled_gains(model),
            shown,
            observer.k_p,
            observer.k_i,
            observer.speed_share,
            model.omega_max,
        )
    g_d, g_q = (-1.0 / float(model.table[row, 0]) for row in (4, 7))
    return MatsuiCurrentGains(
        sampled_gains(model),
        shown,
        g_d,
        g_q,
        observer.l_theta,
        observer.speed_share,
        model.omega_max,
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


def matsui_current_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s;
    its vector is the last current.
    """
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, started=False)


def _shown_errors(shown: ShownGains, omega: Reals, v: Pair, i: Pair) -> Pair:
    active, cross = shown.psi_pm + shown.salient * i[0], shown.salient * i[1]
    scale = 1.0 / (active * active + cross * cross)
    share = omega / (omega * omega + shown.omega_min_2)
    return (scale * (cross * v[1] - active * v[0])) * share, scale * (active * v[1] + cross * v[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn,
    current gap.
    """

    theta: Reals
    now: Pair
    entries: list[Reals]
    cosine: Reals
    half: Reals
    gap: Pair


def _gap(model: SampledGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic) -> _Gap:
    turn = maths.rotation(state.theta_e)
    theta = maths.wrap(state.theta_e + model.t_s * state.omega_e)
    now = park(maths, i, maths.rotation(theta))
    x = limited(model.t_s * state.omega_e, model.x_max)
    half = 0.5 * x
    e = matrix_entries(model, x)
    foretold = next_currents(e, park(maths, state.vectors[0], turn), park(maths, v, turn))
    return _Gap(
        theta, now, e, 1.0 - 0.5 * (half * half), half, (now[0] - foretold[0], now[1] - foretold[1])
    )


def matsui_voltage_step(
    gains: MatsuiVoltageGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).
    """
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    found = _gap(gains.model, state, v, i, maths)
    e, gap = found.entries, found.gap
    scale = -1.0 / (e[2] * e[3] - e[7] * e[8])
    v_d, v_q = scale * (e[3] * gap[0] - e[7] * gap[1]), scale * (e[2] * gap[1] - e[8] * gap[0])
    difference = found.cosine * v_d + found.half * v_q, found.cosine * v_q - found.half * v_d
    angle, slip = _shown_errors(gains.shown, state.omega_e, difference, found.now)
    behind, integral = state.scalars
    speed = (state.omega_e + behind) + gains.speed_share * (slip - behind)
    integral = limited(integral + gains.k_i * angle, gains.omega_max)
    turning = limited(speed + (gains.k_p * angle + integral), gains.omega_max)
    return ObserverState((i,), found.theta, turning, True, (speed - turning, integral))


def matsui_current_step(
    gains: MatsuiCurrentGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).
    """
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    found = _gap(gains.model, state, v, i, maths)
    gap, half = found.gap, found.half
    difference = (
        gains.g_d * (found.cosine * gap[0] - half * gap[1]),
        gains.g_q * (found.cosine * gap[1] + half * gap[0]),
    )
    angle, slip = _shown_errors(gains.shown, state.omega_e, difference, found.now)
    moved = maths.wrap(found.theta + gains.l_theta * (angle + (0.5 * gains.model.t_s) * slip))
    return ObserverState(
        (i,), moved, limited(state.omega_e + gains.speed_share * slip, gains.omega_max)
    )
