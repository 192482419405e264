"""INFORM as the firmware runs it: written once, in the order of operations of the emitted C
(``observers/inform.j2``).

A sequence is six periods: a voltage along 0, 120 and 240 degrees, each with its opposite, so that
back-EMF and resistance fall out of the difference. The sum of the differences along gamma_k, turned
by 2 gamma_k, is z = 3/2 V t_s Y_delta exp(2 j (theta + chi)). Between sequences the control has the
converter to itself. A sequence with a sample that is no number corrects nothing.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.drive_motion import next_flux, plants
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.estimators import Tracker, TrackerLoop, TunedTracker
from dqforge.optimizer.observers.models.matsui_model import ObserverRun
from dqforge.optimizer.observers.parts import ObserverState
from dqforge.optimizer.observers.sampled_machine import (
    CurrentSensor,
    Trial,
    electrical_limit,
    turned,
)
from dqforge.optimizer.saliency.injection import (
    FASTEST_LOOP,
    MOST_OF_LINK,
    NOISE_ANGLE,
    POINTS,
    LoadedSaliency,
    along_locus,
    at_load,
    current_noise,
    known_sample,
    pll_gains,
    require_saliency,
)
from dqforge.optimizer.saliency.sampled_injection import Injection
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair, limited

LAST = 7  # Place in a sequence at which the answer to its last pulse is seen.
MIDDLE = 3.0  # Samples from the middle of the pulses to that place.
DIRECTIONS = ((1.0, 0.0), (-0.5, 0.8660254), (-0.5, -0.8660254))  # Cosine and sine of gamma_k.
_LARGEST = 0.5


@dataclass(frozen=True, slots=True)
class InformGains:
    """What the firmware needs.

    ``t_s`` in s; ``k_p`` and ``k_i`` (1/s) of the phase-locked loop per sequence; ``omega_max`` in
    rad/s; ``voltage`` in V; ``period`` in samples from one sequence to the next. ``scale`` in rad/A
    and ``shift`` in rad stand over |i_q| in steps of 1/``per_ampere``.
    """

    t_s: float
    k_p: float
    k_i: float
    omega_max: float
    voltage: float
    period: float
    per_ampere: float
    scale: tuple[float, ...]
    shift: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class InformState(ObserverState):
    """``vectors``: the last current and z; ``scalars``: the answer to the last pulse in A, whether
    all samples of the sequence were numbers, and z of the sequence before (alpha, beta). ``n`` is
    the place in the period.
    """

    n: int = 0


def inform_start(gains: InformGains, theta_e: Reals, omega_e: Reals) -> InformState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    del gains
    zero = np.zeros_like(theta_e)
    pair = (zero, zero)
    return InformState(
        (pair, pair), theta_e, omega_e, started=False, scalars=(zero, zero), added=pair, seen=pair
    )


def inform_step(
    gains: InformGains,
    state: InformState,
    v: Pair,
    i: Pair,
    heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> InformState:
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, the voltage is not used."""
    del v, heard
    n, zero, one = state.n, maths.number(0.0), maths.number(1.0)
    known, sample = known_sample(i, state.vectors[0], maths)
    (half, whole), z = state.scalars, state.vectors[1]
    assert state.seen is not None
    theta, omega, told = state.theta_e, state.omega_e, sample
    if state.started:
        theta = maths.wrap(theta + gains.t_s * omega)
    if n == 0:
        whole, z = np.zeros_like(half) + one, (np.zeros_like(half), np.zeros_like(half))
    whole = np.where(known, whole, zero)
    if 2 <= n <= LAST:
        cosine, sine = (maths.number(part) for part in DIRECTIONS[(n - 2) // 2])
        moved = (sample[0] - state.vectors[0][0], sample[1] - state.vectors[0][1])
        along = cosine * moved[0] + sine * moved[1]
        if n % 2 == 0:
            half, told = along, state.seen
        else:
            pair = maths.number(0.5) * (half - along)
            z = (z[0] + cosine * pair, z[1] - sine * pair)
    if n == LAST:
        error = _error(gains, (z, told), theta, omega, maths)
        error = np.where(whole > zero, error, zero)
        omega = limited(maths, omega + gains.k_i * error, gains.omega_max)
        theta = maths.wrap(theta + gains.k_p * error)
    return InformState(
        (sample, z),
        theta,
        omega,
        scalars=(half, whole),
        added=_pulse(gains, n, theta, maths),
        seen=told,
        n=(n + 1) % int(gains.period),
    )


def _error(
    gains: InformGains, found: tuple[Pair, Pair], theta: Reals, omega: Reals, maths: Arithmetic
) -> Reals:
    """Angle error in rad of z and the current in A."""
    z, told = found
    i_q = park(maths, told, maths.rotation(theta))[1]
    cosine, sine = maths.rotation(maths.wrap(theta - (maths.number(MIDDLE) * gains.t_s) * omega))
    twice = (cosine * cosine - sine * sine, maths.number(2.0) * (cosine * sine))
    scale, shift = at_load(gains, i_q, maths)
    error = scale * (twice[0] * z[1] - twice[1] * z[0]) - shift
    return limited(maths, error, maths.number(_LARGEST))


def _pulse(gains: InformGains, n: int, theta: Reals, maths: Arithmetic) -> Pair:
    """The voltage that is to be added from the next sampling instant on."""
    zero = np.zeros_like(theta)
    if n > 5:
        return zero, zero
    cosine, sine = DIRECTIONS[n // 2]
    size = gains.voltage if n % 2 == 0 else -gains.voltage
    return zero + maths.number(cosine) * size, zero + maths.number(sine) * size


# INFORM as a tracker, with the axis of the saliency taken for the d axis (``inform``), or with a
# table of where it lies under load (``inductance-mapping``); docs/methods/estimators.md has the
# equations, `dqforge.optimizer.saliency.inform` the steps of the firmware.

USUAL_PERIOD = 16  # Samples from one sequence to the next.
_LOOP = 0.08  # Natural frequency of the loop times the period between sequences.

# Largest angle of the axis beside d that INFORM without a table may leave.
_STRAIGHT = math.radians(5.0)
_TURN = 0.3  # Angle in rad (electrical) by which the rotor may turn while a sequence lasts.


def usual_pulse(design: Design) -> float:
    """Voltage in V that makes 15 % of the largest current in a period, at most 0.28 of the link."""
    l_d = linearised(design.machine).l_d
    return min(0.15 * design.i_max * l_d / design.control.t_s, MOST_OF_LINK * design.inverter.v_dc)


def sequence_noise(sigma: float, step: float) -> float:
    """Standard deviation of the angle of one sequence in rad.

    Args:
        sigma: That of a measured current in A, per axis.
        step: V t_s |Y_delta| in A.

    Neighbouring pulses share a sample: 0.51 sigma/step, where pulses with samples of their own
    would give 0.41.
    """
    gamma = np.array([math.atan2(sine, cosine) for cosine, sine in DIRECTIONS])
    theta = np.linspace(0.0, np.pi, 36, endpoint=False)[:, np.newaxis]
    weight = np.sin(2.0 * theta + gamma)[..., np.newaxis] * np.array(DIRECTIONS)
    taps = np.zeros((len(theta), LAST, 2))
    for k in range(3):
        for place, share in ((2 * k, -0.5), (2 * k + 1, 1.0), (2 * k + 2, -0.5)):
            taps[:, place] += share * weight[:, k]
    return float(np.sqrt(np.mean(np.sum(taps**2, axis=(1, 2)))) * sigma / (3.0 * step))


def tracked_noise(gains: InformGains, sigma: float) -> float:
    """Standard deviation of the angle in rad behind the loop, without load."""
    from scipy.linalg import solve_discrete_lyapunov

    period = gains.period * gains.t_s
    ahead = np.array([[1.0, period], [0.0, 1.0]])
    gain = np.array([gains.k_p, gains.k_i])
    a = ahead - np.outer(gain, ahead[0])
    covariance = solve_discrete_lyapunov(a, np.outer(gain, gain))
    own = sequence_noise(sigma, 1.0 / (3.0 * abs(gains.scale[0])))
    return float(np.sqrt(covariance[0, 0]) * own)


def _period(design: Design, settings: ObserverSettings) -> int:
    """Samples from one sequence to the next."""
    if settings.period is None:
        return USUAL_PERIOD
    count, t_s = round(settings.period / design.control.t_s), design.control.t_s
    if not LAST < count <= 10_000:
        raise InputError(
            f"control.observer.period: a sequence takes {LAST + 1} samples, {(LAST + 1) * t_s:.3g} "
            f"s; write that or more, got {settings.period:.3g} s"
        )
    return count


def design_inform(mapped: bool, design: Design, settings: ObserverSettings) -> InformGains:
    """Gains of the firmware.

    Args:
        mapped: Whether the flux map says where the axis lies under load.
        design, settings: The design, and its settings of this estimator.

    Raises:
        InputError: A setting is out of range.
        NoSolutionError: The saliency or the voltage is too small, or the axis moves without a
            table.
    """
    if design.phase_machine is not None:
        raise NoSolutionError(
            f"control.observer: {settings.method} needs a control that adds its voltage, which "
            "machines of model: waveform have not; choose third-harmonic, or an observer"
        )
    loaded = along_locus(design, POINTS)
    require_saliency(loaded, settings.method)
    if not mapped:
        _require_straight(loaded)
    t_s, machine = design.control.t_s, linearised(design.machine)
    voltage = usual_pulse(design) if settings.voltage is None else settings.voltage
    most = 0.5 * design.inverter.v_dc / math.sqrt(3.0)
    if voltage > most:
        raise InputError(
            f"control.observer.voltage: {voltage:.4g} V leave nothing for the current control; "
            f"write at most {most:.4g} V, half of what the link of {design.inverter.v_dc:g} V gives"
        )
    period = _period(design, settings)
    usual = min(_LOOP / (period * t_s), FASTEST_LOOP)
    bandwidth = usual if settings.pll_bandwidth is None else settings.pll_bandwidth
    if not bandwidth * period * t_s <= 1.0:
        raise InputError(
            f"control.observer.pll_bandwidth: {bandwidth:g} rad/s are too fast for a sequence "
            f"every {period * t_s:.3g} s; write at most {1.0 / (period * t_s):.4g} rad/s"
        )
    damping = 1.0 if settings.damping is None else settings.damping
    k_p, k_i = pll_gains(bandwidth, damping, period * t_s)
    axis = loaded.axis if mapped else np.zeros(POINTS)
    gains = InformGains(
        t_s=t_s,
        k_p=k_p,
        k_i=k_i,
        omega_max=electrical_limit(machine, t_s, None),
        voltage=voltage,
        period=float(period),
        per_ampere=(POINTS - 1) / float(loaded.i_q[-1]),
        scale=tuple((1.0 / (3.0 * voltage * t_s * loaded.y_delta * np.cos(2.0 * axis))).tolist()),
        shift=tuple((0.5 * np.tan(2.0 * axis) + 0.0).tolist()),
    )
    _require_quiet(gains, design)
    return gains


def _require_straight(loaded: LoadedSaliency) -> None:
    worst = int(np.argmax(np.abs(loaded.axis)))
    if abs(loaded.axis[worst]) > _STRAIGHT:
        raise NoSolutionError(
            "control.observer: cross saturation turns the axis that inform finds by "
            f"{math.degrees(loaded.axis[worst]):.3g} deg at {loaded.torque[worst]:.3g} N m, "
            f"{math.degrees(_STRAIGHT):.3g} are permitted; write method: inductance-mapping"
        )


def _require_quiet(gains: InformGains, design: Design) -> None:
    noise = tracked_noise(gains, current_noise(design))
    if noise > NOISE_ANGLE:
        raise NoSolutionError(
            f"control.observer: {current_noise(design):.3g} A of current noise make the angle of "
            f"the pulses wander by {math.degrees(noise):.3g} deg (r.m.s.), "
            f"{math.degrees(NOISE_ANGLE):.3g} are permitted; write voltage: "
            f"{gains.voltage * noise / NOISE_ANGLE:.3g} V or more, or a smaller pll_bandwidth"
        )


def _speeds(design: Design, gains: InformGains) -> tuple[float, float]:
    """From standstill to where the rotor turns too far in a sequence, or from one to the next, or
    the voltage leaves no room for the pulses.
    """
    machine = linearised(design.machine)
    turn = min(_TURN / (6.0 * gains.t_s), 0.8 / (gains.period * gains.t_s))
    i_q = (POINTS - 1) / gains.per_ampere
    room = design.inverter.v_dc / math.sqrt(3.0) - gains.voltage - machine.r_s * i_q
    flux = math.hypot(machine.psi_pm, machine.l_q * i_q)
    return 0.0, min(turn, room / flux, gains.omega_max)


def _in_words(gains: InformGains) -> str:
    period = gains.period * gains.t_s
    return (
        f"six pulses of {gains.voltage:.4g} V, each {gains.t_s * 1e6:.4g} us, every "
        f"{period * 1e3:.4g} ms; loop {math.sqrt(gains.k_i / period):.4g} rad/s"
    )


def _tracking(gains: InformGains) -> TrackerLoop:
    """The loop as if it were corrected at every sample, with the mean age of what it measures: that
    of the pulses when they are judged, and half the time from one sequence to the next.
    """
    age = round(MIDDLE + 0.5 * (gains.period - 1.0))
    bandwidth = math.sqrt(gains.k_i / (gains.period * gains.t_s))
    return TrackerLoop(
        gains.t_s,
        gains.k_p / gains.period,
        bandwidth**2 * gains.t_s,
        ((age, 1.0),),
    )


def pulse_tracker(name: str, title: str, *, mapped: bool) -> Tracker:
    """The record of a tracker by pulses, with or without the table over the load."""
    return Tracker(
        name=name,
        code=name.replace("-", "_"),
        title=title,
        design=partial(design_inform, mapped),
        start=inform_start,
        step=inform_step,
        gains=InformGains,
        speeds=_speeds,
        in_words=_in_words,
        injects=True,
        loop=_tracking,
    )


TRACKER = pulse_tracker(
    "inform", "INFORM: pairs of voltage pulses that show the saliency", mapped=False
)


# The saliency tracker at work on simulated drives, its own voltage included.


def track(
    tracker: Injection,
    machine: Machine,
    omega: FloatArray,
    i_ref: tuple[float, float],
    *,
    theta_error: float = 0.0,
    sensor: CurrentSensor | None = None,
    seed: int = 0,
) -> tuple[ObserverRun, Trial]:
    """Follow S drives along given speeds (electrical, rad/s, shape (K + 1, S)).

    The fundamental voltage is the steady one of ``i_ref`` in A at the true angle, without any
    controller, so that all that moves the currents besides is the injection, one period after it
    was asked for.

    Returns:
        The estimates, and what was measured; its voltages include the injection.
    """
    linear = linearised(machine)
    generator = np.random.default_rng(seed)
    t_s, n = tracker.t_s, tracker.samples
    periods, drives = omega.shape[0] - 1, omega.shape[1]
    theta = np.concatenate(
        [np.zeros((1, drives)), np.cumsum(0.5 * t_s * (omega[1:] + omega[:-1]), axis=0)]
    )
    reference = [np.full(drives, current) for current in i_ref]
    plant = plants(linear, count=drives)
    i_dq = np.empty((periods + 1, drives, 2))
    i_dq[0] = i_ref
    i, v = np.empty_like(i_dq), np.empty((periods, drives, 2))
    psi = plant.flux(i_dq[0, :, 0] + 1j * i_dq[0, :, 1]) * np.exp(1j * theta[0])
    estimate, speed = np.empty((periods + 1, drives)), np.empty((periods + 1, drives))
    angle, rate = theta[0] + theta_error, omega[0].copy()
    products, asked = np.zeros((n, drives)), np.zeros((drives, 2))
    gain = 1.0 / (n * tracker.gain)
    for k in range(periods + 1):
        i[k] = turned(i_dq[k], -theta[k])
        i[k] = i[k] if sensor is None else sensor.read(i[k], generator)
        if k > 0:
            angle = angle + t_s * rate
            products[k % n] = turned(i[k], angle)[:, 1] * tracker.reference[k % n]
            found = gain * np.sum(products, axis=0)
            rate = np.clip(rate + tracker.k_i * found, -tracker.omega_max, tracker.omega_max)
            angle = angle + tracker.k_p * found
        estimate[k], speed[k] = angle, rate
        if k == periods:
            break
        steady = np.stack(linear.voltage(reference[0], reference[1], omega[k]), axis=-1)
        v[k] = turned(steady, -(theta[k] + 0.5 * t_s * omega[k])) + asked
        wave = np.stack(
            [np.full(drives, tracker.voltage * tracker.carrier[k % n]), np.zeros(drives)], axis=-1
        )
        asked = turned(wave, -(angle + 1.5 * t_s * rate))
        psi = next_flux(
            plant, psi, v[k, :, 0] + 1j * v[k, :, 1], theta[k], (omega[k], omega[k + 1]), t_s
        )
        now = plant.current(psi, theta[k + 1]) * np.exp(-1j * theta[k + 1])
        i_dq[k + 1, :, 0], i_dq[k + 1, :, 1] = now.real, now.imag
    return ObserverRun(estimate, speed), Trial(t_s, v, i, theta, omega, i_dq)


# How long a tracker takes from an unknown angle at rest to one known but for half a turn.

# Time constants of the loop: from beside the unstable rest at 90 degrees to within noise.
_SETTLED = 12.0


def settling_samples(tuned: TunedTracker) -> int:
    """Samples of ``t_s`` from the start at the angle 0, at rest and without current reference,
    after which the angle is that of the d axis or half a turn off.
    """
    gains = tuned.gains
    steps = float(getattr(gains, "period", 1.0))
    bandwidth = math.sqrt(float(gains.k_i) / (steps * tuned.t_s))
    return math.ceil(_SETTLED / (bandwidth * tuned.t_s))
