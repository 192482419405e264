"""Dynamic models in the frames against their derivation from the phases by
symbolic differentiation.
"""

from __future__ import annotations

from typing import Any, get_args

import casadi as ca
import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import (
    Frame,
    amplitude_factor,
    dynamic_model,
    frame_model,
    from_frame,
    spectral_derivative,
    to_frame,
)

FRAMES: tuple[Frame, ...] = get_args(Frame)
L_S, M_S = 2.3e-3, -0.7e-3
PHASES = M_S + (L_S - M_S) * np.eye(3)
ORDERS = (1, 2, 3, 5, 6, 7, 9)


def symbolic_shape(seed: int, theta: Any) -> Any:
    """A shape with unequal phases, even and triplen harmonics, within 1."""
    generator = np.random.default_rng(seed)
    rows = []
    for phase in range(3):
        lag = 2.0 * np.pi / 3.0 * phase + generator.uniform(-0.1, 0.1)
        row = -generator.uniform(0.55, 0.75) * ca.sin(theta - lag)
        for order in ORDERS[1:]:
            row += (
                generator.uniform(-0.12, 0.12)
                / order
                * ca.sin(order * theta - generator.uniform(0.0, 6.0))
            )
        rows.append(row)
    return ca.vertcat(*rows)


def rotation(angle: Any) -> Any:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, s, 0), ca.horzcat(-s, c, 0), ca.horzcat(0, 0, 1))


def derivation(frame: Frame, seed: int, scaled: bool) -> Any:
    """Function of theta: F, F', L_f, C and e of a frame, from v = R i + d(L i)/dt + e
    and the transforms alone.

    Paper 002 (2.13), (2.19), (2.29), (2.34), (2.36), (3.1), (3.12) in the right quadrant,
    and (3.16).
    """
    theta = ca.SX.sym("theta")
    shape = symbolic_shape(seed, theta)
    root = np.sqrt(0.75)
    clarke = np.sqrt(2.0 / 3.0) * ca.DM([[1.0, -0.5, -0.5], [0.0, root, -root], [np.sqrt(0.5)] * 3])
    alpha, beta, zero = ca.vertsplit(clarke @ shape)
    matrix, length = clarke, np.sqrt(1.5)
    if frame == "dq0":
        matrix = rotation(theta) @ clarke
    if frame in ("dqx", "dqy"):
        matrix = rotation(theta + (ca.atan2(-alpha, beta) - theta)) @ clarke
        length = ca.sqrt(alpha**2 + beta**2)
    if frame == "dqy":
        theta_y = ca.atan2(-(matrix @ shape)[1], zero)
        c, s = ca.cos(theta_y), ca.sin(theta_y)
        matrix = ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, -s, c), ca.horzcat(0, c, s)) @ matrix
        length = ca.sqrt(alpha**2 + beta**2 + zero**2)
    factor = np.sqrt(1.5) / length if scaled else 1.0
    back = factor * ca.SX(matrix).T
    slope = ca.reshape(ca.jacobian(ca.vec(back), theta), 3, 3)
    into = ca.SX(matrix) / factor
    parts = [into @ PHASES @ back, into @ PHASES @ slope, into @ shape]
    return ca.Function("derivation", [theta], [shape, ca.jacobian(shape, theta), *parts])


def at_angles(function: Any, theta: FloatArray) -> tuple[FloatArray, ...]:
    """Shape and slope (3, N), matrices (N, 3, 3) and the back-EMF (N, 3)."""
    shape, slope, inductance, coupling, emf = (
        np.array(part) for part in function.map(theta.size)(theta[np.newaxis])
    )
    stacked = [np.moveaxis(part.reshape(3, theta.size, 3), 1, 0) for part in (inductance, coupling)]
    return shape, slope, *stacked, emf.T


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("seed", range(4))
def test_closed_forms_are_those_derived_from_the_phases(
    frame: Frame, seed: int, scaled: bool
) -> None:
    theta = np.random.default_rng(100 + seed).uniform(-7.0, 7.0, 96)
    shape, slope, inductance, coupling, emf = at_angles(derivation(frame, seed, scaled), theta)
    model = frame_model(frame, theta, shape, slope, L_S, M_S, scaled=scaled)
    np.testing.assert_allclose(model.inductance, inductance, rtol=0, atol=1e-12 * L_S)
    np.testing.assert_allclose(model.coupling, coupling, rtol=0, atol=1e-11 * L_S)
    np.testing.assert_allclose(model.emf, emf, rtol=0, atol=1e-12)


def test_printed_coefficients_do_not_hold() -> None:
    """(E.27), (E.29) with L_s + 2 M_s, and (E.48) with sin^2 theta_y outside,
    miss the derivation by far.
    """
    theta = np.random.default_rng(5).uniform(-7.0, 7.0, 96)
    shape, _, inductance, coupling, _ = at_angles(derivation("dqy", 1, False), theta)
    _, _, _, scaled, _ = at_angles(derivation("dqy", 1, True), theta)
    size, zero = to_frame("dqx", theta, shape, shape)[1:]
    sine, cosine = -size / np.hypot(size, zero), zero / np.hypot(size, zero)
    turn = coupling[:, 2, 0] / ((L_S - M_S) * cosine)
    np.testing.assert_allclose(coupling[:, 0, 1], (L_S - M_S) * sine * turn, atol=1e-11 * L_S)
    np.testing.assert_allclose(coupling[:, 1, 0], -(L_S - M_S) * sine * turn, atol=1e-11 * L_S)
    assert np.max(np.abs(coupling[:, 0, 1] - (L_S + 2.0 * M_S) * sine * turn)) > 0.5 * L_S
    growth = (scaled - coupling)[:, 0, 0] / (L_S - M_S)
    added = (scaled - coupling)[:, 1, 1]
    np.testing.assert_allclose(
        added, growth * (L_S + 2.0 * M_S - 3.0 * M_S * sine**2), atol=1e-11 * L_S
    )
    assert np.max(np.abs(added - growth * (L_S - M_S) * sine**2)) > 1e-3 * L_S
    # (2.22): no speed term on the 0 axis of dq0.
    stationary = at_angles(derivation("dq0", 1, False), theta)[3]
    np.testing.assert_allclose(stationary[:, 2, :], 0.0, atol=1e-15)
    assert np.ptp(inductance[:, 1, 1]) > 1e-3 * L_S


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("frame", FRAMES)
def test_voltages_are_those_of_the_phases(frame: Frame, scaled: bool) -> None:
    """Any periodic phase currents at a steady speed give the same voltages by
    the phases and by the model.
    """
    count, r_s, omega_e, phi_m = 2048, 0.8, 310.0, 0.11
    theta = 2.0 * np.pi * np.arange(count) / count
    shape, slope = at_angles(derivation(frame, 2, scaled), theta)[:2]
    size, lag = np.random.default_rng(6).uniform(-3.0, 3.0, (2, 3, 4, 1))
    currents = np.sum(size * np.sin(np.arange(1, 5)[:, np.newaxis] * theta - lag), axis=1)
    rate = np.sum(
        size
        * np.arange(1, 5)[:, np.newaxis]
        * np.cos(np.arange(1, 5)[:, np.newaxis] * theta - lag),
        axis=1,
    )
    voltages = r_s * currents + omega_e * (PHASES @ rate) + omega_e * phi_m * shape
    model = frame_model(frame, theta, shape, slope, L_S, M_S, scaled=scaled)
    seen = to_frame(frame, theta, shape, currents, scaled=scaled)
    made = r_s * seen + omega_e * (
        np.einsum("jkm,mj->kj", model.inductance, spectral_derivative(seen))
        + np.einsum("jkm,mj->kj", model.coupling, seen)
        + phi_m * model.emf.T
    )
    np.testing.assert_allclose(
        from_frame(frame, theta, shape, made, scaled=scaled), voltages, atol=1e-8
    )


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("frame", FRAMES)
def test_models_on_the_grid_agree(frame: Frame, scaled: bool) -> None:
    theta = 2.0 * np.pi * np.arange(3600) / 3600
    shape, slope = at_angles(derivation(frame, 3, scaled), theta)[:2]
    grid = dynamic_model(frame, shape, L_S, M_S, scaled=scaled)
    model = frame_model(frame, theta, shape, slope, L_S, M_S, scaled=scaled)
    np.testing.assert_allclose(model.coupling, grid.coupling, rtol=0, atol=1e-9 * L_S)
    np.testing.assert_allclose(model.inductance, grid.inductance, rtol=0, atol=1e-12 * L_S)
    np.testing.assert_allclose(model.emf, grid.emf, atol=1e-12)
    if scaled:
        bare = frame_model(frame, theta, shape, slope, L_S, M_S)
        np.testing.assert_allclose(
            model.emf * amplitude_factor(frame, shape)[:, np.newaxis], bare.emf, atol=1e-12
        )


def test_what_gives_no_model_is_refused() -> None:
    theta = 2.0 * np.pi * np.arange(36) / 36
    shape, slope = (part.copy() for part in at_angles(derivation("dqy", 1, False), theta)[:2])
    with pytest.raises(InputError, match="inductances must be finite"):
        frame_model("dq0", theta, shape, slope, float("nan"), M_S)
    with pytest.raises(InputError, match="do not fit"):
        frame_model("dqy", theta, shape, slope[:, :-1], L_S, M_S)
    shape[:, 7] = 0.25
    assert np.all(np.isfinite(frame_model("dq0", theta, shape, slope, L_S, M_S).coupling))
    with pytest.raises(InputError, match="vanishes at 70 degrees"):
        frame_model("dqy", theta, shape, slope, L_S, M_S)
