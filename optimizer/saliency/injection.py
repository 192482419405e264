"""A tracker of the saliency by an injected wave: the step of the firmware, its gains and range.

Square wave (two samples): the second difference of the current in stator axes, across the direction
in which the voltage acted, less what the rest of the voltage makes of it; sine along the assumed d
axis: the current across it, demodulated; rotating voltage: the negative sequence of the current.
Each gives sin 2 (eps + chi) of the angle error eps, chi being where the flux map has the axis of
the saliency at the present load; scale and shift of the gains make the error in rad of it. A sample
that is not a number corrects nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import InjectionWave
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, Reals, linear_voltage
from dqforge.optimizer.estimators import WRAPPED, Tracker, TrackerLoop, TrackerSteps
from dqforge.optimizer.observers.parts import usual_disturbances
from dqforge.optimizer.observers.sampled_machine import electrical_limit
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.saliency.load_tables import POINTS, at_load, error_at_load, is_known
from dqforge.optimizer.saliency.sampled_injection import DELAY, LONGEST, admittance
from dqforge.optimizer.steps.step_arithmetic import (
    AlphaBeta,
    Arithmetic,
    Member,
    Pair,
    Rotation,
    limited,
)

_FILLED = 3.0  # Samples of which a second difference is made.


@dataclass(frozen=True, slots=True)
class InjectionGains:
    """The injected wave, what demodulates it, and a loop on the angle that it shows; tables stand
    over the load.

    Numbers of ``scale`` (rad per what is demodulated), ``shift`` and ``rest`` stand over |i_q| in
    steps of 1/``per_ampere``. ``carrier`` is that of the d axis, or of alpha with that of beta
    besides (then it rotates).
    """

    t_s: Annotated[float, Member("sampling period", "s")]
    k_p: Annotated[float, Member("share of the angle error per period")]
    k_i: Annotated[float, Member("speed per angle error and period", "1/s")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]
    notch: Annotated[
        tuple[float, float, float, float, float],
        Member("of the fundamental: last three samples, less its last two values"),
    ]
    per_ampere: Annotated[float, Member("points of the tables per A of i_q")]
    scale: Annotated[tuple[float, ...], Member("angle error per demodulated current", "rad/A")]
    shift: Annotated[tuple[float, ...], Member("what the load adds to it", "rad")]
    rest: Annotated[
        tuple[float, ...], Member("current that a voltage across makes in a period", "A/V")
    ]
    carrier: Annotated[tuple[float, ...], Member("injected voltage", "V")]
    carrier_beta: tuple[float, ...]
    reference: Annotated[tuple[float, ...], Member("demodulating carrier")]
    reference_beta: tuple[float, ...]


@dataclass(slots=True, eq=False)
class Injection:
    """What the tracker keeps from sample to sample.

    Arrays of shape (N,). ``asked`` and ``rest`` are those of a square wave, None of others,
    ``products`` those of the others.
    """

    sample: Annotated[tuple[AlphaBeta, AlphaBeta], Member("last currents", "A")]
    told: Annotated[AlphaBeta, Member("fundamental before the last", "A")]
    direction: Annotated[tuple[Rotation, Rotation, Rotation], Member("of the last voltages")]
    asked: Annotated[AlphaBeta | None, Member("voltage before the last", "V")]
    rest: Annotated[AlphaBeta | None, Member("of the voltage that acted last", "V")]
    known: Annotated[Reals, Member("samples that were numbers in a row, up to 3")]
    products: Annotated[tuple[Reals, ...] | None, Member("demodulated currents", "A")]
    n: Annotated[Any, Member("place in the injected period", kind="int")]
    started: Annotated[Any, Member("0 before the first step", kind="int")]
    added: Annotated[
        AlphaBeta,
        Member("to be added to the voltage that acts from the next sampling instant on", "V"),
    ]
    current: Annotated[AlphaBeta, Member("fundamental of the current, for the controllers", "A")]
    theta_e: Annotated[Reals, Member("estimated electrical angle, rad, -pi to pi")]
    omega_e: Annotated[Reals, Member("estimated electrical speed, rad/s")]


@dataclass(frozen=True, slots=True)
class InjectionSteps:
    """What the firmware does with a wave of ``count`` samples per period."""

    count: int
    rotating: bool

    @classmethod
    def of(cls, gains: InjectionGains) -> InjectionSteps:
        """Those of gains."""
        return cls(len(gains.carrier), bool(gains.carrier_beta))

    @property
    def square(self) -> bool:
        """Whether the wave changes its sign at every sample."""
        return self.count == 2

    def state(self, zero: Any) -> Injection:
        """The members of a state, all of them ``zero``."""
        pair, turn = AlphaBeta(zero, zero), Rotation(zero, zero)
        last = pair if self.square else None
        products = None if self.square else (zero,) * self.count
        return Injection(
            (pair, pair), pair, (turn, turn, turn), last, last, zero, products, 0, 0, pair, pair,
            zero, zero,
        )  # fmt: skip

    def start(self, o: Arithmetic, observer: Injection, theta_e: Reals, omega_e: Reals) -> None:
        """Start from an angle in rad, good to 90 degrees, and a speed in rad/s (electrical) at the
        instant of the first step.
        """
        zero = o.full(0.0, theta_e)
        pair, turn = AlphaBeta(zero, zero), Rotation(zero, zero)
        observer.added, observer.current, observer.told = pair, pair, pair
        if self.square:
            observer.asked, observer.rest = pair, pair
        observer.sample, observer.direction = (pair, pair), (turn, turn, turn)
        if observer.products is not None:
            observer.products = (zero,) * self.count
        observer.known = zero
        observer.n, observer.started = 0, 0
        observer.theta_e, observer.omega_e = o.wrap(theta_e), omega_e

    def step(
        self, o: Arithmetic, gains: InjectionGains, observer: Injection, v: AlphaBeta, i: AlphaBeta
    ) -> None:
        """One sample: i in A at the sampling instant, v in V acted until then (only a square wave
        needs it). A sample that is no number corrects nothing.
        """
        known = o.let("known", is_known(o, i))
        last = observer.sample[0]
        sample = o.cases("sample", (known, lambda: i), otherwise=lambda: last)
        rest = self._rest(o, observer, v)

        def first() -> AlphaBeta:
            observer.started = 1
            observer.sample = (sample, observer.sample[1])
            observer.current = sample
            return sample

        def then() -> AlphaBeta:
            theta = o.let("theta", o.wrap(observer.theta_e + gains.t_s * observer.omega_e))
            turn = o.let("turn", o.rotation(theta))
            fundamental = o.let("fundamental", _fundamental(o, gains, observer, sample))
            i_q = o.let("i_q", o.park(fundamental, turn).q)
            more = o.choose(observer.known < _FILLED, observer.known + 1.0, observer.known)
            observer.known = fresh = o.let("fresh", o.choose(known, more, o.full(0.0, i_q)))
            if rest is not None:
                bent = _second_difference(o, gains, observer, (sample, rest), i_q)
                found = o.let("found", o.choose(fresh >= _FILLED, bent, o.full(0.0, i_q)))
            else:
                found = self._demodulated(o, gains, observer, (known, sample), turn)
            error = o.call(error_at_load, gains, found, i_q)
            if rest is not None:
                error = o.choose(fresh >= _FILLED, error, o.full(0.0, i_q))
            error = o.let("error", error)
            omega = o.let("omega", observer.omega_e + gains.k_i * error)
            observer.omega_e = limited(o, omega, gains.omega_max)
            observer.theta_e = o.wrap(theta + gains.k_p * error)
            return fundamental

        told = o.cases(
            "told", (o.equal(observer.started, 0), first), otherwise=then, changing=(observer,)
        )
        if rest is not None:
            observer.asked, observer.rest = observer.added, rest
        ahead = o.wrap(observer.theta_e + (CURRENT_DELAY * gains.t_s) * observer.omega_e)
        direction = o.let("direction", o.rotation(ahead))
        observer.added = self._asked(o, gains, observer, direction)
        observer.sample = (sample, observer.sample[0])
        observer.told, observer.current = observer.current, told
        observer.direction = (direction, *observer.direction[:2])
        count = o.constant("INJECTION_SAMPLES", self.count)
        later = o.let("later", observer.n + 1)
        observer.n = o.choose(later < count, later, 0)

    def _rest(self, o: Arithmetic, observer: Injection, v: AlphaBeta) -> AlphaBeta | None:
        """What acted less what was asked for, in V; only a square wave takes it off."""
        asked = observer.asked
        if asked is None:
            return None
        acted = o.cases("acted", (is_known(o, v), lambda: v), otherwise=lambda: asked)
        return o.let("rest", AlphaBeta(acted.alpha - asked.alpha, acted.beta - asked.beta))

    def _asked(
        self, o: Arithmetic, gains: InjectionGains, observer: Injection, direction: Rotation
    ) -> AlphaBeta:
        """The voltage that is to be added from the next sampling instant on."""
        n = observer.n
        if self.rotating:
            return AlphaBeta(o.at(gains.carrier, n), o.at(gains.carrier_beta, n))
        carrier = o.let("carrier", o.at(gains.carrier, n), "V")
        return AlphaBeta(direction.cosine * carrier, direction.sine * carrier)

    def _demodulated(
        self,
        o: Arithmetic,
        gains: InjectionGains,
        observer: Injection,
        seen: tuple[Any, AlphaBeta],
        turn: Rotation,
    ) -> Reals:
        """The sum of a period; ``seen`` is whether the sample is known, and the sample."""
        (known, i), products, n = seen, observer.products, observer.n
        assert products is not None
        product = self._product(o, gains, observer, i, turn)
        now = o.choose(known, product, o.full(0.0, i.alpha))
        observer.products = kept = o.with_item(products, n, now)
        return o.summed("found", o.full(0.0, i.alpha), self.count, lambda k: o.at(kept, k))

    def _product(
        self,
        o: Arithmetic,
        gains: InjectionGains,
        observer: Injection,
        i: AlphaBeta,
        turn: Rotation,
    ) -> Reals:
        """What a sample adds to the demodulated current."""
        c = o.let("c", o.at(gains.reference, observer.n))
        if not self.rotating:
            found: Reals = (turn.cosine * i.beta - turn.sine * i.alpha) * c
            return found
        s = o.let("s", o.at(gains.reference_beta, observer.n))
        alpha = o.let("alpha", c * i.alpha - s * i.beta)
        beta = o.let("beta", s * i.alpha + c * i.beta)
        cosine = o.let("cosine", turn.cosine * turn.cosine - turn.sine * turn.sine)
        sine = o.let("sine", 2.0 * (turn.cosine * turn.sine))
        product: Reals = cosine * beta - sine * alpha
        return product


def injection_notch(
    o: Arithmetic,  # noqa: ARG001
    gains: InjectionGains,
    now: Reals,
    last: Reals,
    before: Reals,
    told: Reals,
    told_before: Reals,
) -> Reals:
    """One value of the current without what the injected voltage makes of it."""
    b_0, b_1, b_2, a_1, a_2 = gains.notch
    value: Reals = (((b_0 * now + b_1 * last) + b_2 * before) - a_1 * told) - a_2 * told_before
    return value


def _fundamental(
    o: Arithmetic, gains: InjectionGains, observer: Injection, i: AlphaBeta
) -> AlphaBeta:
    (last, before), told, told_before = observer.sample, observer.current, observer.told
    alpha, beta = (
        o.call(injection_notch, gains, i[n], last[n], before[n], told[n], told_before[n])
        for n in (0, 1)
    )
    return AlphaBeta(alpha, beta)


def _second_difference(
    o: Arithmetic,
    gains: InjectionGains,
    observer: Injection,
    seen: tuple[AlphaBeta, AlphaBeta],
    i_q: Reals,
) -> Reals:
    """Of the current, across the sum of the directions of the voltages that acted, less what the
    rest of the voltage has made of it; ``seen`` are the sample and that rest.
    """
    (i, rest), (last, before), acted = seen, observer.sample, observer.rest
    assert acted is not None
    x = o.let("x", gains.t_s * observer.omega_e)
    twice = o.let("twice", 2.0 - x * x)
    alpha = o.let("alpha", (i.alpha - twice * last.alpha) + before.alpha)
    beta = o.let("beta", (i.beta - twice * last.beta) + before.beta)
    moved_alpha = o.let("moved_alpha", rest.alpha - acted.alpha)
    moved_beta = o.let("moved_beta", rest.beta - acted.beta)
    _, one, other = observer.direction
    cosine = o.let("cosine", one.cosine + other.cosine)
    sine = o.let("sine", one.sine + other.sine)
    share = o.let("share", o.call(at_load, gains, gains.rest, i_q))
    bent = cosine * beta - sine * alpha
    own = bent - share * (cosine * moved_beta - sine * moved_alpha)
    found: Reals = own * o.at(gains.reference, observer.n)
    return o.let("bent", found)


def injection_steps(gains: InjectionGains) -> TrackerSteps:
    """What is emitted of gains."""
    own = InjectionSteps.of(gains)
    return TrackerSteps(
        own.state(0.0),
        own.start,
        own.step,
        {"at_load": "injection_at", "error_at_load": "injection_error"},
        (
            ("INJECTION_SAMPLES", own.count, "samples per injected period"),
            ("INJECTION_POINTS", len(gains.scale), "of the tables over the load"),
        ),
    )


def wave_start(gains: InjectionGains, theta_e: Reals, omega_e: Reals) -> Injection:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    steps = InjectionSteps.of(gains)
    state = steps.state(0.0)
    steps.start(WRAPPED, state, theta_e, omega_e)
    return state


def wave_step(
    gains: InjectionGains, state: Injection, v: Pair, i: Pair, heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> Injection:  # fmt: skip
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, ``v`` in V acted until then."""
    del heard
    after = replace(state)
    InjectionSteps.of(gains).step(maths, gains, after, AlphaBeta(*v), AlphaBeta(*i))
    return after


# The saliency of a machine along the currents that it is driven with, from its flux map.
#
# With the incremental inductances at a current, Y = L^-1 is Y_sum + Y_delta (cos 2 chi, sin 2 chi;
# sin 2 chi, -cos 2 chi): the axis of the largest admittance lies at chi from the d axis, which
# cross saturation turns away from it. References: paper 001, 7.2.4; M. Corley, R. Lorenz, IEEE
# Trans. IA 34, 1998.

# Larger over smaller inductance below which noise and unequal phases hide the angle.
LEAST_RATIO = 1.1
_FINE = 65


@dataclass(frozen=True, slots=True, eq=False)
class LoadedSaliency:
    """Saliency at currents, arrays of shape (N,).

    ``i_d``, ``i_q`` in A and ``torque`` in N m; ``y_sum`` and ``y_delta`` in 1/H, the latter
    negative where l_d is above l_q without load; ``axis`` is chi in rad.
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    y_sum: FloatArray
    y_delta: FloatArray
    axis: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """Larger over smaller incremental inductance, shape (N,)."""
        share = np.abs(self.y_delta) / self.y_sum
        return np.asarray((1.0 + share) / (1.0 - share))


def saliency_at(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> LoadedSaliency:
    """Saliency at currents in A, shape (N,)."""
    jet = machine.jet(i_d, i_q)
    none = np.zeros(1)
    bare = machine.jet(none, none)
    sign = 1.0 if bare.l_qq[0] >= bare.l_dd[0] else -1.0
    det = jet.l_dd * jet.l_qq - jet.l_dq * jet.l_qd
    along = sign * 0.5 * (jet.l_qq - jet.l_dd) / det
    across = -sign * 0.5 * (jet.l_dq + jet.l_qd) / det
    return LoadedSaliency(
        i_d,
        i_q,
        machine.torque(i_d, i_q),
        0.5 * (jet.l_dd + jet.l_qq) / det,
        sign * np.hypot(along, across),
        0.5 * np.arctan2(across, along),
    )


def along_locus(design: Design, points: int) -> LoadedSaliency:
    """At equal steps of i_q from none to that of the largest torque, by the currents of the design,
    shape (points,).
    """
    machine = design.machine
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    fine = choice.points(choice.largest_torque() * np.linspace(0.0, 1.0, _FINE))
    i_q = np.linspace(0.0, float(fine.i_q[-1]), points)
    return saliency_at(machine, np.interp(i_q, fine.i_q, fine.i_d), i_q)


def require_saliency(found: LoadedSaliency, name: str) -> None:
    """Refuse a machine whose saliency does not show the angle.

    Raises:
        NoSolutionError: Its ratio is below the least one, without load or at one; the message has
            both.
    """
    ratio = found.ratio
    if ratio[0] < LEAST_RATIO:
        raise NoSolutionError(
            f"control.observer: {name} needs inductances that differ by {LEAST_RATIO:g} or more, "
            f"those of this machine do by {ratio[0]:.3g} without load; choose an observer, and "
            "start by a ramp"
        )
    beyond = np.flatnonzero((ratio < LEAST_RATIO) | (np.abs(found.axis) > np.pi / 4.0))
    if beyond.size:
        k = int(beyond[0])
        raise NoSolutionError(
            f"control.observer: {name} loses the angle under load: at {found.torque[k]:.3g} N m "
            f"(i_d = {found.i_d[k]:.3g} A, i_q = {found.i_q[k]:.3g} A) the incremental inductances "
            f"differ by {ratio[k]:.3g} and their axis lies {np.degrees(found.axis[k]):.3g} deg "
            f"beside d; {LEAST_RATIO:g} and 45 deg are the limits. Write a smaller current limit, "
            "or choose an observer"
        )


# The phase-locked loop of an injection as a sampled linear system: its poles, and the noise of the
# angle by that of the current.
#
# The deviation of the angle (true less estimated) and of the speed are its states, with those of
# the last samples: a voltage that was asked for at one sample acts in the next period and is seen
# at the end of it, the product of a longer wave counts over the whole wave.


def _seen_at(gains: InjectionGains) -> tuple[tuple[int, float], ...]:
    """How many samples before the correction the errors were made that it counts, and in what
    shares; 0 is the predicted angle of now.
    """
    if len(gains.carrier) == 2:
        return ((2, 0.5), (3, 0.5))
    count = len(gains.carrier)
    return tuple((n, 1.0 / count) for n in range(count))


def wave_tracking(gains: InjectionGains) -> TrackerLoop:
    """The loop for the judgement of a speed loop."""
    ahead = 1.5 if len(gains.carrier) == 2 else 0.0
    return TrackerLoop(gains.t_s, gains.k_p, gains.k_i, _seen_at(gains), ahead)


def loop_matrices(gains: InjectionGains) -> tuple[FloatArray, FloatArray]:
    """Transition of (angle, speed, earlier errors) and the input of an error of the measurement in
    rad, shapes (n, n) and (n,).
    """
    seen, t_s, square = _seen_at(gains), gains.t_s, len(gains.carrier) == 2
    size = 2 + max(n for n, _ in seen)
    # 0: angle after the last correction, 1: speed, then errors of 1, 2, ... samples before
    ahead = np.zeros(size)
    ahead[0], ahead[1] = 1.0, t_s
    measured = np.zeros(size)
    for n, share in seen:
        if n == 0:
            measured += share * ahead
        else:
            measured[1 + n] += share
    a, b = np.zeros((size, size)), np.zeros(size)
    a[0], b[0] = ahead - gains.k_p * measured, -gains.k_p
    a[1], b[1] = -gains.k_i * measured, -gains.k_i
    a[1, 1] += 1.0
    if square:
        # the error of the direction that is asked for now: 1.5 samples ahead
        a[2], b[2] = a[0] + CURRENT_DELAY * t_s * a[1], b[0] + CURRENT_DELAY * t_s * b[1]
    else:
        a[2] = ahead
    a[3:, 2:-1] += np.eye(size - 3)
    return a, b


def largest_pole(gains: InjectionGains) -> float:
    """Largest modulus of the poles: stable below 1."""
    return float(np.max(np.abs(np.linalg.eigvals(loop_matrices(gains)[0]))))


def angle_noise(gains: InjectionGains, current_noise: float) -> float:
    """Standard deviation of the angle in rad without load, by white noise of the current of
    ``current_noise`` A per axis.
    """
    from scipy.linalg import solve_discrete_lyapunov

    a, b = loop_matrices(gains)
    scale = abs(gains.scale[0]) * current_noise
    if len(gains.carrier) == 2:
        # twice the sum of three samples with alternating sign, -1, 2, -1 of white noise
        taps = 2.0 * scale * np.array([1.0, 2.0, 1.0])
    else:
        taps = scale * np.sqrt(np.mean(np.square(gains.reference))) * np.ones(len(gains.carrier))
        if gains.carrier_beta:
            taps = scale * np.ones(len(gains.carrier))
    memory = len(taps) - 1
    size = len(b)
    whole = np.zeros((size + memory, size + memory))
    source = np.zeros(size + memory)
    whole[:size, :size] = a
    whole[:size, size:] = np.outer(b, taps[1:])
    source[:size], source[size] = b * taps[0], 1.0
    whole[size + 1 :, size:-1] += np.eye(memory - 1)
    covariance = solve_discrete_lyapunov(whole, np.outer(source, source))
    return float(np.sqrt(covariance[0, 0]))


# Injection as a tracker: square wave at half the sampling frequency, sine along the assumed d axis
# or a rotating voltage; docs/methods/estimators.md has the equations,
# `dqforge.optimizer.saliency.injection` the steps of the firmware.

# Natural frequency in rad/s of the phase-locked loop, unless the design says otherwise.
FASTEST_LOOP = 2.0 * math.pi * 40.0

# Largest standard deviation of the angle in rad that the noise of the current may cause.
NOISE_ANGLE = math.radians(5.0)

# Standard deviation down to which the usual voltage is raised where it can be.
QUIET_ANGLE = math.radians(2.0)
MOST_OF_LINK = 0.28  # Share of the dc link that the usual voltage never exceeds.
_SAMPLES = 10
_NARROW = 0.95  # Modulus of the poles of the notch of sine and rotating voltage.


def usual_voltage(design: Design) -> float:
    """The smaller of a tenth of the dc link and what makes a fifth of the largest current in a
    period, in V: where the noise of the current leaves it enough.
    """
    l_d = linearised(design.machine).l_d
    return min(0.1 * design.inverter.v_dc, 0.2 * design.i_max * l_d / design.control.t_s)


def usual_loop(t_s: float) -> float:
    """Natural frequency in rad/s."""
    return min(0.01 / t_s, FASTEST_LOOP)


def pll_gains(bandwidth: float, damping: float, t_s: float) -> tuple[float, float]:
    """k_p, and k_i in 1/s, that put two poles at exp(s t_s), s^2 + 2 damping bandwidth s +
    bandwidth^2 = 0.
    """
    roots = np.exp(np.roots([1.0, 2.0 * damping * bandwidth, bandwidth**2]) * t_s)
    product, total = float(np.real(np.prod(roots))), float(np.real(np.sum(roots)))
    return 1.0 - product, (1.0 + product - total) / t_s


def notch(wave: InjectionWave, samples: int) -> tuple[float, float, float, float, float]:
    """Coefficients that take the injected frequency out of the current and leave a steady one.

    Square wave: (3 + 2/z - 1/z^2)/4, nothing at half the sampling frequency, no lag of a ramp.
    """
    if wave == "square":
        return 0.75, 0.5, -0.25, 0.0, 0.0
    cosine = math.cos(2.0 * math.pi / samples)
    a_1, a_2 = -2.0 * _NARROW * cosine, _NARROW**2
    whole = (1.0 + a_1 + a_2) / (2.0 - 2.0 * cosine)
    return whole, -2.0 * cosine * whole, whole, a_1, a_2


def _wave(
    wave: InjectionWave, samples: int, voltage: float, difference: complex
) -> tuple[tuple[tuple[float, ...], ...], float]:
    """(carrier d or alpha, beta, reference, beta), and what a radian demodulates to, in A.

    ``difference`` is Y_d - Y_q in A/V at the injected frequency.
    """
    n = np.arange(samples)
    turn = 2.0 * np.pi / samples
    carrier = voltage * np.cos(turn * n)
    if wave == "square":
        # the sum of two directions and of two differences, each 2 V Y eps
        found = (carrier, np.empty(0), np.cos(turn * n), np.empty(0))
        return _floats(found), -8.0 * voltage * difference.real
    phase = turn * (n - DELAY) + np.angle(difference)
    if wave == "sine":
        found = (carrier, np.empty(0), np.cos(phase), np.empty(0))
        return _floats(found), 0.5 * samples * voltage * abs(difference)
    found = (carrier, voltage * np.sin(turn * n), np.cos(phase), np.sin(phase))
    return _floats(found), samples * voltage * abs(difference)


def _floats(parts: tuple[FloatArray, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(part.tolist()) for part in parts)


def _settings(
    design: Design, settings: ObserverSettings
) -> tuple[InjectionWave, int, float | None]:
    """Wave, samples per period and voltage in V, None where it is left open."""
    wave: InjectionWave = settings.wave or "square"
    samples = settings.samples or (2 if wave == "square" else _SAMPLES)
    if wave == "square" and samples != 2:
        raise InputError(
            f"control.observer.samples: a square wave changes its sign every sample, got "
            f"{samples}; write 2, or wave: sine"
        )
    if wave != "square" and samples not in range(6, LONGEST + 1, 2):
        raise InputError(
            f"control.observer.samples: {wave} takes 6, 8, ... {LONGEST} samples per period, got "
            f"{samples}"
        )
    voltage, most = settings.voltage, 0.5 * linear_voltage(design.inverter.v_dc)
    if voltage is not None and voltage > most:
        raise InputError(
            f"control.observer.voltage: {voltage:.4g} V leave nothing for the current control; "
            f"write at most {most:.4g} V, half of what the link of {design.inverter.v_dc:g} V gives"
        )
    return wave, samples, voltage


def design_injection(design: Design, settings: ObserverSettings) -> InjectionGains:
    """Gains of the firmware.

    Raises:
        InputError: A setting is out of range.
        NoSolutionError: The saliency or the voltage is too small, or the loop too fast.
    """
    if design.phase_machine is not None:
        raise NoSolutionError(
            "control.observer: injection needs a control that adds its voltage, which machines of "
            "model: waveform have not; choose third-harmonic, or an observer"
        )
    wave, samples, voltage = _settings(design, settings)
    loaded = along_locus(design, POINTS)
    require_saliency(loaded, "injection")
    t_s = design.control.t_s
    bandwidth = usual_loop(t_s) if settings.pll_bandwidth is None else settings.pll_bandwidth
    damping = 1.0 if settings.damping is None else settings.damping
    if not bandwidth * t_s <= 0.5:
        raise InputError(
            f"control.observer.pll_bandwidth: {bandwidth:g} rad/s are too fast; write at most "
            f"{0.5 / t_s:g} rad/s"
        )
    shape = _Shape(design, loaded, wave, samples, pll_gains(bandwidth, damping, t_s))
    first = _gains(shape, usual_voltage(design) if voltage is None else voltage)
    _require_stable(first)
    if voltage is not None:
        _require_quiet(first, design)
        return first
    gains = _gains(shape, _raised(first, design))
    _require_quiet(gains, design)
    return gains


@dataclass(frozen=True, slots=True)
class _Shape:
    """All but the voltage: the design, its saliency along the load, wave, samples per period, and
    k_p and k_i of the loop.
    """

    design: Design
    loaded: LoadedSaliency
    wave: InjectionWave
    samples: int
    loop: tuple[float, float]


def _gains(shape: _Shape, voltage: float) -> InjectionGains:
    machine, t_s = linearised(shape.design.machine), shape.design.control.t_s
    y, loaded = admittance(machine, t_s, shape.samples), shape.loaded
    parts, whole = _wave(shape.wave, shape.samples, voltage, complex(y[0, 0] - y[1, 1]))
    share = loaded.y_delta / (0.5 * (1.0 / machine.l_d - 1.0 / machine.l_q))
    cosine = np.cos(2.0 * loaded.axis)
    return InjectionGains(
        t_s=t_s,
        k_p=shape.loop[0],
        k_i=shape.loop[1],
        omega_max=electrical_limit(machine, t_s, None),
        notch=notch(shape.wave, shape.samples),
        per_ampere=(POINTS - 1) / float(loaded.i_q[-1]),
        scale=tuple((1.0 / (whole * share * cosine)).tolist()),
        shift=tuple((0.5 * np.tan(2.0 * loaded.axis) + 0.0).tolist()),
        carrier=parts[0],
        carrier_beta=parts[1],
        reference=parts[2],
        reference_beta=parts[3],
        rest=tuple((t_s * (loaded.y_sum - loaded.y_delta * np.cos(2.0 * loaded.axis))).tolist()),
    )


def current_noise(design: Design) -> float:
    """Standard deviation of a measured current in A, as observers are judged with."""
    machine = linearised(design.machine)
    return usual_disturbances(machine, design.inverter.v_dc, 1.0).i_noise


def _raised(gains: InjectionGains, design: Design) -> float:
    """The voltage in V that leaves little noise, as far as the link allows."""
    voltage, noise = gains.carrier[0], angle_noise(gains, current_noise(design))
    most = max(MOST_OF_LINK * design.inverter.v_dc, voltage)
    return min(voltage * max(noise / QUIET_ANGLE, 1.0), most)


def _require_stable(gains: InjectionGains) -> None:
    """Refuse a loop that swings."""
    if largest_pole(gains) >= 1.0:
        raise NoSolutionError(
            "control.observer: the loop is too fast for the delay of the injected voltage: its "
            f"largest pole is {largest_pole(gains):.4g}; write a smaller pll_bandwidth"
        )


def _require_quiet(gains: InjectionGains, design: Design) -> None:
    """Refuse a voltage that noise hides."""
    noise = angle_noise(gains, current_noise(design))
    if noise > NOISE_ANGLE:
        raise NoSolutionError(
            f"control.observer: {current_noise(design):.3g} A of current noise make the angle of "
            f"the injection wander by {math.degrees(noise):.3g} deg (r.m.s.), "
            f"{math.degrees(NOISE_ANGLE):.3g} are permitted; write voltage: "
            f"{gains.carrier[0] * noise / NOISE_ANGLE:.3g} V or more, a smaller pll_bandwidth, or "
            "a slower wave"
        )


def speed_with_room(design: Design, per_ampere: float, voltage: float, most: float) -> float:
    """Electrical speed in rad/s, ``most`` at most, up to which an added voltage in V leaves room
    for the back-EMF of the largest load, where the tables end.
    """
    machine = linearised(design.machine)
    i_q = (POINTS - 1) / per_ampere
    room = linear_voltage(design.inverter.v_dc) - voltage - machine.r_s * i_q
    flux = math.hypot(machine.psi_pm, machine.l_q * i_q)
    return min(most, room / flux)


def _speeds(design: Design, gains: InjectionGains) -> tuple[float, float]:
    """From standstill to where a turn lasts ten injected periods or the voltage leaves no room for
    the injection.
    """
    samples = max(len(gains.carrier), 4)
    turn = 2.0 * math.pi / (10.0 * samples * gains.t_s)
    most = min(turn, gains.omega_max)
    return 0.0, speed_with_room(design, gains.per_ampere, max(gains.carrier), most)


def _in_words(gains: InjectionGains) -> str:
    wave = "rotating" if gains.carrier_beta else ("square" if len(gains.carrier) == 2 else "sine")
    frequency = 1.0 / (len(gains.carrier) * gains.t_s)
    bandwidth = math.sqrt(gains.k_i / gains.t_s)
    return (
        f"{wave} wave of {max(gains.carrier):.4g} V at {frequency:.4g} Hz; loop "
        f"{bandwidth:.4g} rad/s"
    )


TRACKER = Tracker(
    name="injection",
    code="injection",
    title="injected voltage that shows the saliency, with phase-locked loop",
    design=design_injection,
    start=wave_start,
    step=wave_step,
    gains=InjectionGains,
    speeds=_speeds,
    in_words=_in_words,
    injects=True,
    loop=wave_tracking,
    steps=injection_steps,
)
