"""Chapter 4 of paper 002: its blocks against the machine in alpha, beta and 0, and what each
misprint makes of them.
"""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.phase_machines.frame_transforms import frame_model
from dqforge.reports.papers.paper002_bench_currents import bench_machine
from dqforge.reports.papers.paper002_compensation import (
    PLACES,
    Motion,
    ShapedMachine,
    agreement,
    block_voltages,
    check_model,
    compensation,
    frame_quantities,
    largest_shares,
    machine_by_chance,
    model_blocks,
    printed_blocks,
    shipped_machine,
    stationary_voltages,
    trapezoid_machine,
)

OMEGA_E = 1800.0 * np.pi / 30.0 * 2.0


@pytest.mark.parametrize(("l_s", "m_s"), [(7e-3, -1e-3), (2.3e-3, -0.7e-3), (4e-3, 1.5e-3)])
@pytest.mark.parametrize("seed", range(3))
def test_blocks_make_the_voltages_of_the_machine(seed: int, l_s: float, m_s: float) -> None:
    """1e-12 of the largest voltage, for phases that differ, even orders, any currents."""
    machine, motion = machine_by_chance(seed, l_s, m_s)
    even = np.abs(machine.shape + np.roll(machine.shape, 1, axis=0))
    assert np.max(even) > 0.1
    assert agreement(machine, motion, OMEGA_E) < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_blocks_are_the_entries_of_the_model(seed: int) -> None:
    machine, _ = machine_by_chance(seed, 7e-3, -1e-3)
    arrays = (machine.theta, machine.shape, machine.slope)
    model = frame_model("dqy", *arrays, machine.l_s, machine.m_s, scaled=True)
    blocks = model_blocks(frame_quantities(machine), machine.l_s, machine.m_s)
    assert len(blocks) == 9
    for name, (axis, cause) in PLACES.items():
        np.testing.assert_allclose(blocks[name], model.coupling[:, axis, cause], atol=1e-15)


@pytest.mark.parametrize("name", ["A", "C"])
def test_misprinted_blocks_miss_by_more_than_half_of_the_largest_voltage(name: str) -> None:
    machine, motion = machine_by_chance(1, 7e-3, -1e-3)
    voltages, moving = stationary_voltages(machine, motion[0], motion[1], OMEGA_E)
    frame = frame_quantities(machine)
    blocks = model_blocks(frame, machine.l_s, machine.m_s)
    wrong = blocks | {name: printed_blocks(frame, machine.l_s, machine.m_s)[name]}
    gap = np.abs(block_voltages(machine, moving, wrong) - voltages)
    assert np.max(np.max(gap, axis=0) / np.max(np.abs(voltages), axis=0)) > 0.55
    assert largest_shares(machine, moving)[name] > 0.55


def test_what_the_misprints_cost_the_shipped_drive() -> None:
    """At constant torque i_dy = 0, so that C costs nothing, and A three eighths of its block."""
    shipped = shipped_machine(bench_machine())
    found = check_model(shipped, 2, 3.5, OMEGA_E)
    assert found.agreement < 1e-12
    errors = [row.volts for row in found.misprints]
    largest = -compensation("", shipped, 2, 3.5, OMEGA_E).ranges["coupling_d"][0]
    assert errors[0] == pytest.approx(3.0 / 8.0 * largest, rel=1e-9)
    assert errors[1] == 0.0
    assert found.emf_error == pytest.approx(1.0 / 0.88235 - 1.0, abs=1e-4)
    assert found.reference_ripple == pytest.approx(0.21, abs=0.01)


def _machine(shape: str) -> ShapedMachine:
    machine = bench_machine()
    return shipped_machine(machine) if shape == "shipped" else trapezoid_machine(machine)


RANGES = {
    "shipped": {
        "a_x": (0.882, 0.918),
        "a_y": (0.870, 0.918),
        "theta_x": (-2.3, 2.3),
        "theta_y": (-99.45, -80.55),
        "turn": (0.765, 1.245),
        "theta_y_rate": (-0.52, 0.52),
        "growth": (-0.161, 0.161),
        "emf": (110.0, 122.5),
        "coupling_d": (-26.7, -16.2),
        "coupling_q": (-3.77, 3.77),
        "coupling_0": (-6.96, 6.96),
    },
    "trapezoid": {
        "a_x": (0.750, 0.866),
        "a_y": (0.707, 0.866),
        "theta_x": (-1.1, 1.1),
        "theta_y": (-109.5, -70.5),
        "turn": (0.827, 1.103),
        "theta_y_rate": (-0.78, 0.78),
        "growth": (-0.636, 0.636),
        "emf": (123.1, 184.6),
        "coupling_d": (-23.8, -16.8),
        "coupling_q": (-14.3, 14.3),
        "coupling_0": (-10.5, 10.5),
    },
}


@pytest.mark.parametrize("shape", RANGES)
def test_ranges_of_frames_and_compensation(shape: str) -> None:
    found = compensation(shape, _machine(shape), 2, 3.5, OMEGA_E).ranges
    for name, (least, largest) in RANGES[shape].items():
        size = max(abs(least), abs(largest))
        assert found[name][0] == pytest.approx(least, abs=0.02 * size), name
        assert found[name][1] == pytest.approx(largest, abs=0.02 * size), name


@pytest.mark.parametrize("shape", RANGES)
def test_compensation_is_the_voltage_that_constant_torque_needs(shape: str) -> None:
    """The terms of Figure 4.3 are all of the voltage but R i, and the back-EMF bears the power."""
    machine = _machine(shape)
    terms = compensation(shape, machine, 2, 3.5, OMEGA_E)
    currents = np.zeros_like(machine.shape)
    currents[1] = terms.i_qy
    motion = Motion(currents, np.zeros_like(currents), OMEGA_E)
    blocks = model_blocks(terms.frame, machine.l_s, machine.m_s)
    voltages = block_voltages(machine, motion, blocks) - machine.r_s * currents
    voltages[1] -= terms.emf
    np.testing.assert_allclose(voltages, terms.coupling, atol=1e-9)
    power = terms.frame.a_y**2 * terms.i_qy * terms.emf
    np.testing.assert_allclose(power, 3.5 * OMEGA_E / 2.0, rtol=1e-12)
