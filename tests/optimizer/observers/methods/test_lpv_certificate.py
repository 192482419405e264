"""Lyapunov certificate: the matrix against the observer itself, dense speeds,
fast changes of speed, and refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.observers.methods.flux import design
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.methods.lpv_certificate import (
    LyapunovCertificate,
    certify_flux_observer,
    corner_parameters,
    flux_error_matrix,
    holds_exactly,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import ObserverTuning, steady_observer

MACHINE = LinearMachine(pole_pairs=3, r_s=0.5, l_d=2e-3, l_q=3e-3, psi_pm=0.1, i_max=20.0)
T_S = 2e-4
LOW, HIGH = 300.0, 1500.0
CURRENTS = (0j, -3 + 8j, -3 - 8j)


@pytest.fixture(scope="module")
def gains() -> FluxGains:
    return design(MACHINE, ObserverTuning(200.0, 250.0, speed_gain=0.2), T_S, HIGH)


@pytest.fixture(scope="module", params=[1, pytest.param(3, marks=pytest.mark.slow)])
def currents(request: pytest.FixtureRequest) -> tuple[complex, ...]:
    return CURRENTS[: request.param]


@pytest.fixture(scope="module")
def certificate(gains: FluxGains, currents: tuple[complex, ...]) -> LyapunovCertificate:
    return certify_flux_observer(gains, LOW, HIGH, currents)


def _matrix(gains: FluxGains, omega: float, i_dq: complex) -> FloatArray:
    x = omega * T_S
    alpha = gains.alpha_0 + gains.alpha_1 * x
    return np.array(flux_error_matrix(gains, i_dq, float(np.cos(x)), float(np.sin(x)), alpha))


@pytest.mark.parametrize("omega", [200.0, 1400.0])
@pytest.mark.parametrize("i_dq", CURRENTS)
def test_matrix_is_the_derivative_of_the_observer(
    gains: FluxGains, omega: float, i_dq: complex
) -> None:
    """The analytic matrix against central differences of the step that the firmware runs."""
    found = steady_observer(
        METHODS["flux"], gains, T_S, plants(MACHINE), np.array([i_dq]), np.array([omega])
    )
    active = MACHINE.psi_pm + (MACHINE.l_d - MACHINE.l_q) * i_dq.real
    scale = np.array([active, active, 1.0, 1.0 / T_S])
    keep = [0, 1, 4, 5]  # without the stored current, whose error is nil
    jacobian = found.jacobian[0][np.ix_(keep, keep)] * scale[None, :] / scale[:, None]
    # the fixed point itself is off by the error of the voltage model with saliency, some 1e-4
    np.testing.assert_allclose(_matrix(gains, omega, i_dq), jacobian, atol=1e-4)


@pytest.mark.slow
def test_every_speed_of_a_dense_grid_decays_at_least_as_proven(
    gains: FluxGains, certificate: LyapunovCertificate, currents: tuple[complex, ...]
) -> None:
    root = np.linalg.cholesky(certificate.p).T
    for i_dq in currents:
        for omega in np.linspace(LOW, HIGH, 400):
            a = _matrix(gains, float(omega), i_dq)
            assert np.max(np.abs(np.linalg.eigvals(a))) < certificate.contraction
            norm = np.linalg.norm(root @ a @ np.linalg.inv(root), 2)
            assert norm < certificate.contraction
    assert certificate.contraction < 0.999
    assert certificate.corners == 8 * 16 * len(currents)


def test_errors_shrink_however_fast_the_speed_changes(
    gains: FluxGains, certificate: LyapunovCertificate, currents: tuple[complex, ...]
) -> None:
    """Speed and current chosen anew in every sample, the greedy way: as bad for V as
    a thousand choices allow.
    """
    generator = np.random.default_rng(3)
    choices = [_matrix(gains, w, i) for i in currents for w in np.linspace(LOW, HIGH, 60)]
    table = np.array(choices)
    z = generator.standard_normal(4)
    value = float(z @ certificate.p @ z)
    for _ in range(300):
        candidates = table @ z
        values = np.einsum("vi,ij,vj->v", candidates, certificate.p, candidates)
        worst = int(np.argmax(values))
        assert values[worst] <= certificate.contraction**2 * value
        z, value = candidates[worst], float(values[worst])


def test_boxes_contain_the_curve(gains: FluxGains) -> None:
    corners = corner_parameters(gains, LOW, HIGH).reshape(16, 8, 3)
    edges = np.geomspace(LOW, HIGH, 17)
    for k in range(16):
        x = np.linspace(edges[k], edges[k + 1], 50) * T_S
        points = np.stack([np.cos(x), np.sin(x), gains.alpha_0 + gains.alpha_1 * x], axis=1)
        assert np.all(points >= corners[k].min(axis=0))
        assert np.all(points <= corners[k].max(axis=0))


def test_exact_check_refuses_what_does_not_hold() -> None:
    from flint import fmpq

    half = [[fmpq(1, 2), fmpq(0)], [fmpq(0), fmpq(1, 2)]]
    assert holds_exactly(np.eye(2), 0.5000001, [half])
    assert not holds_exactly(np.eye(2), 0.5, [half])  # on the border: not positive definite
    assert not holds_exactly(-np.eye(2), 0.6, [half])
    assert not holds_exactly(np.array([[1.0, 2.0], [2.0, 1.0]]), 0.9, [half])
    assert not holds_exactly(np.eye(2), 0.6, [half, [[fmpq(0), fmpq(2, 3)], [fmpq(0), fmpq(0)]]])
    # in another norm, whose factor is that of numpy
    a = np.array([[0.5, 0.25, 0.0], [-0.125, 0.75, 0.5], [0.0, 0.25, -0.375]])
    p = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.25], [0.0, 0.25, 1.5]])
    root = np.linalg.cholesky(p).T
    factor = float(np.linalg.norm(root @ a @ np.linalg.inv(root), 2))
    exact = [[fmpq(*value.as_integer_ratio()) for value in row] for row in a.tolist()]
    assert holds_exactly(p, 1.000001 * factor, [exact])
    assert not holds_exactly(p, 0.999999 * factor, [exact])


def test_gains_that_violate_it_have_no_certificate(gains: FluxGains) -> None:
    with pytest.raises(NoSolutionError, match="no certificate: at some speed"):
        certify_flux_observer(replace(gains, alpha_0=-0.05), LOW, HIGH)
    with pytest.raises(NoSolutionError, match="no certificate"):
        certify_flux_observer(replace(gains, pll=replace(gains.pll, l_1=2.05)), LOW, HIGH)


def test_range_through_standstill_is_refused(gains: FluxGains) -> None:
    with pytest.raises(InputError, match="0 < omega_low"):
        certify_flux_observer(gains, 0.0, HIGH)
