"""The pulses' own neutral current against switched potentials, and the figures that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from phase_shapes import paper_machine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.ripple import flux_moments, switching_instants
from dqforge.machines.names import Topology
from dqforge.machines.topologies import duty_cycles, neutral_ripple, phase_voltages
from dqforge.optimizer.waveforms.constraint_rows import unit_currents

V_DC, T_S, L_0 = 220.0, 1e-4, 5e-3
WITH_NEUTRAL: tuple[Topology, ...] = ("four-leg", "split-capacitor", "six-leg")


def voltages_at(rpm: float, angles: int = 360) -> FloatArray:
    """Phase voltages of dqy at 1 N m in V, shape (3, angles)."""
    machine = paper_machine(angles)
    omega_e = machine.pole_pairs * rpm * np.pi / 30.0
    return machine.voltage(unit_currents(machine, "dqy"), omega_e)


def ripple_of(topology: Topology, rpm: float) -> float:
    wave = voltages_at(rpm)
    return float(neutral_ripple(topology, wave, v_dc=V_DC, t_s=T_S, l_0=L_0))


@pytest.mark.parametrize("topology", WITH_NEUTRAL)
@pytest.mark.parametrize("rpm", [75.0, 750.0, 1800.0])
def test_neutral_current_of_switched_potentials(topology: Topology, rpm: float) -> None:
    """L_0 di_0/dt = v_0 integrated from one switching instant to the next, angle by angle."""
    wave = voltages_at(rpm, 36)
    squares = [
        switched_square(topology, duty, volts)
        for duty, volts in zip(duty_cycles(topology, wave.T, V_DC), wave.T, strict=True)
    ]
    found = float(neutral_ripple(topology, wave, v_dc=V_DC, t_s=T_S, l_0=L_0))
    assert found == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-9)


def switched_square(topology: Topology, duty: FloatArray, wanted: FloatArray) -> float:
    """Mean square of the neutral current of one carrier period in A^2."""
    edges = switching_instants(duty, T_S)
    times = np.unique(np.concatenate([[0.0, T_S], edges.ravel()]))
    middle = 0.5 * (times[1:] + times[:-1])[:, np.newaxis]
    states = ((middle > edges[:, 0]) & (middle < edges[:, 1])).astype(np.float64)
    excess = np.mean(phase_voltages(topology, states, V_DC), axis=-1) - np.mean(wanted)
    steps = np.diff(times)
    current = np.concatenate([[0.0], np.cumsum(3.0 * excess * steps / L_0)])
    assert abs(current[-1]) < 1e-10
    start, end = current[:-1], current[1:]
    return float(np.sum(steps * (start**2 + start * end + end**2)) / (3.0 * T_S))


@pytest.mark.parametrize(
    ("topology", "printed"),
    [
        ("four-leg", (0.006, 0.109, 0.386)),
        ("split-capacitor", (0.951, 0.883, 0.622)),
        ("six-leg", (0.004, 0.029, 0.072)),
        ("three-wire", (0.0, 0.0, 0.0)),
        ("diode-neutral", (0.0, 0.0, 0.0)),
        ("six-leg-isolated", (0.0, 0.0, 0.0)),
    ],
)
def test_figures_of_the_paper_machine(
    topology: Topology, printed: tuple[float, float, float]
) -> None:
    found = [ripple_of(topology, rpm) for rpm in (75.0, 750.0, 1800.0)]
    np.testing.assert_allclose(found, printed, atol=6e-4)


def test_split_link_without_voltage_has_the_closed_form() -> None:
    none = np.zeros((3, 12))
    found = float(neutral_ripple("split-capacitor", none, v_dc=V_DC, t_s=T_S, l_0=L_0))
    assert found == pytest.approx(math.sqrt(3.0) / 8.0 * V_DC * T_S / L_0, rel=1e-14)
    assert found == pytest.approx(0.953, abs=5e-4)


def test_a_moved_midpoint_changes_the_pulses() -> None:
    wave = voltages_at(750.0, 24)
    link = {"v_dc": V_DC, "t_s": T_S, "l_0": L_0}
    half = neutral_ripple("split-capacitor", wave, v_m=110.0, **link)
    assert half == neutral_ripple("split-capacitor", wave, **link)
    moved = neutral_ripple("split-capacitor", wave, v_m=np.full(24, 60.0), **link)
    assert 0.0 < moved < 0.95 * half


def test_moments_of_any_number_of_legs_are_those_of_each_pair() -> None:
    duty = np.random.default_rng(8).uniform(size=(5, 6))
    moments = flux_moments(duty)
    assert moments.shape == (5, 6, 6)
    for first, second in ((0, 1), (2, 5), (4, 4)):
        pair = flux_moments(duty[:, [first, second]])
        np.testing.assert_array_equal(moments[:, first, second], pair[:, 0, 1])
