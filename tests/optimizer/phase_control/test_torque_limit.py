"""Where the link ends the torque: against the page's voltages, brute force and a dense grid."""

from __future__ import annotations

from functools import partial
from typing import get_args

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.names import Topology
from dqforge.optimizer.phase_control.phase_controller import (
    PhaseControl,
    largest_torques,
    limit_at,
    no_load_speed,
    torque_limit,
)

P, Z = near_sinusoidal(96), trapezoidal(96)
TOP = 2.0 * np.pi * 60.0  # 1800 rpm, two pole pairs


def link_of(voltages: np.ndarray, topology: Topology) -> float:
    """Least link of phase voltages, shape (3, N), from the states of the switches, in words."""
    largest = float(np.max(np.abs(voltages)))
    between = float(np.max(np.max(voltages, axis=0) - np.min(voltages, axis=0)))
    return {
        "three-wire": between,
        "diode-neutral": between,
        "four-leg": max(largest, between),
        "six-leg": largest,
        "six-leg-isolated": 0.5 * between,
        "split-capacitor": 2.0 * largest,
    }[topology]


def phase_voltages(
    control: PhaseControl, torque: float, omega: float, theta: np.ndarray
) -> np.ndarray:
    """The control law in phases, written out: shape (3, N)."""
    grid = 2.0 * np.pi * np.arange(97) / 96
    closed = np.append(control.shape.flux[0], control.shape.flux[0][0])
    neutral = control.topology in ("four-leg", "six-leg", "split-capacitor")

    def flux(angle: np.ndarray) -> np.ndarray:
        turns = [np.mod(angle - 2.0 * np.pi * k / 3.0, 2.0 * np.pi) for k in range(3)]
        return np.stack([np.interp(turn, grid, closed) for turn in turns])

    def current(angle: np.ndarray) -> np.ndarray:
        f = flux(angle)
        f = f if neutral else f - np.mean(f, axis=0)
        return np.asarray(torque * f / (control.pole_pairs * np.sum(f**2, axis=0)))

    step = omega * control.t_s
    first, second = current(theta + step), current(theta + 2.0 * step)
    change = (second - first) / control.t_s
    mutual = (control.inductances[2] - control.inductances[0]) / 3.0
    drop = control.inductances[0] * change + mutual * np.sum(change, axis=0)
    emf = omega * flux(theta + 1.5 * step)
    return np.asarray(0.5 * control.r_s * (first + second) + drop + emf)


@pytest.mark.parametrize(
    ("topology", "volts"),
    [("three-wire", 159.7), ("four-leg", 161.7), ("six-leg", 83.2), ("split-capacitor", 166.4)],
)
def test_links_for_a_torque_at_speed(topology: Topology, volts: float) -> None:
    """3.5 N m at 1800 rpm; the figures are those of paper 002's machine in continuous time."""
    control = plain_control(P, topology)
    at = partial(largest_torques, control, np.array([TOP]), margin=0.0)
    assert at(v_dc=volts + 0.6)[0] > 3.5 > at(v_dc=volts - 0.6)[0]


@pytest.mark.thinned
@pytest.mark.parametrize("machine", [P, Z], ids=["harmonics", "corners"])
@pytest.mark.parametrize("topology", get_args(Topology))
def test_limits_are_those_of_brute_force(topology: Topology, machine: object) -> None:
    control = plain_control(P if machine is P else Z, topology)
    theta = np.linspace(0.0, 2.0 * np.pi, 2881)[:-1]
    for omega in (0.7 * TOP, 1.2 * TOP):
        needed = [
            max(
                link_of(phase_voltages(control, sign * torque, omega, theta), topology)
                for sign in (1.0, -1.0)
            )
            for torque in np.linspace(0.0, control.torque_max, 101)
        ]
        # A link that ends the torque midway between none and the largest one.
        v_dc = 0.5 * (needed[0] + needed[-1])
        brute = control.torque_max / 100 * (int(np.flatnonzero(np.array(needed) <= v_dc)[-1]))
        found = largest_torques(control, np.array([omega]), v_dc, 0.0)[0]
        assert found == pytest.approx(brute, abs=control.torque_max / 95)


@pytest.mark.thinned
@pytest.mark.parametrize("topology", ["three-wire", "six-leg", "split-capacitor"])
def test_lines_between_nodes_promise_no_more_than_there_is(topology: Topology) -> None:
    control = plain_control(P, topology)
    largest = partial(largest_torques, control, margin=0.04)
    limit = torque_limit(220.0, no_load_speed(control, 220.0, 0.04), largest)
    assert limit.torque.size <= 90
    generator = np.random.default_rng(2)
    speeds = generator.uniform(0.0, 1.1 * limit.omega_e[-1], 300)
    for v_dc in generator.uniform(1.0, 260.0, 25):
        there, promised = largest(speeds, v_dc), limit_at(limit, speeds, np.full(300, v_dc))
        assert np.max(promised - there) < 5e-4 * control.torque_max
        if v_dc > 100.0:
            # Nor is much given away.
            assert np.mean(there - promised) < 0.02 * control.torque_max
    at_rest = limit_at(limit, np.zeros(1), np.array([220.0]))
    assert at_rest[0] == pytest.approx(control.torque_max)
