"""Matsui's estimators on simulated drives: convergence with the stated poles, closed-form errors,
refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM
from scipy.linalg import expm

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers.methods.matsui_model import (
    Matsui,
    MatsuiModel,
    closed_form_error,
    errors_of,
    least_speed,
    matsui,
    run,
    steady_error,
    with_errors,
)
from dqforge.optimizer.observers.sampled_machine import simulate

T_S = 200e-6
POLE = 200.0
BOTH: tuple[MatsuiModel, ...] = ("voltage", "current")


@pytest.mark.thinned
@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("case", ["forwards", "backwards", "fast", "salient"])
def test_wrong_start_decays_to_nothing(
    bench001: LinearMachine, kind: MatsuiModel, case: str
) -> None:
    machine, speed, current = {
        "forwards": (bench001, 600.0, [0.0, 2.0]),
        "backwards": (bench001, -600.0, [0.0, 2.0]),
        "fast": (bench001, 1500.0, [0.0, 2.0]),
        "salient": (IPM, 1000.0, [-80.0, 100.0]),
    }[case]
    observer = matsui(machine, T_S, kind, POLE)
    trial = simulate(machine, T_S, np.full((500, 1), speed), np.array(current))
    result = run(observer, trial, theta_error=0.3, omega_error=30.0)
    assert abs(result.angle_error(trial)[-1, 0]) < 5e-3
    assert abs((result.omega - trial.omega)[-1, 0]) < 1.0


@pytest.mark.parametrize("damping", [0.7, 1.0, 1.5])
def test_poles_of_the_voltage_model_are_where_they_were_put(
    bench001: LinearMachine, damping: float
) -> None:
    observer = matsui(bench001, T_S, "voltage", POLE, damping=damping, speed_bandwidth=400.0)
    wanted = np.exp(np.roots([1.0, 2.0 * damping * POLE, POLE**2]) * T_S)
    for pole in [*wanted, np.exp(-400.0 * T_S)]:
        assert np.min(np.abs(observer.poles - pole)) < 1e-6


@pytest.mark.parametrize("kind", BOTH)
def test_exact_poles_lie_near_the_design(bench001: LinearMachine, kind: MatsuiModel) -> None:
    """The linearised sampled loop, by differences of the estimator's own step,
    agrees with the simple loop.
    """
    slow = replace(bench001, l_d=bench001.l_q)
    observer = matsui(slow, 20e-6, kind, POLE, speed_bandwidth=600.0, damping=1.5, omega_min=5.0)
    _, found = steady_error(observer, slow, 600.0, (0.0, 1.0))
    for pole in observer.poles:
        assert np.min(np.abs(found - pole)) < 3e-4


@pytest.mark.parametrize("kind", BOTH)
def test_small_errors_decay_with_the_slowest_pole(
    bench001: LinearMachine, kind: MatsuiModel
) -> None:
    observer = matsui(bench001, T_S, kind, POLE, speed_bandwidth=800.0, damping=1.5)
    trial = simulate(bench001, T_S, np.full((300, 2), 600.0), np.array([0.0, 1.0]))
    moved = run(observer, trial, theta_error=0.01).theta - run(observer, trial).theta
    _, poles = steady_error(observer, bench001, 600.0, (0.0, 1.0))
    assert np.all(np.abs(poles) < 1.0)
    assert moved[220, 0] / moved[200, 0] == pytest.approx(abs(poles[0]) ** 20, rel=0.01)


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize(
    "errors", [{"r_s": 0.01}, {"l_d": 0.02, "l_q": 0.02}, {"psi_pm": -0.003}, {"l_q": 0.02}]
)
@pytest.mark.parametrize("salient", [False, True])
def test_parameter_errors_cost_what_the_closed_form_says(
    bench001: LinearMachine, kind: MatsuiModel, errors: dict[str, float], salient: bool
) -> None:
    machine = replace(IPM, r_s=0.05) if salient else replace(bench001, l_d=1.7e-3, l_q=1.7e-3)
    t_s, i_dq = (5e-5, (-80.0, 100.0)) if salient else (2e-5, (-1.0, 2.0))
    observer = matsui(with_errors(machine, **errors), t_s, kind, 400.0)
    exact, poles = steady_error(observer, machine, 600.0, i_dq)
    closed = closed_form_error(observer, machine, 600.0, i_dq)
    assert abs(poles[0]) < 1.0
    assert exact.theta == pytest.approx(closed.theta, rel=0.1, abs=1e-4)
    assert exact.omega == pytest.approx(closed.omega, rel=0.1, abs=0.05)


@pytest.mark.thinned
@pytest.mark.parametrize("kind", BOTH)
def test_exact_steady_error_is_where_a_simulation_ends(
    bench001: LinearMachine, kind: MatsuiModel
) -> None:
    wrong = with_errors(bench001, r_s=0.2, l_q=0.2, l_d=0.2)
    observer = matsui(wrong, T_S, kind, POLE)
    trial = simulate(bench001, T_S, np.full((1200, 1), 600.0), np.array([0.0, 2.0]))
    result = run(observer, trial)
    exact, _ = steady_error(
        observer, bench001, 600.0, (float(trial.i_dq[-1, 0, 0]), float(trial.i_dq[-1, 0, 1]))
    )
    assert result.angle_error(trial)[-1, 0] == pytest.approx(exact.theta, abs=1e-4)


def test_resistance_does_not_turn_the_voltage_model_without_d_current(
    bench001: LinearMachine,
) -> None:
    surface = replace(bench001, l_d=bench001.l_q)
    believed = with_errors(surface, r_s=0.3)
    assert (
        closed_form_error(matsui(believed, T_S, "voltage", POLE), surface, 600.0, (0.0, 2.0)).theta
        == 0.0
    )
    off = closed_form_error(matsui(believed, T_S, "current", POLE), surface, 600.0, (0.0, 2.0))
    assert off.omega == pytest.approx(-0.3 * 2.35 * 2.0 / 0.06)


def test_least_speed(bench001: LinearMachine) -> None:
    observer = matsui(replace(bench001, l_d=bench001.l_q), T_S, "voltage", POLE, omega_min=5.0)
    assert least_speed(observer, (0.0, 2.0), 1.0, 0.1) == pytest.approx(1.0 / (0.06 * 0.1))
    assert least_speed(observer, (0.0, 2.0), 0.001, 0.1) == 5.0
    current = matsui(bench001, T_S, "current", 1000.0)
    assert least_speed(current, (0.0, 2.0), 1.0, 0.1) > 1.0 / (0.06 * 0.1)
    with pytest.raises(NoSolutionError, match="faster control"):
        least_speed(matsui(bench001, T_S, "current", 20.0), (0.0, 2.0), 1.0, 0.1)


def test_refusals(bench001: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match="psi_pm is 0"):
        matsui(replace(bench001, psi_pm=0.0), T_S, "voltage", POLE)
    with pytest.raises(InputError, match=r"pole t_s = 1"):
        matsui(bench001, T_S, "current", 6000.0)
    observer: Matsui = matsui(bench001, T_S, "current", POLE)
    assert observer.poles[0] == pytest.approx(np.exp(-POLE * T_S))


@pytest.mark.parametrize("kind", BOTH)
def test_errors_of_a_period_are_those_of_the_voltage_that_is_missing(kind: MatsuiModel) -> None:
    """Salient, any currents and voltage: the voltage that the currents miss, by the matrix
    exponential, turned to the middle of the period, along and across the active flux.
    """
    generator = np.random.default_rng(7)
    observer = matsui(IPM, T_S, kind, POLE, omega_min=90.0, omega_max=1000.0)
    active_d = IPM.l_d - IPM.l_q
    for omega in (-700.0, 30.0, 500.0):
        i, v, i_next = 80.0 * generator.standard_normal((3, 2))
        inductances, emf = np.array([IPM.l_d, IPM.l_q]), np.array([0.0, omega * IPM.psi_pm])
        crossed = omega * np.array([[0.0, IPM.l_q], [-IPM.l_d, 0.0]])
        whole = np.zeros((6, 6))
        whole[:2, :2] = (crossed - IPM.r_s * np.eye(2)) / inductances[:, None]
        whole[:2, 2:4] = whole[:2, 4:] = np.diag(1.0 / inductances)
        whole[2:4, 2:4] = omega * np.array([[0.0, 1.0], [-1.0, 0.0]])  # held in the stator
        moved = expm(whole * T_S)[:2]
        gap = i_next - moved @ [*i, *v, *-emf]
        # The voltage goes on from the beginning of the period to its middle, currents go back.
        way = (-0.5 if kind == "voltage" else 0.5) * omega * T_S
        turn = np.array([[np.cos(way), -np.sin(way)], [np.sin(way), np.cos(way)]])
        if kind == "voltage":
            of_d, of_q = -turn @ np.linalg.solve(moved[:, 2:4], gap)
        else:
            of_d, of_q = (turn @ gap) * IPM.r_s / np.expm1(-IPM.r_s * T_S / inductances)
        along, across = IPM.psi_pm + active_d * i_next[0], active_d * i_next[1]
        square = along**2 + across**2
        speed = (along * of_q + across * of_d) / square
        angle = (across * of_q - along * of_d) / square * omega / (omega**2 + 90.0**2)
        found = errors_of(observer, np.array(omega), i, v, i_next)
        np.testing.assert_allclose(found, [angle, speed], rtol=5e-3, atol=3e-4)
