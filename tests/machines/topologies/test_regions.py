"""Voltage regions against the convex hulls of all switching states, and what they come to."""

from __future__ import annotations

import itertools
import math
from typing import get_args

import numpy as np
import pytest
from phase_shapes import FUNDAMENTAL_P, paper_machine, trapezoid_machine
from scipy.spatial import ConvexHull

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import (
    TOPOLOGIES,
    VOLTAGE_ROWS,
    link_demand,
    sine_share,
    voltage_bounds,
    voltage_reach,
)
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.waveforms.constraint_rows import figures, unit_currents

V_DC = 220.0
NAMES: tuple[Topology, ...] = get_args(Topology)


def phases_of(topology: Topology, states: FloatArray) -> FloatArray:
    """Phase voltages over V_dc of the switching states, written out by hand."""
    if topology in ("three-wire", "diode-neutral"):
        return states
    if topology == "split-capacitor":
        return states - 0.5
    return np.asarray(states[:, :3] - states[:, 3:])


LEGS: dict[Topology, int] = {
    "three-wire": 3,
    "diode-neutral": 3,
    "split-capacitor": 3,
    "four-leg": 4,
    "six-leg": 6,
    "six-leg-isolated": 6,
}


def hull_reach(topology: Topology, directions: FloatArray) -> FloatArray:
    """Largest multiples of directions (n, 3) within the hull of all states, in V_dc; without a
    neutral in the plane of the differences.
    """
    states = np.array(list(itertools.product((0.0, 1.0), repeat=LEGS[topology])))
    vertices = phases_of(topology, states)
    if not TOPOLOGIES[topology].neutral:
        plane = clarke_matrix(power_invariant=True)[:2]
        vertices, directions = vertices @ plane.T, directions @ plane.T
    facets = ConvexHull(np.unique(vertices, axis=0)).equations
    slopes = directions @ facets[:, :-1].T
    with np.errstate(divide="ignore"):
        return np.asarray(np.min(np.where(slopes > 0.0, -facets[:, -1] / slopes, np.inf), axis=1))


@pytest.mark.parametrize("topology", NAMES)
def test_region_is_the_convex_hull_of_all_states(topology: Topology) -> None:
    directions = np.random.default_rng(3).normal(size=(2000, 3))
    found = voltage_reach(directions, topology, V_DC)
    np.testing.assert_allclose(found, V_DC * hull_reach(topology, directions), rtol=1e-12)


def test_a_moved_midpoint_moves_the_region_of_a_split_link() -> None:
    low, high = voltage_bounds("split-capacitor", V_DC, np.array([80.0, 110.0]))
    np.testing.assert_allclose(low[:, :3], [[-80.0] * 3, [-110.0] * 3])
    np.testing.assert_allclose(high[:, :3], [[140.0] * 3, [110.0] * 3])
    assert np.all(np.isinf(high[:, 3:]))
    up, down = np.array([10.0, -1.0, 0.0]), np.array([-10.0, 1.0, 0.0])
    assert voltage_reach(up, "split-capacitor", V_DC, 80.0) == 14.0
    assert voltage_reach(down, "split-capacitor", V_DC, 80.0) == 8.0


@pytest.mark.parametrize("topology", NAMES)
def test_demand_and_reach_say_the_same(topology: Topology) -> None:
    waves = np.random.default_rng(4).normal(size=(20, 3, 30))
    reach = np.min(voltage_reach(np.swapaxes(waves, 1, 2), topology, 1.0), axis=-1)
    np.testing.assert_allclose(link_demand(waves, topology), 1.0 / reach, rtol=1e-14)
    low, high = voltage_bounds(topology, link_demand(waves, topology))
    rows = np.swapaxes(waves, 1, 2) @ VOLTAGE_ROWS.T
    room = np.minimum(high[:, np.newaxis] - rows, rows - low[:, np.newaxis])
    np.testing.assert_allclose(np.min(room, axis=(1, 2)), 0.0, atol=1e-12)


def test_no_voltage_reaches_without_end() -> None:
    assert voltage_reach(np.zeros(3), "six-leg", V_DC) == math.inf
    assert voltage_reach(np.ones(3), "three-wire", V_DC) == math.inf


@pytest.mark.parametrize(
    ("topology", "sine", "paper", "trapezoid"),
    [
        ("three-wire", 0.577, 0.589, 0.608),
        ("diode-neutral", 0.577, 0.589, 0.608),
        ("four-leg", 0.577, 0.589, 0.608),
        ("six-leg", 1.000, 1.111, 1.216),
        ("six-leg-isolated", 1.155, 1.178, 1.216),
        ("split-capacitor", 0.500, 0.556, 0.608),
    ],
)
def test_largest_fundamental_of_each_shape(
    topology: Topology, sine: float, paper: float, trapezoid: float
) -> None:
    shares = [
        machine.psi_pm / float(link_demand(machine.flux, topology))
        for machine in (paper_machine(), trapezoid_machine())
    ]
    np.testing.assert_allclose(shares, [paper, trapezoid], atol=6e-4)
    assert sine_share(topology) == pytest.approx(sine, abs=5e-4)
    theta = 2.0 * np.pi * (np.arange(3600) / 3600 - np.arange(3)[:, np.newaxis] / 3.0)
    assert 1.0 / link_demand(np.cos(theta), topology) == pytest.approx(
        sine_share(topology), rel=1e-6
    )


@pytest.mark.parametrize(
    ("topology", "dqx", "dqy"),
    [
        ("three-wire", 159.7, None),
        ("four-leg", 159.7, 161.7),
        ("six-leg", 86.2, 83.2),
        ("six-leg-isolated", 79.9, None),
        ("split-capacitor", 172.5, 166.4),
    ],
)
def test_dc_link_of_the_paper_machine(topology: Topology, dqx: float, dqy: float | None) -> None:
    """3.5 N m at 1800 rpm."""
    machine = paper_machine()
    assert machine.psi_pm == pytest.approx(FUNDAMENTAL_P, rel=1e-9)
    found = [link_of(machine, rule, topology) for rule in ("dqx", "dqy")]
    assert found[0] == pytest.approx(dqx, abs=0.06)
    assert dqy is None or found[1] == pytest.approx(dqy, abs=0.06)


def link_of(machine: PhaseMachine, rule: str, topology: Topology) -> float:
    currents = 3.5 * unit_currents(machine, "dqx" if rule == "dqx" else "dqy")
    omega_m = np.array([1800.0 * np.pi / 30.0])
    return float(figures(machine, currents[np.newaxis], omega_m, topology).bus[0])
