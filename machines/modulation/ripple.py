"""Ripple of flux, current and torque within the carrier period, from the switched voltages.

Pulses are centred in the carrier period T = 1 / f_sw and the references stay constant in it. The
integral of the difference between switched and wanted voltage, the harmonic flux lambda, is zero at
both ends and in the middle of the period and straight between the switching instants. For the phase
with the duty cycle u it is, less the part common to the three phases and in terms of v_dc T,

    g(s) = -G(s, 1 - u) / 2,   G(s, a) = min(s, a) (1 - max(s, a)),
                               s = 0 to 1 over the first half of the period

and -g over the second half. G is the Green's function of a string,
whose products integrate in closed form:

    < g_j g_k > = a (1 - b) (1 - a^2 - (1 - b)^2) / 24,   a <= b the two values of 1 - u

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical and graphical methods for
    carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics 14(1), 1999,
    doi:10.1109/63.737592 (harmonic flux trajectories, harmonic distortion function). The closed
    forms here were derived anew with computer algebra.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineOrBatch
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    PhaseWaveforms,
    in_linear_range,
    modulate,
    sector_waveforms,
)
from dqforge.machines.modulation.registry import hand_over
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, rotor_axes

_THIRTY = math.pi / 6.0


_SIXTY = math.pi / 3.0


_ROOT3 = math.sqrt(3.0)


# Cross product psi x i as a matrix.
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


# Places in an interval, denser towards its ends, which are left out.
_PLACES = 0.5 - 0.5 * np.cos(np.linspace(1e-5, math.pi - 1e-5, 25))


# Operating points at once: some arrays of 512 x 100 angles x 8 segments x 2 axes are 7 MB each.
_CHUNK = 512


@dataclass(frozen=True, slots=True)
class Ripple:
    """Ripple at operating points, arrays of the shape (...).

    Args:
        current: Root mean square of the ripple of a phase current in A, over the electrical period.
        i_d, i_q: Root mean squares of the ripple in rotor coordinates in A.
        torque: Largest peak-to-peak torque within a carrier period in N m, over the electrical
            period.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray


def switching_instants(duty: FloatArray, t_s: float = 1.0) -> FloatArray:
    """When the upper switches of a carrier period turn on and off: (1 -+ u) t_s / 2,
    pulses centred in the period.

    Args:
        duty: Duty cycles, any shape (...), saturated at 0 and 1.
        t_s: Carrier period in s.

    Returns:
        Times in s from the start of the period. At the duty cycle 1 they are its ends and at 0 both
        are its middle: the phase does not switch.
    """
    saturated = np.clip(duty, 0.0, 1.0)
    return 0.5 * t_s * np.stack([1.0 - saturated, 1.0 + saturated], axis=-1)


def flux_moments(duty: FloatArray) -> FloatArray:
    """Averages < g_j g_k > over a carrier period, in (v_dc T)^2.

    Args:
        duty: Duty cycles of any number n of legs, shape (..., n), within 0 and 1; of one leg g is
            the flux of its own potential, and what legs have in common falls out where it does not
            act.

    Returns:
        FloatArray, shape (..., n, n)
    """
    off = 1.0 - duty
    a = np.minimum(off[..., :, None], off[..., None, :])
    b = np.maximum(off[..., :, None], off[..., None, :])
    return np.asarray(a * (1.0 - b) * (1.0 - a**2 - (1.0 - b) ** 2) / 24.0)


def harmonic_distortion_factor(
    name: ModulationName, index: ArrayLike, load_angle: ArrayLike = 0.0
) -> FloatArray:
    """Mean square of the harmonic flux over an electrical period, normalised as by Hava 1999 (HDF).

    ::

        HDF = c2 m^2 + c3 m^3 + c4 m^4,   m = V / (v_dc / 2) = 4/pi M
        HDF = 288 < |lambda|^2 > / (v_dc / f_sw)^2

    so that a machine with the inductance L has a phase-current ripple of v_dc / (24 L f_sw)
    sqrt(HDF) r.m.s. The coefficients are in the records of the modulators; those of GDPWM depend
    on the clamping angle, delta = psi - 30 degrees:

        c2 = 6,   c3 = (9 cos 3 delta - 54 cos delta - 8 sqrt 3) / (2 pi)
        c4 = 27/8 + 27 sqrt 3 / (64 pi) (4 cos 2 delta - 2 cos 4 delta)

    At the same carrier frequency. Discontinuous modulators commutate at 2/3 of the rate: for equal
    commutations divide by the square of 3/2.

    Args:
        name: The modulator.
        index: Modulation index M relative to six-step operation, any shape; meaningful in the
            linear range only.
        load_angle: Angle in rad by which the current lags the voltage, broadcastable; only GDPWM
            and DDT-GDPWM depend on it.
    """
    m, phi = np.broadcast_arrays(
        2.0 * SIX_STEP_AMPLITUDE * np.asarray(index, dtype=np.float64),
        np.asarray(load_angle, dtype=np.float64),
    )
    c2, c3, c4 = MODULATORS[name].distortion(phi)
    return np.asarray(m**2 * (c2 + m * (c3 + m * c4)))


def inverse_inductance(machine: MachineOrBatch, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Inverse of the incremental inductances in 1/H, shape (N, 2, 2), at currents in A,
    shape (N,).

    Args:
        machine: Any machine, or one per point.
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    jet = machine.jet(i_d, i_q)
    matrix = np.stack(
        [np.stack([jet.l_dd, jet.l_dq], axis=-1), np.stack([jet.l_qd, jet.l_qq], axis=-1)], axis=-2
    )
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def ripple_squares(wave: PhaseWaveforms, stiffness: FloatArray) -> FloatArray:
    """Mean squares of the ripple of i_d and i_q, shape (N, 2), in A^2 for v_dc T = 1 V s.

    Multiply by (v_dc / f_sw)^2; half of their sum is the mean square of a phase.

    Args:
        wave: Waveforms of N points from `sector_waveforms`.
        stiffness: Inverse of the incremental inductances in 1/H, shape (N, 2, 2).
    """
    axes = stiffness[:, None] @ rotor_axes(wave.theta_e)
    through = axes @ flux_moments(np.clip(wave.modulation.duty, 0.0, 1.0))
    return np.asarray(np.einsum("ng,ngkp,ngkp->nk", wave.weight, through, axes))


def _flux_corners(duty: FloatArray, theta_e: FloatArray) -> FloatArray:
    """Harmonic flux in rotor coordinates at the corners of the first half period, shape (..., 5,
    2), in v_dc T.
    """
    off = 1.0 - duty
    places = np.sort(off, axis=-1)[..., :, None]
    own = off[..., None, :]
    phases = -0.5 * np.minimum(places, own) * (1.0 - np.maximum(places, own))
    corners = phases @ np.swapaxes(rotor_axes(theta_e), -1, -2)
    ends = np.zeros((*corners.shape[:-2], 1, 2))
    return np.concatenate([ends, corners, ends], axis=-2)


def _torque_span(linear: FloatArray, quadratic: FloatArray, corners: FloatArray) -> FloatArray:
    """Peak-to-peak of linear . x + x quadratic x (...) along the flux polygon (...,
    5, 2) and its mirror image.

    `linear` (..., 2) and `quadratic` (..., 2, 2). The torque is a parabola
    over each straight piece.
    """
    forth = np.concatenate([corners, -corners], axis=-2)
    start, step = forth[..., :-1, :], np.diff(forth, axis=-2)
    bent = np.einsum("...si,...ij,...sj->...s", step, quadratic, step)
    both = quadratic + np.swapaxes(quadratic, -1, -2)
    slope = np.einsum("...i,...si->...s", linear, step) + np.einsum(
        "...si,...ij,...sj->...s", step, both, start
    )
    first = np.einsum("...i,...si->...s", linear, start) + np.einsum(
        "...si,...ij,...sj->...s", start, quadratic, start
    )
    curved = bent != 0.0
    vertex = np.clip(np.where(curved, -slope / np.where(curved, 2.0 * bent, 1.0), 0.0), 0.0, 1.0)
    values = np.concatenate([first, first + vertex * (slope + vertex * bent)], axis=-1)
    return np.asarray(np.ptp(values, axis=-1))


def _peak_angles(name: ModulationName, lag: FloatArray) -> FloatArray:
    """Angles (N, n) of the voltage vector at which the largest torque ripple is sought, in rad,
    for lags (N,).

    Close together, and up to both sides of the angles where the resting phase changes.
    """
    change = np.clip(hand_over(name, lag), 0.0, _SIXTY)[:, None]
    angles = np.concatenate([change * _PLACES, change + (_SIXTY - change) * _PLACES], axis=-1)
    return (
        np.concatenate([angles, angles + _SIXTY], axis=-1) if MODULATORS[name].one_rail else angles
    )


def _largest_torque_ripple(
    name: ModulationName,
    machine: Machine,
    currents: FloatArray,
    voltages: FloatArray,
    v_dc: float,
    t_s: float,
) -> FloatArray:
    """Largest peak-to-peak torque in N m (N,) for currents and voltages of the shape (2, N)."""
    direction = np.arctan2(voltages[1], voltages[0])
    theta = (
        _peak_angles(name, direction - np.arctan2(currents[1], currents[0])) - direction[:, None]
    )
    spans = torque_spans(name, machine, currents, voltages, theta, v_dc=v_dc, t_s=t_s)
    return np.asarray(np.max(spans, axis=-1))


def torque_spans(
    name: ModulationName,
    machine: Machine,
    currents: FloatArray,
    voltages: FloatArray,
    theta: FloatArray,
    *,
    v_dc: float,
    t_s: float,
) -> FloatArray:
    """Peak-to-peak torque in N m within a carrier period, shape (N, n), at electrical angles of the
    rotor in rad.

    Args:
        name: The modulator.
        machine: Any machine; a saturated one is linearised at the operating point.
        currents, voltages: In d and q, A and V (peak), shape (2, N).
        theta: Angles, shape (N, n).
        v_dc, t_s: DC-link voltage in V and carrier period in s.
    """
    voltage = dq_to_phases(voltages[0][:, None], voltages[1][:, None], theta)
    current = dq_to_phases(currents[0][:, None], currents[1][:, None], theta)
    corners = v_dc * t_s * _flux_corners(modulate(name, voltage, current, v_dc).duty, theta)
    # T = 3/2 p psi x i, where psi varies by lambda and i by the stiffness times lambda.
    stiffness = inverse_inductance(machine, currents[0], currents[1])
    psi_d, psi_q = machine.flux(currents[0], currents[1])
    by_current = (np.stack([-psi_q, psi_d], axis=-1)[:, None, :] @ stiffness)[:, 0, :]
    factor = 1.5 * machine.pole_pairs
    linear = factor * (by_current + np.stack([currents[1], -currents[0]], axis=-1))
    quadratic = factor * _TURN @ stiffness
    return _torque_span(linear[:, None], quadratic[:, None], corners)


def _chunk_ripple(
    name: ModulationName,
    machine: Machine,
    currents: FloatArray,
    voltages: FloatArray,
    v_dc: float,
    t_s: float,
) -> FloatArray:
    """Rows of `Ripple` for currents and voltages of the shape (2, N), shape (4, N)."""
    wave = sector_waveforms(name, voltages[0], voltages[1], currents[0], currents[1], v_dc)
    squares = (v_dc * t_s) ** 2 * ripple_squares(
        wave, inverse_inductance(machine, currents[0], currents[1])
    )
    square_d, square_q = squares[:, 0], squares[:, 1]
    torque = _largest_torque_ripple(name, machine, currents, voltages, v_dc, t_s)
    return np.stack(
        [np.sqrt(0.5 * (square_d + square_q)), np.sqrt(square_d), np.sqrt(square_q), torque]
    )


def ripple(
    name: ModulationName,
    machine: Machine,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    *,
    v_dc: float,
    f_sw: float,
) -> Ripple:
    """Ripple of currents and torque that the modulator makes in a machine.

    Within a carrier period the rotor stands still and the flux varies by lambda, the currents by
    the inverse of the incremental inductances times lambda; in the linear machine by lambda_d / l_d
    and lambda_q / l_q. The torque is 3/2 p (psi_d i_q - psi_q i_d) of both, without linearisation.
    Squares are averaged over the electrical period to rounding; the largest torque ripple is that
    of 50 angles in 60 degrees.

    Args:
        name: The modulator.
        machine: Any machine; a saturated one is linearised at the operating point.
        i_d, i_q, omega_m: Currents in A (peak) and mechanical speed in rad/s, broadcastable to the
            shape (...).
        v_dc, f_sw: DC-link voltage in V and carrier frequency in Hz.

    Returns:
        Arrays of the shape (...); NaN where the voltage is beyond the linear range.
    """
    points = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (i_d, i_q, omega_m))
    )
    d, q, omega = (value.ravel() for value in points)
    v_d, v_q = machine.voltage(d, q, machine.pole_pairs * omega)
    rows = np.full((4, d.size), np.nan)
    (possible,) = np.nonzero(in_linear_range(name, np.hypot(v_d, v_q), v_dc))
    for start in range(0, possible.size, _CHUNK):
        part = possible[start : start + _CHUNK]
        currents, voltages = np.stack([d[part], q[part]]), np.stack([v_d[part], v_q[part]])
        rows[:, part] = _chunk_ripple(name, machine, currents, voltages, v_dc, 1.0 / f_sw)
    current, ripple_d, ripple_q, torque = rows.reshape(4, *points[0].shape)
    return Ripple(current=current, i_d=ripple_d, i_q=ripple_q, torque=torque)
