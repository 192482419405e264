"""Extended Kalman filter for angle and speed of a synchronous machine from its currents (paper 001,
7.2.5).

State x = (i_d, i_q, omega, theta) with infinite inertia, (7.23) to (7.26), L_d and L_q kept apart.
From sample to sample (`dqforge.optimizer.observers.sampled_machine`, exact for a constant speed):

    i[k+1] = Phi(omega) i[k] + Gamma(omega) v_dq + h(omega),
        v_dq = the held voltage turned by -theta[k]
    omega[k+1] = omega[k],   theta[k+1] = theta[k] + t_s omega[k]

    F = [ Phi   Phi' i + Gamma' v + h'   -Gamma J v ]
                J v = (-v_q, v_d), ' = derivative by omega
        [ 0             1                     0     ]
        [ 0             t_s                   1     ]

The measured current is turned into the predicted rotor frame, where noise of equal
variance on both axes stays such:

    innovation nu = i_measured,dq - i_predicted,   H = [ 1 0 0 -i_q ]
                                                       [ 0 1 0  i_d ]

Process noise: white acceleration of density q_a (rad^2/s^3), whose integrals give the covariance of
omega and theta, and a variance q_i (A^2) per sample on both currents for voltages that the firmware
does not know.

Deviations from paper 001: it measures i_d and i_q as if the angle were known, (7.28), so that its H
lacks the last column; it takes the induced voltage (7.29) as an input, although it is a function of
the state.

References:
    S. Bolognani, R. Oboe, M. Zigliotto, "Sensorless full-digital PMSM drive EKF estimation of speed
    and rotor position", IEEE Trans. Ind. Electronics 46, 1999 ([74] of paper 001); Y. Bar-Shalom,
    X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, sections
    5.4 (consistency) and 10.3 (EKF).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.sampled_machine import (
    SampledMachine,
    Trial,
    applied,
    sampled_machine,
    turned,
    wrapped,
)

_PSI_LEAST = 1e-9


_BOTH = np.eye(2)


@dataclass(frozen=True, slots=True)
class Ekf:
    """An extended Kalman filter.

    Args:
        model: The sampled machine.
        q_i: Process variance of each current per sample in A^2.
        q_a: Density of the white acceleration (electrical) in rad^2/s^3.
        r: Variance of each measured current in A^2.
        theta_0, omega_0: Standard deviations of angle (rad) and speed (rad/s) at the start.
    """

    model: SampledMachine
    q_i: float
    q_a: float
    r: float
    theta_0: float = 0.3
    omega_0: float = 50.0

    @property
    def q(self) -> FloatArray:
        """Process covariance per sample, shape (4, 4)."""
        t_s = self.model.t_s
        q = np.zeros((4, 4))
        q[0, 0] = q[1, 1] = self.q_i
        q[2, 2], q[3, 3] = self.q_a * t_s, self.q_a * t_s**3 / 3.0
        q[2, 3] = q[3, 2] = self.q_a * t_s**2 / 2.0
        return q

    @property
    def p_0(self) -> FloatArray:
        """Covariance at the start, shape (4, 4): currents as measured."""
        return np.diag([self.r, self.r, self.omega_0**2, self.theta_0**2])


@dataclass(frozen=True, slots=True, eq=False)
class EkfRun:
    """Estimates of a filter over a trial of K periods of S drives.

    ``x`` are the states (i_d, i_q, omega, theta) after correction, shape (K + 1, S, 4);
    ``innovation`` in A, shape (K, S, 2), with its covariance ``s``, shape (K, S, 2, 2), ``p`` the
    last covariance, shape (S, 4, 4).
    """

    x: FloatArray
    innovation: FloatArray
    s: FloatArray
    p: FloatArray

    @property
    def theta(self) -> FloatArray:
        """Estimated angle in rad, shape (K + 1, S)."""
        return self.x[..., 3]

    @property
    def omega(self) -> FloatArray:
        """Estimated electrical speed in rad/s, shape (K + 1, S)."""
        return self.x[..., 2]

    @property
    def nis(self) -> FloatArray:
        """Normalised innovation squared nu' S^-1 nu, shape (K, S): chi-square of
        2 degrees if all is right.
        """
        a, b, d = self.s[..., 0, 0], self.s[..., 0, 1], self.s[..., 1, 1]
        x, y = self.innovation[..., 0], self.innovation[..., 1]
        return np.asarray((d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b))

    @property
    def log_likelihood(self) -> FloatArray:
        """Mean log-likelihood of an innovation per drive, shape (S,), without the constant -ln 2
        pi.
        """
        det = self.s[..., 0, 0] * self.s[..., 1, 1] - self.s[..., 0, 1] ** 2
        return np.asarray(-0.5 * np.mean(np.log(det) + self.nis, axis=0))


def ekf(
    machine: Machine, t_s: float, q_i: float, q_a: float, r: float, omega_max: float | None = None
) -> Ekf:
    """A filter with given noise; ``omega_max`` in rad/s (electrical) limits the estimate.

    Raises:
        InputError: A variance is not positive.
        NoSolutionError: The machine shows its angle neither by a magnet nor by saliency.
    """
    for name, value in (("q_i", q_i), ("q_a", q_a), ("r", r)):
        if not (value > 0.0 and np.isfinite(value)):
            raise InputError(
                f"control.observer: {name} of the Kalman filter must be positive and finite, got "
                f"{value:g}"
            )
    model = sampled_machine(machine, t_s, omega_max)
    linear = model.machine
    if linear.psi_pm + abs(linear.saliency) * linear.i_max < _PSI_LEAST:
        raise NoSolutionError(
            "control.observer: a machine without magnet flux and without saliency shows no angle"
        )
    return Ekf(model, q_i, q_a, r)


def transition(
    model: SampledMachine, x: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predicted state and Jacobian F for states of shape (..., 4) and voltages in stator
    coordinates, (..., 2).
    """
    i, omega, theta = x[..., :2], x[..., 2], x[..., 3]
    v_dq = turned(v, theta)
    entries, slopes = model.entries_and_slopes(omega)
    following = np.empty_like(x)
    following[..., :2] = applied(entries, i, v_dq)
    following[..., 2] = omega
    following[..., 3] = theta + model.t_s * omega
    f = np.zeros((*x.shape, 4))
    f[..., :2, :2] = entries[..., :4].reshape(*omega.shape, 2, 2)
    f[..., :2, 2] = applied(slopes, i, v_dq)
    f[..., 0, 3] = entries[..., 4] * v_dq[..., 1] - entries[..., 5] * v_dq[..., 0]
    f[..., 1, 3] = entries[..., 6] * v_dq[..., 1] - entries[..., 7] * v_dq[..., 0]
    f[..., 2, 2] = f[..., 3, 3] = 1.0
    f[..., 3, 2] = model.t_s
    return following, f


def correct(
    x: FloatArray, p: FloatArray, i: FloatArray, r: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Correction by a measured current in stator coordinates: state, covariance,
    innovation and its covariance.
    """
    innovation = turned(i, x[..., 3]) - x[..., :2]
    b = np.empty_like(innovation)
    b[..., 0], b[..., 1] = -x[..., 1], x[..., 0]
    ph = p[..., :2] + b[..., np.newaxis, :] * p[..., 3:]  # P H', (..., 4, 2)
    s = ph[..., :2, :] + b[..., np.newaxis] * ph[..., 3:, :]
    s = 0.5 * (s + np.swapaxes(s, -1, -2)) + r * _BOTH
    gain = np.swapaxes(np.linalg.solve(s, np.swapaxes(ph, -1, -2)), -1, -2)
    corrected = x + (gain @ innovation[..., np.newaxis])[..., 0]
    left = p - gain @ np.swapaxes(ph, -1, -2)
    return corrected, 0.5 * (left + np.swapaxes(left, -1, -2)), innovation, s


def run(
    filter_: Ekf,
    trial: Trial,
    theta_error: float | FloatArray = 0.0,
    omega_error: float | FloatArray = 0.0,
) -> EkfRun:
    """Run the filter over a trial, from its measured currents and from errors of
    angle (rad) and speed (rad/s).
    """
    periods, drives = trial.v.shape[:2]
    model, q = filter_.model, filter_.q
    x = np.empty((periods + 1, drives, 4))
    x[0, :, 3] = trial.theta[0] + theta_error
    x[0, :, 2] = trial.omega[0] + omega_error
    x[0, :, :2] = turned(trial.i[0], x[0, :, 3])
    p = np.broadcast_to(filter_.p_0, (drives, 4, 4))
    innovation, s = np.empty((periods, drives, 2)), np.empty((periods, drives, 2, 2))
    for k in range(periods):
        predicted, f = transition(model, x[k], trial.v[k])
        p = f @ p @ np.swapaxes(f, -1, -2) + q
        x[k + 1], p, innovation[k], s[k] = correct(predicted, p, trial.i[k + 1], filter_.r)
        x[k + 1, :, 2] = np.clip(x[k + 1, :, 2], -model.omega_max, model.omega_max)
    return EkfRun(x, innovation, s, p)


def angle_error(theta: FloatArray, trial: Trial) -> FloatArray:
    """Estimated minus true angle in rad, wrapped, of estimates of shape (K + 1, S)."""
    return wrapped(theta - trial.theta)
