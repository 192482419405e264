"""The Kalman filter in matrices, an independent view of the step that is emitted: whole
covariances, the textbook's correction, numpy's solver.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.methods.ekf import Ekf
from dqforge.optimizer.observers.sampled_machine import (
    SampledMachine,
    Trial,
    applied,
    turned,
    wrapped,
)

_BOTH = np.eye(2)


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
        """Normalised innovation squared, shape (K, S)."""
        solved = np.linalg.solve(self.s, self.innovation[..., np.newaxis])[..., 0]
        return np.asarray(np.sum(self.innovation * solved, axis=-1))

    @property
    def log_likelihood(self) -> FloatArray:
        """Mean log-likelihood of an innovation per drive, shape (S,)."""
        return np.asarray(-0.5 * np.mean(np.linalg.slogdet(self.s)[1] + self.nis, axis=0))


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


BAND = 0.95


@dataclass(frozen=True, slots=True)
class Consistency:
    """Shares of time, 0 to 1, for which the NIS lies inside its 95 % band.

    ``samples``: the NIS of every sample of every drive; ``drives``: its mean over the drives at
    each sample; ``window``: its moving average over ``window_length`` samples of one drive.
    ``mean`` is the mean NIS, 2 if right.
    """

    mean: float
    samples: float
    drives: float
    window: float
    window_length: int


def band(degrees: int, share: float = BAND) -> tuple[float, float]:
    """Two-sided chi-square band of 2 x ``degrees`` degrees of freedom over ``degrees``:
    of a mean of so many NIS.
    """
    from scipy.stats import chi2

    low, high = chi2.ppf([0.5 * (1.0 - share), 0.5 * (1.0 + share)], 2 * degrees) / degrees
    return float(low), float(high)


def consistency(nis: FloatArray, settle: int = 100, window: int = 50) -> Consistency:
    """How consistent NIS values of shape (K, S) are, without the first ``settle`` samples."""
    nis = nis[settle:]
    total = np.cumsum(np.concatenate([np.zeros((1, nis.shape[1])), nis]), axis=0)
    moving = (total[window:] - total[:-window]) / window

    def inside(values: FloatArray, count: int) -> float:
        low, high = band(count)
        return float(np.mean((values >= low) & (values <= high)))

    return Consistency(
        mean=float(np.mean(nis)),
        samples=inside(nis, 1),
        drives=inside(np.mean(nis, axis=1), nis.shape[1]),
        window=inside(moving, window),
        window_length=window,
    )
