"""Angle at standstill and low speed from the saliency: a pulsating voltage along the
assumed d axis, and a PLL.

The firmware adds V w[n] to the voltage along the assumed d axis, w[n] = cos(2 pi n/N), one period
of N samples (N = 2: the sign changes every sample). At this frequency the machine is a sampled
admittance Y(z) in the rotor's frame, z = exp(2 pi j/N), from
`dqforge.optimizer.observers.sampled_machine` at standstill,

    Y(z) = (z - Phi)^-1 Gamma,   i_d = Y_d V z^n,   i_q = Y_q V z^n

Off by eps = theta - theta_hat the assumed q axis carries 1/2 (Y_d - Y_q) V sin 2 eps. Multiplied by
the same carrier, later by the dead time of the loop and the angle of Y_d - Y_q, and averaged over
one period of N samples, that leaves

    m = k/2 sin 2 eps,   k = |Y_d - Y_q| V (N = 2) or half of that (N > 2)

which a PLL drives to zero:   theta += t_s omega,   measure m,   omega += k_i m/k,
                              theta += k_p m/k. Its poles are
exact: roots of the loop with the average of N samples. The magnet's polarity does not show: the
start angle decides between theta and theta + pi.

Where the q axis' flux moves the d axis (l_dq of `Machine.jet`), the admittance is Y = L^-1 and the
PLL comes to rest where Y_dd sin 2 eps - Y_qq sin 2 eps + 2 Y_dq cos 2 eps = 0:

    theta_hat = theta - 1/2 atan2(2 l_dq, l_qq - l_dd)

White current noise of variance s^2 gives m the variance s^2/2 (N = 2) or
s^2/(2 N) per axis' average.

References:
    Paper 001, 7.2.4.2; M. Corley, R. Lorenz, "Rotor position and velocity estimation for a
    salient-pole PMSM at standstill and high speeds", IEEE Trans. Ind. Applications 34, 1998 ([90]
    there); Y.-D. Yoon, S.-K. Sul et al., "High-bandwidth sensorless algorithm for AC machines based
    on square-wave-type voltage injection", IEEE Trans. Ind. Applications 47, 2011 (N = 2).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.sampled_machine import electrical_limit, exact_entries

LONGEST = 16

# Samples from the instant at which a voltage is asked for to the period in which it acts.
DELAY = 1


@dataclass(frozen=True, slots=True)
class Injection:
    """A tracker of the saliency.

    Args:
        t_s: Sampling period in s.
        samples: N, samples per period of the injected voltage, 2 or an even number up to 16.
        voltage: Injected amplitude V in V.
        carrier, reference: w[n] and the demodulating carrier over one period, shape (N,).
        gain: k, demodulated current per radian of error, in A/rad; its sign is in the reference.
        k_p, k_i: Share of an error that the angle is corrected by per period, and the speed in 1/s
            per period.
        omega_max: Limit of the estimate in rad/s.
    """

    t_s: float
    samples: int
    voltage: float
    carrier: FloatArray
    reference: FloatArray
    gain: float
    k_p: float
    k_i: float
    omega_max: float

    @property
    def frequency(self) -> float:
        """Injected frequency in Hz."""
        return 1.0 / (self.samples * self.t_s)

    @property
    def poles(self) -> FloatArray:
        """Poles of the PLL with the average of N samples, in the z plane, shape (N + 1,),
        by falling modulus.
        """
        return closed_poles(self.k_p, self.k_i, self.t_s, self.samples)


def closed_poles(k_p: float, k_i: float, t_s: float, samples: int) -> FloatArray:
    """Eigenvalues of the loop over the errors of angle and speed and the last N -
    1 of the predicted angle.
    """
    found = np.linalg.eigvals(_loop(k_p, k_i, t_s, samples)[0])
    return np.asarray(found[np.argsort(-np.abs(found))])


def _loop(k_p: float, k_i: float, t_s: float, samples: int) -> tuple[FloatArray, FloatArray]:
    """Transition of (angle error, speed error, products of the last N - 1 samples over k),
    and its noise input.
    """
    size = samples + 1
    ahead = np.zeros(size)
    ahead[0], ahead[1] = (
        1.0,
        -t_s,
    )  # the error theta - theta_hat after the prediction, with the speed's as hat - true
    product, noise = ahead, np.zeros(size)
    mean = np.zeros(size)
    mean[2:] = 1.0 / samples
    mean = mean + product / samples
    a = np.zeros((size, size))
    a[0], a[1] = ahead - k_p * mean, k_i * mean
    a[1, 1] += 1.0
    noise[0], noise[1] = -k_p / samples, k_i / samples
    a[2], noise[2] = product, 1.0
    a[3:, 2:-1] += np.eye(samples - 2)
    return a, noise


def admittance(machine: Machine, t_s: float, samples: int, omega: float = 0.0) -> FloatArray:
    """Y(z) in A/V of held voltages and sampled currents in the rotor's frame at the
    injected frequency, shape (2, 2).

    At a speed (electrical, rad/s) the rotor's frame is left to turn; the entries are complex.
    """
    entries = exact_entries(linearised(machine), np.array([omega]), t_s)[0]
    z = np.exp(2j * np.pi / samples)
    return np.asarray(
        np.linalg.solve(z * np.eye(2) - entries[:4].reshape(2, 2), entries[4:8].reshape(2, 2))
    )


def injection(
    machine: Machine,
    t_s: float,
    voltage: float,
    bandwidth: float,
    *,
    samples: int = 2,
    damping: float = 1.0,
    current_noise: float = 0.0,
    noise_angle: float = np.radians(1.0),
    omega_max: float | None = None,
) -> Injection:
    """A tracker with a PLL of given bandwidth in rad/s (method ``bandwidth``).

    k_p and k_i put two poles at exp(s t_s), s^2 + 2 damping bandwidth s + bandwidth^2 = 0,
    of the PLL without average.

    Args:
        voltage: Injected amplitude in V.
        samples: N.
        current_noise: Standard deviation of a measured current in A, 0 if it does not matter.
        noise_angle: Largest standard deviation of the angle in rad that this noise may cause.

    Raises:
        InputError: A setting is out of range.
        NoSolutionError: Without saliency, or with too little of it for the noise; or the average
            makes the PLL unstable.
    """
    if samples not in range(2, LONGEST + 1, 2):
        raise InputError(
            f"control.observer.injection: samples per period must be 2, 4, ... {LONGEST}, got "
            f"{samples}"
        )
    if not (voltage > 0.0 and np.isfinite(voltage)):
        raise InputError(
            f"control.observer.injection: the voltage must be positive, got {voltage:g} V"
        )
    if not (bandwidth > 0.0 and bandwidth * t_s <= 1.0):
        raise InputError(
            f"control.observer.pole must lie above 0 and up to {1.0 / t_s:g} rad/s, got "
            f"{bandwidth:g}"
        )
    linear = linearised(machine)
    y = admittance(linear, t_s, samples)
    difference = complex(y[0, 0] - y[1, 1])
    if not abs(difference) > 1e-3 * abs(y[0, 0]):
        raise NoSolutionError(
            "control.observer: injection needs l_q to differ from l_d, which shows the angle; this "
            f"machine has l_d = {linear.l_d:g} H and l_q = {linear.l_q:g} H"
        )
    n = np.arange(samples)
    turn = 2.0 * np.pi / samples
    carrier = np.cos(turn * n)
    reference = np.cos(turn * (n - DELAY) + np.angle(difference))
    # N = 2 has only the sign; the phase is 0 or pi there, as all is real.
    gain = abs(difference) * voltage * (1.0 if samples == 2 else 0.5)
    roots = np.exp(np.roots([1.0, 2.0 * damping * bandwidth, bandwidth**2]) * t_s)
    product, total = float(np.real(np.prod(roots))), float(np.real(np.sum(roots)))
    found = Injection(
        t_s,
        samples,
        voltage,
        carrier,
        reference,
        float(gain),
        1.0 - product,
        (1.0 + product - total) / t_s,
        electrical_limit(linear, t_s, omega_max),
    )
    if np.max(np.abs(found.poles)) >= 1.0:
        raise NoSolutionError(
            f"control.observer: a PLL of {bandwidth:g} rad/s is too fast for an average over "
            f"{samples} samples of {t_s:g} s; write a slower pole or fewer samples"
        )
    noise = angle_noise(found, current_noise)
    if noise > noise_angle:
        raise NoSolutionError(
            f"control.observer: {current_noise:g} A of current noise makes the angle wander by "
            f"{np.degrees(noise):.2g} deg (r.m.s.), {np.degrees(noise_angle):.2g} are permitted; "
            f"inject {voltage * noise / noise_angle:.3g} V or more, or write a slower "
            "control.observer.pole"
        )
    return found


def angle_noise(tracker: Injection, current_noise: float) -> float:
    """Standard deviation of the angle in rad by white noise of the measured currents in A,
    exactly for the sampled PLL.

    The covariance of angle, speed and the last N - 1 products solves the
    discrete Lyapunov equation.
    """
    from scipy.linalg import solve_discrete_lyapunov

    power = float(np.mean(tracker.reference**2))
    a, b = _loop(tracker.k_p, tracker.k_i, tracker.t_s, tracker.samples)
    covariance = solve_discrete_lyapunov(a, np.outer(b, b))
    return float(np.sqrt(power * covariance[0, 0]) * current_noise / tracker.gain)


def cross_saturation_error(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Steady error theta_hat - theta = -1/2 atan2(2 l_dq, l_qq - l_dd) in rad at currents in A,
    shape (N,).

    With l_qq below l_dd the tracker was designed for the other sign of the saliency,
    and both arguments change sign.
    """
    jet = machine.jet(np.asarray(i_d, dtype=np.float64), np.asarray(i_q, dtype=np.float64))
    sign = 1.0 if machine.l_q > machine.l_d else -1.0
    mutual = 0.5 * (jet.l_dq + jet.l_qd)
    return np.asarray(-0.5 * np.arctan2(2.0 * sign * mutual, sign * (jet.l_qq - jet.l_dd)))


def usable_saliency(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Relative saliency sqrt((l_qq - l_dd)^2 + 4 l_dq^2)/(l_dd + l_qq) at currents in A,
    shape (N,).
    """
    jet = machine.jet(np.asarray(i_d, dtype=np.float64), np.asarray(i_q, dtype=np.float64))
    return np.asarray(np.hypot(jet.l_qq - jet.l_dd, jet.l_dq + jet.l_qd) / (jet.l_dd + jet.l_qq))


def speed_error(machine: LinearMachine, tracker: Injection, omega: float) -> float:
    """Angle error in rad, to first order, at a speed (electrical, rad/s),
    by the coupling that the speed makes.

    The frame turns while the voltage, along the d axis of the middle of the period, is held: Y_qd
    is not zero any more. What it leaves in phase with the reference, over the gain, is the error.
    """
    half = 0.5 * omega * tracker.t_s
    middle = np.array([[np.cos(half), -np.sin(half)], [np.sin(half), np.cos(half)]])
    y = admittance(machine, tracker.t_s, tracker.samples, omega) @ middle
    n = np.arange(tracker.samples)
    turn = 2.0 * np.pi / tracker.samples
    wave = np.real(y[1, 0] * tracker.voltage * np.exp(1j * turn * (n - DELAY)))
    return float(np.mean(wave * tracker.reference) / tracker.gain)


def highest_speed(
    machine: Machine, tracker: Injection, v_max: float, angle: float, i_q: float = 0.0
) -> float:
    """Electrical speed in rad/s up to which the tracker serves: three limits, the least counts.

    The coupling costs at most ``angle`` in rad; the voltage limit ``v_max`` in V leaves room for
    the injection above the back-EMF and the voltage of ``i_q`` in A; a turn lasts ten injected
    periods.
    """
    linear = linearised(machine)
    room = (v_max - tracker.voltage - linear.r_s * abs(i_q)) / max(
        float(np.hypot(linear.psi_pm, linear.l_q * i_q)), 1e-12
    )
    most = min(2.0 * np.pi * tracker.frequency / 10.0, room, tracker.omega_max)
    grid = np.linspace(0.0, max(most, 0.0), 201)
    errors = np.array([abs(speed_error(linear, tracker, float(w))) for w in grid])
    beyond = np.flatnonzero(errors > angle)
    return float(grid[max(int(beyond[0]) - 1, 0)] if beyond.size else grid[-1])
