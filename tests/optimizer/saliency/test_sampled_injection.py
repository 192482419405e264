"""Saliency tracking on simulated drives: standstill, speed, noise, cross saturation
against brute force, refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, RELUCTANCE
from scipy.integrate import solve_ivp

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers.sampled_machine import CurrentSensor
from dqforge.optimizer.saliency.inform import track
from dqforge.optimizer.saliency.sampled_injection import (
    admittance,
    angle_noise,
    cross_saturation_error,
    highest_speed,
    injection,
    speed_error,
    usable_saliency,
)

T_S = 1e-4


@pytest.mark.thinned
@pytest.mark.parametrize("machine", [IPM, RELUCTANCE])
@pytest.mark.parametrize("samples", [2, 8])
@pytest.mark.parametrize("omega", [0.0, 40.0])
def test_angle_is_found_at_standstill_and_low_speed(
    machine: LinearMachine, samples: int, omega: float
) -> None:
    tracker = injection(machine, T_S, 60.0, 120.0, samples=samples)
    result, trial = track(tracker, machine, np.full((900, 1), omega), (-5.0, 10.0), theta_error=0.4)
    error = result.angle_error(trial)[:, 0]
    assert abs(error[-1] - speed_error(machine, tracker, omega)) < np.radians(0.06)
    assert abs((result.omega - trial.omega)[-1, 0]) < 0.1


@pytest.mark.parametrize("samples", [2, 4, 16])
def test_error_decays_with_the_slowest_pole(samples: int) -> None:
    tracker = injection(IPM, T_S, 60.0, 120.0, samples=samples, damping=1.5)
    result, trial = track(tracker, IPM, np.zeros((600, 1)), (0.0, 0.0), theta_error=0.02)
    error = result.angle_error(trial)[:, 0]
    assert error[540] / error[500] == pytest.approx(abs(tracker.poles[0]) ** 40, rel=0.02)


def test_admittance_is_the_steady_state_of_an_integration() -> None:
    """Held cosine voltages on the d axis, integrated until only the injected frequency is left."""
    machine, samples = replace(IPM, r_s=0.5), 8
    y = admittance(machine, T_S, samples)
    i, rows = 0.0, []
    for k in range(60 * samples):
        rows.append(i)
        volts = np.cos(2.0 * np.pi * k / samples)
        i = solve_ivp(
            lambda _, x, u=volts: (u - machine.r_s * x) / machine.l_d, (0.0, T_S), [i], rtol=1e-10
        ).y[0, -1]
    last = np.array(rows[-samples:])
    phasor = 2.0 * np.mean(last * np.exp(-2j * np.pi * np.arange(samples) / samples))
    assert phasor == pytest.approx(complex(y[0, 0]), rel=1e-5)
    assert y[0, 1] == 0.0


@pytest.mark.thinned
@pytest.mark.parametrize("samples", [2, 8])
def test_noise_of_the_angle(samples: int) -> None:
    tracker = injection(IPM, T_S, 60.0, 120.0, samples=samples)
    sensor = CurrentSensor(12, 300.0, 0.3)
    result, trial = track(tracker, IPM, np.zeros((1300, 60)), (0.0, 20.0), sensor=sensor)
    spread = float(np.std(result.angle_error(trial)[300:]))
    assert spread == pytest.approx(angle_noise(tracker, float(np.sqrt(sensor.variance))), rel=0.06)


def test_coupling_at_speed_is_what_a_simulation_shows() -> None:
    machine = replace(IPM, r_s=0.3)
    tracker = injection(machine, T_S, 60.0, 120.0, samples=8)
    result, trial = track(tracker, machine, np.full((900, 1), 300.0), (0.0, 0.0))
    assert result.angle_error(trial)[-8:, 0].mean() == pytest.approx(
        speed_error(machine, tracker, 300.0), rel=0.1
    )


def test_cross_saturation_error_is_where_the_high_frequency_current_has_no_q_part() -> None:
    """Brute force: turn the injected flux around until the current responds along it only."""
    machine = catalogue.load("abb-syrm-6k7-saturated").machine
    i_d, i_q = np.array([12.0]), np.array([9.0])
    found = float(cross_saturation_error(machine, i_d, i_q)[0])
    jet = machine.jet(i_d, i_q)
    matrix = np.array([[jet.l_dd[0], jet.l_dq[0]], [jet.l_qd[0], jet.l_qq[0]]])
    angles = np.linspace(-np.pi / 4, np.pi / 4, 200_001)
    along = np.stack([np.cos(angles), np.sin(angles)])
    response = np.linalg.solve(matrix, along)
    across = -np.sin(angles) * response[0] + np.cos(angles) * response[1]
    inside = np.flatnonzero(np.diff(np.sign(across)))
    assert len(inside) == 1
    assert abs(found) > np.radians(0.5)
    assert found == pytest.approx(angles[inside[0]], abs=2e-5)
    relative = float(usable_saliency(machine, i_d, i_q)[0])
    eigenvalues = np.linalg.eigvalsh(matrix)
    assert relative == pytest.approx(
        (eigenvalues[1] - eigenvalues[0]) / np.sum(eigenvalues), rel=1e-6
    )


def test_no_cross_saturation_no_error() -> None:
    for machine in (IPM, RELUCTANCE):
        np.testing.assert_array_equal(
            cross_saturation_error(machine, np.array([-5.0]), np.array([8.0])), 0.0
        )


def test_range() -> None:
    tracker = injection(IPM, T_S, 60.0, 120.0, samples=8)
    most = highest_speed(IPM, tracker, 280.0, np.radians(2.0))
    assert 0.0 < most <= 2.0 * np.pi * 1250.0 / 10.0
    assert abs(speed_error(IPM, tracker, most)) <= np.radians(2.0)
    assert highest_speed(IPM, tracker, 80.0, np.radians(2.0)) == pytest.approx(
        20.0 / 0.1049, rel=1e-3
    )
    assert tracker.frequency == pytest.approx(1250.0)


def test_refusals(bench001: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match="l_q to differ"):
        injection(replace(bench001, l_d=bench001.l_q), T_S, 10.0, 50.0)
    with pytest.raises(InputError, match="samples per period"):
        injection(IPM, T_S, 10.0, 50.0, samples=3)
    with pytest.raises(InputError, match="voltage must be positive"):
        injection(IPM, T_S, 0.0, 50.0)
    with pytest.raises(InputError, match="pole must lie"):
        injection(IPM, T_S, 10.0, 2e4)
    with pytest.raises(NoSolutionError, match="too fast for an average"):
        injection(IPM, T_S, 10.0, 5000.0, samples=16)
    with pytest.raises(NoSolutionError, match=r"inject [0-9.]+ V or more"):
        injection(IPM, T_S, 10.0, 120.0, current_noise=1.0)
