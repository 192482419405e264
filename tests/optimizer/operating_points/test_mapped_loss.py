"""Least total loss and budgets with a loss map over the currents, against the machine whose iron
loss is a formula, a fine grid of currents, and SciPy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.loss_map import LossMap
from dqforge.machines.losses.machine_budget import MachineLoss, machine_budget
from dqforge.optimizer.operating_points.points import (
    copper_only,
    drive_losses,
    loss_coefficients,
    optimal_points,
)

MACHINE = LinearMachine(pole_pairs=4, r_s=0.05, l_d=0.3e-3, l_q=0.7e-3, psi_pm=0.08, i_max=150.0)
FORMULA = MachineLoss(hysteresis=60.0, eddy=0.05)
OMEGA = 2.0 * np.pi * 200.0
AXIS = np.linspace(-160.0, 160.0, 17)
VOLTS = 200.0


def whole(i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hysteresis, eddy and magnet loss in W at OMEGA that no |psi|^2 makes: the armature's own
    field heats teeth and magnets. Polynomials of third degree: the splines are exact.
    """
    along, across = i_d / 150.0, i_q / 150.0
    first = 60.0 + 20.0 * along + 80.0 * along**2 + 30.0 * across**2
    second = 90.0 + 40.0 * along + 140.0 * along**2 + 60.0 * across**2 + 25.0 * along * across**2
    return first, second, 30.0 * (along + 0.3) ** 2 + 20.0 * across**2


def mapped(first: FloatArray, second: FloatArray, magnet: FloatArray | None = None) -> LossMap:
    of_magnets = None if magnet is None else FluxMap(AXIS, AXIS, magnet, 0.0 * magnet)
    return LossMap(FluxMap(AXIS, AXIS, first, second), of_magnets, OMEGA)


GRID = np.meshgrid(AXIS, AXIS, indexing="ij")
OTHER = MachineLoss(mapped=mapped(*whole(*GRID)))


def same_as_formula() -> MachineLoss:
    psi_d, psi_q = MACHINE.flux(*GRID)
    square = psi_d**2 + psi_q**2
    loss = mapped(FORMULA.hysteresis * OMEGA * square, FORMULA.eddy * OMEGA**2 * square)
    return replace(FORMULA, mapped=loss)


def points(count: int) -> tuple[FloatArray, FloatArray]:
    generator = np.random.default_rng(1)
    return generator.uniform(-55.0, 55.0, count), generator.uniform(-700.0, 700.0, count)


def lost(i_d: FloatArray, i_q: FloatArray, omega_m: FloatArray) -> FloatArray:
    """Copper and mapped loss in W, written out."""
    share = np.abs(omega_m) * MACHINE.pole_pairs / OMEGA
    first, second, magnet = whole(i_d, i_q)
    copper = 1.5 * MACHINE.r_s * (i_d**2 + i_q**2)
    return np.asarray(copper + first * share + (second + magnet) * share**2)


def test_a_map_of_the_formula_gives_its_currents_and_budgets() -> None:
    torque, omega_m = points(400)
    extra = same_as_formula()
    found, wanted = (
        optimal_points(
            MACHINE, torque, omega_m, v_max=VOLTS, loss=loss_coefficients(MACHINE, omega_m, extra=e)
        )
        for e in (extra, FORMULA)
    )
    for name in ("i_d", "i_q", "loss", "active"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=1e-9)
    assert found.kkt_residual.max() < 1e-8
    by_map, by_formula = (
        machine_budget(MACHINE, found.i_d, found.i_q, omega_m, loss=e) for e in (extra, FORMULA)
    )
    for name in ("copper", "iron", "magnet", "i_d", "i_q", "v_d", "v_q"):
        np.testing.assert_allclose(
            getattr(by_map, name), getattr(by_formula, name), rtol=1e-10, atol=1e-9
        )


def test_power_at_the_terminals_is_losses_and_shaft_power() -> None:
    torque, omega_m = points(200)
    found = optimal_points(MACHINE, torque, omega_m, v_max=VOLTS)
    budget = machine_budget(MACHINE, found.i_d, found.i_q, omega_m, loss=OTHER)
    given = 1.5 * (budget.v_d * budget.i_d + budget.v_q * budget.i_q)
    spent = budget.copper + budget.iron + budget.magnet + budget.shaft_power
    np.testing.assert_allclose(given, spent, rtol=1e-10, atol=1e-8)
    assert budget.magnet.max() > 20.0


def test_a_still_machine_loses_copper_alone() -> None:
    still = np.zeros(1)
    budget = machine_budget(MACHINE, still - 20.0, still + 30.0, still, loss=OTHER)
    assert (budget.iron[0], budget.magnet[0], budget.i_q[0]) == (0.0, 0.0, 30.0)


def test_gradient_and_hessian_are_those_of_differences() -> None:
    generator = np.random.default_rng(2)
    i_d, i_q, omega = (generator.uniform(-150.0, 150.0, 50) for _ in range(3))
    loss = OTHER.mapped
    assert loss is not None
    jet = loss.jet(i_d, i_q, 20.0 * omega)
    assert np.allclose(jet.value, sum(loss.losses(i_d, i_q, 20.0 * omega)))
    h = 1e-3
    for first, second, names in ((h, 0.0, ("d", "dd", "dq")), (0.0, h, ("q", "dq", "qq"))):
        up, down = (loss.jet(i_d + s * first, i_q + s * second, 20.0 * omega) for s in (1.0, -1.0))
        for name, of in zip(names, ("value", "d", "q"), strict=True):
            slope = (getattr(up, of) - getattr(down, of)) / (2.0 * h)
            np.testing.assert_allclose(getattr(jet, name), slope, rtol=1e-6, atol=1e-6)


def test_least_loss_is_the_best_of_a_fine_grid() -> None:
    """Rays of i_d, on each of which the torque fixes i_q: no current that makes the torque loses
    less, and the best of the grid lies where the solver is.
    """
    torque, omega_m = points(60)
    found = optimal_points(
        MACHINE, torque, omega_m, v_max=1e4, loss=loss_coefficients(MACHINE, omega_m, extra=OTHER)
    )
    assert found.reached.all()
    assert found.kkt_residual.max() < 1e-8
    i_d = np.linspace(-150.0, 100.0, 12_501)
    per_ampere = 1.5 * MACHINE.pole_pairs * (MACHINE.psi_pm + (MACHINE.l_d - MACHINE.l_q) * i_d)
    i_q = torque[:, np.newaxis] / per_ampere
    loss = lost(i_d[np.newaxis], i_q, omega_m[:, np.newaxis])
    best, rows = np.argmin(loss, axis=1), np.arange(torque.size)
    np.testing.assert_allclose(found.loss, loss[rows, best], rtol=1e-6)
    np.testing.assert_allclose(found.i_d, i_d[best], atol=0.02)
    copper = optimal_points(MACHINE, torque, omega_m, v_max=1e4, loss=copper_only(MACHINE))
    saved = lost(copper.i_d, copper.i_q, omega_m) - found.loss
    assert saved.min() > -1e-9
    assert saved.max() > 5.0


@pytest.mark.slow
def test_least_loss_within_the_voltage_agrees_with_slsqp() -> None:
    torque, omega_m = points(60)
    found = optimal_points(
        MACHINE, torque, omega_m, v_max=80.0, loss=loss_coefficients(MACHINE, omega_m, extra=OTHER)
    )
    checked = 0
    for k in np.flatnonzero(found.reached):
        omega = MACHINE.pole_pairs * omega_m[k]

        def room(i: FloatArray, omega: float = omega) -> float:
            psi_d, psi_q = MACHINE.flux(i[0], i[1])
            v_d, v_q = MACHINE.r_s * i[0] - omega * psi_q, MACHINE.r_s * i[1] + omega * psi_d
            return float(1.0 - (v_d**2 + v_q**2) / 80.0**2)

        def made(i: FloatArray, k: int = int(k)) -> float:
            return float(MACHINE.torque(i[0], i[1]) - torque[k])

        best = minimize(
            lambda i, k=k: float(lost(i[0], i[1], omega_m[k])) / 100.0,
            np.array([found.i_d[k] + 4.0, found.i_q[k] + 3.0]),
            method="SLSQP",
            constraints=[{"type": "ineq", "fun": room}, {"type": "eq", "fun": made}],
            options={"ftol": 1e-12, "maxiter": 300},
        )
        if best.success:
            checked += 1
            assert 100.0 * best.fun == pytest.approx(found.loss[k], rel=1e-6)
    assert checked > 20, (checked, found.reached.sum())
    assert np.count_nonzero(found.active[found.reached] == 1) >= 5


def test_losses_of_a_drive_are_what_was_minimised() -> None:
    from drives import MOSFET

    from dqforge.machines.devices.inverter import Inverter

    torque, omega_m = points(20)
    loss = loss_coefficients(MACHINE, omega_m, extra=OTHER)
    found = optimal_points(MACHINE, torque, omega_m, v_max=VOLTS, loss=loss)
    bare = replace(Inverter(400.0, 10e3, MOSFET, 60.0), device=None)
    shown = drive_losses(MACHINE, bare, found.i_d, found.i_q, omega_m, extra=OTHER)
    np.testing.assert_allclose(shown.total, found.loss, rtol=1e-12)


def test_a_loss_that_a_spline_takes_below_zero_counts_as_zero() -> None:
    loss = mapped(GRID[0], 0.0 * GRID[0])
    zero = np.zeros(1)
    assert loss.losses(zero - 10.0, zero, zero + OMEGA)[0][0] == 0.0
    assert loss.jet(zero - 10.0, zero, zero + OMEGA).d[0] == 0.0


@pytest.mark.slow
def test_a_bumpy_loss_of_a_saturated_machine_against_its_torque_curves() -> None:
    """Along the curve of each torque, i_q by interpolation on a fine line for each of many i_d."""
    axis = np.linspace(-160.0, 160.0, 33)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    psi_d = 0.08 + 0.03 * np.arctan(d / 80.0) * np.cos(q / 300.0) + 1e-5 * d
    machine = SaturatedMachine(
        4, 0.05, FluxMap(axis, axis, psi_d, 0.09 * np.arctan(q / 120.0) + 1e-5 * q), 150.0
    )
    first, second, _ = whole(d, q)
    first = first + 5.0 * np.cos(d / 25.0) * np.cos(q / 30.0)
    second = second + 5.0 * np.sin(d / 30.0) * np.cos(q / 25.0)
    loss = LossMap(FluxMap(axis, axis, first, second), None, OMEGA)
    generator = np.random.default_rng(5)
    torque, omega_m = generator.uniform(2.0, 50.0, 40), generator.uniform(20.0, 400.0, 40)
    extra = MachineLoss(mapped=loss)
    found = optimal_points(
        machine, torque, omega_m, v_max=90.0, loss=loss_coefficients(machine, omega_m, extra=extra)
    )
    i_d, line = np.linspace(-150.0, 0.0, 601), np.linspace(0.0, 150.0, 601)
    along, across = np.meshgrid(i_d, line, indexing="ij")
    made = machine.torque(along, across)
    checked = 0
    for k in np.flatnonzero(found.reached):
        i_q = np.array([np.interp(torque[k], row, line, right=np.nan) for row in made])
        omega = machine.pole_pairs * omega_m[k]
        of_d, of_q = machine.flux(i_d, i_q)
        volts = np.hypot(0.05 * i_d - omega * of_q, 0.05 * i_q + omega * of_d)
        watts = 1.5 * 0.05 * (i_d**2 + i_q**2) + loss.losses(i_d, i_q, i_d * 0.0 + omega)[0]
        fits = (volts <= 90.0) & (np.hypot(i_d, i_q) <= 150.0)
        if not fits.any():
            continue
        checked += 1
        best = float(np.nanmin(np.where(fits, watts, np.nan)))
        assert found.loss[k] <= best * (1.0 + 1e-5), (torque[k], omega_m[k])
    assert checked > 20
    assert found.kkt_residual.max() < 1e-8
    assert len(set(found.active[found.reached].tolist())) >= 2
