"""Quantities carried into the frames alpha-beta-0, dq0, dqx and dqy and back,
and how fast the frames turn.

The matrices, their angles on the grid and the figures of Table 3.1 are those of
:mod:`dqforge.machines.phase_machines.frames` and can be imported from here too; conventions as
there. Here the derivative F' of the back-EMF shape by the angle is an argument, so that all of it
holds at any angles and is as exact as F' is: take the formula's derivative where there is one,
:func:`spectral_derivative` for a smooth shape on the grid.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines import frames as dq_frames
from dqforge.machines.phase_machines.frames import (
    CLARKE,
    Entries,
    Frame,
    FrameAngles,
    FrameRms,
    frame_rms,
    loss_ratio_x_over_y,
    thesis_shapes,
    transform,
)
from dqforge.machines.phase_machines.phase_machine import grid
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT

__all__ = [
    "Frame",
    "FrameAngles",
    "FrameRates",
    "FrameRms",
    "amplitude_factor",
    "frame_rates",
    "frame_rms",
    "from_frame",
    "loss_ratio_x_over_y",
    "matrices",
    "resampled",
    "spectral_derivative",
    "spectral_frame_angles",
    "thesis_shapes",
    "to_frame",
    "transform",
    "transform_rate",
]


@dataclass(frozen=True, slots=True, eq=False)
class FrameRates:
    """Derivatives by theta of the angles and amplitude factors of dqx and dqy, in 1/rad,
    arrays of shape (N,).

    ``theta_x``, ``theta_y`` those of the angles; ``growth_x``, ``growth_y`` the relative ones of
    the factors, (da_x/dtheta) / a_x and (da_y/dtheta) / a_y.
    """

    theta_x: FloatArray
    theta_y: FloatArray
    growth_x: FloatArray
    growth_y: FloatArray


def spectral_derivative(waveform: FloatArray, turns: int = 1) -> FloatArray:
    """Derivative by the angle in 1/rad of periodic values on the grid theta_j = 2 pi turns j / N,
    along the last axis.

    Exact for harmonics below N/2. A harmonic at N/2 has no slope at the angles of the grid and is
    left out. At kinks and jumps it rings over the whole period;
    :func:`dqforge.machines.phase_machines.phase_machine.derivative` keeps errors local.

    Args:
        waveform: Values in any unit, shape (..., N).
        turns: Electrical periods after which they repeat.
    """
    count = waveform.shape[-1]
    spectrum = 1j * (np.arange(count // 2 + 1) / turns) * np.fft.rfft(waveform)
    # The inverse takes the imaginary part at N/2 for zero.
    return np.asarray(np.fft.irfft(spectrum, n=count), dtype=np.float64)


def resampled(waveform: FloatArray, count: int) -> FloatArray:
    """Trigonometric interpolation of periodic rows at even angles.

    Args:
        waveform: Values in any unit, shape (..., N).
        count: Number of angles wanted.
    """
    lines = np.fft.rfft(waveform, axis=-1)
    return np.asarray(np.fft.irfft(lines, n=count, axis=-1) * (count / waveform.shape[-1]))


def amplitude_factor(frame: Frame, shape: FloatArray) -> FloatArray:
    """Factor by which paper 002 divides quantities in a frame, shape (N,).

    a_x = sqrt(3/2) / |F_alphabeta| in dqx, (2.36); a_y = sqrt(3/2) / |F_alphabeta0| in dqy, (3.16);
    else 1. Infinite where the shape F, shape (3, N), has no such vector.
    """
    if frame in ("alphabeta0", "dq0"):
        return np.ones(shape.shape[1])
    axes = CLARKE @ shape
    length = np.linalg.norm(axes if frame == "dqy" else axes[:2], axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(POWER_INVARIANT / length, dtype=np.float64)


def to_frame(
    frame: Frame, theta: FloatArray, shape: FloatArray, phases: FloatArray, *, scaled: bool = False
) -> FloatArray:
    """Quantities of the phases a, b, c on the axes of a frame.

    Args:
        frame, theta, shape: As in :func:`transform`: angles in rad, shape (N,), and the back-EMF
            shape F at them, shape (3, N).
        phases: Phase quantities in any unit, shape (3, N).
        scaled: Whether to divide by :func:`amplitude_factor`, as paper 002 does in (2.28) and
            (3.2). Its (4.2) and (4.3) together would divide by a_x and by a_y; (3.2) and (4.7)
            divide by a_y alone, which is done here.

    Returns:
        FloatArray, shape (3, N), power-invariant unless scaled

    Raises:
        InputError: As :func:`transform`, or the quantities do not fit the shape.
    """
    _require_same_size(shape, phases)
    seen: FloatArray = np.einsum("jkm,mj->kj", transform(frame, theta, shape), phases)
    return seen / amplitude_factor(frame, shape) if scaled else seen


def from_frame(
    frame: Frame, theta: FloatArray, shape: FloatArray, axes: FloatArray, *, scaled: bool = False
) -> FloatArray:
    """Phase quantities from those on the axes of a frame, the inverse of :func:`to_frame`.

    The matrices are orthogonal, their inverses the transposes: paper 002 (C.2), (D.2), (E.6).
    Parameters, shapes and errors are those of :func:`to_frame`.

    Args:
        frame: The frame.
        theta: Angles in rad, shape (N,).
        shape: Back-EMF shape F at these angles, shape (3, N).
        axes: Quantities on the axes of the frame in any unit, shape (3, N).
        scaled: Whether the quantities were divided by `amplitude_factor`.
    """
    _require_same_size(shape, axes)
    phases: FloatArray = np.einsum("jkm,kj->mj", transform(frame, theta, shape), axes)
    return phases * amplitude_factor(frame, shape) if scaled else phases


def frame_rates(theta: FloatArray, shape: FloatArray, slope: FloatArray) -> FrameRates:
    """How fast dqx and dqy turn and their factors grow, from F and F' alone.

    In dqx the shape is (0, F_qx, F_0). The d component of F' there is -(1 + theta_x') F_qx, all of
    it made by the turning frame; the others are the derivatives of F_qx and F_0, from which follow
    theta_y = atan2(-F_qx, F_0) and the factors. Paper 002 uses these derivatives from (2.30) on and
    gives no formula for them.

    Args:
        theta: Angles in rad, shape (N,), any.
        shape, slope: Back-EMF shape F at these angles and its derivative F' by theta in 1/rad,
            shape (3, N).

    Raises:
        InputError: As :func:`to_frame`; in particular, F gives dqx no direction at an angle, which
            is named.
    """
    _, size, zero = to_frame("dqx", theta, shape, shape)
    aside, size_rate, zero_rate = to_frame("dqx", theta, shape, slope)
    whole = size**2 + zero**2
    return FrameRates(
        theta_x=-aside / size - 1.0,
        theta_y=(size * zero_rate - zero * size_rate) / whole,
        growth_x=-size_rate / size,
        growth_y=-(size * size_rate + zero * zero_rate) / whole,
    )


def spectral_frame_angles(shape: FloatArray, turns: int = 1) -> FrameAngles:
    """Angles and amplitude factors of dqx and dqy on the grid, with rates from the
    spectral derivative of the shape.

    As :func:`dqforge.machines.phase_machines.frames.frame_angles`, where formulas, misprints and
    errors are given, but for the rates: there they come from differences over neighbouring angles,
    which kinks do not spoil; here they are exact to rounding for a shape of harmonics below N/2.

    ``shape`` is the back-EMF shape F on the grid theta_j = 2 pi turns j / N, shape (3, N).
    """
    angles = dq_frames.frame_angles(shape, turns)
    theta = grid(shape.shape[1], turns)
    rates = frame_rates(theta, shape, spectral_derivative(shape, turns))
    return replace(angles, theta_x_rate=rates.theta_x, theta_y_rate=rates.theta_y)


def transform_rate(
    frame: Frame, theta: FloatArray, shape: FloatArray, slope: FloatArray
) -> FloatArray:
    """Derivative by theta of the matrices of :func:`transform`, in 1/rad, shape (N, 3, 3).

    It is W T with W skew: turning in the plane of d and q by 1 (dq0) or 1 + theta_x', which dqy
    sees mirrored, and in dqy in the plane of qy and 0y by theta_y'. Times omega_e it is the
    derivative by time.

    Parameters and errors are those of :func:`frame_rates`; alphabeta0 and dq0 exist for any
    shape and ignore the slope.

    Args:
        frame: The frame.
        theta: Angles in rad, shape (N,).
        shape, slope: Back-EMF shape F at these angles and its derivative by theta in 1/rad, shape
            (3, N).
    """
    matrix = transform(frame, theta, shape)
    if frame == "alphabeta0":
        return np.zeros_like(matrix)
    if frame == "dq0":
        return matrices(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), theta.size) @ matrix
    rates = frame_rates(theta, shape, slope)
    turn = 1.0 + rates.theta_x
    if frame == "dqx":
        return matrices(((0.0, turn, 0.0), (-turn, 0.0, 0.0), (0.0, 0.0, 0.0)), theta.size) @ matrix
    _, size, zero = to_frame("dqx", theta, shape, shape)
    whole = np.hypot(size, zero)
    to_q, to_zero = turn * size / whole, turn * zero / whole
    skew: Entries = (
        (0.0, to_q, to_zero),
        (-to_q, 0.0, -rates.theta_y),
        (-to_zero, rates.theta_y, 0.0),
    )
    return matrices(skew, theta.size) @ matrix


def matrices(entries: Entries, count: int) -> FloatArray:
    """Matrices (count, 3, 3) of entries that are numbers or arrays (count,)."""
    cells = [np.broadcast_to(cell, (count,)) for row in entries for cell in row]
    return np.stack(cells, axis=-1).reshape(count, 3, 3)


def _require_same_size(shape: FloatArray, quantities: FloatArray) -> None:
    if quantities.shape != shape.shape:
        raise InputError(
            f"quantities of shape {quantities.shape} do not fit a back-EMF shape of {shape.shape}: "
            "give three rows and a column per angle in both"
        )
