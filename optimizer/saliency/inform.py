"""INFORM: the step of the firmware, its gains and range.

A sequence is six periods: a voltage along 0, 120 and 240 degrees, each with its opposite, so that
back-EMF and resistance fall out of the difference. The sum of the differences along gamma_k, turned
by 2 gamma_k, is z = 3/2 V t_s Y_delta exp(2 j (theta + chi)). Between sequences the control has the
converter to itself. A sequence with a sample that is no number corrects nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.scenario import next_flux, plants
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, Reals, linear_voltage
from dqforge.optimizer.estimators import (
    WRAPPED,
    Tracker,
    TrackerLoop,
    TrackerSteps,
)
from dqforge.optimizer.observers.methods.matsui_model import ObserverRun
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
    LoadedSaliency,
    along_locus,
    current_noise,
    pll_gains,
    require_saliency,
    speed_with_room,
)
from dqforge.optimizer.saliency.load_tables import POINTS, error_at_load, is_known
from dqforge.optimizer.saliency.sampled_injection import Injection
from dqforge.optimizer.steps.step_arithmetic import (
    AlphaBeta,
    Arithmetic,
    Member,
    Pair,
    limited,
    where,
)

LAST = 7  # Place in a sequence at which the answer to its last pulse is seen.
MIDDLE = 3.0  # Samples from the middle of the pulses to that place.
DIRECTIONS = ((1.0, 0.0), (-0.5, 0.8660254), (-0.5, -0.8660254))  # Cosine and sine of gamma_k.


@dataclass(frozen=True, slots=True)
class InformGains:
    """The pulses, and a loop on the angle that they show; tables stand over the load.

    ``scale`` and ``shift`` stand over |i_q| in steps of 1/``per_ampere``; ``period`` is in samples
    from one sequence to the next.
    """

    t_s: Annotated[float, Member("sampling period", "s")]
    k_p: Annotated[float, Member("share of the angle error per sequence")]
    k_i: Annotated[float, Member("speed per angle error and sequence", "1/s")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]
    voltage: Annotated[float, Member("of the pulses", "V")]
    period: float
    per_ampere: Annotated[float, Member("points of the tables per A of i_q")]
    scale: Annotated[tuple[float, ...], Member("angle error per measured current", "rad/A")]
    shift: Annotated[tuple[float, ...], Member("what the load adds to it", "rad")]


@dataclass(frozen=True, slots=True)
class InductanceMappingGains(InformGains):
    """The pulses, and a loop on the angle that they show; tables stand over the load, that of the
    shift has the axis there.
    """


@dataclass(slots=True, eq=False)
class Inform:
    """What the tracker keeps from sample to sample.

    Arrays of shape (N,); ``n`` and ``started`` are the same of all.
    """

    sample: Annotated[AlphaBeta, Member("last current", "A")]
    z: Annotated[AlphaBeta, Member("sum of the differences, turned", "A")]
    half: Annotated[Reals, Member("answer to the first pulse of a pair", "A")]
    whole: Annotated[Any, Member("all samples of the sequence were numbers", kind="int")]
    n: Annotated[Any, Member("place in the period", kind="int")]
    started: Annotated[Any, Member("0 before the first step", kind="int")]
    added: Annotated[
        AlphaBeta,
        Member("to be added to the voltage that acts from the next sampling instant on", "V"),
    ]
    current: Annotated[AlphaBeta, Member("current between the pulses, for the controllers", "A")]
    theta_e: Annotated[Reals, Member("estimated electrical angle, rad, -pi to pi")]
    omega_e: Annotated[Reals, Member("estimated electrical speed, rad/s")]


class InductanceMapping(Inform):
    """What the tracker keeps from sample to sample.

    Arrays of shape (N,); ``n`` and ``started`` are the same of all.
    """

    __slots__ = ()


def _blank(kind: type[Inform]) -> Inform:
    zero: Any = 0.0
    pair = AlphaBeta(zero, zero)
    return kind(pair, pair, zero, 0, 0, 0, pair, pair, zero, zero)


def pulses_start(o: Arithmetic, observer: Inform, theta_e: Reals, omega_e: Reals) -> None:
    """Start from an angle in rad, good to 90 degrees, and a speed in rad/s (electrical) at the
    instant of the first step.
    """
    zero = o.full(0.0, theta_e)
    pair = AlphaBeta(zero, zero)
    observer.added, observer.current, observer.sample, observer.z = pair, pair, pair, pair
    observer.half = zero
    observer.whole, observer.n, observer.started = 0, 0, 0
    observer.theta_e, observer.omega_e = o.wrap(theta_e), omega_e


@dataclass(frozen=True, slots=True)
class PulseSteps:
    """What the firmware does at every sample, with a sequence every so many; ``code`` is part of
    the names in C.
    """

    code: str
    period: int

    def step(
        self, o: Arithmetic, gains: InformGains, observer: Inform, v: AlphaBeta, i: AlphaBeta
    ) -> None:
        """One sample: i in A at the sampling instant; the voltage v that acted is not needed. A
        sequence with a sample that is no number corrects nothing.
        """
        del v
        cosines, sines = (
            o.table(name, [pair[axis] for pair in DIRECTIONS])
            for axis, name in enumerate(("cosines", "sines"))
        )
        known = o.let("known", is_known(o, i))
        last, n = observer.sample, observer.n
        sample = o.cases("sample", (known, lambda: i), otherwise=lambda: last)

        def moved() -> AlphaBeta:
            return o.let("moved", AlphaBeta(sample.alpha - last.alpha, sample.beta - last.beta))

        def along() -> Reals:
            k = o.let("k", (n - 2) // 2)
            d = moved()
            found: Reals = o.at(cosines, k) * d.alpha + o.at(sines, k) * d.beta
            return found

        def ahead() -> None:
            observer.theta_e = o.wrap(observer.theta_e + gains.t_s * observer.omega_e)

        def begun() -> None:
            zero = o.full(0.0, observer.half)
            observer.whole = 1
            observer.z = AlphaBeta(zero, zero)

        def first() -> AlphaBeta:
            observer.half = along()
            return observer.current

        def second() -> AlphaBeta:
            k = o.let("k", (n - 2) // 2)
            cosine, sine = o.let("cosine", o.at(cosines, k)), o.let("sine", o.at(sines, k))
            d = moved()
            pair = 0.5 * (observer.half - (cosine * d.alpha + sine * d.beta))
            pair = o.let("pair", pair, "without back-EMF and resistance, A")
            z = observer.z
            observer.z = AlphaBeta(z.alpha + cosine * pair, z.beta - sine * pair)
            return sample

        where(o, o.negated(o.equal(observer.started, 0)), ahead, observer)
        observer.started = 1
        where(o, o.equal(n, 0), begun, observer)
        observer.whole = o.choose(known, observer.whole, 0)
        odd = o.equal(n % 2, 1)
        told = o.cases(
            "told",
            ((n < 2) | (n > LAST), lambda: sample),
            (odd, second),
            otherwise=first,
            changing=(observer,),
        )
        where(o, o.equal(n, LAST), lambda: _corrected(o, gains, observer, told), observer)

        def pulse() -> AlphaBeta:
            k = o.let("k", n // 2)
            size = o.let("size", o.choose(o.equal(n % 2, 0), gains.voltage, -gains.voltage))
            none = o.full(0.0, observer.half)
            return AlphaBeta(none + o.at(cosines, k) * size, none + o.at(sines, k) * size)

        def rests() -> AlphaBeta:
            return AlphaBeta(o.full(0.0, observer.half), o.full(0.0, observer.half))

        observer.added = o.cases("added", (n <= 5, pulse), otherwise=rests)
        observer.sample, observer.current = sample, told
        period = o.constant(f"{self.code.upper()}_PERIOD", self.period)
        later = o.let("later", n + 1)
        observer.n = o.choose(later < period, later, 0)


def _corrected(o: Arithmetic, gains: InformGains, observer: Inform, told: AlphaBeta) -> None:
    """Angle and speed by what a sequence has shown."""
    theta, z = observer.theta_e, observer.z
    i_q = o.let("i_q", o.park(told, o.let("now", o.rotation(theta))).q)
    before = o.wrap(theta - (MIDDLE * gains.t_s) * observer.omega_e)
    turn = o.let("turn", o.rotation(before))
    cosine = o.let("cosine", turn.cosine * turn.cosine - turn.sine * turn.sine)
    sine = o.let("sine", 2.0 * (turn.cosine * turn.sine))
    found = o.call(error_at_load, gains, cosine * z.beta - sine * z.alpha, i_q)
    error = o.let("error", o.choose(o.equal(observer.whole, 0), o.full(0.0, i_q), found))
    omega = o.let("omega", observer.omega_e + gains.k_i * error)
    observer.omega_e = limited(o, omega, gains.omega_max)
    observer.theta_e = o.wrap(theta + gains.k_p * error)


def pulse_steps(code: str, kind: type[Inform], gains: InformGains) -> TrackerSteps:
    """What is emitted of gains.

    Args:
        code: Part of the names in C.
        kind: The state.
        gains: The numbers.
    """
    period = int(gains.period)
    return TrackerSteps(
        _blank(kind),
        pulses_start,
        PulseSteps(code, period).step,
        {"at_load": f"{code}_at", "error_at_load": f"{code}_error"},
        (
            (f"{code.upper()}_POINTS", len(gains.scale), "of the tables over the load"),
            (f"{code.upper()}_PERIOD", period, "samples from one sequence of pulses to the next"),
        ),
    )


def inform_start(gains: InformGains, theta_e: Reals, omega_e: Reals) -> Inform:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    del gains
    state = _blank(Inform)
    pulses_start(WRAPPED, state, theta_e, omega_e)
    return state


def inform_step(
    gains: InformGains,
    state: Inform,
    v: Pair,
    i: Pair,
    heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> Inform:
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, the voltage is not used."""
    del heard
    after = replace(state)
    steps = PulseSteps("inform", int(gains.period))
    steps.step(maths, gains, after, AlphaBeta(*v), AlphaBeta(*i))
    return after


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
    most = 0.5 * linear_voltage(design.inverter.v_dc)
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
    gains = (InductanceMappingGains if mapped else InformGains)(
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
    turn = min(_TURN / (6.0 * gains.t_s), 0.8 / (gains.period * gains.t_s))
    most = min(turn, gains.omega_max)
    return 0.0, speed_with_room(design, gains.per_ampere, gains.voltage, most)


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
    code = name.replace("-", "_")
    return Tracker(
        name=name,
        code=code,
        title=title,
        design=partial(design_inform, mapped),
        start=inform_start,
        step=inform_step,
        gains=InductanceMappingGains if mapped else InformGains,
        speeds=_speeds,
        in_words=_in_words,
        injects=True,
        loop=_tracking,
        steps=partial(pulse_steps, code, InductanceMapping if mapped else Inform),
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
        asked = turned(wave, -(angle + CURRENT_DELAY * t_s * rate))
        psi = next_flux(
            plant, psi, v[k, :, 0] + 1j * v[k, :, 1], theta[k], (omega[k], omega[k + 1]), t_s
        )
        now = plant.current(psi, theta[k + 1]) * np.exp(-1j * theta[k + 1])
        i_dq[k + 1, :, 0], i_dq[k + 1, :, 1] = now.real, now.imag
    return ObserverRun(estimate, speed), Trial(t_s, v, i, theta, omega, i_dq)
