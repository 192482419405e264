"""Noise covariances of the Kalman filter by consistency of its innovations,
on simulated drives with stated noise.

If the model and its noise are right, the innovations are white with the covariance S that the
filter states, and their likelihood

    ln p = -1/2 sum over samples of (ln det S + nu' S^-1 nu)

is largest for the right q_i, q_a, r: a filter too sure of itself pays by nu' S^-1 nu, one too
cautious by ln det S. The maximum is searched for in the logarithms of the three with a simplex
(nlopt, Sbplx), on drives whose noise is known: current sensor, voltage error, acceleration. Nothing
is set by hand.

Consistency is then shown on other drives (Bar-Shalom, section 5.4): the normalised innovation
squared (NIS) of a sample follows the chi-square distribution of 2 degrees of freedom, its mean over
S drives or over a window of W samples that of 2 S or 2 W, divided by S or W.

References:
    Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    2001, section 5.4; R. Mehra, "On the identification of variances and adaptive Kalman filtering",
    IEEE Trans. Automatic Control 15, 1970.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.models.kalman_model import Ekf, ekf, run
from dqforge.optimizer.observers.sampled_machine import (
    CurrentSensor,
    Trial,
    simulate,
    usual_sensor,
    wandering_speed,
)

BAND = 0.95


_TRAINING = (300, 16)


_EVALUATIONS = 90


_DECADES = 6.0


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """What disturbs a drive.

    ``sensor`` measures the currents; ``voltage_rms`` in V per axis and period acts besides the
    commanded voltage; ``acceleration`` is the density of the electrical acceleration in rad/s^1.5:
    the standard deviation of the speed's change over one second.
    """

    sensor: CurrentSensor
    voltage_rms: float
    acceleration: float


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


def usual_noise(machine: Machine, v_dc: float, t_s: float, dead_time: float = 0.0) -> DriveNoise:
    """Noise of a drive that the design says nothing of.

    The sensor of `usual_sensor`; a voltage error of a hundredth of half the DC voltage and of the
    dead time's share; torque steps as large as the machine's own torque at i_max, one in ten
    milliseconds on average.
    """
    linear = linearised(machine)
    voltage = 0.5 * v_dc * (0.01 + dead_time / t_s)
    inertia = linear.inertia if linear.inertia is not None else 0.0
    torque = linear.torque_per_ampere * linear.i_max
    rate = linear.pole_pairs * torque / inertia if inertia > 0.0 and torque > 0.0 else 1e4
    return DriveNoise(usual_sensor(linear), voltage, rate * 0.1)


def noisy_trial(
    machine: Machine,
    t_s: float,
    noise: DriveNoise,
    speed: float,
    i_ref: FloatArray,
    periods: int,
    drives: int,
    seed: int,
) -> Trial:
    """Drives that begin at ``speed`` (electrical, rad/s) and wander from there,
    with the stated noise.
    """
    omega = wandering_speed(speed, noise.acceleration, t_s, periods, drives, seed)
    return simulate(
        machine,
        t_s,
        omega,
        i_ref,
        sensor=noise.sensor,
        voltage_rms=noise.voltage_rms,
        theta_0=1.0,
        seed=seed + 1,
    )


def first_guess(
    machine: Machine, t_s: float, noise: DriveNoise, omega_max: float | None = None
) -> Ekf:
    """The filter with the covariances that the stated noise implies, by formula.

    r is the sensor's variance, q_a the square of the acceleration's density, q_i the mean square of
    Gamma(0) times the voltage error. Quantisation and the change of speed within a sample are what
    it leaves to the search.
    """
    start = ekf(machine, t_s, 1.0, noise.acceleration**2, noise.sensor.variance, omega_max)
    gamma = start.model.table[[4, 7], 0]
    return replace(
        start,
        q_i=max(float(np.mean(gamma**2)) * noise.voltage_rms**2, 1e-6 * noise.sensor.variance),
    )


def tuned_ekf(
    machine: Machine,
    t_s: float,
    noise: DriveNoise,
    speed: float,
    i_ref: FloatArray,
    *,
    start: Ekf | None = None,
    omega_max: float | None = None,
    seed: int = 100,
) -> Ekf:
    """The filter whose innovations are likeliest on simulated drives around ``speed`` (electrical,
    rad/s).

    Args:
        i_ref: Currents (i_d, i_q) in A during the trial, shape (2,).
        start: Where the search begins, by default `first_guess`; the result does not depend on it.
        omega_max: Limit of the estimated electrical speed in rad/s.
        seed: Of the training drives.

    Raises:
        NoSolutionError: The filter loses its own simulation whatever the covariances.
    """
    import nlopt

    first = first_guess(machine, t_s, noise, omega_max)
    begin = first if start is None else start
    periods, drives = _TRAINING
    trial = noisy_trial(machine, t_s, noise, speed, i_ref, periods, drives, seed)
    scale = np.log([first.q_i, first.q_a, first.r])

    def candidate(logarithms: FloatArray) -> Ekf:
        q_i, q_a, r = np.exp(logarithms)
        return replace(first, q_i=float(q_i), q_a=float(q_a), r=float(r))

    def likelihood(logarithms: FloatArray, _: FloatArray) -> float:
        with np.errstate(all="ignore"):  # a filter that loses its machine is only a bad one
            value = float(np.mean(run(candidate(logarithms), trial).log_likelihood))
        return value if np.isfinite(value) else -1e9

    search = nlopt.opt(nlopt.LN_SBPLX, 3)
    search.set_max_objective(likelihood)
    width = 0.5 * _DECADES * np.log(10.0)
    # Where the voltage errs more than the sensor, r is hardly seen:
    # it is never less than the sensor's own variance.
    low, high = scale - np.array([width, width, 0.0]), scale + width
    search.set_lower_bounds(low)
    search.set_upper_bounds(high)
    search.set_initial_step(1.0)
    search.set_ftol_abs(3e-5)
    search.set_xtol_abs(1e-2)
    search.set_maxeval(_EVALUATIONS)
    best = np.asarray(
        search.optimize(np.clip(np.log([begin.q_i, begin.q_a, begin.r]), low, high)),
        dtype=np.float64,
    )
    if not search.last_optimum_value() > -1e8:
        raise NoSolutionError(
            "control.observer: no noise covariances make the Kalman filter follow its own "
            "simulation; lower the speed"
        )
    return candidate(best)


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
