"""Phase machines in closed loop with a controller written by hand: what the simulation hands it,
what it swaps in it, and the figures of torque and copper that the theory of the currents gives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import plain_phase_control as plain
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import VerificationError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import (
    InverterModel,
    PhaseOpening,
    Scenario,
    constant,
)
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulate_many, simulator

T_S = 1e-4
BANDWIDTH = 2.0 * math.pi * 500.0
SPEEDS = (75.0, 750.0, 1800.0)
MOST = [
    pytest.param(name, marks=() if name in ("four-leg", "split-capacitor") else pytest.mark.slow)
    for name in TOPOLOGIES
]


@pytest.fixture(scope="module")
def design() -> Design:
    return catalogue.load("paper002-phase-waveforms")


@pytest.fixture(scope="module")
def four_leg() -> Iterator[Simulator]:
    with simulator(plain.header("four-leg", 2), "t", topology="four-leg") as compiled:
        yield compiled


def machine_of(design: Design) -> PhaseMachine:
    assert isinstance(design.phase_machine, PhaseMachine)
    return design.phase_machine


def trapezoid(machine: PhaseMachine) -> PhaseMachine:
    """Flat for 120 degrees at 0.2 Wb."""
    theta = 2.0 * np.pi * np.arange(360) / 360
    lag = 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    corner = np.arcsin(np.sin(theta - lag)) / (np.pi / 6.0)
    return replace(machine, flux=-0.2 * np.clip(corner, -1.0, 1.0))


def drive(design: Design, topology: Topology, machine: PhaseMachine | None = None) -> Drive:
    link = replace(design.inverter, topology=topology, midpoint_capacitance=4e-3)
    return Drive(design.machine, link, T_S, phases=machine or machine_of(design))


def turning(
    rpm: float, duration: float, torque: float = 1.0, inverter: InverterModel = "averaged"
) -> Scenario:
    speed = rpm * math.pi / 30.0
    return Scenario(
        duration,
        "torque",
        constant(torque),
        shaft=constant(speed),
        omega_m=speed,
        inverter=inverter,
        dead_time=0.0,
    )


def gains() -> bytes:
    return plain.gain_bytes(BANDWIDTH, 1.0, (8e-3, 5e-3), T_S)


# Copper loss in W at 1 N m of the phase waveforms and of the trapezoid: all three currents, or
# those without a zero sequence.
COPPER = {True: (3.297, 2.720), False: (3.342, 2.834)}


@pytest.mark.slow
def test_diodes_of_a_neutral_let_the_pulses_leak(design: Design) -> None:
    """Where all legs lie low and the machine's zero-sequence voltage pulls the neutral below them;
    with smooth diodes, by SciPy, 0.022 A at 1800 rpm.
    """
    runs = [
        (drive(design, "diode-neutral"), turning(rpm, 0.4, inverter="switched"), gains())
        for rpm in SPEEDS
    ]
    shapes = [plain.shape_bytes(machine_of(design).flux)] * len(runs)
    with simulator(plain.header("diode-neutral", 2), "t", topology="diode-neutral") as program:
        found = simulate_many(program, runs, shapes=shapes, tail=0.5)
    np.testing.assert_allclose(found.tail_neutral_rms, [0.0034, 0.0233, 0.0212], rtol=0.03)


@pytest.mark.thinned
@pytest.mark.parametrize("topology", MOST)
def test_averaged_torque_and_copper_are_those_of_the_currents(
    design: Design, topology: Topology
) -> None:
    """Thousands of machines need one program: two back-EMFs at three speeds, gains and shape
    given.
    """
    machines = (machine_of(design), trapezoid(machine_of(design)))
    runs = [
        (drive(design, topology, machine), turning(rpm, 0.4), gains())
        for machine in machines
        for rpm in SPEEDS
    ]
    shapes = [plain.shape_bytes(machine.flux) for machine in machines for _ in SPEEDS]
    with simulator(plain.header(topology, 2), "t", topology=topology) as program:
        found = simulate_many(program, runs, shapes=shapes, tail=0.5)
    assert np.all(found.bounded)
    np.testing.assert_allclose(found.tail_torque, 1.0, rtol=1e-3)
    ripple = 100.0 * found.tail_ripple_means
    assert np.all(ripple[:3] < (0.05, 0.05, 0.2))
    assert np.all(ripple[3:] < (0.4, 0.7, 2.0))
    copper = found.tail_copper_a + found.tail_copper_b + found.tail_copper_c
    wired = TOPOLOGIES[topology].neutral
    np.testing.assert_allclose(copper, np.repeat(COPPER[wired], 3), rtol=2e-3)
    neutral = np.repeat((0.365, 0.564) if wired else (0.0, 0.0), 3)
    np.testing.assert_allclose(found.tail_neutral_rms, neutral, atol=5e-3)
    assert bool(np.all(found.tail_midpoint > 0.1)) == (topology == "split-capacitor")


@pytest.mark.slow
def test_a_shape_that_is_not_the_header_s_is_refused(design: Design, four_leg: Simulator) -> None:
    with pytest.raises(VerificationError, match="back-EMF"):
        simulate(
            four_leg,
            drive(design, "four-leg"),
            turning(75.0, 0.01),
            gains=gains(),
            shape=b"12345678",
        )
    with pytest.raises(ValueError, match="a controller for four-leg cannot drive six-leg"):
        simulate(four_leg, drive(design, "six-leg"), turning(75.0, 0.01), gains=gains())


def opened(design: Design, program: Simulator, detected_after: float | None) -> FloatArray:
    """Torque and neutral current over the revolution that ends 0.2 s after phase b opened."""
    opening = PhaseOpening("b", 0.05, detected_after)
    scenario = replace(turning(750.0, 0.25), open_phase=opening)
    shape = plain.shape_bytes(machine_of(design).flux)
    found = simulate(program, drive(design, "four-leg"), scenario, gains=gains(), shape=shape)
    assert found.phases is not None
    np.testing.assert_array_equal(found.phases.i_phases[-800:, 1], 0.0)
    return np.stack([found.torque[-800:], found.phases.i_neutral[-800:]])


def test_controller_that_knows_of_an_open_phase_makes_constant_torque(
    design: Design, four_leg: Simulator
) -> None:
    """Unaware it misses half of the torque twice a period, where phase b should make it, but for
    what its P action adds to the others; told of it 1 N m, with 2.14 A r.m.s. in the neutral.
    """
    flux = machine_of(design).flux
    shares = np.sum(flux[[0, 2]] ** 2, axis=0) / np.sum(flux**2, axis=0)
    unaware, _ = opened(design, four_leg, None)
    assert float(np.min(shares)) < float(np.min(unaware)) < float(np.min(shares)) + 0.15
    assert float(np.min(shares)) == pytest.approx(0.475, abs=1e-3)
    torque, neutral = opened(design, four_leg, 1e-3)
    assert float(np.mean(torque)) == pytest.approx(1.0, rel=2e-3)
    assert float(np.ptp(torque)) < 0.02
    assert float(np.sqrt(np.mean(neutral**2))) == pytest.approx(2.14, abs=0.02)


def test_modes_reach_the_controller(design: Design, four_leg: Simulator) -> None:
    """A current reference hands d and q over; the speed error makes a torque."""
    shape, wired = plain.shape_bytes(machine_of(design).flux), drive(design, "four-leg")
    current = replace(turning(300.0, 0.02), mode="current", reference_d=constant(-0.5))
    found = simulate(four_leg, wired, current, gains=gains(), shape=shape)
    np.testing.assert_array_equal(found.i_d_reference, -0.5)
    np.testing.assert_array_equal(found.i_q_reference, 1.0)
    assert float(np.mean(found.torque[-50:])) == pytest.approx(1.0, rel=5e-3)
    speed = replace(turning(300.0, 0.02), mode="speed", reference=constant(100.0))
    found = simulate(four_leg, wired, speed, gains=gains(), shape=shape)
    np.testing.assert_allclose(found.torque_reference, 0.01 * (100.0 - 10.0 * math.pi), rtol=1e-6)


@pytest.mark.slow
def test_header_of_three_legs_leaves_the_others_unconnected(design: Design) -> None:
    """As for machines with a sinusoidal back-EMF: nothing drives a neutral that it knows not of."""
    found = simulate_three_legs(design)
    assert found.shape[1] == 3
    assert np.ptp(found) > 0.01


def simulate_three_legs(design: Design) -> FloatArray:
    from dqforge.optimizer.solution import solve
    from dqforge.reports.control.header import control_files
    from dqforge.reports.main_header import header_files

    solution = solve(design)
    files = header_files(solution) | control_files(solution)
    with simulator(files, design.export.prefix) as program:
        run = simulate(program, drive(design, "four-leg"), turning(300.0, 0.02))
    assert run.phases is not None
    np.testing.assert_array_equal(run.phases.i_neutral, 0.0)
    assert float(np.mean(run.torque[-50:])) == pytest.approx(1.0, rel=0.02)
    return run.phases.duty_legs
