"""Frames of paper 002 against derivations from the phases, symbolic and numeric,
and its table as corrected.
"""

from __future__ import annotations

from dataclasses import astuple
from typing import Any, get_args

import casadi as ca
import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import (
    AMPLITUDE_INVARIANT,
    CLARKE,
    Frame,
    coupling_entries,
    dynamic_model,
    frame_angles,
    frame_rms,
    inductance_entries,
    loss_ratio_x_over_y,
    thesis_shapes,
    transform,
)

FRAMES: tuple[Frame, ...] = get_args(Frame)
L_S, M_S = 2.3e-3, -0.7e-3
SYMBOLS = (("theta", 1), ("l_s", 1), ("m_s", 1), ("x", 3), ("y", 3))
PHASES = M_S + (L_S - M_S) * np.eye(3)


def grid(count: int) -> FloatArray:
    return 2.0 * np.pi * np.arange(count) / count


def unbalanced(seed: int, count: int = 3600) -> FloatArray:
    """A shape with unequal phases, even and triplen harmonics, at most 1,
    whose alpha-beta vector never vanishes.
    """
    generator = np.random.default_rng(seed)
    theta, orders = grid(count), np.array([2, 3, 5, 6, 7, 9])[:, np.newaxis]
    turns = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    shape = -generator.uniform(0.8, 1.2, (3, 1)) * np.sin(
        turns + generator.uniform(-0.1, 0.1, (3, 1))
    )
    for phase in range(3):
        size, lag = (
            generator.uniform(-0.3, 0.3, orders.shape) / orders,
            generator.uniform(0.0, 6.0, orders.shape),
        )
        shape[phase] += np.sum(size * np.sin(orders * theta - lag), axis=0)
    return np.asarray(shape / np.max(np.abs(shape)))


def spectral_derivative(values: FloatArray) -> FloatArray:
    """Derivative of smooth periodic values along the first axis, by the discrete Fourier
    transform.
    """
    count = values.shape[0]
    orders = np.fft.rfftfreq(count, 1.0 / count).reshape((-1,) + (1,) * (values.ndim - 1))
    return np.asarray(np.fft.irfft(1j * orders * np.fft.rfft(values, axis=0), n=count, axis=0))


def symbolic_clarke() -> Any:
    return ca.DM(CLARKE)


def symbolic_transform(frame: Frame, theta: Any, theta_x: Any, theta_y: Any) -> Any:
    """Matrices (2.13), (2.19), (2.29) and (3.1) of paper 002, written out."""
    angle = {"alphabeta0": 0.0 * theta, "dq0": theta}.get(frame, theta + theta_x)
    c, s = ca.cos(angle), ca.sin(angle)
    matrix = (
        ca.vertcat(ca.horzcat(c, s, 0), ca.horzcat(-s, c, 0), ca.horzcat(0, 0, 1))
        @ symbolic_clarke()
    )
    if frame != "dqy":
        return matrix
    c, s = ca.cos(theta_y), ca.sin(theta_y)
    return ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, -s, c), ca.horzcat(0, c, s)) @ matrix


@pytest.mark.parametrize("frame", FRAMES)
def test_matrices_follow_from_the_phases_for_any_angle_functions(frame: Frame) -> None:
    """T L T^-1 and T L d(T^-1)/dtheta by differentiation of symbols.

    The parabolas give any angle and any slope.
    """
    theta, l_s, m_s, x, y = symbols = [ca.SX.sym(name, size) for name, size in SYMBOLS]
    theta_x, theta_y = (p[0] + p[1] * theta + p[2] * theta**2 for p in (x, y))
    sine, cosine, rate = ca.sin(theta_y), ca.cos(theta_y), ca.jacobian(theta_y, theta)
    matrix = symbolic_transform(frame, theta, theta_x, theta_y)
    phases = m_s * ca.DM.ones(3, 3) + (l_s - m_s) * ca.DM.eye(3)
    slope = ca.reshape(ca.jacobian(ca.vec(matrix.T), theta), 3, 3)
    turn: Any = 1.0 if frame == "dq0" else 1.0 + ca.jacobian(theta_x, theta)
    # The entries are sums of products, so that they take symbols as well as numbers.
    anything: Any = (sine, cosine, turn, rate, l_s, m_s)
    coupling = coupling_entries(frame, *anything)
    inductance = inductance_entries(frame, *anything[:2], *anything[4:])
    wanted = ca.horzcat(matrix @ phases @ matrix.T, matrix @ phases @ slope, matrix @ matrix.T)
    found = ca.horzcat(
        *(ca.vertcat(*(ca.horzcat(*row) for row in part)) for part in (inductance, coupling)),
        ca.DM.eye(3),
    )
    difference = ca.Function("difference", symbols, [wanted - found])
    generator = np.random.default_rng(7)
    for point in generator.uniform(-3.0, 3.0, (40, 9)):
        values = difference(point[0], point[1], point[2], point[3:6], point[6:9])
        assert np.max(np.abs(np.array(values))) < 1e-11


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("seed", range(3))
def test_model_is_that_of_the_phases_seen_from_the_frame(
    frame: Frame, seed: int, scaled: bool
) -> None:
    shape = unbalanced(seed)
    theta, angles = grid(shape.shape[1]), frame_angles(shape)
    matrix = transform(frame, theta, shape)
    factor = (
        {"dqx": angles.a_x, "dqy": angles.a_y}.get(frame, np.ones(shape.shape[1]))
        if scaled
        else 1.0
    )
    scale = np.broadcast_to(factor, (shape.shape[1],))[:, np.newaxis, np.newaxis]
    back = scale * np.linalg.inv(matrix)
    model = dynamic_model(frame, shape, L_S, M_S, scaled=scaled)
    tolerance = 1e-7 * L_S
    np.testing.assert_allclose(
        model.inductance, matrix @ PHASES @ np.linalg.inv(matrix), rtol=0, atol=tolerance
    )
    coupling = matrix @ PHASES @ spectral_derivative(back) / scale
    np.testing.assert_allclose(model.coupling, coupling, rtol=0, atol=tolerance)
    alpha, beta, zero = CLARKE @ shape / scale[:, 0, 0]
    size, c, s, none = np.hypot(alpha, beta), np.cos(theta), np.sin(theta), 0.0 * zero
    emf = {
        "alphabeta0": (alpha, beta, zero),
        "dq0": (c * alpha + s * beta, c * beta - s * alpha, zero),
        "dqx": (none, size, zero),
        "dqy": (none, np.hypot(size, zero), none),
    }
    np.testing.assert_allclose(model.emf.T, emf[frame], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_dqy_bears_all_torque_on_one_axis_with_constant_current(seed: int) -> None:
    """With the factor a_y, a current of T / (p phi_m sqrt(3/2)) on qy makes constant
    torque at the least loss.
    """
    shape = unbalanced(seed)
    matrix, angles = transform("dqy", grid(shape.shape[1]), shape), frame_angles(shape)
    currents = np.linalg.inv(matrix)[:, :, 1] * (angles.a_y / np.sqrt(1.5))[:, np.newaxis]
    np.testing.assert_allclose(np.sum(currents * shape.T, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(
        currents, np.linalg.pinv(shape.T[:, np.newaxis, :])[..., 0], atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(matrix), -1.0, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_angles_are_those_of_the_matrices_and_rates_their_derivatives(seed: int) -> None:
    shape = unbalanced(seed)
    theta, angles = grid(shape.shape[1]), frame_angles(shape)
    alpha, beta, _ = CLARKE @ shape
    difference = angles.theta_x - (np.arctan2(-alpha, beta) - theta)
    np.testing.assert_allclose(np.exp(1j * difference), 1.0, atol=1e-12)
    from_x = transform("dqy", theta, shape) @ np.linalg.inv(transform("dqx", theta, shape))
    np.testing.assert_allclose(from_x[:, 1, 1], -np.sin(angles.theta_y), atol=1e-12)
    np.testing.assert_allclose(from_x[:, 1, 2], np.cos(angles.theta_y), atol=1e-12)
    np.testing.assert_allclose(angles.theta_x_rate, spectral_derivative(angles.theta_x), atol=1e-7)
    np.testing.assert_allclose(angles.theta_y_rate, spectral_derivative(angles.theta_y), atol=1e-7)


def test_balanced_sine_makes_dqx_and_dqy_the_dq_frame() -> None:
    """Without zero sequence theta_y is -90 degrees, so that q keeps its sign, and 0 is mirrored."""
    shape = thesis_shapes(720)["balanced sine"]
    angles, theta = frame_angles(shape), grid(720)
    for value, wanted in zip(astuple(angles), (0.0, -np.pi / 2.0, 0.0, 0.0, 1.0, 1.0), strict=True):
        np.testing.assert_allclose(value, wanted, atol=1e-9)
    dq0 = transform("dq0", theta, shape)
    np.testing.assert_allclose(transform("dqx", theta, shape), dq0, atol=1e-12)
    np.testing.assert_allclose(
        transform("dqy", theta, shape), np.diag([1.0, 1.0, -1.0]) @ dq0, atol=1e-12
    )


def test_factor_makes_the_peak_of_a_phase() -> None:
    amplitude, angle = 3.7, 0.4
    phases = amplitude * np.cos(angle - 2.0 * np.pi / 3.0 * np.arange(3))
    alpha, beta, _ = AMPLITUDE_INVARIANT * (CLARKE @ phases)
    assert (alpha, beta) == pytest.approx(
        (amplitude * np.cos(angle), amplitude * np.sin(angle)), rel=1e-12
    )
    np.testing.assert_allclose(CLARKE @ CLARKE.T, np.eye(3), atol=1e-15)


# Paper 002, Table 3.1, as corrected: d, q, qx, qy, 0 and the copper loss of dqx over that of dqy.
TABLE = {
    "balanced sine": (0.0, 1.2247, 1.2247, 1.2247, 0.0, 1.0),
    "one phase at half amplitude": (0.144, 1.031, 1.041, 1.061, 0.204, 1.061),
    "one phase missing": (0.289, 0.866, 0.913, 1.000, 0.408, 1.732),
    "trapezoid": (None, 1.491, 1.491, 1.528, 0.333, 1.042),
}


def test_root_mean_squares_and_losses_of_the_table() -> None:
    shapes = thesis_shapes(7200)
    assert list(shapes) == list(TABLE)
    for name, wanted in TABLE.items():
        found = (*astuple(frame_rms(shapes[name])), loss_ratio_x_over_y(shapes[name]))
        for value, figure in zip(found, wanted, strict=True):
            assert figure is None or value == pytest.approx(figure, abs=5.1e-4), name


def test_exact_values_of_the_table() -> None:
    """The trapezoid's mean square is 7/9, so that qy is sqrt(7/3).

    Its zero sequence is a triangle of peak 1/sqrt 3.
    """
    rms = frame_rms(thesis_shapes(7200)["trapezoid"])
    assert rms.qy == pytest.approx(np.sqrt(7.0 / 3.0), rel=1e-6)
    assert rms.zero == pytest.approx(1.0 / 3.0, rel=1e-6)
    assert rms.d**2 + rms.q**2 == pytest.approx(rms.qx**2, rel=1e-12)
    assert loss_ratio_x_over_y(thesis_shapes(7200)["one phase missing"]) == pytest.approx(
        np.sqrt(3.0), rel=1e-12
    )


@pytest.mark.parametrize("seed", range(3))
def test_loss_ratio_is_that_of_the_smallest_phase_currents(seed: int) -> None:
    """Least-norm phase currents for unit torque, with and without the condition that their sum is
    zero.
    """
    rows = unbalanced(seed, 720).T[:, np.newaxis, :]
    free = np.linalg.pinv(rows)[..., 0]
    star = np.linalg.pinv(np.concatenate([rows, np.ones_like(rows)], axis=1))[..., 0]
    assert loss_ratio_x_over_y(rows[:, 0, :].T) == pytest.approx(
        np.sum(star**2) / np.sum(free**2), rel=1e-10
    )


@pytest.mark.parametrize(("count", "where"), [(360, "at 0 degrees"), (365, "near 180 degrees")])
def test_single_phase_gives_no_direction(count: int, where: str) -> None:
    """The vector of one phase alone passes zero twice, on the grid or between two of its angles."""
    shape = np.zeros((3, count))
    shape[0] = np.sin(grid(count) + (0.0 if count == 360 else 0.25 * 2.0 * np.pi / count))
    with pytest.raises(InputError, match=where):
        frame_angles(shape)
    with pytest.raises(InputError, match=where):
        loss_ratio_x_over_y(shape)


def test_matrices_name_the_angle_without_direction() -> None:
    theta = grid(36)
    shape = thesis_shapes(36)["balanced sine"].copy()
    shape[:, 5] = 0.5
    assert transform("dq0", theta, shape).shape == (36, 3, 3)
    with pytest.raises(InputError, match="vanishes at 50 degrees"):
        transform("dqx", theta, shape)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (np.zeros((2, 36)), r"needs the shape \(3, N\)"),
        (np.zeros((3, 12)), "N from 24 on"),
        (np.full((3, 36), np.nan), "finite"),
        (np.full((3, 36), 1.5), "at most 1, got 1.5"),
    ],
)
def test_what_is_no_shape_is_refused(shape: FloatArray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        frame_rms(shape)


def test_angles_must_fit_the_columns() -> None:
    with pytest.raises(InputError, match="35 angles do not fit"):
        transform("dq0", grid(35), thesis_shapes(36)["trapezoid"])
