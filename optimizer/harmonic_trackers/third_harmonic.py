"""Angle from the third harmonic of the back-EMF: the sum of the phase voltages,
integrated (paper 001, 7.2.3).

In the sum of the three phase voltages against the star point the voltages of resistance and
inductance cancel, as the currents add up to zero. What remains is omega times the harmonics of
orders 3, 9, ... of the back-EMF. Its integral

    lambda = a cos(3 theta - phi)

has an amplitude that no speed changes. The measured quantity u is the mean of the sum over one
period (an averaging converter), so that lambda[k] = lambda[k-1] + t_s u holds exactly. Drift is
compensated by what the estimate says that the flux must be:

    theta-  = theta + t_s omega                      lambda- = lambda + t_s (u - b)
    x       = 3 theta- - phi,   r = lambda- - a cos x
    lambda  = lambda- - k r,    b += k_b r
            (integrator with drift compensation; b in V is the offset of u)
    e       = -2/(3 a) r sin x
            (mean angle error, as sin^2 x is 1/2 on average)
    omega  += k_i e,            theta = theta- + k_p e

Without error r vanishes: no ripple, no bias. While k is small against 3 omega t_s and the PLL slow
against 6 omega, both loops keep apart: poles of (lambda, b) by k = 1 - p^2, k_b = (1 - p)^2/t_s, of
the PLL as its bandwidth says. What the loops do together at a speed is exact: eigenvalues of the
product of all steps over a period of lambda (`turn_pole`).

The angle is known but for multiples of 120 degrees, and the direction of rotation does not show:
the start angle and the sign of the start speed decide.

References:
    J. Moreira, "Indirect sensing for rotor flux position of permanent magnet AC motors operating
    over a wide speed range", IEEE Trans. Ind. Applications 32, 1996; paper 001, 7.2.3.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.models.matsui_model import ObserverRun
from dqforge.optimizer.observers.sampled_machine import wrapped

# Third harmonic over the fundamental, each as flux linkage, below which converters and unequal
# phases hide it.
_LEAST = 0.005

# How many times slower than the ripple of lambda the loops must be for the range that is stated.
_APART = 4.0


@dataclass(frozen=True, slots=True)
class ThirdHarmonic:
    """A tracker of the third harmonic.

    Args:
        t_s: Sampling period in s.
        amplitude, phase: a in V s and phi in rad of the integral of the sum voltage, a cos(3 theta
            - phi).
        k, k_b: Share of the flux error taken off per period, and the offset's correction in V per V
            s and period.
        k_p, k_i: PLL: share of the angle error per period, and the speed's correction in 1/s per
            period.
        omega_max: Limit of the estimate in rad/s (electrical).
    """

    t_s: float
    amplitude: float
    phase: float
    k: float
    k_b: float
    k_p: float
    k_i: float
    omega_max: float

    @property
    def least_speed(self) -> float:
        """Electrical speed in rad/s from which both loops are slow against the ripple
        that they must not follow.
        """
        of_flux = self.k / self.t_s / 3.0
        of_angle = self.k_p / self.t_s / 6.0
        return _APART * max(of_flux, of_angle)


def third_flux(machine: PhaseMachine) -> tuple[float, float]:
    """Amplitude a in V s and phase phi in rad of the integral a cos(3 theta - phi) of
    the sum of the back-EMFs.
    """
    theta = machine.theta
    third = 2.0 * np.mean(np.sum(machine.flux, axis=0) * np.exp(-3j * theta)) / 3j
    return float(np.abs(third)), float(-np.angle(third))


def other_harmonics(machine: PhaseMachine) -> float:
    """Angle error in rad, at most, by the other harmonics of the sum: their flux over
    three times that of the third.
    """
    places = np.arange(1, machine.angles // 2)
    orders = places[places != 3 * machine.turns] / machine.turns
    lines = np.abs(np.fft.rfft(np.sum(machine.flux, axis=0)))[1 : machine.angles // 2]
    parts = 2.0 * lines[places != 3 * machine.turns] / machine.angles / orders
    return float(np.sum(parts) / (3.0 * third_flux(machine)[0]))


def third_harmonic(
    machine: PhaseMachine | None,
    t_s: float,
    bandwidth: float,
    *,
    drift: float | None = None,
    omega_max: float,
) -> ThirdHarmonic:
    """A tracker by pole placement (method ``bandwidth``).

    Args:
        machine: The machine in phase quantities, None for one with sinusoidal back-EMF.
        bandwidth: Double pole of the PLL in rad/s.
        drift: Double pole of flux and offset in rad/s, by default as the PLL.
        omega_max: Largest electrical speed in rad/s.

    Raises:
        InputError: A pole is out of range.
        NoSolutionError: No third harmonic, or too little; or the sampling leaves fewer than six
            samples per turn of it.
    """
    own = bandwidth if drift is None else drift
    for value in (bandwidth, own):
        if not (value > 0.0 and value * t_s <= 0.5):
            raise InputError(
                f"control.observer.pole must lie above 0 and up to {0.5 / t_s:g} rad/s, got "
                f"{value:g}"
            )
    if machine is None:
        raise NoSolutionError(
            "control.observer: third-harmonic needs the third harmonic of the back-EMF; write "
            "machine.model: waveform with its back_emf, or choose another method"
        )
    amplitude, phase = third_flux(machine)
    if amplitude < _LEAST * machine.psi_pm:
        raise NoSolutionError(
            "control.observer: the third harmonic of this machine's flux is "
            f"{100.0 * amplitude / machine.psi_pm:.2f} % of the fundamental, "
            f"{100.0 * _LEAST:.1f} % are needed; choose another method"
        )
    if 3.0 * omega_max * t_s > 1.0:
        raise NoSolutionError(
            f"control.observer: at {omega_max:g} rad/s (electrical) a period of the third harmonic "
            f"has fewer than six samples of {t_s:g} s; sample faster"
        )
    p, flux = float(np.exp(-bandwidth * t_s)), float(np.exp(-own * t_s))
    return ThirdHarmonic(
        t_s,
        amplitude,
        phase,
        1.0 - flux**2,
        (1.0 - flux) ** 2 / t_s,
        1.0 - p**2,
        (1.0 - p) ** 2 / t_s,
        omega_max,
    )


def sum_voltage(machine: PhaseMachine, theta: FloatArray, t_s: float) -> FloatArray:
    """Mean of the sum of the back-EMFs over each period in V, from angles in rad at the samples,
    (K + 1, S) -> (K, S).

    All harmonics of the sum take part; the difference of their integral is exact
    whatever the speed in between.
    """
    count = machine.angles
    spectrum = np.fft.rfft(np.sum(machine.flux, axis=0)) / count
    orders = np.arange(1, len(spectrum) - 1) / machine.turns
    parts = 2.0 * spectrum[1:-1] / (1j * orders)
    used = np.flatnonzero(np.abs(parts) > 1e-12 * np.max(np.abs(parts)))
    flux = sum(
        (np.real(parts[n] * np.exp(1j * orders[n] * theta)) for n in used), np.zeros_like(theta)
    )
    return np.asarray(np.diff(flux, axis=0) / t_s)


def run(
    tracker: ThirdHarmonic, u: FloatArray, theta_0: FloatArray | float, omega_0: FloatArray | float
) -> ObserverRun:
    """Follow mean sum voltages in V, shape (K, S), from start angles in rad and
    speeds in rad/s (electrical).
    """
    periods, drives = u.shape
    theta, omega = np.empty((periods + 1, drives)), np.empty((periods + 1, drives))
    theta[0], omega[0] = theta_0, omega_0
    flux, offset = tracker.amplitude * np.cos(3.0 * theta[0] - tracker.phase), np.zeros(drives)
    for k in range(periods):
        ahead = theta[k] + tracker.t_s * omega[k]
        flux = flux + tracker.t_s * (u[k] - offset)
        x = 3.0 * ahead - tracker.phase
        rest = flux - tracker.amplitude * np.cos(x)
        flux, offset = flux - tracker.k * rest, offset + tracker.k_b * rest
        error = -2.0 / (3.0 * tracker.amplitude) * rest * np.sin(x)
        omega[k + 1] = np.clip(
            omega[k] + tracker.k_i * error, -tracker.omega_max, tracker.omega_max
        )
        theta[k + 1] = ahead + tracker.k_p * error
    return ObserverRun(theta, omega)


def _step_matrices(
    tracker: ThirdHarmonic, omega: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Transition of (theta, omega, flux, offset) errors at N angles, (N, 4, 4), and input of u, (N,
    4).
    """
    t_s, a = tracker.t_s, tracker.amplitude
    x = 3.0 * omega * t_s * np.arange(1, count + 1)
    sine = np.sin(x)
    rest = np.stack(
        [3.0 * a * sine, 3.0 * a * sine * t_s, np.ones(count), np.full(count, -t_s)], axis=-1
    )
    detect = (-2.0 / (3.0 * a) * sine)[:, np.newaxis] * rest
    m = np.tile(
        np.array(
            [
                [1.0, t_s, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, -t_s],
                [0.0, 0.0, 0.0, 1.0],
            ]
        ),
        (count, 1, 1),
    )
    m[:, 0] += tracker.k_p * detect
    m[:, 1] += tracker.k_i * detect
    m[:, 2] -= tracker.k * rest
    m[:, 3] += tracker.k_b * rest
    of_u = -2.0 / (3.0 * a) * sine * t_s
    b = np.stack(
        [
            tracker.k_p * of_u,
            tracker.k_i * of_u,
            np.full(count, (1.0 - tracker.k) * t_s),
            np.full(count, tracker.k_b * t_s),
        ],
        axis=-1,
    )
    return m, b


def turn_pole(tracker: ThirdHarmonic, omega: float) -> float:
    """Largest modulus of an error after one sample, on average, at a speed (electrical, rad/s):
    stable below 1.

    From the product of the linearised steps over about a period of lambda,
    the root of its spectral radius.
    """
    count = max(round(2.0 * np.pi / (3.0 * abs(omega) * tracker.t_s)), 1)
    product = np.eye(4)
    for matrix in _step_matrices(tracker, 2.0 * np.pi / (3.0 * count * tracker.t_s), count)[0]:
        product = matrix @ product
    return float(np.max(np.abs(np.linalg.eigvals(product))) ** (1.0 / count))


def angle_noise(tracker: ThirdHarmonic, omega: float, u_rms: float) -> float:
    """Standard deviation of the angle in rad by white noise of u of ``u_rms`` V at a speed,
    averaged over a period.

    The covariance follows the linearised steps until it repeats.
    """
    count = max(round(2.0 * np.pi / (3.0 * abs(omega) * tracker.t_s)), 1)
    m, b = _step_matrices(tracker, 2.0 * np.pi / (3.0 * count * tracker.t_s), count)
    product, noise = np.eye(4), np.zeros((4, 4))
    for matrix, column in zip(m, b, strict=True):
        product = matrix @ product
        noise = matrix @ noise @ matrix.T + np.outer(column, column)
    from scipy.linalg import solve_discrete_lyapunov

    covariance = solve_discrete_lyapunov(product, noise)
    total = 0.0
    for matrix, column in zip(m, b, strict=True):
        covariance = matrix @ covariance @ matrix.T + np.outer(column, column)
        total += covariance[0, 0]
    return float(np.sqrt(total / count) * u_rms)


def third_error(theta: FloatArray, true: FloatArray) -> FloatArray:
    """Estimated minus true angle in rad, brought to -60 .. 60 degrees, as multiples
    of 120 degrees do not show.
    """
    return np.asarray(wrapped(3.0 * (theta - true)) / 3.0)
