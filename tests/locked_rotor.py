"""Drives at rest in the time domain, many angles of a machine side by side: exact winding, relay of
the dead time, a slow current controller, an estimator that injects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.plants.scenario import ComplexArray
from dqforge.optimizer.estimators import Tracker
from dqforge.optimizer.observers.sampled_machine import exact_entries
from dqforge.optimizer.steps.step_arithmetic import EXACT

BASE = "abb-ipmsm-2k2"


def random_drive(generator: Generator, least: float = 1.1, most: float = 2.5) -> Design:
    """A machine of 24 to 560 V and 3 to 80 A with an l_q over l_d from ``least`` to ``most``."""
    v_dc = float(generator.choice([24.0, 48.0, 325.0, 560.0]))
    current = float(np.exp(generator.uniform(np.log(3.0), np.log(80.0))))
    omega = 2.0 * np.pi * float(generator.uniform(60.0, 350.0))
    impedance = 0.8 * v_dc / np.sqrt(3.0) / current
    poles = int(generator.integers(2, 8))
    l_d = float(generator.uniform(0.12, 0.5)) * impedance / omega
    machine = LinearMachine(
        pole_pairs=poles,
        r_s=float(generator.uniform(0.015, 0.12)) * impedance,
        l_d=l_d,
        l_q=float(generator.uniform(least, most)) * l_d,
        psi_pm=0.7 * v_dc / np.sqrt(3.0) / omega,
        i_max=current,
        inertia=1e-3,
        omega_m_max=omega / poles,
    )
    f_s = float(generator.choice([8e3, 10e3, 16e3, 20e3]))
    base = catalogue.load(BASE)
    return replace(
        base,
        machine=machine,
        inverter=Inverter(v_dc, f_s),
        control=replace(base.control, t_s=1.0 / f_s),
    )


@dataclass(frozen=True)
class Rest:
    """How a drive rests: ``load`` as a share of the largest current on q (nothing: a tenth of it on
    d), ``dead_time`` left in s, ``noise`` of the current as a share of the largest, ``away`` in rad
    of the first estimate.
    """

    load: float = 0.0
    dead_time: float = 0.0
    noise: float = 0.005
    away: float = 0.3


def _lost(i: ComplexArray, design: Design, dead_time: float) -> ComplexArray:
    """Voltage that dead time takes, alpha + j beta, from currents alpha + j beta."""
    a, b = i.real, np.sqrt(3.0) * i.imag
    size = dead_time / design.control.t_s * design.inverter.v_dc
    edge = 0.02 * design.i_max
    leg = [-size * np.clip(x / edge, -1.0, 1.0) for x in (a, 0.5 * (b - a), 0.5 * (-b - a))]
    lost = (2.0 * leg[0] - leg[1] - leg[2]) / 3.0 + 1j * (leg[1] - leg[2]) / np.sqrt(3.0)
    return np.asarray(lost, dtype=np.complex128)


def track_at_rest(
    tracker: Tracker,
    gains: object,
    design: Design,
    rest: Rest,
    generator: Generator,
    shape: tuple[int, int] = (1500, 16),
) -> FloatArray:
    """Angle errors in rad, modulo half a turn, shape (samples, angles)."""
    machine, t_s = linearised(design.machine), design.control.t_s
    entries = exact_entries(machine, np.array([0.0]), t_s)[0]
    phi, gamma = entries[:4].reshape(2, 2), entries[4:8].reshape(2, 2)
    theta = generator.uniform(-np.pi, np.pi, shape[1])
    turn = np.exp(1j * theta)
    wanted = machine.i_max * (0.1 if rest.load == 0.0 else 1j * rest.load)
    i = np.full(shape[1], wanted, dtype=np.complex128)
    state: Any = tracker.start(
        gains,
        EXACT.wrap(theta + generator.uniform(-rest.away, rest.away, shape[1])),
        np.zeros(shape[1]),
    )
    asked, integral = np.zeros_like(i), np.zeros_like(i)
    kp = 0.1 * machine.l_d / t_s
    found = np.empty(shape)
    for k in range(shape[0]):
        noise = generator.standard_normal((2, shape[1])) * rest.noise * machine.i_max
        seen = i * turn + noise[0] + 1j * noise[1]
        before = asked
        state = tracker.step(
            gains, state, (before.real, before.imag), (seen.real, seen.imag), (), EXACT
        )
        error = wanted - (state.current[0] + 1j * state.current[1]) / turn
        integral = integral + 0.05 * kp * error
        v = (before + _lost(i * turn, design, rest.dead_time)) / turn
        v = v + machine.r_s * wanted + kp * error + integral
        after = phi @ np.stack([i.real, i.imag]) + gamma @ np.stack([v.real, v.imag])
        i = after[0] + 1j * after[1]
        asked = state.added[0] + 1j * state.added[1]
        found[k] = np.angle(np.exp(2j * (state.theta_e - theta))) / 2.0
    return found
