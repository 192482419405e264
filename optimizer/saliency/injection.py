"""A tracker of the saliency by an injected wave as the firmware runs it: written once, in the order
of operations of the emitted C (``observers/injection.j2``).

Square wave (two samples): the second difference of the current in stator axes, across the direction
in which the voltage acted, less what the rest of the voltage makes of it; sine along the assumed d
axis: the current across it, demodulated; rotating voltage: the negative sequence of the current.
Each gives sin 2 (eps + chi) of the angle error eps, chi being where the flux map has the axis of
the saliency at the present load; scale and shift of the gains make the error in rad of it. A sample
that is not a number corrects nothing.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import InjectionWave
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.estimators import Tracker, TrackerLoop
from dqforge.optimizer.observers.parts import ObserverState, usual_disturbances
from dqforge.optimizer.observers.sampled_machine import electrical_limit
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.saliency.sampled_injection import DELAY, LONGEST, admittance
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair, limited

POINTS = 9  # Of the tables over the load.
_UNKNOWN = 1.0e15
_LARGEST = 0.5  # Largest error in rad that a sample may claim.
_FILLED = 3.0


class LoadTables(Protocol):
    """Gains with tables over the load."""

    @property
    def per_ampere(self) -> float:
        """Points per A of |i_q|."""
        ...

    @property
    def scale(self) -> tuple[float, ...]:
        """Angle error per demodulated current, in rad/A."""
        ...

    @property
    def shift(self) -> tuple[float, ...]:
        """What the load adds to it, in rad."""
        ...


@dataclass(frozen=True, slots=True)
class WaveGains:
    """What the firmware needs.

    ``t_s`` in s; ``k_p`` and ``k_i`` (1/s) of the phase-locked loop; ``omega_max`` in rad/s. The
    fundamental of the current is ``notch[0..2]`` of the last three samples less ``notch[3..4]`` of
    its last two values. ``scale`` (rad per what is demodulated), ``shift`` in rad and ``rest`` in
    A/V (what a voltage across makes of the current in a period) stand over |i_q| in steps of
    1/``per_ampere``. ``carrier`` in V is that of the d axis, or of alpha with
    that of beta besides (then it rotates); ``reference`` demodulates.
    """

    t_s: float
    k_p: float
    k_i: float
    omega_max: float
    notch: tuple[float, float, float, float, float]
    per_ampere: float
    scale: tuple[float, ...]
    shift: tuple[float, ...]
    carrier: tuple[float, ...]
    carrier_beta: tuple[float, ...]
    reference: tuple[float, ...]
    reference_beta: tuple[float, ...]
    rest: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class WaveState(ObserverState):
    """``vectors``: the last two currents, the last two of the fundamental, the last three
    directions (cosine, sine) of the voltage, the voltage that was asked for before the last, and
    the rest of that which acted; ``scalars``: samples known in a row, and demodulated currents.
    ``n`` is the place in the wave.
    """

    n: int = 0


def wave_start(gains: WaveGains, theta_e: Reals, omega_e: Reals) -> WaveState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    zero = np.zeros_like(theta_e)
    pair = (zero, zero)
    products = 0 if len(gains.carrier) == 2 else len(gains.carrier)
    return WaveState(
        (pair,) * 9, theta_e, omega_e, started=False, scalars=(zero,) * (1 + products),
        added=pair, seen=pair,
    )  # fmt: skip


def known_sample(i: Pair, last: Pair, maths: Arithmetic) -> tuple[Reals, Pair]:
    """Whether a sample is a number, and the sample, or the last one in its place."""
    known = (np.abs(i[0]) < maths.number(_UNKNOWN)) & (np.abs(i[1]) < maths.number(_UNKNOWN))
    return known, (np.where(known, i[0], last[0]), np.where(known, i[1], last[1]))


def place_of(gains: LoadTables, i_q: Reals, maths: Arithmetic) -> tuple[Any, Reals]:
    """Where an i_q in A lies in the tables: the point below, and the part of the way to the next
    one.
    """
    place, last = np.abs(i_q) * gains.per_ampere, maths.number(POINTS - 1.001)
    inside = np.where(place < last, place, last)
    index = inside.astype(np.int64)
    return index, inside - index.astype(maths.number)


def between(table: tuple[float, ...], place: tuple[Any, Reals], maths: Arithmetic) -> Reals:
    """A table there, by lines."""
    values, (index, part) = np.array(table, dtype=maths.number), place
    return np.asarray(values[index] + part * (values[index + 1] - values[index]))


def at_load(gains: LoadTables, i_q: Reals, maths: Arithmetic) -> tuple[Reals, Reals]:
    """Scale and shift at an i_q in A."""
    place = place_of(gains, i_q, maths)
    offset = between(gains.shift, place, maths)
    return between(gains.scale, place, maths), np.where(i_q < 0.0, -offset, offset)


def _fundamental(gains: WaveGains, i: Pair, vectors: tuple[Pair, ...]) -> Pair:
    b_0, b_1, b_2, a_1, a_2 = gains.notch
    last, before, told, told_before = vectors[:4]
    x, y = (
        (((b_0 * i[n] + b_1 * last[n]) + b_2 * before[n]) - a_1 * told[n]) - a_2 * told_before[n]
        for n in (0, 1)
    )
    return x, y


def _second_difference(
    gains: WaveGains, state: WaveState, seen: tuple[Pair, Pair, Pair], maths: Arithmetic
) -> Reals:
    """Of the current, across the sum of the directions of the voltages that acted, less what the
    rest of the voltage has made of it.
    """
    i, rest, told = seen
    x = gains.t_s * state.omega_e
    twice = 2.0 - x * x
    last, before = state.vectors[:2]
    bent = tuple((i[n] - twice * last[n]) + before[n] for n in (0, 1))
    moved = tuple(rest[n] - state.vectors[8][n] for n in (0, 1))
    cosine, sine = (state.vectors[5][n] + state.vectors[6][n] for n in (0, 1))
    ahead = maths.rotation(maths.wrap(state.theta_e + gains.t_s * state.omega_e))
    share = between(gains.rest, place_of(gains, park(maths, told, ahead)[1], maths), maths)
    own = (cosine * bent[1] - sine * bent[0]) - share * (cosine * moved[1] - sine * moved[0])
    return np.asarray(own * gains.reference[state.n])


def _product(gains: WaveGains, n: int, i: Pair, turn: Pair) -> Reals:
    """What a sample adds to the demodulated current."""
    if not gains.carrier_beta:
        return np.asarray((turn[0] * i[1] - turn[1] * i[0]) * gains.reference[n])
    c, s = gains.reference[n], gains.reference_beta[n]
    alpha, beta = c * i[0] - s * i[1], s * i[0] + c * i[1]
    cosine, sine = turn[0] * turn[0] - turn[1] * turn[1], 2.0 * (turn[0] * turn[1])
    return np.asarray(cosine * beta - sine * alpha)


def wave_step(
    gains: WaveGains, state: WaveState, v: Pair, i: Pair, heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> WaveState:  # fmt: skip
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, ``v`` in V acted until then."""
    del heard
    theta, omega, count = state.theta_e, state.omega_e, len(gains.carrier)
    known, sample = known_sample(i, state.vectors[0], maths)
    assert state.added is not None
    acted = known_sample(v, state.vectors[7], maths)[1]
    rest = (acted[0] - state.vectors[7][0], acted[1] - state.vectors[7][1])
    vectors, fresh, products = state.vectors, state.scalars[0], list(state.scalars[1:])
    if not state.started:
        vectors, told = (sample,) * 4 + vectors[4:], sample
        fresh = np.zeros_like(fresh)
    else:
        ahead = maths.wrap(theta + gains.t_s * omega)
        turn = maths.rotation(ahead)
        told = _fundamental(gains, sample, vectors)
        more = np.where(fresh < maths.number(_FILLED), fresh + maths.number(1.0), fresh)
        fresh = np.where(known, more, maths.number(0.0))
        if count == 2:
            found = _second_difference(gains, state, (sample, rest, told), maths)
            found = np.where(fresh >= maths.number(_FILLED), found, maths.number(0.0))
        else:
            product = _product(gains, state.n, sample, turn)
            products[state.n] = np.where(known, product, maths.number(0.0))
            found = np.zeros_like(theta)
            for each in products:
                found = found + each
        scale, shift = at_load(gains, park(maths, told, turn)[1], maths)
        error = limited(maths, scale * found - shift, maths.number(_LARGEST))
        if count == 2:
            error = np.where(fresh >= maths.number(_FILLED), error, maths.number(0.0))
        omega = limited(maths, omega + gains.k_i * error, gains.omega_max)
        theta = maths.wrap(ahead + gains.k_p * error)
    direction = maths.rotation(maths.wrap(theta + (1.5 * gains.t_s) * omega))
    return WaveState(
        (
            *(sample, vectors[0], told, vectors[2]),
            *(direction, vectors[4], vectors[5], state.added, rest),
        ),
        theta,
        omega,
        scalars=(fresh, *products),
        added=_asked(gains, state.n, direction),
        seen=told,
        n=(state.n + 1) % count,
    )


def _asked(gains: WaveGains, n: int, direction: Pair) -> Pair:
    """The voltage that is to be added from the next sampling instant on."""
    if gains.carrier_beta:
        zero = np.zeros_like(direction[0])
        return zero + gains.carrier[n], zero + gains.carrier_beta[n]
    return direction[0] * gains.carrier[n], direction[1] * gains.carrier[n]


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


def _seen_at(gains: WaveGains) -> tuple[tuple[int, float], ...]:
    """How many samples before the correction the errors were made that it counts, and in what
    shares; 0 is the predicted angle of now.
    """
    if len(gains.carrier) == 2:
        return ((2, 0.5), (3, 0.5))
    count = len(gains.carrier)
    return tuple((n, 1.0 / count) for n in range(count))


def wave_tracking(gains: WaveGains) -> TrackerLoop:
    """The loop for the judgement of a speed loop."""
    ahead = 1.5 if len(gains.carrier) == 2 else 0.0
    return TrackerLoop(gains.t_s, gains.k_p, gains.k_i, _seen_at(gains), ahead)


def loop_matrices(gains: WaveGains) -> tuple[FloatArray, FloatArray]:
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
        a[2], b[2] = a[0] + 1.5 * t_s * a[1], b[0] + 1.5 * t_s * b[1]
    else:
        a[2] = ahead
    a[3:, 2:-1] += np.eye(size - 3)
    return a, b


def largest_pole(gains: WaveGains) -> float:
    """Largest modulus of the poles: stable below 1."""
    return float(np.max(np.abs(np.linalg.eigvals(loop_matrices(gains)[0]))))


def angle_noise(gains: WaveGains, current_noise: float) -> float:
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
    voltage, most = settings.voltage, 0.5 * design.inverter.v_dc / math.sqrt(3.0)
    if voltage is not None and voltage > most:
        raise InputError(
            f"control.observer.voltage: {voltage:.4g} V leave nothing for the current control; "
            f"write at most {most:.4g} V, half of what the link of {design.inverter.v_dc:g} V gives"
        )
    return wave, samples, voltage


def design_injection(design: Design, settings: ObserverSettings) -> WaveGains:
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


def _gains(shape: _Shape, voltage: float) -> WaveGains:
    machine, t_s = linearised(shape.design.machine), shape.design.control.t_s
    y, loaded = admittance(machine, t_s, shape.samples), shape.loaded
    parts, whole = _wave(shape.wave, shape.samples, voltage, complex(y[0, 0] - y[1, 1]))
    share = loaded.y_delta / (0.5 * (1.0 / machine.l_d - 1.0 / machine.l_q))
    cosine = np.cos(2.0 * loaded.axis)
    return WaveGains(
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


def _raised(gains: WaveGains, design: Design) -> float:
    """The voltage in V that leaves little noise, as far as the link allows."""
    voltage, noise = gains.carrier[0], angle_noise(gains, current_noise(design))
    most = max(MOST_OF_LINK * design.inverter.v_dc, voltage)
    return min(voltage * max(noise / QUIET_ANGLE, 1.0), most)


def _require_stable(gains: WaveGains) -> None:
    """Refuse a loop that swings."""
    if largest_pole(gains) >= 1.0:
        raise NoSolutionError(
            "control.observer: the loop is too fast for the delay of the injected voltage: its "
            f"largest pole is {largest_pole(gains):.4g}; write a smaller pll_bandwidth"
        )


def _require_quiet(gains: WaveGains, design: Design) -> None:
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


def _speeds(design: Design, gains: WaveGains) -> tuple[float, float]:
    """From standstill to where a turn lasts ten injected periods or the voltage leaves no room for
    the injection.
    """
    machine = linearised(design.machine)
    samples = max(len(gains.carrier), 4)
    turn = 2.0 * math.pi / (10.0 * samples * gains.t_s)
    voltage = max(gains.carrier)
    i_q = (POINTS - 1) / gains.per_ampere
    room = design.inverter.v_dc / math.sqrt(3.0) - voltage - machine.r_s * i_q
    flux = math.hypot(machine.psi_pm, machine.l_q * i_q)
    return 0.0, min(turn, room / flux, gains.omega_max)


def _in_words(gains: WaveGains) -> str:
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
    gains=WaveGains,
    speeds=_speeds,
    in_words=_in_words,
    injects=True,
    loop=wave_tracking,
)
