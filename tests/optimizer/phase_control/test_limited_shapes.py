"""Currents beyond the torque limit: torque, voltage and the seam to the plain ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control

from dqforge.machines.names import Topology
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.limited_shapes import (
    LimitedFit,
    fit_limited,
    limited_deviation,
    limited_torques,
)
from dqforge.optimizer.phase_control.phase_controller import (
    PhaseControl,
    flux_at,
    reference_currents,
)

MACHINE = near_sinusoidal(360)
MARGIN = 0.04
TOPOLOGIES = pytest.mark.parametrize(
    "topology", ["three-wire", pytest.param("four-leg", marks=pytest.mark.slow)]
)


@cache
def fitted(topology: Topology) -> tuple[PhaseControl, LimitedFit]:
    control = plain_control(near_sinusoidal(96), topology)
    found = fit_limited(control, MACHINE, 150.0, 5.94, 2.0 * np.pi * 60.0, MARGIN)
    assert found is not None
    return control, found


@TOPOLOGIES
def test_torque_and_voltage_between_the_nodes(topology: Topology) -> None:
    """On speeds, torques and angles of the test's own, in phases, by the law of the control."""
    control, found = fitted(topology)
    limited, t_s = found.shapes, control.t_s
    theta = np.linspace(0.0, 2.0 * np.pi, 301)[:-1]
    phases = np.linalg.inv(clarke_matrix())
    generator = np.random.default_rng(4)
    gained = []
    for omega in generator.uniform(limited.omega_e[0], limited.omega_e[-1], 12):
        plain, most = limited_torques(limited, omega, np.array(150.0))
        gained.append(float(most - plain))
        for share in (0.15, 0.6, 1.0):
            torque = np.array(plain + share * (most - plain))

            def current(
                angle: np.ndarray, torque: np.ndarray = torque, omega: float = omega
            ) -> np.ndarray:
                at = np.array(omega)
                away = limited_deviation(limited, 1, torque, at, np.array(150.0), angle)
                return torque * reference_currents(control, angle, at) + away

            f, i = flux_at(control.shape, theta), current(theta)
            made = control.pole_pairs * (1.5 * (f[0] * i[0] + f[1] * i[1]) + 3.0 * f[2] * i[2])
            assert np.max(np.abs(made - torque)) < 5e-3 * control.torque_max
            assert np.max(np.abs(phases @ i)) < 5.94 * 1.005
            first, second = current(theta + omega * t_s), current(theta + 2.0 * omega * t_s)
            l_ab, _, l_0 = control.inductances
            rise = np.array([[l_ab], [l_ab], [l_0]]) * (second - first) / t_s
            v = 0.5 * control.r_s * (first + second) + rise
            v = v + omega * flux_at(control.shape, theta + 1.5 * omega * t_s)
            if topology == "three-wire":
                v[2] = 0.0
                assert np.max(np.abs(i[2])) < 1e-9
            v = phases @ v
            spread = np.max(v, axis=0) - np.min(v, axis=0)
            assert np.max(spread) <= (1.0 - MARGIN) * 150.0 * (1.0 + max(found.excess, 0.0) + 2e-3)
    assert np.mean(gained) > 0.2 * control.torque_max


@TOPOLOGIES
def test_the_seam_to_the_plain_currents(topology: Topology) -> None:
    control, found = fitted(topology)
    limited = found.shapes
    theta = np.linspace(0.0, 6.2, 50)
    knee, link = np.array(limited.omega_e[0]), np.array(150.0)
    at_knee = limited_deviation(limited, 1, np.array(control.torque_max), knee, link, theta)
    assert np.max(np.abs(at_knee)) < 1e-12
    below = limited_deviation(limited, 1, np.array(9.0), 0.5 * knee, link, theta)
    assert np.max(np.abs(below)) == 0.0
    # Up to the plain limit the currents stay in proportion to the torque.
    omega = np.array(0.5 * (limited.omega_e[0] + limited.omega_e[1]))
    plain, _ = limited_torques(limited, omega, link)
    still = limited_deviation(limited, 1, 0.9 * plain, omega, link, theta)
    assert np.max(np.abs(still)) < 1e-9
    # At a higher link the same currents come at a higher speed.
    slow = limited_deviation(limited, 1, np.array(3.0), np.array(380.0), link, theta)
    fast = limited_deviation(limited, 1, np.array(3.0), np.array(456.0), 1.2 * link, theta)
    assert np.max(np.abs(slow)) > 0.1
    assert fast == pytest.approx(slow, abs=1e-9)


@TOPOLOGIES
def test_beyond_the_last_speed_nothing_is_promised(topology: Topology) -> None:
    _, found = fitted(topology)
    last = found.shapes.omega_e[-1]
    _, beyond = limited_torques(found.shapes, np.array(1.3 * last), np.array(150.0))
    assert beyond == 0.0
    # At a lower link that is a lower speed.
    _, beyond = limited_torques(found.shapes, np.array(0.9 * last), np.array(120.0))
    assert beyond == 0.0


@TOPOLOGIES
def test_reverse_motoring_is_the_mirror(topology: Topology) -> None:
    _, found = fitted(topology)
    theta = np.linspace(0.0, 6.2, 50)
    link = np.array(150.0)
    ahead = limited_deviation(found.shapes, 1, np.array(3.0), np.array(380.0), link, theta)
    back = limited_deviation(found.shapes, 1, np.array(-3.0), np.array(-380.0), link, -theta)
    assert np.max(np.abs(ahead)) > 0.1
    assert back == pytest.approx(ahead * np.array([[1.0], [-1.0], [1.0]]), abs=1e-9)
