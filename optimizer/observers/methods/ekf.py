"""The extended Kalman filter for angle and speed of a synchronous machine from its currents (paper
001, 7.2.5): record, tuning, gains and step.

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

Its noise covariances come from the consistency of its innovations on simulated drives with stated
noise. If the model and its noise are right, the innovations are white with the covariance S that
the filter states, and their likelihood

    ln p = -1/2 sum over samples of (ln det S + nu' S^-1 nu)

is largest for the right q_i, q_a, r: a filter too sure of itself pays by nu' S^-1 nu, one too
cautious by ln det S. The maximum is searched for in the logarithms of the three with a simplex
(nlopt, Sbplx), on drives whose noise is known: current sensor, voltage error, acceleration. Nothing
is set by hand.

References:
    S. Bolognani, R. Oboe, M. Zigliotto, "Sensorless full-digital PMSM drive EKF estimation of speed
    and rotor position", IEEE Trans. Ind. Electronics 46, 1999 ([74] of paper 001); Y. Bar-Shalom,
    X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, sections
    5.4 (consistency) and 10.3 (EKF);
    R. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Trans.
    Automatic Control 15, 1970.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.scenario import ComplexArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import (
    USUAL_SHARE_OF_SPEED,
    USUAL_WIDTH,
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
)
from dqforge.optimizer.observers.sampled_machine import (
    CurrentSensor,
    SampledGains,
    SampledMachine,
    Trial,
    entries_and_slopes,
    model_scale,
    next_currents,
    sampled_gains,
    sampled_machine,
    simulate,
    turned,
    usual_sensor,
    wandering_speed,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Dq, Member, Pair, limited

_PSI_LEAST = 1e-9

# Periods and drives of the trial, evaluations of the search and its width in decades.
_TRAINING = (300, 16)
_EVALUATIONS = 90
_DECADES = 6.0


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
    erring = innovations(first.model, trial)
    scale = np.log([first.q_i, first.q_a, first.r])

    def candidate(logarithms: FloatArray) -> Ekf:
        q_i, q_a, r = np.exp(logarithms)
        return replace(first, q_i=float(q_i), q_a=float(q_a), r=float(r))

    def likelihood(logarithms: FloatArray, _: FloatArray) -> float:
        with np.errstate(all="ignore"):  # a filter that loses its machine is only a bad one
            value = float(np.mean(erring(candidate(logarithms)).log_likelihood))
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


def usual_ekf(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Nothing of it is used: the filter is tuned by its innovations."""
    return ObserverTuning(
        min(USUAL_WIDTH, 0.05 / t_s), min(USUAL_WIDTH, 0.05 / t_s), omega_floor=0.02 * omega_max
    )


@lru_cache(maxsize=16)
def _consistent(machine: LinearMachine, t_s: float, omega_max: float) -> EkfGains:
    noise = usual_noise(machine, 2.0 * omega_max * machine.psi_pm, t_s)
    i_ref = np.array([0.0, 0.5 * machine.i_max])
    return ekf_gains(
        tuned_ekf(machine, t_s, noise, USUAL_SHARE_OF_SPEED * omega_max, i_ref, omega_max=omega_max)
    )


def design_ekf(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> EkfGains:
    """Covariances of consistent innovations on simulated drives with the noise of
    `usual_noise` (`tuned_ekf`).

    The DC voltage, of which the noise of the voltage is a share, is taken as twice the
    back-EMF at ``omega_max``.
    """
    del tuning
    return _consistent(machine, t_s, omega_max)


_TURN = np.float32(6.2831855)
_I_SQUARE = np.float32(1e30)

# Of the Riccati equation: 2^40 samples.
_DOUBLINGS = 40

# Largest variance of an angle in rad^2: one of which nothing is known has pi^2/3.
_P_THETA = np.float32(10.0)


@dataclass(frozen=True, slots=True)
class EkfGains:
    """The sampled machine, variances per sample and at the start, and the limit of the speed."""

    model: SampledGains
    q_i: Annotated[float, Member("process variance of a current per sample", "A^2")]
    q_22: Annotated[float, Member("of the speed", "rad^2/s^2")]
    q_23: Annotated[float, Member("of speed and angle", "rad^2/s")]
    q_33: Annotated[float, Member("of the angle", "rad^2")]
    r: Annotated[float, Member("variance of a measured current", "A^2")]
    p_omega: Annotated[float, Member("variance of the first speed", "rad^2/s^2")]
    p_theta: Annotated[float, Member("variance of the first angle", "rad^2")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]


# Places of the covariance that are kept: behind i_d and i_q the upper triangle, row by row.
_UPPER = tuple((n, m) for n in range(4) for m in range(n, 4))

# The scalars of the state: currents, and the covariance in the order of `_UPPER`.
_MEMBERS = (
    ("i_d", Member("estimated current, d", "A")),
    ("i_q", Member("... and q", "A")),
    ("p_dd", Member("variance of i_d", "A^2")),
    ("p_dq", Member("covariance of i_d and i_q", "A^2")),
    ("p_d_omega", Member("... of i_d and speed", "A rad/s")),
    ("p_d_theta", Member("... of i_d and angle", "A rad")),
    ("p_qq", Member("variance of i_q", "A^2")),
    ("p_q_omega", Member("covariance of i_q and speed", "A rad/s")),
    ("p_q_theta", Member("... of i_q and angle", "A rad")),
    ("p_omega", Member("variance of the speed", "rad^2/s^2")),
    ("p_omega_theta", Member("covariance of speed and angle", "rad^2/s")),
    ("p_theta", Member("variance of the angle", "rad^2")),
)

_ROWS, _COLUMNS = (np.array(places) for places in zip(*_UPPER, strict=True))

# Where each entry of a covariance stands among those that are kept.
_FULL = np.array([[_UPPER.index((min(n, m), max(n, m))) for m in range(4)] for n in range(4)])
_DIAGONAL = _FULL.diagonal()
_LOW_ROWS, _LOW_COLUMNS = [0, 0, 1], [0, 1, 1]  # Places of the covariance of the currents alone.


def ekf_gains(filter_: Ekf) -> EkfGains:
    """What the firmware needs of a filter."""
    q, p = filter_.q, filter_.p_0
    values = (
        filter_.q_i,
        q[2, 2],
        q[2, 3],
        q[3, 3],
        filter_.r,
        p[2, 2],
        p[3, 3],
        filter_.model.omega_max,
    )
    return EkfGains(sampled_gains(filter_.model), *(float(value) for value in values))


def ekf_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s.

    Its scalars are i_d and i_q in A and the upper triangle of the covariance of (i_d, i_q, omega,
    theta).
    """
    zero = np.zeros_like(theta_e)
    return ObserverState((), theta_e, omega_e, False, (zero,) * (2 + len(_UPPER)))


def ekf_sizes(scalars: FloatArray, _: FloatArray) -> FloatArray:
    """Noticeable changes of the scalars of M filters, shape (M, 12): a covariance
    counts by its two variances.
    """
    size = np.empty_like(scalars)
    norm = np.hypot(scalars[:, 0], scalars[:, 1])
    size[:, 0] = size[:, 1] = np.where(norm > 1e-6, norm, 1.0)
    root = np.sqrt(np.abs(scalars[:, 2 + _DIAGONAL]))
    for k, (n, m) in enumerate(_UPPER):
        size[:, 2 + k] = np.maximum(root[:, n] * root[:, m], 1e-30)
    return size


class _Transition(NamedTuple):
    """Entries of the sampled machine, currents in A before, voltage in V in the rotor's frame,
    angle of the period in rad, derivatives of the currents by the state, shape (2, 4, N).
    """

    e: Reals
    i: Pair
    u: Pair
    advance: Reals
    f: Reals


def _transition(gains: EkfGains, state: ObserverState, v: Pair, o: Arithmetic) -> _Transition:
    """Currents and angle one period after a state, and their derivatives by it."""
    model, i = gains.model, (state.scalars[0], state.scalars[1])
    u = o.let("u", o.park(v, o.rotation(state.theta_e)), "voltage in the rotor's frame, V")
    advance = o.let("advance", model.t_s * state.omega_e, "angle of the period, rad")
    x = o.let("x", limited(o, advance, model.x_max))
    o.remark("The sampled machine and its derivatives by the speed.")
    e, slopes = entries_and_slopes(o, model, x)
    f = np.empty((2, 4, *np.shape(i[0])), dtype=np.asarray(i[0]).dtype)
    f[0, 0], f[0, 1], f[1, 0], f[1, 1] = e[0], e[5], e[6], e[1]
    f[0, 2], f[1, 2] = next_currents(slopes, i, u)
    f[0, 3], f[1, 3] = e[2] * u[1] - e[7] * u[0], e[8] * u[1] - e[3] * u[0]
    return _Transition(e, i, u, advance, o.let("f", f))


def _ekf_predicted(
    gains: EkfGains, state: ObserverState, v: Pair, maths: Arithmetic
) -> tuple[Dq, Reals, Reals]:
    """Currents, covariance of shape (4, 4, N) and angle, foretold."""
    o, model = maths, gains.model
    p = np.array(state.scalars[2:])[_FULL]
    e, i, u, advance, f = _transition(gains, state, v, o)
    o.remark("Covariance one period on: f p f' + q.")
    by = f[:, :, np.newaxis]
    a = ((by[:, 0] * p[0] + by[:, 1] * p[1]) + by[:, 2] * p[2]) + by[:, 3] * p[3]
    a = o.let("a", a)
    last = o.let("last", p[3, 2:] + model.t_s * p[2, 2:])
    new = np.empty_like(p)
    parts = a[_LOW_ROWS] * f[_LOW_COLUMNS]
    total = ((parts[:, 0] + parts[:, 1]) + parts[:, 2]) + parts[:, 3]
    new[0, 0], new[1, 1] = total[0] + gains.q_i, total[2] + gains.q_i
    new[0, 1] = new[1, 0] = total[1]
    new[:2, 2] = new[2, :2] = a[:, 2]
    new[:2, 3] = new[3, :2] = a[:, 3] + model.t_s * a[:, 2]
    new[2, 2] = p[2, 2] + gains.q_22
    new[2, 3] = new[3, 2] = (p[2, 3] + model.t_s * p[2, 2]) + gains.q_23
    new[3, 3] = (last[1] + model.t_s * last[0]) + gains.q_33
    current = o.let("current", next_currents(e, i, u), "foretold, A")
    theta = o.let("theta", o.wrap(state.theta_e + advance), "foretold angle, rad")
    return current, o.let("p", new), theta


def _ekf_begun(
    gains: EkfGains, theta: Reals, omega: Reals, i: Pair, o: Arithmetic
) -> ObserverState:
    """The measured current at a given angle and speed, with the covariance of the start."""
    first = o.let("first", o.park(i, o.rotation(theta)), "measured current, A")
    zero = o.full(0.0, theta)
    values = (gains.r, gains.r, gains.p_omega, gains.p_theta)
    rows = tuple(o.full(values[n], theta) if n == m else zero for n, m in _UPPER)
    return ObserverState((), theta, omega, True, (*first, *rows))


def _ekf_sound(gains: EkfGains, i: Pair, speed: Reals, p: Reals, det: Reals, turn: Reals) -> Any:
    """Whether all is within the range of a filter that works, shape (N,): false for not-a-number.

    ``p`` are the variances, shape (4, N), ``det`` is the determinant of the innovation's
    covariance, ``turn`` the correction of the angle in rad.
    """
    good = (det > 0.0) & (turn >= -_TURN) & (turn <= _TURN)
    good &= (speed >= -gains.omega_max) & (speed <= gains.omega_max)
    good &= (i[0] * i[0] + i[1] * i[1]) < _I_SQUARE
    for variance in p:
        good &= variance > 0.0
    return good & (p[2] <= gains.omega_max * gains.omega_max + gains.p_omega) & (p[3] <= _P_THETA)


class _Seen(NamedTuple):
    """Foretold currents in A, covariance (4, 4, N) and angle in rad; innovation in A, covariance
    times observation (4, 2, N), covariance of the innovation in A^2 with its determinant.
    """

    foretold: Dq
    p: Reals
    theta: Reals
    nu: Dq
    h: Reals
    s: tuple[Reals, Reals, Reals]
    det: Reals


def _ekf_seen(gains: EkfGains, state: ObserverState, v: Pair, i: Pair, o: Arithmetic) -> _Seen:
    """A sample beside what was foretold of it."""
    foretold, p, theta = _ekf_predicted(gains, state, v, o)
    seen = o.let("seen", o.park(i, o.rotation(theta)), "measured current, A")
    nu = o.let("nu", Dq(seen.d - foretold.d, seen.q - foretold.q), "innovation, A")
    o.remark("Covariance of the innovation, and the gain.")
    b = o.let("b", np.array([-foretold.q, foretold.d]))
    h = o.let("h", p[:, :2] + b * p[:, 3:])
    s_dd = o.let("s_dd", (h[0, 0] + b[0] * h[3, 0]) + gains.r)
    s_dq = o.let("s_dq", h[0, 1] + b[0] * h[3, 1])
    s_qq = o.let("s_qq", (h[1, 1] + b[1] * h[3, 1]) + gains.r)
    return _Seen(
        foretold, p, theta, nu, h, (s_dd, s_dq, s_qq), o.let("det", s_dd * s_qq - s_dq * s_dq)
    )


class _Corrected(NamedTuple):
    """Currents in A, upper triangle of the covariance, limited speed in rad/s, and by how much the
    angle was corrected in rad.
    """

    current: Dq
    upper: Reals
    speed: Reals
    turn: Reals


def _ekf_corrected(gains: EkfGains, state: ObserverState, seen: _Seen, o: Arithmetic) -> _Corrected:
    """The foretold state corrected by a sample."""
    foretold, p, _, nu, h, (s_dd, s_dq, s_qq), det = seen
    inverse = o.let("inverse", 1.0 / det)
    k = o.let("k", (h * np.array([s_qq, s_dd]) - h[:, ::-1] * s_dq) * inverse)
    shift = o.let("shift", k[:, 0] * nu.d + k[:, 1] * nu.q)
    taken = k[_ROWS] * h[_COLUMNS]
    upper = o.let("after", p[_ROWS, _COLUMNS] - (taken[:, 0] + taken[:, 1]))
    reached = o.let("reached", state.omega_e + shift[2])
    speed = o.let("speed", limited(o, reached, gains.omega_max), "rad/s")
    current = o.let("corrected", Dq(foretold.d + shift[0], foretold.q + shift[1]), "current, A")
    return _Corrected(current, upper, speed, shift[3])


def ekf_step(
    gains: EkfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).

    A sample after which a number is out of range (`_ekf_sound`) begins anew with its current, the
    covariance of the start, the angle that was foretold and the speed before.
    """
    o = maths
    if not state.started:
        return _ekf_begun(gains, state.theta_e, state.omega_e, i, o)
    seen = _ekf_seen(gains, state, v, i, o)
    current, upper, speed, turn = _ekf_corrected(gains, state, seen, o)
    theta = seen.theta
    sound = _ekf_sound(gains, current, speed, upper[_DIAGONAL], seen.det, turn)
    return o.either(
        sound,
        lambda: ObserverState((), o.wrap(theta + turn), speed, True, (*current, *upper)),
        lambda: _ekf_begun(gains, theta, state.omega_e, i, o),
    )


class Innovations(NamedTuple):
    """Innovations ``nu`` in A, shape (K, S, 2), of S drives over K periods, with the covariance
    that the filter states, ``s`` in A^2, shape (K, S, 2, 2).
    """

    nu: FloatArray
    s: FloatArray

    @property
    def nis(self) -> FloatArray:
        """Normalised innovation squared nu' S^-1 nu, shape (K, S): chi-square of
        2 degrees if all is right.
        """
        a, b, d = self.s[..., 0, 0], self.s[..., 0, 1], self.s[..., 1, 1]
        x, y = self.nu[..., 0], self.nu[..., 1]
        return np.asarray((d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b))

    @property
    def log_likelihood(self) -> FloatArray:
        """Mean log-likelihood of an innovation per drive, shape (S,), without the constant -ln 2
        pi.
        """
        det = self.s[..., 0, 0] * self.s[..., 1, 1] - self.s[..., 0, 1] ** 2
        return np.asarray(-0.5 * np.mean(np.log(det) + self.nis, axis=0))


def innovations(model: SampledMachine, trial: Trial) -> Callable[[Ekf], Innovations]:
    """How filters over one model err in a trial of K periods of S drives, from true angles and
    speeds: by the step that is emitted, in double precision, all samples in one call of CasADi.

    A filter whose numbers leave its range goes on: it does not begin anew.
    """
    import casadi

    from dqforge.optimizer.steps.step_graphs import Graphs, Number, graph

    def numbers(symbol: Any) -> tuple[Any, ...]:
        return tuple(Number(symbol[k]) for k in range(symbol.numel()))

    periods, drives = trial.v.shape[:2]
    count = len(_MEMBERS)
    state, noise = casadi.SX.sym("state", count + 2), casadi.SX.sym("noise", 5)
    v, i = casadi.SX.sym("v", 2), casadi.SX.sym("i", 2)
    own = ekf_gains(Ekf(model, 1.0, 1.0, 1.0))
    q_i, q_22, q_23, q_33, r = numbers(noise)
    gains = replace(own, q_i=q_i, q_22=q_22, q_23=q_23, q_33=q_33, r=r)
    scalars, o = numbers(state), Graphs()
    before = ObserverState((), scalars[count], scalars[count + 1], True, scalars[:count])
    seen = _ekf_seen(gains, before, numbers(v), numbers(i), o)
    current, upper, speed, turn = _ekf_corrected(gains, before, seen, o)
    after = casadi.vertcat(*map(graph, (*current, *upper, o.wrap(seen.theta + turn), speed)))
    found = casadi.vertcat(*map(graph, (*seen.nu, *seen.s)))
    step = casadi.Function("step", [state, noise, v, i], [after, found])
    run = step.map(drives).mapaccum(periods)
    first = np.zeros((count + 2, drives))
    first[0], first[1] = turned(trial.i[0], trial.theta[0]).T
    first[count], first[count + 1] = trial.theta[0], trial.omega[0]
    inputs = [part.reshape(-1, 2).T for part in (trial.v, trial.i[1:])]

    def of(filter_: Ekf) -> Innovations:
        given = ekf_gains(filter_)
        for k, (n, m) in enumerate(_UPPER):
            first[2 + k] = filter_.p_0[n, m]
        values = np.array([given.q_i, given.q_22, given.q_23, given.q_33, given.r])
        column = np.repeat(values[:, np.newaxis], periods * drives, axis=1)
        told = np.asarray(run(first, column, *inputs)[1]).T.reshape(periods, drives, 5)
        return Innovations(told[..., :2], told[..., [2, 3, 3, 4]].reshape(periods, drives, 2, 2))

    return of


def ekf_rest(gains: EkfGains, omega: FloatArray, v: ComplexArray, i: ComplexArray) -> FloatArray:
    """Scalars of the filter at rest on machines that are as it believes, shape (M, 12).

    The covariance is the steady solution of the Riccati equation, by doubling (Anderson, Moore,
    "Optimal Filtering", 1979, section 6.7).

    Args:
        omega: Electrical speeds in rad/s, shape (M,).
        v, i: Voltage in V that acted over the period and current in A at its end, both d + j q in
            the rotor's frame at its end, shape (M,).
    """
    state = ObserverState((), -gains.model.t_s * omega, omega, scalars=(i.real, i.imag))
    f = np.zeros((len(omega), 4, 4))
    f[:, :2] = np.moveaxis(_transition(gains, state, (v.real, v.imag), EXACT).f, -1, 0)
    f[:, 2, 2] = f[:, 3, 3] = 1.0
    f[:, 3, 2] = gains.model.t_s
    h = np.zeros((len(omega), 2, 4))
    h[:, 0, 0] = h[:, 1, 1] = 1.0
    h[:, 0, 3], h[:, 1, 3] = -i.imag, i.real
    q = np.zeros((4, 4))
    q[0, 0] = q[1, 1] = gains.q_i
    q[2, 2], q[2, 3], q[3, 2], q[3, 3] = gains.q_22, gains.q_23, gains.q_23, gains.q_33
    foretold = steady_covariance(f, h, q, gains.r)
    across = h @ foretold
    s = across @ _transposed(h) + gains.r * np.eye(2)
    p = foretold - _transposed(across) @ np.linalg.solve(s, across)
    return np.column_stack([i.real, i.imag, p[:, _ROWS, _COLUMNS]])


def steady_covariance(f: FloatArray, h: FloatArray, q: FloatArray, r: float) -> FloatArray:
    """Covariance before the correction of steady Kalman filters, shape (M, n, n).

    Args:
        f, h: Transition and observation, shapes (M, n, n) and (M, m, n).
        q: Process covariance, shape (n, n).
        r: Variance of each measurement.
    """
    one = np.eye(len(q))
    a, g, p = _transposed(f), _transposed(h) @ h / r, np.broadcast_to(q, f.shape)
    for _ in range(_DOUBLINGS):
        within = np.linalg.inv(one + g @ p)
        ahead = a @ within
        more = _transposed(a) @ p @ within @ a
        g, a, p = g + ahead @ g @ _transposed(a), ahead @ a, p + more
        if not np.max(np.abs(more) / (1e-300 + np.abs(p))) > 1e-13:
            break
    return 0.5 * (p + _transposed(p))


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)


def ekf_in_words(_tuning: ObserverTuning, gains: EkfGains, t_s: float) -> str:
    """What the innovations have tuned.

    Args:
        gains: Of `design_ekf`.
        t_s: Sampling period in s.
    """
    return (
        f"tuned by its innovations: variance of the currents {gains.q_i:.3g} A^2 per sample, "
        f"of what is measured {gains.r:.3g} A^2, density of the acceleration "
        f"{gains.q_22 / t_s:.3g} rad^2/s^3"
    )


METHOD = ObserverMethod(
    name="ekf",
    code="ekf",
    title="extended Kalman filter",
    design=design_ekf,
    start=ekf_start,
    step=ekf_step,
    usual=usual_ekf,
    searched=(),
    gains=EkfGains,
    scale=model_scale,
    in_words=ekf_in_words,
    settle=300,
    rest=ekf_rest,
    sizes=ekf_sizes,
    unproven="its gains follow the covariance, which is part of the state and no linear system",
    members=StateMembers((), _MEMBERS),
)
