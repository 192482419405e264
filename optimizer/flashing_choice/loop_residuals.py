"""What a current loop leaves of a periodic disturbance, in closed form.

The loop is linear and the same at every angle where its integrators live in dq0: a voltage that
disturbs the order m of the stationary frame makes the current

    di_m = dV_m / (R + j w L + kp G + ki G / (j (w - w_0))),   w = m omega_e,  G = exp(-1.5 j w T_s)

with w_0 = omega_e in the plane (the integrators turn along) and 0 on the zero sequence; orders that
have an integrator of their own vanish. 1.5 samples pass from the measurement to the middle of what
the voltage does. Currents change nothing in each other's orders, and add up. The frames dqx and dqy
differ in their integrators only, which is left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.phase_control.phase_controller import AxisGains, PhaseControl

ComplexArray = NDArray[np.complex128]

DELAY = 1.5


_FADES_FROM = 0.8


def stationary(phases: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Alpha and beta as a complex waveform (N,), and the mean of the phases (N,).

    Args:
        phases: Phase quantities, shape (3, N).
    """
    turn = np.exp(2j * np.pi / 3.0 * np.arange(3))
    return np.asarray(2.0 / 3.0 * (turn @ phases)), np.asarray(np.mean(phases, axis=0))


def phases_of(plane: ComplexArray, zero: FloatArray) -> FloatArray:
    """Phase quantities (3, N) of alpha, beta and the zero sequence.

    Args:
        plane, zero: As from `stationary`.
    """
    turn = np.exp(-2j * np.pi / 3.0 * np.arange(3))
    return np.asarray(np.real(turn[:, np.newaxis] * plane) + zero)


def _integrated(
    control: PhaseControl, omega_e: float, orders: FloatArray, *, zero: bool
) -> FloatArray:
    """Share of each signed order that an integrator of its own takes away, 0 to 1."""
    share = np.zeros(orders.shape)
    if control.harmonics is None:
        return share
    for order in control.harmonics.zero if zero else control.harmonics.plane:
        frequency = abs(order * omega_e) / (2.0 * np.pi)
        left = (1.0 - frequency / control.harmonics.frequency_max) / (1.0 - _FADES_FROM)
        hit = np.abs(orders) == abs(order) if zero else orders == order
        share = np.where(hit, 1.0 if left > 0.0 else 0.0, share)
    return share


def _impedance(
    gains: AxisGains, r_s: float, inductance: float, w: FloatArray, turn: float, t_s: float
) -> ComplexArray:
    """Voltage over current in Ohm of the closed loop at angular frequencies in rad/s; infinite
    where the integrator stands.
    """
    late = np.exp(-1j * DELAY * w * t_s)
    slip = w - turn
    still = slip == 0.0
    integral = gains.ki / (1j * np.where(still, 1.0, slip)) * late
    found = r_s + 1j * w * inductance + gains.kp * late + integral
    return np.asarray(np.where(still & (gains.ki > 0.0), np.inf, found))


def residual_currents(
    control: PhaseControl,
    disturbance: FloatArray,
    omega_e: float,
    share: float = 1.0,
    turns: int = 1,
) -> FloatArray:
    """Phase currents in A, shape (3, N), that the loop leaves of voltages.

    Args:
        control: Gains, inductances and integrators.
        disturbance: Voltages in V that act on the phases beside what the controller knows, shape
            (3, N).
        omega_e: Electrical speed in rad/s, not 0.
        share: Inductance of the plant over the model's.
        turns: Electrical periods that the waveforms span; orders between the whole ones count.
    """
    plane, zero = stationary(disturbance)
    orders = np.fft.fftfreq(plane.size, turns / plane.size).astype(np.float64)
    w = orders * omega_e
    l_ab = 0.5 * (control.inductances[0] + control.inductances[1])
    found = []
    for values, gains, inductance, turn, is_zero in (
        (plane, control.gains[1], l_ab, omega_e, False),
        (zero.astype(np.complex128), control.gains[2], control.inductances[2], 0.0, True),
    ):
        impedance = _impedance(gains, control.r_s, share * inductance, w, turn, control.t_s)
        left = 1.0 - _integrated(control, omega_e, orders, zero=is_zero)
        lines = np.fft.fft(values) * left / impedance
        found.append(np.fft.ifft(lines))
    return phases_of(found[0], np.real(found[1]))


def followed_offsets(control: PhaseControl, offset: FloatArray, omega_e: float) -> FloatArray:
    """Currents in A, shape (3,), that the machine gets because its sensors are off by ``offset``
    (3,) in A: the loop's answer at standstill of the stationary frame.

    Args:
        control: Gains and integrators.
        offset: Errors of the sensors of a, b and c.
        omega_e: Electrical speed in rad/s, not 0.
    """
    plane, zero = stationary(offset[:, np.newaxis])
    gains, gains_0 = control.gains[1], control.gains[2]
    action = gains.kp + gains.ki / (-1j * omega_e)
    answers = action / (control.r_s + action) * plane
    nothing = gains_0.kp == 0.0 and gains_0.ki == 0.0
    return -phases_of(answers, np.zeros(1) if nothing else zero)[:, 0]


def noise_gain(gains: AxisGains, r_s: float, inductance: float, t_s: float) -> float:
    """R.m.s. of a current over that of white noise of its sensor, proportional action alone.

    Args:
        gains: Of the axis.
        r_s, inductance: Of the axis in Ohm and H.
        t_s: Sampling period in s.
    """
    z = np.exp(1j * np.linspace(-np.pi, np.pi, 4096, endpoint=False))
    pole = np.exp(-r_s * t_s / inductance)
    plant = (1.0 - pole) / r_s / (z - pole) / z
    answer = gains.kp * plant / (1.0 + gains.kp * plant)
    return float(np.sqrt(np.mean(np.abs(answer) ** 2)))
