"""Loads that act against the motion, and a brake that holds by a spring."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import ElasticBrake, Scenario, constant
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

T_S = 1e-4
MACHINE = LinearMachine(
    pole_pairs=4, r_s=0.5, l_d=2e-3, l_q=2e-3, psi_pm=0.05, i_max=20.0, inertia=1e-3
)
LINK = Inverter(100.0, 1.0 / T_S)
# Duty cycles that hold a stator current of 8 A along phase a: v_a = 4 V.
HELD = (constant(0.54), constant(0.48))
TORQUE = 1.5 * 4 * 0.05 * 8.0


@pytest.fixture(scope="module")
def plant() -> Iterator[Simulator]:
    with simulator() as compiled:
        yield compiled


def pulled(plant: Simulator, scenario: Scenario) -> Simulation:
    return simulate(plant, Drive(MACHINE, LINK, T_S), scenario)


def test_free_shaft_slows_by_its_friction_and_stays(plant: Simulator) -> None:
    """J d omega/dt = -T until rest, and no way back."""
    half = constant(0.5)
    drive = Drive(replace(MACHINE, psi_pm=1e-9), LINK, T_S)
    scenario = Scenario(
        0.08, "open-loop", half, half, load=constant(1.0), omega_m=-50.0, load_kind="friction"
    )
    run = simulate(plant, drive, scenario)
    expected = np.minimum(-50.0 + 1000.0 * run.t, 0.0)
    np.testing.assert_allclose(run.omega_m, expected, atol=1e-6)
    assert np.all(run.omega_m[run.t > 0.0501] == 0.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_alignment_ends_inside_its_dead_band(plant: Simulator, side: float) -> None:
    """The rotor comes to rest where the current's torque no longer exceeds the load, and not
    at the current's direction."""
    load = 0.5 * TORQUE
    scenario = Scenario(
        2.0, "open-loop", *HELD, load=constant(load), theta_e=side * 2.5, load_kind="friction"
    )
    run = pulled(plant, scenario)
    band = math.asin(load / TORQUE)
    assert abs(run.omega_m[-1]) < 1e-6
    assert 0.1 * band < abs(run.theta_e[-1]) <= band + 1e-3
    assert np.ptp(run.theta_e[run.t > 1.5]) < 1e-6


@pytest.mark.parametrize(("share", "moves"), [(0.97, True), (1.03, False)])
def test_shaft_breaks_away_where_the_torque_exceeds_the_load(
    plant: Simulator, share: float, moves: bool
) -> None:
    scenario = Scenario(
        0.3,
        "open-loop",
        *HELD,
        load=constant(share * TORQUE),
        theta_e=-0.5 * math.pi,
        load_kind="friction",
    )
    run = pulled(plant, scenario)
    assert bool(np.any(run.omega_m != 0.0)) is moves


def test_phase_machine_meets_the_same_load(plant: Simulator) -> None:
    angles = 2.0 * np.pi * np.arange(360) / 360.0
    turned = np.stack([-0.05 * np.sin(angles - n * 2.0 * np.pi / 3.0) for n in range(3)])
    phases = PhaseMachine(4, 0.5, 2e-3, 0.0, turned, 20.0)
    load = constant(0.5 * TORQUE)
    scenario = Scenario(0.2, "open-loop", *HELD, load=load, theta_e=1.5, load_kind="friction")
    found = [
        simulate(plant, Drive(MACHINE, LINK, T_S, phases=each), scenario) for each in (None, phases)
    ]
    assert max(abs(run.omega_m[-1]) for run in found) < 1e-6
    np.testing.assert_allclose(found[1].theta_e, found[0].theta_e, atol=2e-3)


def natural(time: FloatArray, speed: float, omega: float, decay: float) -> FloatArray:
    """Angle of a damped spring that starts at rest position with a speed."""
    own = math.sqrt(omega**2 - decay**2)
    return np.asarray(speed / own * np.exp(-decay * time) * np.sin(own * time))


def test_brake_is_a_spring_where_the_shaft_was(plant: Simulator) -> None:
    half = constant(0.5)
    drive = Drive(replace(MACHINE, psi_pm=1e-9), LINK, T_S)
    brake = ElasticBrake(0.02, 10.0, 0.02)
    run = simulate(plant, drive, Scenario(0.1, "open-loop", half, half, omega_m=3.0, brake=brake))
    after = run.t >= 0.02
    angle = natural(run.t[after] - 0.02, 3.0, 100.0, 10.0)
    np.testing.assert_allclose(run.theta_e[after] / 4.0 - 0.06, angle, atol=1e-6)
