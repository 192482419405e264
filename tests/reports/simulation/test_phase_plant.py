"""The compiled phase machines against SciPy: phase equations written anew, on every topology.

The references have a 3 x 3 inductance matrix, a Lagrange multiplier where a neutral is open, and
diodes of a steep, but smooth characteristic where the plant has exact instants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from simulated_phases import (
    CAPACITANCE,
    L_2,
    L_N,
    L_S,
    LAGS,
    M_S,
    ORDERS,
    SHARES,
    T_S,
    TOPOLOGY_NAMES,
    V_DC,
    P,
    R,
    assert_close,
    drive,
    duties,
    phases,
    profiles,
)

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.plants.scenario import (
    Profile,
    Scenario,
    constant,
)
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator


@pytest.fixture(scope="module")
def plant() -> Iterator[Simulator]:
    with simulator() as compiled:
        yield compiled


def flux(theta_e: float) -> FloatArray:
    """Back-EMF over electrical speed."""
    angle = theta_e - np.array([0.0, 1.0, 2.0]) * 2.0 * math.pi / 3.0
    waves = np.sin(ORDERS[:, np.newaxis] * angle - np.array(LAGS)[:, np.newaxis])
    return np.asarray(-(SHARES @ waves), dtype=np.float64)


def inductances(theta_e: float, l_2: float) -> tuple[FloatArray, FloatArray]:
    """Inductance matrix and its derivative by the angle."""
    lag = 2.0 * theta_e - 2.0 * math.pi / 3.0 * np.add.outer(np.arange(3), np.arange(3))
    constant_part = np.full((3, 3), M_S) + (L_S - M_S) * np.eye(3)
    return constant_part + l_2 * np.cos(lag), -2.0 * l_2 * np.sin(lag)


def phase_rates(
    end: FloatArray,
    neutral: float | None,
    x: FloatArray,
    omega_m: float,
    l_2: float,
    choke: float = L_N,
) -> FloatArray:
    """Rates of the phase currents for potentials of the phases' ends in V, and of the neutral;
    None where that one is open.
    """
    i, theta_e = x[:3], P * x[3]
    matrix, slope = inductances(theta_e, l_2)
    across = end - R * i - P * omega_m * (flux(theta_e) + slope @ i)
    if neutral is not None:
        return np.asarray(np.linalg.solve(matrix + choke, across - neutral), dtype=np.float64)
    bordered = np.block([[matrix, np.ones((3, 1))], [np.ones((1, 3)), np.zeros((1, 1))]])
    whole = np.linalg.solve(bordered, np.append(across, 0.0))
    return np.asarray(whole[:3], dtype=np.float64)


def ends(legs: FloatArray) -> FloatArray:
    """Potentials of the ends of the phases less those of their second legs."""
    return legs[:3] - legs[3:] if legs.size == 6 else legs[:3]


def neutral_end(topology: Topology, legs: FloatArray, v_m: float) -> float | None:
    if topology == "four-leg":
        return float(legs[3])
    return {"split-capacitor": v_m, "six-leg": 0.0}.get(topology)


def torque(x: FloatArray, l_2: float) -> float:
    _, slope = inductances(P * x[3], l_2)
    return float(P * (flux(P * x[3]) @ x[:3] + 0.5 * x[:3] @ slope @ x[:3]))


@pytest.mark.thinned
@pytest.mark.parametrize("salient", [False, True])
@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_averaged_plant_equals_phase_equations(
    plant: Simulator, topology: Topology, salient: bool
) -> None:
    """Free shaft, a link with ripple, a choke in the neutral, the midpoint a state."""
    legs, l_2 = len(TOPOLOGIES[topology].legs), L_2 if salient else 0.0
    duty = duties(legs, 40)
    held = np.full(legs, 0.5)
    x = np.array([0.0, 0.0, 0.0, 0.1, 60.0, 0.0])  # currents, angle, speed, midpoint off its half
    states = [x]

    def right(time: float, x: FloatArray) -> FloatArray:
        v_dc = V_DC + 10.0 * math.sin(2.0 * math.pi * 300.0 * time)
        neutral = neutral_end(topology, held * v_dc, 0.5 * v_dc + x[5])
        rates = phase_rates(ends(held * v_dc), neutral, x, x[4], l_2)
        speeding = (torque(x, l_2) - 1e-3 * x[4] - 0.3) / 8e-4
        return np.array([*rates, x[4], speeding, np.sum(x[:3]) / CAPACITANCE])

    for k in range(40):
        span = (k * T_S, (k + 1) * T_S)
        x = solve_ivp(right, span, x, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        states.append(x)
        held = duty[k]
    expected = np.stack(states)
    scenario = Scenario(
        40 * T_S,
        "open-loop",
        Profile(),
        duties=profiles(duty),
        load=constant(0.3),
        v_dc=Profile((0.0,), (V_DC,), amplitude=10.0, frequency=300.0),
        omega_m=60.0,
        theta_e=P * 0.1,
        sub_steps=60,
    )
    found = simulate(plant, drive(topology, phases(salient)), scenario)
    assert found.phases is not None
    assert float(np.max(np.abs(expected[:, :3]))) > 1.0
    assert_close(found.phases.i_phases, expected[:, :3], 1e-8)
    assert_close(found.omega_m, expected[:, 4], 1e-9)
    assert_close(found.torque, np.array([torque(row, l_2) for row in expected]), 1e-8)
    assert found.phases.duty_legs.shape == (41, legs)
    np.testing.assert_allclose(found.phases.duty_legs[1:], duty[:40], rtol=1e-15)
    summed = np.sum(expected[:, :3], axis=1)
    np.testing.assert_allclose(found.phases.i_neutral, summed, atol=1e-8)
    np.testing.assert_allclose(3.0 * found.i_zero, found.phases.i_neutral, rtol=1e-15)
    assert TOPOLOGIES[topology].neutral == bool(np.max(np.abs(found.phases.i_neutral)) > 0.1)
    if topology == "split-capacitor":
        half = 0.5 * found.v_dc
        assert_close(found.phases.v_midpoint - half, expected[:, 5], 1e-8)
        assert float(np.max(np.abs(expected[:, 5]))) > 1.0
    else:
        assert np.all(np.isnan(found.phases.v_midpoint))


# Currents out of the legs for those of the phases.
OUT_OF: dict[int, FloatArray] = {
    3: np.eye(3),
    4: np.vstack([np.eye(3), [-1.0, -1.0, -1.0]]),
    6: np.vstack([np.eye(3), -np.eye(3)]),
}


def rested(
    topology: Topology, off: FloatArray, on: FloatArray, speed: float, steep: float
) -> Callable[[float, FloatArray], FloatArray]:
    """Rates of currents, angle, midpoint and the integral of the squared neutral current while the
    switches rest; legs that are ``off`` lie at V/2 (1 - tanh(i/steep)).
    """

    def right(_: float, x: FloatArray) -> FloatArray:
        free = 0.5 * V_DC * (1.0 - np.tanh(OUT_OF[on.size] @ x[:3] / steep))
        legs = np.where(off, free, np.where(on, V_DC, 0.0))
        neutral = neutral_end(topology, legs, 0.5 * V_DC + x[4])
        if topology == "diode-neutral":
            neutral = 0.5 * V_DC * (1.0 + math.tanh(float(np.sum(x[:3])) / steep))
        rates = phase_rates(ends(legs), neutral, x, speed, 0.0, 0.0)
        summed = float(np.sum(x[:3]))
        return np.array([*rates, speed, summed / CAPACITANCE, summed**2])

    return right


def switched_by_scipy(
    topology: Topology, duty: FloatArray, dead_time: float, speed: float, steep: float
) -> FloatArray:
    """States (as `rested`) at the samples, the interval between any two switching
    instants integrated by itself.
    """
    legs = duty.shape[1]
    held, x = np.full(legs, 0.5), np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    on, dead_until = np.zeros(legs, dtype=bool), np.full(legs, -1.0)
    states = [x]
    for half in range(2 * duty.shape[0]):
        start, end = 0.5 * half * T_S, 0.5 * (half + 1) * T_S
        rising = half % 2 == 0  # the carrier falls: legs switch on
        edges = start + (end - start) * ((1.0 - held) if rising else held)
        marks = np.unique([start, end, *edges, *(edges + dead_time), *dead_until])
        for low, high in pairwise(marks[(marks >= start) & (marks <= end)]):
            turned = (edges <= low) & (on != rising)
            on[turned], dead_until[turned] = rising, low + dead_time
            off = dead_until > low + 1e-12
            stiff = bool(np.any(off)) or topology == "diode-neutral"
            x = solve_ivp(
                rested(topology, off, on.copy(), speed, steep),
                (low, high),
                x,
                method="Radau" if stiff else "DOP853",
                rtol=1e-7 if stiff else 1e-11,
                atol=1e-8 if stiff else 1e-12,
            ).y[:, -1]
        if not rising:
            states.append(x)
            held = duty[half // 2]
    return np.stack(states)


def switched(
    plant: Simulator, topology: Topology, duty: FloatArray, dead_time: float, speed: float
) -> Simulation:
    scenario = Scenario(
        duty.shape[0] * T_S,
        "open-loop",
        Profile(),
        duties=profiles(duty),
        shaft=constant(speed),
        theta_e=P * 0.1,
        inverter="switched",
        dead_time=dead_time,
        sub_steps=20,
    )
    return simulate(plant, drive(topology, phases(), choke=0.0), scenario, tail=0.0)


@pytest.mark.parametrize("topology", [name for name in TOPOLOGIES if name != "diode-neutral"])
def test_switched_plant_equals_intervals_of_scipy(plant: Simulator, topology: Topology) -> None:
    duty = duties(len(TOPOLOGIES[topology].legs), 12)
    expected = switched_by_scipy(topology, duty, 0.0, 60.0, 1.0)
    found = switched(plant, topology, duty, 0.0, 60.0)
    assert found.phases is not None
    assert float(np.max(np.abs(expected[:, :3]))) > 1.0
    assert_close(found.phases.i_phases, expected[:, :3], 1e-8)


@pytest.mark.thinned
@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_dead_times_and_diodes_equal_steep_characteristics(
    plant: Simulator, topology: Topology
) -> None:
    """Dead times of 4 us, in which currents die and float; diodes of 0.1 mA."""
    duty = duties(len(TOPOLOGIES[topology].legs), 3)
    expected = switched_by_scipy(topology, duty, 4e-6, 60.0, 1e-4)
    found = switched(plant, topology, duty, 4e-6, 60.0)
    ideal = switched(plant, topology, duty, 0.0, 60.0)
    assert found.phases is not None
    assert ideal.phases is not None
    i, without = found.phases.i_phases, ideal.phases.i_phases
    scale = float(np.max(np.abs(expected[:, :3])))
    assert float(np.max(np.abs(i - expected[:, :3]))) < 2e-3 * scale
    assert float(np.max(np.abs(i - without))) > 2e-2 * scale
    neutral = math.sqrt(max(float(expected[-1, 5]), 0.0) / (3 * T_S))
    assert float(found.figures.tail_neutral_rms[0]) == pytest.approx(neutral, rel=3e-3, abs=2e-4)
    if topology == "diode-neutral":
        assert neutral > 0.01
