"""Carrying quantities into the frames and back, and how the frames turn,
against definitions and differentiation.
"""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines import frame_transforms as dq_frames
from dqforge.machines.phase_machines.frame_transforms import (
    Frame,
    FrameAngles,
    amplitude_factor,
    frame_rates,
    frame_rms,
    from_frame,
    loss_ratio_x_over_y,
    spectral_derivative,
    spectral_frame_angles,
    thesis_shapes,
    to_frame,
    transform,
    transform_rate,
)
from dqforge.machines.transforms import clarke_matrix

FRAMES: tuple[Frame, ...] = get_args(Frame)
ORDERS = np.array([1, 2, 3, 5, 6, 7, 9])[:, np.newaxis]


def grid(count: int) -> FloatArray:
    return 2.0 * np.pi * np.arange(count) / count


def unbalanced(seed: int, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A shape with unequal phases, even and triplen harmonics, within 1,
    and its derivative by the formula.
    """
    generator = np.random.default_rng(seed)
    shape, slope = np.zeros((3, theta.size)), np.zeros((3, theta.size))
    for phase in range(3):
        size = generator.uniform(-0.12, 0.12, ORDERS.shape) / ORDERS
        lag = generator.uniform(0.0, 6.0, ORDERS.shape)
        size[0], lag[0] = (
            -generator.uniform(0.55, 0.75),
            2.0 * np.pi / 3.0 * phase + generator.uniform(-0.1, 0.1),
        )
        shape[phase] = np.sum(size * np.sin(ORDERS * theta - lag), axis=0)
        slope[phase] = np.sum(ORDERS * size * np.cos(ORDERS * theta - lag), axis=0)
    assert np.max(np.abs(shape)) < 1.0
    return shape, slope


@pytest.mark.parametrize("count", [25, 26])
def test_spectral_derivative_is_exact_up_to_half_the_angles(count: int) -> None:
    theta = grid(count)
    wave = 0.3 + np.stack([np.sin(12 * theta - 0.4), np.cos(5 * theta)])
    slope = np.stack([12 * np.cos(12 * theta - 0.4), -5 * np.sin(5 * theta)])
    np.testing.assert_allclose(spectral_derivative(wave), slope, atol=1e-12)


def test_spectral_derivative_of_what_alternates_is_zero() -> None:
    np.testing.assert_allclose(spectral_derivative(np.cos(13 * grid(26))), 0.0, atol=1e-12)


def test_amplitude_invariant_matrix_gives_peak_and_mean_of_the_phases() -> None:
    turns = np.linspace(0.0, 6.0, 50) - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    alpha, beta, zero = clarke_matrix() @ (3.7 * np.cos(turns) + 0.6)
    np.testing.assert_allclose(alpha, 3.7 * np.cos(turns[0]), atol=1e-12)
    np.testing.assert_allclose(beta, 3.7 * np.sin(turns[0]), atol=1e-12)
    np.testing.assert_allclose(zero, 0.6, atol=1e-12)
    np.testing.assert_allclose(
        clarke_matrix()[:2], dq_frames.AMPLITUDE_INVARIANT * dq_frames.CLARKE[:2]
    )


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("frame", FRAMES)
def test_quantities_come_back_and_keep_their_power(frame: Frame, scaled: bool) -> None:
    theta = np.random.default_rng(1).uniform(-7.0, 7.0, 90)
    shape, _ = unbalanced(1, theta)
    matrix = transform(frame, theta, shape)
    np.testing.assert_allclose(np.linalg.inv(matrix), np.swapaxes(matrix, 1, 2), atol=1e-14)
    phases = np.random.default_rng(2).normal(size=(3, 90))
    axes = to_frame(frame, theta, shape, phases, scaled=scaled)
    np.testing.assert_allclose(
        from_frame(frame, theta, shape, axes, scaled=scaled), phases, atol=1e-13
    )
    factor = amplitude_factor(frame, shape) if scaled else 1.0
    power = factor**2 * np.sum(axes * to_frame(frame, theta, shape, shape, scaled=scaled), axis=0)
    np.testing.assert_allclose(power, np.sum(phases * shape, axis=0), atol=1e-13)


def test_components_are_those_of_the_definitions() -> None:
    """(2.12), (2.19), (2.29) and (3.1) of paper 002, one after the other
    with the angles themselves.
    """
    theta = grid(120)
    shape, _ = unbalanced(3, theta)
    phases = np.random.default_rng(4).normal(size=(3, 120))
    angles = spectral_frame_angles(shape)
    alpha, beta, zero = dq_frames.CLARKE @ phases
    stationary = alpha + 1j * beta
    dq, dqx = stationary * np.exp(-1j * theta), stationary * np.exp(-1j * (theta + angles.theta_x))
    sine, cosine = np.sin(angles.theta_y), np.cos(angles.theta_y)
    wanted: dict[Frame, tuple[FloatArray, ...]] = {
        "alphabeta0": (alpha, beta, zero),
        "dq0": (dq.real, dq.imag, zero),
        "dqx": (dqx.real, dqx.imag, zero),
        "dqy": (dqx.real, cosine * zero - sine * dqx.imag, cosine * dqx.imag + sine * zero),
    }
    for frame, rows in wanted.items():
        np.testing.assert_allclose(to_frame(frame, theta, shape, phases), rows, atol=1e-13)
    np.testing.assert_allclose(amplitude_factor("dqx", shape), angles.a_x, rtol=1e-14)
    np.testing.assert_allclose(amplitude_factor("dqy", shape), angles.a_y, rtol=1e-14)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("seed", range(3))
def test_transform_rate_is_the_derivative_of_the_matrices(seed: int, frame: Frame) -> None:
    theta = grid(2048)
    shape, slope = unbalanced(seed, theta)
    wanted = np.moveaxis(
        spectral_derivative(np.moveaxis(transform(frame, theta, shape), 0, -1)), -1, 0
    )
    np.testing.assert_allclose(transform_rate(frame, theta, shape, slope), wanted, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_rates_are_the_derivatives_of_angles_and_factors(seed: int) -> None:
    theta = grid(2048)
    shape, slope = unbalanced(seed, theta)
    angles, rates = spectral_frame_angles(shape), frame_rates(theta, shape, slope)
    assert isinstance(angles, FrameAngles)
    assert np.ptp(angles.theta_x) > 0.05
    assert np.ptp(angles.theta_y) > 0.05
    for found, value in (
        (rates.theta_x, angles.theta_x),
        (rates.theta_y, angles.theta_y),
        (rates.growth_x, np.log(angles.a_x)),
        (rates.growth_y, np.log(angles.a_y)),
    ):
        np.testing.assert_allclose(found, spectral_derivative(value), atol=1e-9)
    np.testing.assert_allclose(angles.theta_x_rate, rates.theta_x, atol=1e-10)
    np.testing.assert_allclose(angles.theta_y_rate, rates.theta_y, atol=1e-10)


def test_spectral_rates_need_fewer_angles_than_differences() -> None:
    theta = grid(72)
    shape, slope = unbalanced(5, theta)
    exact = frame_rates(theta, shape, slope).theta_x
    spectral = np.max(np.abs(spectral_frame_angles(shape).theta_x_rate - exact))
    local = np.max(np.abs(dq_frames.frame_angles(shape).theta_x_rate - exact))
    assert spectral < 1e-12
    assert local > 1e-6


def test_angles_without_zero_sequence() -> None:
    """theta_y is -90 degrees, so that F_qy > 0; dqy has q of dqx, and 0 mirrored."""
    theta = grid(360)
    shape, _ = unbalanced(6, theta)
    shape = shape - np.mean(shape, axis=0)
    shape /= 1.1 * np.max(np.abs(shape))
    angles = spectral_frame_angles(shape)
    np.testing.assert_allclose(angles.theta_y, -np.pi / 2.0, atol=1e-12)
    np.testing.assert_allclose(angles.theta_y_rate, 0.0, atol=1e-12)
    phases = np.random.default_rng(7).normal(size=(3, 360))
    mirrored = to_frame("dqx", theta, shape, phases) * np.array([[1.0], [1.0], [-1.0]])
    np.testing.assert_allclose(to_frame("dqy", theta, shape, phases), mirrored, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_constant_current_on_qy_makes_constant_torque_at_least_loss(seed: int) -> None:
    """i_qy = T / (p phi_m sqrt(3/2)) after division by a_y; (4.4) of paper 002 errs."""
    theta = grid(720)
    shape, _ = unbalanced(seed, theta)
    torque, pole_pairs, phi_m = 1.3, 2, 0.11
    axes = np.zeros((3, 720))
    axes[1] = torque / (pole_pairs * phi_m * np.sqrt(1.5))
    currents = from_frame("dqy", theta, shape, axes, scaled=True)
    np.testing.assert_allclose(
        pole_pairs * phi_m * np.sum(shape * currents, axis=0), torque, rtol=1e-12
    )
    rows = pole_pairs * phi_m * shape.T[:, np.newaxis, :]
    least = np.asarray(torque * np.linalg.pinv(rows)[..., 0].T, dtype=np.float64)
    np.testing.assert_allclose(currents, least, rtol=1e-10, atol=1e-12)
    back = to_frame("dqy", theta, shape, np.asarray(least, dtype=np.float64), scaled=True)
    np.testing.assert_allclose(back, axes, atol=1e-11)


# Paper 002, Table 3.1, as corrected: d, q, qx, qy, 0 and the copper loss of dqx over that of dqy.
TABLE = {
    "balanced sine": (0.0, 1.225, 1.225, 1.225, 0.0, 1.0),
    "one phase at half amplitude": (0.144, 1.031, 1.041, 1.061, 0.204, 1.061),
    "one phase missing": (0.289, 0.866, 0.913, 1.000, 0.408, 1.732),
    "trapezoid": (None, 1.491, 1.491, 1.528, 0.333, 1.042),
}


@pytest.mark.parametrize("name", TABLE)
def test_table_and_losses_from_the_components_themselves(name: str) -> None:
    """The figures, and the functions that give them, against components and phase
    currents carried by the matrices.
    """
    theta, shape = grid(7200), thesis_shapes(7200)[name]
    seen = {frame: to_frame(frame, theta, shape, shape) for frame in FRAMES}
    losses = []
    for frame in ("dqx", "dqy"):
        axes = np.zeros((3, 7200))
        axes[1] = 1.0 / seen[frame][1]
        currents = from_frame(frame, theta, shape, axes)
        np.testing.assert_allclose(np.sum(currents * shape, axis=0), 1.0, rtol=1e-10)
        losses.append(np.mean(np.sum(currents**2, axis=0)))
    rms = [
        float(np.sqrt(np.mean(row**2)))
        for row in (*seen["dq0"][:2], seen["dqx"][1], seen["dqy"][1])
    ]
    zero = float(np.sqrt(np.mean(seen["dq0"][2] ** 2)))
    found = (*rms, zero, losses[0] / losses[1])
    for value, figure in zip(found, TABLE[name], strict=True):
        assert figure is None or value == pytest.approx(figure, abs=5.1e-4)
    table = frame_rms(shape)
    given = (table.d, table.q, table.qx, table.qy, table.zero, loss_ratio_x_over_y(shape))
    assert given == pytest.approx(found, abs=1e-12)
    for idle in (seen["dqx"][0], seen["dqy"][0], seen["dqy"][2]):
        np.testing.assert_allclose(idle, 0.0, atol=1e-12)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_angle_without_direction_is_named(frame: Frame) -> None:
    """Where all phases are equal only the zero sequence is left, where all are zero nothing;
    dq0 does not mind.
    """
    theta = grid(36)
    for level in (0.5, 0.0):
        shape, slope = unbalanced(8, theta)
        shape[:, 5] = level
        assert np.all(np.isfinite(to_frame("dq0", theta, shape, shape, scaled=True)))
        assert np.all(np.isfinite(transform_rate("dq0", theta, shape, slope)))
        with pytest.raises(InputError, match="vanishes at 50 degrees"):
            to_frame(frame, theta, shape, shape, scaled=True)
        with pytest.raises(InputError, match="vanishes at 50 degrees"):
            transform_rate(frame, theta, shape, slope)
        with pytest.raises(InputError, match="vanishes at 50 degrees"):
            spectral_frame_angles(shape)


def test_quantities_must_fit_the_shape() -> None:
    theta = grid(36)
    shape, slope = unbalanced(9, theta)
    with pytest.raises(InputError, match=r"\(3, 35\) do not fit a back-EMF shape of \(3, 36\)"):
        to_frame("dq0", theta, shape, shape[:, :-1])
    with pytest.raises(InputError, match=r"\(2, 36\) do not fit"):
        from_frame("dq0", theta, shape, shape[:2])
    with pytest.raises(InputError, match=r"\(3, 35\) do not fit"):
        frame_rates(theta, shape, slope[:, :-1])
