"""Junctions over time against a differential-equation solver and against
linear system simulation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import StateSpace, lsim

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.devices.thermal_network import FosterNetwork
from dqforge.machines.losses.bridge_tables import (
    BridgeTables,
    JunctionNetworks,
    bridge_tables,
    junction_history,
    junction_networks,
)

DEVICE = SwitchDevice(
    "mosfet", 10e-3, 1e-3, 1e-3, 100.0, 600.0, 0.3, on_resistance_temperature_coefficient=5e-3
)
NETWORK = JunctionNetworks(
    np.array([[0.02, 0.1, 0.13, 0.05]]), np.array([[1e-3, 0.02, 0.3, 0.0]]), 0.0
)


def tables() -> BridgeTables:
    return bridge_tables(Inverter(600.0, 10e3, DEVICE, 65.0))


def made(power: FloatArray, slope: float) -> FloatArray:
    """Losses (2, 1, K, N) in W at 25 and 175 degC that grow by `slope` per kelvin."""
    return np.asarray(
        np.broadcast_to(
            np.stack([power, power * (1.0 + 150.0 * slope)])[None, None], (2, 1, 2, power.size)
        )
    )


def test_constant_losses_follow_scipy() -> None:
    random = np.random.default_rng(5)
    steps, h = 400, 0.01
    power = random.uniform(0.0, 300.0, steps)
    found = junction_history(tables(), NETWORK, made(power, 0.0), np.full(steps, h), repeated=False)
    time = np.arange(steps * 10 + 1) * h / 10.0
    held = np.append(np.repeat(power, 10), power[-1])
    total = 0.05 * held
    for resistance, tau in ((0.02, 1e-3), (0.1, 0.02), (0.13, 0.3)):
        system = StateSpace([[-1.0 / tau]], [[resistance / tau]], [[1.0]], [[0.0]])
        total = total + lsim(system, held, time, interp=False)[1]
    # scipy's value at the end of an interval has the next loss on the part without capacity.
    ends = total[10::10] - 0.05 * (held[10::10] - power)
    assert found.end[0, 0] == pytest.approx(65.0 + ends, abs=1e-8)
    assert found.steady


def test_losses_that_follow_the_temperature_against_a_solver() -> None:
    """Intervals short against all capacities but the fastest, so that the
    mean stands for the course.
    """
    slope, h = 3e-3, 2e-4
    power = np.repeat([50.0, 250.0, 0.0, 150.0], 250)
    network = JunctionNetworks(np.array([[0.1, 0.15]]), np.array([[0.01, 0.05]]), 0.0)
    found = junction_history(
        tables(), network, made(power, slope), np.full(power.size, h), repeated=False
    )

    def course(t: float, x: FloatArray) -> FloatArray:
        loss = power[min(int(t / h), power.size - 1)] * (1.0 + slope * (65.0 + x.sum() - 25.0))
        return np.array([(0.1 * loss - x[0]) / 0.01, (0.15 * loss - x[1]) / 0.05])

    state = np.zeros(2)
    for k in range(4):
        span = (k * 0.05 + 1e-12, (k + 1) * 0.05 - 1e-12)
        state = solve_ivp(course, span, state, rtol=1e-10, atol=1e-10, max_step=5e-3).y[:, -1]
        assert found.end[0, 0, 250 * (k + 1) - 1] == pytest.approx(65.0 + state.sum(), abs=1e-3)


def test_a_repeated_mission_ends_as_it_begins() -> None:
    power = np.random.default_rng(1).uniform(0.0, 300.0, 60)
    length = np.random.default_rng(2).uniform(1e-3, 0.1, 60)
    many = junction_history(
        tables(), NETWORK, made(np.tile(power, 40), 2e-3), np.tile(length, 40), repeated=False
    )
    once = junction_history(tables(), NETWORK, made(power, 2e-3), length)
    assert once.end[0, 0] == pytest.approx(many.end[0, 0, -60:], abs=1e-5)


def test_long_intervals_reach_the_steady_state_and_runaway_is_said() -> None:
    """0.3 K/W and dP/dT: T = 65 + 0.3 P (1 + s (T - 25)); from 0.3 P s = 1 on there is none."""
    steady = junction_history(tables(), NETWORK, made(np.full(3, 200.0), 4e-3), np.full(3, 1e3))
    expected = (65.0 + 60.0 * (1.0 - 0.1)) / (1.0 - 0.24)
    assert steady.end[1, 0] == pytest.approx(np.full(3, expected), abs=1e-5)
    hot = junction_history(tables(), NETWORK, made(np.full(3, 200.0), 2e-2), np.full(3, 1e3))
    assert not hot.steady
    assert np.all(np.isnan(hot.end))


def test_networks_come_from_the_device_and_keep_its_total() -> None:
    inverter = Inverter(600.0, 10e3, DEVICE, 65.0)
    from dqforge.machines.devices.inverter import DeviceModel

    model = replace(
        DeviceModel.from_switch_device(DEVICE), thermal=FosterNetwork((0.05, 0.1), (1e-3, 0.1))
    )
    for cauer in (False, True):
        thermal = (
            model.thermal.cauer()
            if cauer and isinstance(model.thermal, FosterNetwork)
            else model.thermal
        )
        given = replace(inverter, device_model=replace(model, thermal=thermal))
        found = junction_networks(given, bridge_tables(given))
        assert found.resistances.sum() == pytest.approx(0.3)
        assert sorted(found.time_constants[0]) == pytest.approx([0.0, 1e-3, 0.1])
    assert junction_networks(inverter, bridge_tables(inverter)).time_constants.tolist() == [[0.0]]
