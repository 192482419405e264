"""Losses over the currents: growth with the speed, derivatives, and the formula beside a map."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.losses.loss_map import LossMap, held_against_flux

AXIS, OMEGA = np.linspace(-20.0, 20.0, 9), 400.0
D, Q = np.meshgrid(AXIS, AXIS, indexing="ij")


def flux(i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    return 0.2 + 3e-3 * i_d, 7e-3 * i_q


def made(hysteresis: float, eddy: float, exponent: float = 1.0, *, magnet: bool = False) -> LossMap:
    """A map of (k_h w^x + k_c w^2) |psi|^2 at all speeds, and half its eddies for the magnets."""
    psi_d, psi_q = flux(D, Q)
    square = psi_d**2 + psi_q**2
    second = eddy * OMEGA**2 * square
    magnets = FluxMap(AXIS, AXIS, 0.5 * second, np.zeros_like(square)) if magnet else None
    return LossMap(
        FluxMap(AXIS, AXIS, hysteresis * OMEGA**exponent * square, second), magnets, OMEGA, exponent
    )


@pytest.mark.parametrize("exponent", [1.0, 1.4])
@pytest.mark.parametrize("omega", [-150.0, 0.0, 900.0])
def test_losses_grow_as_each_part_does(exponent: float, omega: float) -> None:
    hysteresis, eddy = 0.3, 4e-4
    loss_map = made(hysteresis, eddy, exponent, magnet=True)
    i_d, i_q = np.array([-10.0, 5.0, 3.0]), np.array([10.0, 0.0, -12.5])
    psi_d, psi_q = flux(i_d, i_q)
    square = psi_d**2 + psi_q**2
    iron, magnet = loss_map.losses(i_d, i_q, np.full(3, omega))
    expected = (hysteresis * abs(omega) ** exponent + eddy * omega**2) * square
    np.testing.assert_allclose(iron, expected, rtol=1e-6)
    np.testing.assert_allclose(magnet, 0.5 * eddy * omega**2 * square, rtol=1e-6)
    jet = loss_map.jet(i_d, i_q, np.full(3, omega))
    np.testing.assert_allclose(jet.value, iron + magnet, rtol=1e-9)
    whole = hysteresis * abs(omega) ** exponent + 1.5 * eddy * omega**2
    np.testing.assert_allclose(jet.d, whole * 2.0 * psi_d * 3e-3, rtol=1e-6)
    np.testing.assert_allclose(jet.q, whole * 2.0 * psi_q * 7e-3, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(jet.dd, whole * 2.0 * 9e-6, rtol=1e-5)
    np.testing.assert_allclose(jet.qq, whole * 2.0 * 49e-6, rtol=1e-5)
    np.testing.assert_allclose(jet.dq, 0.0, atol=1e-8)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_the_formula_beside_a_map_is_its_least_squares(exponent: float) -> None:
    """With x the loss and its growth at omega_0 are matched; the rest is counted by hand."""
    loss_map = made(0.3, 4e-4, exponent)
    found = held_against_flux(loss_map, flux, 15.0)
    assert found is not None
    near = np.hypot(D, Q) <= 15.0
    assert found.points == int(np.count_nonzero(near))
    assert found.fitted
    if exponent == 1.0:
        assert (found.hysteresis, found.eddy) == pytest.approx((0.3, 4e-4), rel=1e-9)
    loss = 0.3 * OMEGA**exponent + 4e-4 * OMEGA**2
    growth = 0.3 * exponent * OMEGA ** (exponent - 1.0) + 2.0 * 4e-4 * OMEGA
    assert found.hysteresis * OMEGA + found.eddy * OMEGA**2 == pytest.approx(loss, rel=1e-9)
    assert found.hysteresis + 2.0 * found.eddy * OMEGA == pytest.approx(growth, rel=1e-9)
    assert found.misfit == 0.0
    assert found.below == 0
    given = held_against_flux(loss_map, flux, 15.0, (0.5, 1e-3))
    assert given is not None
    psi_d, psi_q = flux(D[near], Q[near])
    square = psi_d**2 + psi_q**2
    left = (loss - 0.5 * OMEGA - 1e-3 * OMEGA**2) * square
    assert given.misfit == pytest.approx(np.linalg.norm(left) / np.linalg.norm(loss * square))
    worst = int(np.argmin(left))
    assert given.below == np.count_nonzero(left < 0.0)
    assert given.least[0] == pytest.approx(left[worst])
    if left[worst] < 0.0:
        assert given.least[1:] == pytest.approx((D[near][worst], Q[near][worst]), abs=1e-9)
        assert f"least {left[worst]:.3g} W at i_d = {D[near][worst]:.4g} A" in given.sentence
    assert not given.fitted
    assert held_against_flux(loss_map, lambda d, q: (0.0 * d, 0.0 * q), 15.0) is None
