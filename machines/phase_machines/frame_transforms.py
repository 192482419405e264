"""Quantities carried into the frames alpha-beta-0, dq0, dqx and dqy and back,
and how fast the frames turn.

The matrices, their angles on the grid and the figures of Table 3.1 are those of
:mod:`dqforge.machines.phase_machines.frame_transforms` and can be imported from here too; conventions as
there. Here the derivative F' of the back-EMF shape by the angle is an argument, so that all of it
holds at any angles and is as exact as F' is: take the formula's derivative where there is one,
:func:`spectral_derivative` for a smooth shape on the grid.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import derivative, grid
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import DOUBLES, POWER_INVARIANT, clarke_matrix, park


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

    As :func:`dqforge.machines.phase_machines.frame_transforms.frame_angles`, where formulas, misprints and
    errors are given, but for the rates: there they come from differences over neighbouring angles,
    which kinks do not spoil; here they are exact to rounding for a shape of harmonics below N/2.

    ``shape`` is the back-EMF shape F on the grid theta_j = 2 pi turns j / N, shape (3, N).
    """
    angles = frame_angles(shape, turns)
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


# Frames for machines with any back-EMF shape: alpha-beta-0, dq0, dqx and dqy,
# with their dynamic models.
#
# Everything here is power-invariant, as in paper 002: the transforms are orthogonal, and torque and
# copper loss are plain sums over the axes. The other modules are amplitude-invariant;
# :data:`AMPLITUDE_INVARIANT` converts.
#
# The back-EMF is e = omega_e phi_m F(theta), theta in rad from phase a to the d axis, omega_e in
# rad/s, phi_m in Wb, the shape F of the three phases without unit and at most 1. A shape is an
# array (3, N); where derivatives or means over the period are taken, column j belongs to theta_j =
# 2 pi turns j / N, with ``turns`` electrical periods after which it repeats: 1, or the pole pairs
# where they differ.
#
# dqx turns d and q so that the back-EMF lies on q alone, but for the zero sequence; dqy turns q and
# 0 as well, so that one axis bears all torque. The matrix of paper 002 from dqx to dqy, (3.1), is a
# reflection: its determinant is -1.

# Amplitude-invariant (peak of phase) over power-invariant quantity on the alpha, beta,
# d and q axes.
#
# On the 0 axis the factor is 1/sqrt 3 where the amplitude-invariant zero sequence
# is the mean of the phases.
Frame = Literal["alphabeta0", "dq0", "dqx", "dqy"]
Entry = FloatArray | float
Entries = tuple[tuple[Entry, Entry, Entry], tuple[Entry, Entry, Entry], tuple[Entry, Entry, Entry]]
AMPLITUDE_INVARIANT = 1.0 / POWER_INVARIANT

# Orthogonal matrix (3, 3) from phases to alpha, beta and 0; paper 002 (2.13).
CLARKE = clarke_matrix(power_invariant=True)
LEAST_ANGLES = 24  # Angles of a period below which derivatives and means tell nothing.
_TURN = 2.0 * math.pi / 3.0
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class FrameAngles:
    """Angles and amplitude factors of dqx and dqy over the period, arrays of shape (N,).

    ``theta_x``, ``theta_y`` in rad, within (-pi, pi] and [-pi, 0]; ``theta_x_rate``,
    ``theta_y_rate`` their derivatives by theta; ``a_x``, ``a_y`` the factors by which paper 002
    divides quantities, (2.36) and (3.16).
    """

    theta_x: FloatArray
    theta_y: FloatArray
    theta_x_rate: FloatArray
    theta_y_rate: FloatArray
    a_x: FloatArray
    a_y: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DynamicModel:
    """Voltages of a frame, v = R i + L_f di/dt + omega_e C i + omega_e phi_m e, at every angle.

    ``inductance`` L_f in H and ``coupling`` C in H, shape (N, 3, 3); ``emf`` e without unit,
    shape (N, 3).
    """

    inductance: FloatArray
    coupling: FloatArray
    emf: FloatArray


@dataclass(frozen=True, slots=True)
class FrameRms:
    """R.m.s. over the period of the back-EMF on the axes d and q of dq0, qx of dqx, qy of dqy,
    and 0; without unit.

    The axes dx, dy and 0y bear none.
    """

    d: float
    q: float
    qx: float
    qy: float
    zero: float


def thesis_shapes(count: int) -> dict[str, FloatArray]:
    """Shapes of paper 002, section 2.5, at `count` angles: name to F, shape (3, count).

    Balanced sine; phase b at half amplitude; phase b missing; trapezoid,
    each flat 120 degrees wide.
    """
    sine = -np.sin(grid(count) - _TURN * np.arange(3)[:, np.newaxis])
    return {
        "balanced sine": sine,
        "one phase at half amplitude": sine * np.array([[1.0], [0.5], [1.0]]),
        "one phase missing": sine * np.array([[1.0], [0.0], [1.0]]),
        "trapezoid": np.clip(np.arcsin(np.clip(sine, -1.0, 1.0)) * (6.0 / np.pi), -1.0, 1.0),
    }


def transform(frame: Frame, theta: FloatArray, shape: FloatArray) -> FloatArray:
    """Orthogonal matrices from the phases a, b, c to the frame's axes, in the order of its name.

    Paper 002 also divides quantities in dqx and dqy by a_x and a_y of :func:`frame_angles`; that is
    not part of these matrices.

    Args:
        frame: dq0 turns by theta (2.19), dqx by theta + theta_x with a 1 on the 0 axis (2.29), dqy
            then within the plane of qx and 0 by theta_y (3.1).
        theta: Angles in rad, shape (N,), any.
        shape: Back-EMF shape F at these angles, shape (3, N); only dqx and dqy depend on it.

    Returns:
        FloatArray, shape (N, 3, 3)

    Raises:
        InputError: The shapes do not fit, F is beyond 1, or F gives dqx or dqy no direction at an
            angle.
    """
    alpha, beta, zero = _clarke_axes(shape)
    if theta.shape != alpha.shape:
        raise InputError(
            f"{theta.size} angles do not fit the back-EMF shape of {alpha.size} columns: give one "
            "per column"
        )
    if frame == "alphabeta0":
        return np.tile(CLARKE, (theta.size, 1, 1))
    if frame == "dq0":
        return _rotation(np.cos(theta), np.sin(theta)) @ CLARKE
    size = np.hypot(alpha, beta)
    _require_direction(size, theta)
    to_x: FloatArray = _rotation(beta / size, -alpha / size) @ CLARKE
    if frame == "dqx":
        return to_x
    whole = np.hypot(size, zero)
    return _reflection(zero / whole, -size / whole) @ to_x


def frame_angles(shape: FloatArray, turns: int = 1) -> FrameAngles:
    """Angles of dqx and dqy with their derivatives, and the amplitude factors.

    ::

        theta_x = atan2(-F_alpha, F_beta) - theta     a_x = sqrt(3/2) / |F_alphabeta|
            (2.34), (2.36)
        theta_y = atan2(-F_qx, F_0x)                  a_y = sqrt(3/2) / |F_alphabeta0|
            (3.12), (3.16)

    (3.12) prints F_qy for F_qx, and its arctangent loses the quadrant; here F_qy > 0, so that
    theta_y is -90 degrees without zero sequence, where the paper has 90.

    ``shape`` is the back-EMF shape F on the grid, shape (3, N), over ``turns`` electrical periods.

    Raises:
        InputError: The array is no shape, or its alpha-beta vector vanishes at an angle or between
            two.
    """
    alpha, beta, zero = _clarke_axes(shape)
    theta = grid(alpha.size, turns)
    size = _directed(alpha, beta, theta)
    whole = np.hypot(size, zero)
    alpha_rate, beta_rate, zero_rate = CLARKE @ derivative(shape, turns)
    size_rate = (alpha * alpha_rate + beta * beta_rate) / size
    along, across = park(DOUBLES, (alpha, beta), (np.cos(theta), np.sin(theta)))
    return FrameAngles(
        # Measured from the dq axes the angle needs no unwrapping.
        theta_x=np.arctan2(-along, across),
        theta_y=np.arctan2(-size, zero),
        theta_x_rate=(alpha * beta_rate - beta * alpha_rate) / size**2 - 1.0,
        theta_y_rate=(size * zero_rate - zero * size_rate) / whole**2,
        a_x=POWER_INVARIANT / size,
        a_y=POWER_INVARIANT / whole,
    )


def dynamic_model(
    frame: Frame,
    shape: FloatArray,
    l_s: float,
    m_s: float,
    *,
    scaled: bool = False,
    turns: int = 1,
) -> DynamicModel:
    """Dynamic model of a machine without saliency in a frame, from closed forms.

    Sources: paper 002 (2.14)-(2.16), (2.20)-(2.22), (2.30), (2.31), (E.13)-(E.49), as corrected in
    :func:`coupling_entries`.

    Args:
        frame: The frame.
        shape: Back-EMF shape F on the grid, shape (3, N).
        l_s, m_s: Self inductance of a phase and mutual inductance of two, in H.
        scaled: Whether currents, voltages and back-EMF in dqx and dqy are divided by a_x and a_y,
            as in paper 002. This adds (da/dtheta) / a times L_f to C. (E.48) prints that term with
            sin^2 theta_y outside; it belongs inside, as in L_s + 2 M_s - 3 M_s sin^2 theta_y. The 0
            axis of dqx, which the paper does without, is divided too.
        turns: Electrical periods that the grid spans.

    Raises:
        InputError: As :func:`frame_angles`; alphabeta0 and dq0 exist for any shape.
    """
    axes = _clarke_axes(shape)
    theta = grid(axes.shape[1], turns)
    factor = np.ones(theta.size)
    sine: Entry = 0.0
    cosine: Entry = 1.0
    turn: Entry = 1.0
    rate: Entry = 0.0
    if frame in ("dqx", "dqy"):
        angles = frame_angles(shape, turns)
        sine, cosine = np.sin(angles.theta_y), np.cos(angles.theta_y)
        turn, rate = 1.0 + angles.theta_x_rate, angles.theta_y_rate
        factor = angles.a_x if frame == "dqx" else angles.a_y
    inductance = _filled(inductance_entries(frame, sine, cosine, l_s, m_s), theta.size)
    coupling = _filled(coupling_entries(frame, sine, cosine, turn, rate, l_s, m_s), theta.size)
    emf: FloatArray = np.einsum("jkm,mj->jk", transform(frame, theta, shape), shape)
    if not scaled or frame in ("alphabeta0", "dq0"):
        return DynamicModel(inductance, coupling, emf)
    seen = axes if frame == "dqy" else axes[:2]
    # Both factors are inverse to the length of the vector they see,
    # so a'/a is minus the growth of that length.
    rates = (CLARKE @ derivative(shape, turns))[: seen.shape[0]]
    growth = -np.sum(seen * rates, axis=0) / np.sum(seen**2, axis=0)
    coupling += growth[:, np.newaxis, np.newaxis] * inductance
    return DynamicModel(inductance, coupling, emf / factor[:, np.newaxis])


def inductance_entries(frame: Frame, sine: Entry, cosine: Entry, l_s: Entry, m_s: Entry) -> Entries:
    """Entries of the inductance matrix L_f in H.

    ``sine`` and ``cosine`` of theta_y matter in dqy alone.

    Paper 002 (2.14)-(2.16) and (E.38)-(E.46).

    Args:
        frame: The frame.
        sine, cosine: Those of theta_y, numbers or shape (N,).
        l_s, m_s: Self inductance of a phase and mutual inductance of two, in H, numbers or shape
            (N,).
    """
    plane, zero = l_s - m_s, l_s + 2.0 * m_s
    if frame != "dqy":
        return ((plane, 0.0, 0.0), (0.0, plane, 0.0), (0.0, 0.0, zero))
    mixed = 3.0 * m_s * sine * cosine
    return (
        (plane, 0.0, 0.0),
        (0.0, zero - 3.0 * m_s * sine * sine, mixed),
        (0.0, mixed, plane + 3.0 * m_s * sine * sine),
    )


def coupling_entries(
    frame: Frame, sine: Entry, cosine: Entry, turn: Entry, rate: Entry, l_s: Entry, m_s: Entry
) -> Entries:
    """Entries of the speed matrix C in H, for quantities not divided by an amplitude factor.

    ``turn`` is 1 in dq0 and 1 + d theta_x/d theta in dqx and dqy, ``rate`` is d theta_y/d theta,
    ``sine`` and ``cosine`` are those of theta_y; the last three matter in dqy alone.

    Paper 002 (2.20)-(2.22), (2.30), (2.31) and (E.26)-(E.34), corrected: there is no speed term on
    the 0 axis, where (2.22), (C.7) and (C.12) print one, and the factor of sin theta_y is L_s -
    M_s, where (E.27) and (E.29) print L_s + 2 M_s.

    Args:
        frame: The frame.
        sine, cosine: Those of theta_y, numbers or shape (N,).
        turn, rate: Speeds of both turns of the frame over that of theta, numbers or shape (N,).
        l_s, m_s: Self inductance of a phase and mutual inductance of two, in H, numbers or shape
            (N,).
    """
    if frame == "alphabeta0":
        return ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    plane, zero = (l_s - m_s) * turn, l_s + 2.0 * m_s
    if frame != "dqy":
        return ((0.0, -plane, 0.0), (plane, 0.0, 0.0), (0.0, 0.0, 0.0))
    mixed, square = 3.0 * m_s * sine * cosine * rate, 3.0 * m_s * sine * sine
    return (
        (0.0, plane * sine, -plane * cosine),
        (-plane * sine, -mixed, (zero - square) * rate),
        (plane * cosine, -(l_s - m_s + square) * rate, mixed),
    )


def frame_rms(shape: FloatArray, turns: int = 1) -> FrameRms:
    """R.m.s. of the back-EMF on the axes for unit amplitude, paper 002, Table 3.1.

    The paper's qx and qy for the trapezoid, 1.83 and 1.92, are r.m.s.(|F|^2) / sqrt(3/2),
    another quantity.

    ``shape`` is the back-EMF shape F on the grid, shape (3, N), over ``turns`` electrical periods.

    Raises:
        InputError: The array is no shape.
    """
    alpha, beta, zero = _clarke_axes(shape)
    theta = grid(alpha.size, turns)
    d, q = park(DOUBLES, (alpha, beta), (np.cos(theta), np.sin(theta)))

    def rms(*parts: FloatArray) -> float:
        return math.sqrt(sum(float(np.mean(part**2)) for part in parts))

    return FrameRms(
        d=rms(d),
        q=rms(q),
        qx=rms(alpha, beta),
        qy=rms(alpha, beta, zero),
        zero=rms(zero),
    )


def loss_ratio_x_over_y(shape: FloatArray) -> float:
    """Copper loss by dqx, without current in the 0 axis, over that by dqy,
    for the same constant torque.

    The current on the one axis that makes torque is inverse to the back-EMF there, so the ratio is
    mean(1 / |F_alphabeta|^2) / mean(1 / |F_alphabeta0|^2).

    ``shape`` is the back-EMF shape F on the grid, shape (3, N), over any number of periods.

    Raises:
        InputError: As :func:`frame_angles`.
    """
    alpha, beta, zero = _clarke_axes(shape)
    size = _directed(alpha, beta, grid(alpha.size))
    return float(np.mean(1.0 / size**2) / np.mean(1.0 / (size**2 + zero**2)))


def _clarke_axes(shape: FloatArray) -> FloatArray:
    """Alpha, beta and 0 of a shape that has been checked, shape (3, N)."""
    if shape.ndim != 2 or shape.shape[0] != 3 or shape.shape[1] < LEAST_ANGLES:
        raise InputError(
            f"a back-EMF shape needs the shape (3, N), N from {LEAST_ANGLES} on, got {shape.shape}"
        )
    if not np.all(np.isfinite(shape)):
        raise InputError("a back-EMF shape must be finite")
    peak = float(np.max(np.abs(shape)))
    if peak > 1.0 + _ROUNDING:
        raise InputError(f"a back-EMF shape is at most 1, got {peak:g}: divide it by its peak")
    axes: FloatArray = CLARKE @ shape
    return axes


def _require_direction(size: FloatArray, theta: FloatArray) -> None:
    """Refuse an alpha-beta vector of length zero, relative to the largest."""
    lost = np.flatnonzero(size <= _ROUNDING * np.max(size))
    if lost.size:
        raise InputError(
            f"the alpha-beta vector of the back-EMF vanishes at {math.degrees(theta[lost[0]]):.6g} "
            "degrees, where dqx and dqy have no direction: give a shape of which two phases are "
            "never zero together"
        )


def _directed(alpha: FloatArray, beta: FloatArray, theta: FloatArray) -> FloatArray:
    """Length of the alpha-beta vector on the grid, shape (N,), of which it is
    known that it never vanishes.
    """
    size = np.hypot(alpha, beta)
    _require_direction(size, theta)
    # A vector that reverses from one angle to the next has passed zero,
    # though no angle of the grid met it.
    turned = np.flatnonzero(alpha * np.roll(alpha, -1) + beta * np.roll(beta, -1) <= 0.0)
    if turned.size:
        near = math.degrees(theta[turned[0]] + 0.5 * theta[1])
        raise InputError(
            f"the alpha-beta vector of the back-EMF vanishes or reverses near {near:.6g} degrees, "
            "where dqx and dqy have no direction: give a shape of which two phases are never zero "
            "together, or more angles"
        )
    return size


def _filled(entries: Entries, count: int) -> FloatArray:
    """Matrices (N, 3, 3) of entries that are numbers or arrays (N,)."""
    cells = [np.broadcast_to(cell, (count,)) for row in entries for cell in row]
    return np.stack(cells, axis=-1).reshape(count, 3, 3)


def _rotation(cosine: FloatArray, sine: FloatArray) -> FloatArray:
    """Rotations of the first two axes, shape (N, 3, 3); paper 002 (2.19)."""
    return _filled(((cosine, sine, 0.0), (-sine, cosine, 0.0), (0.0, 0.0, 1.0)), cosine.size)


def _reflection(cosine: FloatArray, sine: FloatArray) -> FloatArray:
    """Matrices from dqx to dqy, shape (N, 3, 3); paper 002 (3.1)."""
    return _filled(((1.0, 0.0, 0.0), (0.0, -sine, cosine), (0.0, cosine, sine)), cosine.size)


# Dynamic models of a machine without saliency in the frames, at any angles:
# the terms that decoupling needs.
#
# In every frame v = R i + L_f di/dt + omega_e C i + omega_e phi_m e, power-invariant, with the
# resistance R of a phase in Ohm. The matrices come from the closed forms of
# :mod:`dqforge.machines.phase_machines.frame_transforms`; here they take the exact derivative of the back-EMF
# shape, where :func:`dqforge.machines.phase_machines.frame_transforms.dynamic_model` takes differences on the
# grid.
#
# Paper 002, (2.14)-(2.22), (2.30), (2.31), (3.3)-(3.5), (4.10)-(4.18) and appendices B to E.
# Where it errs:
#
# =========================================
# ============================================================== printed
# holds =========================================
# ============================================================== (2.22), (C.7), (C.9), (C.12): a
# speed     none: dT/dtheta has no entry there term (L_s + 2 M_s) omega i_0 (3.3), (3.4), (4.10),
# (4.12), (E.27),     (L_s - M_s) sin theta_y, as (E.28) and (E.32) have with cosine (E.29), (E.47),
# (E.48): (L_s + 2 M_s) sin theta_y (3.4), (4.17), (E.48):                    (L_s + 2 M_s - 3 M_s
# sin^2 theta_y), as in (E.18) (L_s + 2 M_s - 3 M_s) sin^2 theta_y (3.4), (E.48): that term times
# a'/a alone a'/a omega i_qy, as in (4.17) and (E.13) (4.16): the term without inductance
# times (L_s - M_s), as in (E.47) (D.19), (E.51): torque without factor     times a_x^2, a_y^2, as
# in (2.32) and (3.6) =========================================
# ==============================================================


def frame_model(
    frame: Frame,
    theta: FloatArray,
    shape: FloatArray,
    slope: FloatArray,
    l_s: float,
    m_s: float,
    *,
    scaled: bool = False,
) -> DynamicModel:
    """Dynamic model in a frame at any angles, from closed forms.

    ::

        alphabeta0   L_f = diag(L_s - M_s, L_s - M_s, L_s + 2 M_s)          (2.14)-(2.16)
                     C = 0
        dq0, dqx     L_f the same                                           (2.20)-(2.22), (2.30), (2.31)
                     C_qd = -C_dq = (L_s - M_s) (1 + theta_x'), else 0      theta_x' = 0 in dq0
        dqy          L_f,qq = L_s + 2 M_s - 3 M_s sin^2 theta_y             (E.42), in (E.48) misprinted
                     L_f,00 = L_s - M_s + 3 M_s sin^2 theta_y               (E.46)
                     L_f,q0 = L_f,0q = 3/2 M_s sin 2 theta_y                (E.43), (E.45)
                     C_dq = -C_qd = (L_s - M_s) sin theta_y (1 + theta_x')  (E.27), (E.29), misprinted
                     C_0d = -C_d0 = (L_s - M_s) cos theta_y (1 + theta_x')  (E.28), (E.32)
                     C_00 = -C_qq = 3/2 M_s sin 2 theta_y theta_y'          (E.30), (E.34)
                     C_q0 = L_f,qq theta_y', C_0q = -L_f,00 theta_y'        (E.31), (E.33)

    Args:
        frame: The frame.
        theta: Angles in rad, shape (N,).
        shape, slope: Back-EMF shape F at these angles and its derivative by theta in 1/rad, shape
            (3, N).
        l_s, m_s: Self inductance of a phase and mutual inductance of two, in H.
        scaled: Whether currents, voltages and back-EMF are divided by a_x in dqx and a_y in dqy, as
            in paper 002. This adds (da/dtheta) / a times L_f to C, (D.9) and (E.13). The 0 axis of
            dqx, which the paper does without, is divided too.

    Returns:
        DynamicModel, with ``inductance`` and ``coupling`` of shape (N, 3, 3) in H,
        ``emf`` of shape (N, 3) without unit

    Raises:
        InputError: The inductances are not finite, or as
            :func:`dqforge.machines.phase_machines.frame_transforms.to_frame`: dqx and dqy need a
            back-EMF whose alpha-beta vector vanishes at no angle; the first where it does is named.
    """
    if not np.all(np.isfinite([l_s, m_s])):
        raise InputError(f"the inductances must be finite, got l_s = {l_s:g} H and m_s = {m_s:g} H")
    emf = to_frame(frame, theta, shape, shape, scaled=scaled).T
    sine: Entry = 0.0
    cosine: Entry = 1.0
    turn: Entry = 1.0
    rate: Entry = 0.0
    growth: Entry = 0.0
    if frame in ("dqx", "dqy"):
        rates = frame_rates(theta, shape, slope)
        _, size, zero = to_frame("dqx", theta, shape, shape)
        whole = np.hypot(size, zero)
        sine, cosine = -size / whole, zero / whole
        turn, rate = 1.0 + rates.theta_x, rates.theta_y
        growth = rates.growth_x if frame == "dqx" else rates.growth_y
    inductance = matrices(inductance_entries(frame, sine, cosine, l_s, m_s), theta.size)
    coupling = matrices(coupling_entries(frame, sine, cosine, turn, rate, l_s, m_s), theta.size)
    if scaled:
        coupling += np.reshape(growth, (-1, 1, 1)) * inductance
    return DynamicModel(inductance, coupling, emf)
