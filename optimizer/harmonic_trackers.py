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

import math
from typing import Annotated

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import Reals
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.estimators import Tracker, TrackerLoop
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.optimizer.observers.methods.matsui_model import ObserverRun
from dqforge.optimizer.observers.parts import ObserverState, StateMembers
from dqforge.optimizer.observers.sampled_machine import wrapped
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member, Pair, limited

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


# The third-harmonic tracker as the firmware runs it.


@dataclass(frozen=True, slots=True)
class ThirdHarmonicGains:
    """The integral of the sum voltage, what takes its drift away, and a loop on it."""

    t_s: Annotated[float, Member("sampling period", "s")]
    amplitude: Annotated[float, Member("of the integral of the sum voltage", "V s")]
    phase: Annotated[float, Member("its phase", "rad")]
    k: Annotated[float, Member("share of the flux error per period")]
    k_b: Annotated[float, Member("offset per flux error and period", "1/s")]
    k_p: Annotated[float, Member("share of the angle error per period")]
    k_i: Annotated[float, Member("speed per angle error and period", "1/s")]
    detector: Annotated[float, Member("angle error per flux error: -2/(3 amplitude)", "rad/(V s)")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]


MEMBERS = StateMembers(
    (),
    (
        ("flux", Member("integral of the sum voltage", "V s")),
        ("offset", Member("of the sum voltage", "V")),
    ),
)


def third_harmonic_gains(tracker: ThirdHarmonic) -> ThirdHarmonicGains:
    """What the firmware needs of a tracker; the phase is brought to -pi to pi."""
    return ThirdHarmonicGains(
        tracker.t_s,
        tracker.amplitude,
        float((tracker.phase + np.pi) % (2.0 * np.pi) - np.pi),
        tracker.k,
        tracker.k_b,
        tracker.k_p,
        tracker.k_i,
        -2.0 / (3.0 * tracker.amplitude),
        tracker.omega_max,
    )


def third_harmonic_start(
    gains: ThirdHarmonicGains, theta_e: Reals, omega_e: Reals
) -> ObserverState:
    """Start from an angle in rad, good to 60 degrees, and a speed in rad/s (electrical), whose sign
    decides.
    """
    del gains
    zero = np.zeros_like(theta_e)
    return ObserverState((), theta_e, omega_e, started=False, scalars=(zero, zero))


def third_harmonic_step(
    gains: ThirdHarmonicGains,
    state: ObserverState,
    v: Pair,
    i: Pair,
    heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> ObserverState:
    """One sample: u in V, mean of v_a + v_b + v_c against the star point over the period that ends
    now; v and i are not needed.
    """
    del v, i
    o, (flux, offset), (u,) = maths, state.scalars, heard
    if not state.started:
        first = o.rotation(o.wrap(3.0 * state.theta_e - gains.phase))[0]
        scalars = (gains.amplitude * first, offset)
        return ObserverState((), state.theta_e, state.omega_e, scalars=scalars)
    theta = o.let("theta", o.wrap(state.theta_e + gains.t_s * state.omega_e), "foretold angle, rad")
    turn = o.let("turn", o.rotation(o.wrap(3.0 * theta - gains.phase)))
    model = o.let("model", gains.amplitude * turn[0])
    moved = o.choose(o.magnitude(u) < 1e6, flux + gains.t_s * (u - offset), model)
    moved = o.let("flux", moved, "V s; as foretold where u is no number")
    rest = o.let("rest", moved - model)
    error = o.let("error", (gains.detector * rest) * turn[1], "rad")
    omega = o.let("omega", state.omega_e + gains.k_i * error)
    return ObserverState(
        (),
        o.wrap(theta + gains.k_p * error),
        limited(o, omega, gains.omega_max),
        scalars=(moved - gains.k * rest, offset + gains.k_b * rest),
    )


# The third harmonic as a tracker of a design: what the sum of the phase voltages may hold besides,
# its usual tuning, its range.
#
# Currents that add up to zero leave nothing in the sum where the inductances seen by each phase add
# up to the same, L_aa + L_ba + L_ca = ...: a saliency of the second harmonic does so. What differs
# from phase to phase or over the angle, times the largest current, is a flux beside the third
# harmonic's, and turns the angle by that over three times its amplitude.

_LOOP = (
    0.15  # double pole of the loop over the largest electrical speed: a fifth of it is the least
)


_DRIFT = 0.5  # that of flux and offset over the loop's


_SLOWEST = 2.0 * math.pi * 0.5  # in rad/s


def usual_loop(omega_max: float, t_s: float) -> float:
    """Double pole of the loop in rad/s with which the range begins at a fifth of the largest speed.

    Args:
        omega_max: Largest electrical speed in rad/s.
        t_s: Sampling period in s.
    """
    return min(max(_LOOP * omega_max, _SLOWEST), 0.5 / t_s)


def current_angle(machine: SalientPhaseMachine, amplitude: float, i_max: float) -> float:
    """Angle in rad by which currents may turn the third harmonic, at most.

    Args:
        machine: Whose inductances vary.
        amplitude: Of the integral of the sum voltage in V s.
        i_max: Largest current in A, peak.
    """
    sums = np.sum(machine.inductance, axis=1)
    away = sums - np.mean(sums)
    away = away - np.mean(away, axis=1, keepdims=True)  # the same of all phases carries no current
    return float(np.max(np.linalg.norm(away, axis=1))) * math.sqrt(1.5) * i_max / (3.0 * amplitude)


def design_third_harmonic(design: Design, settings: ObserverSettings) -> ThirdHarmonicGains:
    """Gains of the firmware.

    Args:
        design: Machine, topology and sampling.
        settings: ``pll_bandwidth`` is the double pole of the loop, ``bandwidth`` that of flux and
            offset.

    Raises:
        InputError: A pole is out of range, or the neutral carries a current.
        NoSolutionError: There is no third harmonic, too little of it, or too much besides.
    """
    machine, phases, t_s = design.machine, design.phase_machine, design.control.t_s
    omega_m = machine.omega_m_max
    omega_m = design.control.bases.speed if omega_m is None else omega_m
    omega_max = 1.2 * omega_m * machine.pole_pairs
    loop = settings.pll_bandwidth
    loop = usual_loop(omega_max / 1.2, t_s) if loop is None else loop
    drift = _DRIFT * loop if settings.bandwidth is None else settings.bandwidth
    plain = phases.phases if isinstance(phases, SalientPhaseMachine) else phases
    found = third_harmonic(plain, t_s, loop, drift=drift, omega_max=omega_max)
    rule = TOPOLOGIES[design.inverter.topology]
    if rule.neutral or rule.diodes:
        raise InputError(
            f"inverter.topology: {design.inverter.topology} lets the phase currents add up to "
            "something, which the sum of the phase voltages then shows beside the third harmonic; "
            "write three-wire, or another control.observer.method"
        )
    assert plain is not None
    angle = other_harmonics(plain)
    if isinstance(phases, SalientPhaseMachine):
        angle += current_angle(phases, found.amplitude, design.i_max)
    if angle > ANGLE_LIMIT:
        raise NoSolutionError(
            "control.observer: other harmonics of the sum of the phase voltages, and currents, "
            f"turn the angle of the third by up to {math.degrees(angle):.3g} deg, "
            f"{math.degrees(ANGLE_LIMIT):.3g} deg are permitted; choose another method"
        )
    gains = third_harmonic_gains(found)
    _require_speed(design, gains)
    return gains


def _require_speed(design: Design, gains: ThirdHarmonicGains) -> None:
    """Refuse a simulation that runs on it below its range."""
    wanted = None if design.simulation is None else design.simulation.sensorless
    least = _as_designed(gains).least_speed / design.machine.pole_pairs
    if wanted is not None and wanted.below < least * (1.0 - 1e-9):
        raise NoSolutionError(
            f"simulation.sensorless: third-harmonic holds from {format_quantity(least, 'rpm')} on, "
            f"the drive would run on it down to {format_quantity(wanted.below, 'rpm')}; write "
            f"below: {format_quantity(1.02 * least, 'rpm', 3)} or more, or a smaller "
            "control.observer.pll_bandwidth"
        )


def _as_designed(gains: ThirdHarmonicGains) -> ThirdHarmonic:
    """The tracker that the gains are of."""
    return ThirdHarmonic(
        gains.t_s,
        gains.amplitude,
        gains.phase,
        gains.k,
        gains.k_b,
        gains.k_p,
        gains.k_i,
        gains.omega_max,
    )


def _speeds(design: Design, gains: ThirdHarmonicGains) -> tuple[float, float]:
    del design
    return _as_designed(gains).least_speed, gains.omega_max


def _in_words(gains: ThirdHarmonicGains) -> str:
    loop = math.sqrt(gains.k_i / gains.t_s)
    drift = math.sqrt(gains.k_b / gains.t_s)
    return (
        f"flux of {gains.amplitude:.4g} V s in the sum; loop {loop:.4g} rad/s, flux and offset "
        f"{drift:.4g} rad/s"
    )


def _tracking(gains: ThirdHarmonicGains) -> TrackerLoop:
    """The loop for the judgement of a speed loop: it sees the error of the predicted angle, on
    average over the ripple of twice the third harmonic, to which it is slow in its range.
    """
    return TrackerLoop(gains.t_s, gains.k_p, gains.k_i, ((0, 1.0),))


TRACKER = Tracker(
    name="third-harmonic",
    code="third_harmonic",
    title="third harmonic of the back-EMF with phase-locked loop",
    design=design_third_harmonic,
    start=third_harmonic_start,
    step=third_harmonic_step,
    gains=ThirdHarmonicGains,
    speeds=_speeds,
    in_words=_in_words,
    hears=("sum-voltage",),
    at_speed=True,
    loop=_tracking,
    members=MEMBERS,
)
