"""What the position observers in integers are made of: codes of 32 bits with products of 64,
whatever the format of the control is.

An observer integrates: in 16 bits its filters and its loop would come to rest in dead bands, the
speed of a loop of 250 rad/s at 5 kHz in one of 0.16 degrees. So voltages, currents, angle and speed
enter from the codes of the control, 16 or 32 bits, and all that lies between is kept in 32 bits:
per unit with 2^31 codes of full scale, angles with 2^32 codes of a turn, small angles with 2^31
codes of a radian.

Every function takes its operations from an `Arithmetic`, as in `optimizer.fixed_control`: numbers
make it the model of the emitted C, ranges its proof.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Generic, Literal, NamedTuple

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park, park_inverse
from dqforge.optimizer.fixed_control.codes import Codes, full_scale, rotation
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise
from dqforge.optimizer.observers.methods.flux_gains import FluxPath
from dqforge.optimizer.observers.methods.open_loop_flux import OpenLoopFluxGains
from dqforge.optimizer.observers.pll import PllGains
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    CodeArray,
    Integers,
    Range,
    larger,
    magnitude,
    rounded,
    scaled,
)
from dqforge.optimizer.steps.step_arithmetic import Member

WIDTH = 32  # Bits of every code inside an observer.
ONE = 2 ** (WIDTH - 1)  # Codes of full scale, and of a radian.
TOP = ONE - 1  # The largest code.

# Names of quantities that must fit 32 bits begin so, because the C divides them there.
NARROW = "int32: "
_HALF_WORD = 16
_MOST_DIVISOR = 2**62
_SIZE_BITS = 15


def clipped(o: Arithmetic[N, Any], a: N) -> N:
    """The code nearest to a of those that lie as far below zero as above."""
    return o.clamp(a, -TOP, TOP)


def times(o: Arithmetic[N, Any], name: str, a: N, b: N) -> N:
    """Product of two codes, rounded."""
    return o.call(rounded, name, o.product(name, a, b), WIDTH - 1)


def to_rotor(o: Arithmetic[N, Any], vector: Pair[N], turn: Pair[N]) -> Dq[N]:
    """Stationary coordinates in a frame turned by (cosine, sine)."""
    return Dq(*park(Codes(o, WIDTH), vector, turn))


def to_stator(o: Arithmetic[N, Any], vector: Dq[N], turn: Pair[N]) -> Pair[N]:
    """Coordinates of a turned frame back."""
    return park_inverse(Codes(o, WIDTH), vector, turn)


def difference(o: Arithmetic[N, Any], name: str, a: Pair[N], b: Pair[N]) -> Pair[N]:
    """The vector a - b; one bit more than a code."""
    return Pair(o.total(name, a.x, o.negative(b.x)), o.total(name, a.y, o.negative(b.y)))


def scaled_pair(o: Arithmetic[N, Any], name: str, gain: FixedGain, a: Pair[N]) -> Pair[N]:
    """A vector times a gain."""
    return Pair(o.call(scaled, name, gain, a.x), o.call(scaled, name, gain, a.y))


def clipped_vector(o: Arithmetic[N, Any], alpha: N, beta: N) -> Pair[N]:
    """A vector whose components are codes."""
    return Pair(o.call(clipped, alpha), o.call(clipped, beta))


def sine_of_angle(o: Arithmetic[N, Any], across: N, vector: Pair[N], floor: int) -> N:
    """A component over the length of its vector, which counts as floor at least: a sine, 2^31 codes
    of 1.
    """
    return over_length(o, across, length(o, vector, floor))


def quotient_by_length(o: Arithmetic[N, Any], vector: Pair[N], floor: int) -> Pair[N]:
    """A vector over its length, which counts as floor at least; 2^31 codes of 1."""
    size = length(o, vector, floor)
    return Pair(o.call(over_length, vector.x, size), o.call(over_length, vector.y, size))


def length(o: Arithmetic[N, Any], vector: Pair[N], floor: int) -> N:
    """Length of a vector in codes of 16 bits, ``floor`` at least.

    It only scales a loop gain and needs few digits: it is the root of a word of 32 bits.
    """
    x = o.let("x", o.shifted(vector.x, _HALF_WORD))
    y = o.let("y", o.shifted(vector.y, _HALF_WORD))
    x_2 = o.let("x_2", o.known(o.product("x^2", x, x), 0, 2**30))
    y_2 = o.let("y_2", o.known(o.product("y^2", y, y), 0, 2**30))
    length = o.let("length", o.root(o.total("x^2 + y^2", x_2, y_2)), "in codes of 16 bits")
    return o.let("size", o.clamp(length, floor, 2**16))


def over_length(o: Arithmetic[N, Any], across: N, size: N) -> N:
    """A code over a length in codes of 16 bits, with all digits: two divisions of 32 bits, the
    second of what the first leaves.
    """
    first = o.let("first", o.quotient(f"{NARROW}across / size", across, size))
    whole = o.known(o.product("whole part of across", first, size), -ONE, TOP)
    # What a division leaves is less than its divisor.
    rest = o.known(o.total("rest of across", across, o.negative(whole)), 1 - 2**16, 2**16 - 1)
    fine = o.let("fine", o.product(f"{NARROW}rest 2^15", rest, o.const(1 << _SIZE_BITS)))
    second = o.let("second", o.quotient("rest / size", fine, size))
    coarse = o.product("across / size 2^15", first, o.const(1 << _SIZE_BITS))
    return o.call(clipped, o.total("sine of the angle", coarse, second))


def quotient(o: Arithmetic[N, Any], name: str, a: N, b: N, bits: int) -> N:
    """The code a over the code b with so many fractional bits, towards zero, saturated; a divisor
    below one code counts as one.
    """
    fine = o.product(f"{name}: numerator", a, o.const(1 << bits))
    return o.call(clipped, o.quotient(name, fine, o.clamp(b, 1, _MOST_DIVISOR)))


@dataclass(frozen=True, slots=True)
class FixedPll:
    """Phase-locked loop in integers."""

    advance: Annotated[FixedGain, Member("angle of a period, of the code of the speed")]
    l_1: Annotated[FixedGain, Member("angle of an angle error in codes of a radian")]
    l_2: Annotated[FixedGain, Member("speed of an angle error")]


def predicted(o: Arithmetic[N, Any], advance: FixedGain, theta: N, omega: N) -> N:
    """Angle one period on, 2^32 codes of a turn."""
    turn = o.call(scaled, "angle of a period", advance, omega)
    return o.wrapped(o.total("angle foretold", theta, turn), WIDTH)


def turned_by(o: Arithmetic[N, Any], gain: FixedGain, theta: N, error: N) -> N:
    """An angle corrected by a share of an error in codes of a radian."""
    return o.wrapped(o.total("angle", theta, o.call(scaled, "l_1 error", gain, error)), WIDTH)


def corrected(o: Arithmetic[N, Any], pll: FixedPll, theta: N, omega: N, error: N) -> tuple[N, N]:
    """Angle and speed after an angle error in codes of a radian; the speed saturates."""
    speed = o.total("speed", omega, o.call(scaled, "l_2 error", pll.l_2, error))
    return o.call(turned_by, pll.l_1, theta, error), o.call(clipped, speed)


def with_sign_of(o: Arithmetic[N, Any], sign: N, a: N) -> N:
    """The number a, or -a where ``sign`` is below zero."""
    return o.choose(o.at_least(sign, o.const(0)), a, o.negative(a))


def speed_size(o: Arithmetic[N, Any], omega: N) -> N:
    """Magnitude of a speed, a code."""
    held = o.let("held", o.call(clipped, omega))
    return o.known(magnitude(o, held), 0, TOP)


# Voltage model of the stator flux linkage in integers, and the angle of its active part.

_TWO_CODES = 2 * ONE


@dataclass(frozen=True, slots=True)
class FixedFluxPath:
    """Voltage model over a period; all gains lead to codes of the flux linkage."""

    volt: Annotated[FixedGain, Member("of the voltage")]
    half_drop: Annotated[FixedGain, Member("of the sum of two currents")]
    l_q: Annotated[FixedGain, Member("of the change of the current")]
    end_drop: Annotated[FixedGain, Member("end correction, of the change of the current")]
    end_turn: Annotated[FixedGain, Member("and of the turning flux linkage")]


@dataclass(frozen=True, slots=True)
class FixedCurrentModel:
    """Current model: from codes of the current to those of the flux linkage."""

    l_d: FixedGain
    l_q: FixedGain
    psi_pm: int


def fixed_flux_path(path: FluxPath, scales: Scales) -> FixedFluxPath:
    """The voltage model in integers.

    Args:
        path: In double precision.
        scales: Full scales of the control.
    """
    current = scales.current / scales.flux
    return FixedFluxPath(
        volt=gain("flux of a voltage", path.t_s * scales.voltage / scales.flux),
        half_drop=gain("flux of a voltage drop", path.half_drop * current, _TWO_CODES),
        l_q=gain("L_q", path.l_q * current, _TWO_CODES),
        end_drop=gain("end correction", path.end * path.drop * current, _TWO_CODES),
        end_turn=gain("end correction", path.end * scales.turn),
    )


def fixed_current_model(l_d: float, l_q: float, psi_pm: float, scales: Scales) -> FixedCurrentModel:
    """The current model in integers, from inductances in H and the magnet flux linkage in V s."""
    current = scales.current / scales.flux
    return FixedCurrentModel(
        gain("L_d", l_d * current), gain("L_q", l_q * current), code("psi_pm", psi_pm / scales.flux)
    )


def flux_floor(floor: float, scales: Scales) -> int:
    """Least active flux linkage that counts in full, ``floor`` in V s, in codes of 16 bits."""
    return size_floor(floor / scales.flux)


def model_flux(
    o: Arithmetic[N, Any], model: FixedCurrentModel, i: Pair[N], turn: Pair[N]
) -> Pair[N]:
    """Stator flux linkage of the current model."""
    x = o.let("x", o.call(to_rotor, i, turn))
    along = o.total(
        "flux of the d axis", o.call(scaled, "l_d i_d", model.l_d, x.x), o.const(model.psi_pm)
    )
    across = o.call(clipped, o.call(scaled, "l_q i_q", model.l_q, x.y))
    psi = o.let("psi", Dq(o.call(clipped, along), across))
    return o.call(to_stator, psi, turn)


def integrated(
    o: Arithmetic[N, Any],
    path: FixedFluxPath,
    psi: Pair[N],
    v: Pair[N],
    last: Pair[N],
    i: Pair[N],
    omega: N,
) -> Pair[N]:
    """Flux linkage after a period in which v acted and the current went from last to i."""
    both = Pair(o.total("both currents", last.x, i.x), o.total("both currents", last.y, i.y))
    volts = scaled_pair(o, "flux of the voltage", path.volt, v)
    drop = scaled_pair(o, "flux of the drop", path.half_drop, both)
    first = o.let("first", difference(o, "v - R i", volts, drop))
    change = o.let("change", difference(o, "change of the current", i, last))
    own = scaled_pair(o, "l_q change", path.l_q, change)
    apart = difference(o, "turning flux", first, own)
    turning = o.let("turning", o.call(clipped_vector, apart.x, apart.y))
    turned = Pair(
        o.call(times, "omega turning", omega, turning.x),
        o.call(times, "omega turning", omega, turning.y),
    )
    end = scaled_pair(o, "end: drop", path.end_drop, change)
    around = scaled_pair(o, "end: turn", path.end_turn, turned)
    return o.call(
        clipped_vector,
        o.total("flux", psi.x, first.x, o.negative(end.x), around.y),
        o.total("flux", psi.y, first.y, o.negative(end.y), o.negative(around.x)),
    )


def active_angle(
    o: Arithmetic[N, Any],
    model: FixedCurrentModel,
    psi: Pair[N],
    i: Pair[N],
    turn: Pair[N],
    floor: int,
) -> N:
    """Sine of the angle from a direction to the active flux psi - l_q i."""
    apart = difference(o, "active flux", psi, scaled_pair(o, "l_q i", model.l_q, i))
    active = o.let("active", o.call(clipped_vector, apart.x, apart.y))
    seen = o.let("seen", o.call(to_rotor, active, turn))
    return o.call(sine_of_angle, seen.y, active, floor)


# What a position observer in integers is: its record, its state, and a run over samples.

WordType = Literal["int32_t", "int64_t", "uint32_t"]


@dataclass(frozen=True, slots=True)
class Word:
    """A word of the state: its member in C, its type, and what it is."""

    name: str
    type: WordType = "int32_t"
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class TrackedState(Generic[N]):
    """Angle, 2^32 codes of a turn, speed, 2^31 codes of full scale, and what else is kept."""

    theta: N
    omega: N
    words: tuple[N, ...]


Step = Callable[[Any, Any, TrackedState[Any], Pair[Any], Pair[Any]], TrackedState[Any]]


@dataclass(frozen=True, slots=True)
class FixedMethod:
    """One method of observing the position, in integers.

    Args:
        name, code: As those of the `ObserverMethod` of the same name.
        gains: The dataclass that ``design`` returns: integers, `FixedGain` and records of them.
        design: (gains of the method in double precision, scales) -> gains in integers.
        words: What the state holds besides angle and speed.
        limits: gains -> what each word can be; ``step`` leaves none of these ranges.
        begin, step: (arithmetic, gains, state, voltage, current) -> state after the first and after
            any other sample; both vectors (alpha, beta) in codes of 32 bits.
    """

    name: str
    code: str
    gains: type[Any]
    design: Callable[[Any, Scales], Any]
    words: tuple[Word, ...]
    limits: Callable[[Any], tuple[Range, ...]]
    begin: Step
    step: Step


def code_limits(count: int) -> Callable[[Any], tuple[Range, ...]]:
    """``limits`` of a state of so many codes."""

    def limits(_: Any) -> tuple[Range, ...]:
        return (Range(-TOP - 1, TOP),) * count

    return limits


def vector_words(**vectors: str) -> tuple[Word, ...]:
    """Words of vectors in stationary coordinates, by their names with what they are."""
    return tuple(
        Word(f"{name}.{part}", meaning=meaning)
        for name, meaning in vectors.items()
        for part in ("alpha", "beta")
    )


def widened(o: Arithmetic[N, Any], name: str, a: N, width: int) -> N:
    """A code of ``width`` bits as one of 32 bits."""
    return o.product(name, a, o.const(1 << (WIDTH - width)))


def shown(o: Arithmetic[N, Any], state: TrackedState[N], width: int) -> tuple[N, N]:
    """Angle and speed in codes of ``width`` bits."""
    bits, top = WIDTH - width, full_scale(width)
    half = o.const((1 << bits) >> 1)
    theta = o.shifted(o.wrapped(o.total("angle shown", state.theta, half), WIDTH), bits)
    omega = o.call(rounded, "speed shown", state.omega, bits) if bits else state.omega
    return theta, o.clamp(omega, -top, top)


def observe_codes(
    method: FixedMethod,
    gains: Any,
    width: int,
    start: tuple[CodeArray, CodeArray],
    samples: tuple[CodeArray, CodeArray, CodeArray, CodeArray],
) -> tuple[CodeArray, CodeArray]:
    """Estimated angle and speed in codes of ``width`` bits, shape (K, S).

    Args:
        method, gains, width: The observer and the format of the control.
        start: Angle and speed before the first sample in codes of ``width`` bits, shape (S,).
        samples: v_alpha, v_beta, i_alpha and i_beta in codes of ``width`` bits, shape (K, S).
    """
    o = Integers()
    theta, omega = (
        widened(o, "angle or speed of the start", np.asarray(part), width) for part in start
    )
    empty = np.zeros_like(theta)
    state = TrackedState(theta, omega, (empty,) * len(method.words))
    wide = [widened(o, "voltage or current", part, width) for part in samples]
    angles, speeds = np.empty_like(wide[0]), np.empty_like(wide[0])
    for k in range(len(angles)):
        v, i = Pair(wide[0][k], wide[1][k]), Pair(wide[2][k], wide[3][k])
        state = (method.step if k else method.begin)(o, gains, state, v, i)
        angles[k], speeds[k] = shown(o, state, width)
    return angles, speeds


# Open-loop flux estimator in integers (`dqforge.optimizer.observers.methods.open_loop_flux`).

BITS = 25  # Fractional bits of the factor c of the filter, which stays below 2^(30 - 25).
LARGEST = 1 << (WIDTH - 2)  # Limit of both parts of c in codes.
_MOST_CORNER = 1 << 36
_SHARE_BITS = 30


@dataclass(frozen=True, slots=True)
class FixedOpenLoop:
    """Open-loop flux estimator; kappa is the corner of its filter over the angle of a period.

    Codes of kappa have 2^31 of the angle of a period at full speed.
    """

    path: FixedFluxPath
    model: FixedCurrentModel
    corner: Annotated[FixedGain, Member("of the filter, of the code of the speed")]
    least: Annotated[int, Member("and the least"), "int64_t"]
    half: Annotated[FixedGain, Member("half of kappa, 2^25 codes of 1, of the corner")]
    slowest: Annotated[int, Member("least speed of the factor c")]
    cotangent: Annotated[FixedPolynomials, Member("half cotangent times x")]
    floor: Annotated[int, Member("least active flux linkage that counts in full, of 16 bits")]
    pll: FixedPll


class Compensation(NamedTuple, Generic[N]):
    """The factor c by which the filter makes a turning flux linkage too small, and half of kappa;
    2^25 codes of 1.
    """

    real: N
    imaginary: N
    half: N


def design(gains: OpenLoopFluxGains, scales: Scales) -> FixedOpenLoop:
    """The estimator in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.

    Raises:
        NoSolutionError: A gain has no format, or the corner of the filter is beyond that of any
            speed.
    """
    x = scales.turn
    least = round(gains.kappa_0 / x * ONE)
    if max(least, gains.kappa_1 * ONE) > _MOST_CORNER:
        raise NoSolutionError(
            "fixed point: observer, the filter's corner is more than 32 times the full scale of "
            "the speed; use a larger base in control.per_unit.speed"
        )
    series = [1.0, -(x**2) / 12.0, -(x**4) / 720.0]
    return FixedOpenLoop(
        path=fixed_flux_path(gains.path, scales),
        model=fixed_current_model(gains.l_d, gains.l_q, gains.psi_pm, scales),
        corner=gain("corner by the speed", gains.kappa_1),
        least=least,
        half=gain("half of kappa", 0.5 * x * 2**BITS / ONE, _MOST_CORNER),
        slowest=max(1, round(gains.x_min / x * ONE)),
        cotangent=common_scale("half cotangent", [series], _SHARE_BITS),
        floor=flux_floor(gains.floor, scales),
        pll=scales.pll(gains.pll),
    )


def compensation(o: Arithmetic[N, Any], gains: FixedOpenLoop, omega: N) -> Compensation[N]:
    """What makes up for the filter at a speed."""
    size = o.let("size", o.call(speed_size, omega))
    corner = o.let("corner", o.call(scaled, "corner", gains.corner, size))
    kappa = o.let("kappa", larger(o, corner, o.const(gains.least)))
    slow = o.let("slow", o.clamp(size, gains.slowest, TOP))
    over = o.let("over", o.call(quotient, "kappa / x", kappa, slow, BITS))
    # The angle of a period enters the series as the speed does: its square is one of codes.
    square = o.call(times, "square of the speed", slow, slow)
    share = o.call(polynomial, gains.cotangent.rows[0], square)
    found = o.call(
        rounded, "half cotangent", o.product("half cotangent", share, over), gains.cotangent.shift
    )
    part = o.let("part", o.clamp(found, -LARGEST, LARGEST))
    half = o.let("half", o.call(scaled, "half of kappa", gains.half, kappa))
    real = o.clamp(o.total("1 + kappa / 2", o.const(1 << BITS), half), -LARGEST, LARGEST)
    return Compensation(real, with_sign_of(o, omega, o.negative(part)), half)


def begin(
    o: Arithmetic[N, Any], gains: FixedOpenLoop, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The flux linkage of the current model, as the filter would have it: psi conj(c) / |c|^2."""
    del v
    c = o.let("c", o.call(compensation, gains, state.omega))
    turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
    psi = o.let("psi", o.call(model_flux, gains.model, i, turn))
    square = o.total(
        "|c|^2",
        o.product("|c|^2", c.real, c.real),
        o.product("|c|^2", c.imaginary, c.imaginary),
    )
    whole = o.let("whole", o.shifted(square, BITS))
    size = o.let("size", o.clamp(whole, 1, 1 << (2 * WIDTH - 2)))
    first = o.total(
        "conj(c) psi",
        o.product("conj(c) psi", c.real, psi.x),
        o.product("conj(c) psi", c.imaginary, psi.y),
    )
    second = o.total(
        "conj(c) psi",
        o.product("conj(c) psi", c.real, psi.y),
        o.negative(o.product("conj(c) psi", c.imaginary, psi.x)),
    )
    filtered = o.let(
        "filtered",
        o.call(
            clipped_vector,
            o.quotient("psi / c", first, size),
            o.quotient("psi / c", second, size),
        ),
    )
    return TrackedState(state.theta, state.omega, (*filtered, i.x, i.y))


def step(
    o: Arithmetic[N, Any], gains: FixedOpenLoop, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    before, last = Pair(*state.words[:2]), Pair(*state.words[2:])
    c = o.let("c", o.call(compensation, gains, state.omega))
    theta_p = o.let("theta", o.call(predicted, gains.pll.advance, state.theta, state.omega))
    turn = o.let("turn", o.call(rotation, WIDTH, theta_p))
    whole = o.let("whole", o.call(integrated, gains.path, before, v, last, i, state.omega))
    one = o.const(1 << BITS)
    slower = o.total("1 + kappa", one, c.half, c.half)
    keep = o.let("keep", o.call(quotient, "1 / (1 + kappa)", one, slower, _SHARE_BITS))

    def kept(own: N) -> N:
        return o.call(rounded, "kept flux", o.product("kept flux", keep, own), _SHARE_BITS)

    filtered = o.let("filtered", Pair(kept(whole.x), kept(whole.y)))
    real = o.total(
        "c psi",
        o.product("c psi", c.real, filtered.x),
        o.negative(o.product("c psi", c.imaginary, filtered.y)),
    )
    imaginary = o.total(
        "c psi",
        o.product("c psi", c.real, filtered.y),
        o.product("c psi", c.imaginary, filtered.x),
    )
    psi = o.let(
        "psi",
        o.call(
            clipped_vector,
            o.call(rounded, "c psi", real, BITS),
            o.call(rounded, "c psi", imaginary, BITS),
        ),
    )
    error = o.let("error", o.call(active_angle, gains.model, psi, i, turn, gains.floor))
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (filtered.x, filtered.y, i.x, i.y))


METHOD = FixedMethod(
    name="open-loop-flux",
    code="open_loop_flux",
    gains=FixedOpenLoop,
    design=design,
    words=vector_words(psi="filtered stator flux linkage", i="last current"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)


# Full scales of an observer in integers, and gains between them.

_FLUX_RESERVE = 1.5


@dataclass(frozen=True, slots=True)
class Scales:
    """Full scales: ``current`` in A, ``voltage`` in V, ``speed`` (electrical) in rad/s; ``t_s``
    in s; the machine for which the observer was made.
    """

    current: float
    voltage: float
    speed: float
    t_s: float
    machine: LinearMachine

    @property
    def turn(self) -> float:
        """Angle in rad by which the drive turns in a period at full scale of the speed."""
        return self.t_s * self.speed

    @property
    def flux(self) -> float:
        """Full scale of flux linkages in V s: half as much again as magnet and largest current
        make together.
        """
        machine = self.machine
        inductance = max(machine.l_d, machine.l_q)
        return _FLUX_RESERVE * (machine.psi_pm + inductance * self.current)

    def emf(self, omega_max: float) -> float:
        """Full scale of EMFs in V: at least that of the voltage, and half as much again as the
        machine makes at ``omega_max`` rad/s.
        """
        machine = self.machine
        flux = machine.psi_pm + abs(machine.l_d - machine.l_q) * self.current
        return max(self.voltage, _FLUX_RESERVE * omega_max * flux)

    def pll(self, gains: PllGains) -> FixedPll:
        """A phase-locked loop in integers."""
        return FixedPll(
            advance=self.advance,
            l_1=gain("share of the angle error", gains.l_1 / math.pi),
            l_2=gain("speed of the angle error", gains.l_2 / self.speed),
        )

    @property
    def advance(self) -> FixedGain:
        """Codes of the angle of a period from codes of the speed."""
        return gain("angle of a period", self.turn / math.pi)


def gain(name: str, value: float, argument: int = ONE) -> FixedGain:
    """A gain between codes.

    Args:
        name: What it is, for the message.
        value: The gain.
        argument: Largest magnitude of what it is multiplied with.

    Raises:
        NoSolutionError: No format of 32 bits holds it.
    """
    try:
        return quantise(value, WIDTH, argument)
    except NoSolutionError as error:
        raise NoSolutionError(f"fixed point: observer, {name}: {error}") from None


def code(name: str, share: float, one: int = ONE) -> int:
    """Code of a share of full scale.

    Raises:
        NoSolutionError: It is beyond full scale.
    """
    found = round(share * one)
    if abs(found) > TOP:
        raise NoSolutionError(
            f"fixed point: observer, {name} is {share:.4g} of full scale; use larger bases in "
            "control.per_unit"
        )
    return found


def size_floor(share: float) -> int:
    """Code of 16 bits of a least length, for `kit.sine_of_angle`; at least one."""
    return max(1, round(share * 2**15))


def speed_limit(omega: float, scales: Scales) -> int:
    """Code of a speed limit in rad/s, at most full scale."""
    limit: int = min(TOP, round(omega / scales.speed * ONE))
    return limit


# Polynomials of the speed in integers: mantissas of one scale, by Horner's rule.

_MOST_SHIFT = 60


@dataclass(frozen=True, slots=True)
class FixedPolynomials:
    """Polynomials of the square of a speed, mantissas of one shift, of rising powers.

    p(s) = sum of ``rows[n][k]`` s^k / 2^shift with 0 <= s <= 1 per unit; their values are mantissas
    of that ``shift``.
    """

    rows: tuple[tuple[int, ...], ...]
    shift: Annotated[int, "uint32_t"]


def common_scale(
    name: str, rows: Sequence[Sequence[float]], bits: int, weights: Sequence[float] | None = None
) -> FixedPolynomials:
    """Coefficients at the finest common scale at which no value needs more than ``bits`` bits.

    Args:
        name: What the polynomials are, for the message.
        rows: Coefficients of rising powers of s per unit.
        bits: A value stays below 2^bits in magnitude.
        weights: Largest s^k of each power where that is less than 1.

    Raises:
        NoSolutionError: No scale holds them.
    """
    count = len(rows[0])
    most = weights if weights is not None else [1.0] * count
    largest = max(sum(abs(c) * w for c, w in zip(row, most, strict=True)) for row in rows)
    if not 0.0 < largest < 2.0**bits:
        raise NoSolutionError(
            f"fixed point: {name} has no scale of {bits} bits; use other bases in control.per_unit"
        )
    shift = min(_MOST_SHIFT, math.floor(bits - math.log2(largest) - 1e-9))
    # A coefficient beyond 32 bits of its own power would not be a mantissa.
    widest = max(abs(c) for row in rows for c in row)
    shift = min(shift, math.floor(31 - math.log2(widest) - 1e-9))
    if shift < 0:
        raise NoSolutionError(
            f"fixed point: {name} has no scale of 32 bits; use other bases in control.per_unit"
        )
    return FixedPolynomials(tuple(tuple(round(c * 2.0**shift) for c in row) for row in rows), shift)


def polynomial(o: Arithmetic[N, Any], row: tuple[int, ...], square: N) -> N:
    """Mantissa of a polynomial of the square of a speed."""
    value = o.const(row[-1])
    for k in range(len(row) - 2, -1, -1):
        product = o.call(times, "polynomial", value, square)
        value = o.total("polynomial", product, o.const(row[k]))
        value = o.let(f"sum_{k}", value) if k else value
    return value


def odd_polynomial(o: Arithmetic[N, Any], row: tuple[int, ...], square: N, x: N) -> N:
    """Mantissa of a polynomial of the square of a speed, times the speed x."""
    return o.call(times, "odd polynomial", o.call(polynomial, row, square), x)
