"""A phase machine on any topology, and duty cycles for all of its legs, to simulate."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.plants.scenario import (
    Profile,
)
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.reports.simulation.plant_input import Drive

T_S = 1e-4
V_DC = 200.0
P, R, L_S, M_S, L_N = 3, 0.8, 4e-3, -0.7e-3, 0.6e-3
CAPACITANCE = 150e-6
ORDERS, SHARES, LAGS = np.array([1.0, 3.0, 5.0]), np.array([0.1, 0.02, 0.006]), (0.0, 0.4, -0.3)
L_2 = -0.5e-3
TOPOLOGY_NAMES: tuple[Topology, ...] = tuple(TOPOLOGIES)


def phases(salient: bool = False) -> AnyPhaseMachine:
    machine = PhaseMachine.from_harmonics(
        ORDERS, SHARES, LAGS, pole_pairs=P, r_s=R, l_s=L_S, m_s=M_S, i_max=30.0
    )
    return SalientPhaseMachine.with_second_harmonic(machine, L_2) if salient else machine


def drive(
    topology: Topology, machine: AnyPhaseMachine, choke: float = L_N, f_sw: float = 1.0 / T_S
) -> Drive:
    link = Inverter(
        V_DC, f_sw, topology=topology, neutral_inductance=choke, midpoint_capacitance=CAPACITANCE
    )
    shown = LinearMachine(
        P, machine.r_s, 4.7e-3, 4.7e-3, 0.1, 30.0, inertia=8e-4, friction=1e-3, omega_m_max=150.0
    )
    return Drive(shown, link, T_S, phases=machine)


def duties(legs: int, samples: int) -> FloatArray:
    """Duty cycles that differ in every leg and period, shape (samples, legs)."""
    k, leg = np.arange(samples)[:, np.newaxis], np.arange(legs)
    return np.asarray(
        0.5 + 0.16 * np.sin(2.0 * np.pi * (k / 37.0 - leg / 3.0)) + 0.03 * np.sin(1.3 * k + leg)
    )


def profiles(duty: FloatArray) -> tuple[Profile, ...]:
    times = tuple(T_S * k for k in range(duty.shape[0]))
    return tuple(Profile(times, tuple(column)) for column in duty.T)


def assert_close(found: FloatArray, expected: FloatArray, relative: float) -> None:
    np.testing.assert_allclose(
        found, expected, rtol=0.0, atol=relative * float(np.max(np.abs(expected)))
    )
