"""Angle functions, the numbers of Clarke and Park transforms, and duty cycles in integers,
as the emitted C has them.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof. Codes of ``width`` bits are per unit, 2^(width - 1) of them are full scale; those of an angle
are a share of a turn, 2^width of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar, Generic, Literal, Protocol

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.registry import MODULATORS, zero_sequence_of
from dqforge.machines.names import ModulationName, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    Integers,
    Seed,
    larger,
    longest,
    magnitude,
    newton_steps,
    reciprocal,
    reciprocal_seed,
    root_seed,
    rounded,
    scaled,
    shortened,
)
from dqforge.optimizer.loops.integer_gains import FixedGain

# Those of the package's modulators that there are in integers: all.
FIXED_MODULATORS: tuple[ModulationName, ...] = tuple(MODULATORS)
_TERMS = 5
_INTERVALS = 128  # of the table of a quarter turn
_SEED = 20_261_121


@dataclass(frozen=True, slots=True)
class TurnSteps:
    """Sine and cosine in integers.

    In 16 bits they are straight lines between the entries of ``table``, sines of a quarter turn in
    codes; that takes half of the instructions of a polynomial on the least cores. In 32 bits
    ``table`` is empty: with u = x / 2^(width - 3), x the angle from the nearest quarter turn, they
    are u p(u^2) and 1 + u^2 q(u^2) by Horner's rule; u^2 is a code of 2^(width - 1), after a shift
    by ``square``, ``sine`` and ``cosine`` are the coefficients of p and q in codes of 2^width, the
    highest first.
    """

    width: int
    square: int = 0
    sine: tuple[int, ...] = ()
    cosine: tuple[int, ...] = ()
    table: tuple[int, ...] = ()

    @property
    def addends(self) -> tuple[int, ...]:
        """Coefficients of p but the first at the scale of a product, with half of what the shift
        leaves.
        """
        return tuple(_addend(self.width, c) for c in self.sine[1:])

    @property
    def cosine_addends(self) -> tuple[int, ...]:
        """Those of q in the same way."""
        return tuple(_addend(self.width, c) for c in self.cosine[1:])


def _addend(width: int, coefficient: int) -> int:
    return (coefficient << (width - 1)) + (1 << (width - 2))


def _sine_table(width: int) -> tuple[int, ...]:
    """Sines of a quarter turn, longer by half of what a chord lies below its arc."""
    step = 0.5 * math.pi / _INTERVALS
    one = 2.0 ** (width - 1) * (1.0 + step**2 / 16.0)
    sines = (one * math.sin(k * step) for k in range(_INTERVALS + 1))
    return tuple(min(round(value), 2 ** (width - 1) - 1) for value in sines)


@cache
def turn_steps(width: int) -> TurnSteps:
    """Integers of sine and cosine; the polynomials are least squares at Chebyshev nodes of u^2,
    nearly minimax and within 0.1 codes of the functions.
    """
    if width == 16:
        return TurnSteps(width, table=_sine_table(width))
    nodes = np.cos((np.arange(64) + 0.5) * (math.pi / 64)) * 0.5 + 0.5  # of u^2, 0 to 1
    u = np.sqrt(nodes)
    angle = 0.25 * math.pi * u

    def fitted(values: FloatArray, weight: FloatArray, terms: int) -> tuple[int, ...]:
        # Weighted by what the polynomial is multiplied with: the error of the result counts.
        matrix = np.polynomial.polynomial.polyvander(nodes, terms - 1) * weight[:, None]
        found = np.linalg.lstsq(matrix, values, rcond=None)[0].tolist()
        return tuple(round(c * 2.0**width) for c in reversed(found))

    return TurnSteps(
        width,
        width - 5,
        fitted(np.sin(angle), u, _TERMS),
        fitted(np.cos(angle) - 1.0, nodes, _TERMS - 1),
    )


def _eighth(o: Arithmetic[N, Any], width: int, x: N) -> Pair[N]:
    """Cosine and sine of an angle from the nearest quarter turn, as codes of 2^(width - 1)."""
    made = turn_steps(width)
    square = rounded(o, "turn: u^2", o.product("turn: u^2", x, x), made.square)
    found = []
    for coefficients, addends in (
        (made.cosine, made.cosine_addends),
        (made.sine, made.addends),
    ):
        value = o.const(coefficients[0])
        for addend in addends:
            product = o.product("turn: product", value, square)
            value = o.shifted(o.total("turn: sum", product, o.const(addend)), width - 1)
        found.append(value)
    fall = rounded(o, "turn: fall", o.product("turn: fall", found[0], square), width)
    cosine = o.total("turn: cosine", o.const(2 ** (width - 1)), fall)
    cosine = o.clamp(cosine, 0, 2 ** (width - 1) - 1)  # 1 has no code; it is never below 0
    sine = rounded(o, "turn: sine", o.product("turn: sine", found[1], x), width - 2)
    return Pair(cosine, sine)


def _quarter(o: Arithmetic[N, Any], width: int, x: N) -> Pair[N]:
    """Cosine and sine of an angle within a quarter turn from the table.

    The cosine is the sine of what is left of the quarter, to the last bit: it rounds the other way.
    """
    table = turn_steps(width).table
    bits = width - 2 - int(math.log2(_INTERVALS))
    index, share, half = o.shifted(x, bits), o.wrapped(x, bits), 1 << (bits - 1)
    back = o.total("turn: index", o.const(_INTERVALS - 1), o.negative(index))
    low, high = o.entry(table, index), o.entry(table[1:], index)
    rise = o.product("turn: rise", o.total("turn: rise", high, o.negative(low)), share)
    rise = o.shifted(o.total("turn: rise", rise, o.const(half)), bits)
    below, above = o.entry(table, back), o.entry(table[1:], back)
    fall = o.product("turn: fall", o.total("turn: fall", above, o.negative(below)), share)
    fall = o.shifted(o.total("turn: fall", fall, o.const(half - 1)), bits)
    cosine = o.total("turn: cosine", above, o.negative(fall))
    sine = o.total("turn: sine", low, rise)
    # Change no number: between two entries of the table.
    top = 2 ** (width - 1) - 1
    return Pair(o.clamp(cosine, 0, top), o.clamp(sine, 0, top))


def rotation(o: Arithmetic[N, Any], width: int, angle: N) -> Pair[N]:
    """Cosine and sine of an angle, 0 to 2^width - 1 codes."""
    quarter = o.const(2 ** (width - 2))
    if turn_steps(width).table:
        moved = angle
        cosine, sine = _quarter(o, width, o.wrapped(angle, width - 2))
    else:
        half_way = o.const(2 ** (width - 3))
        moved = o.wrapped(o.total("turn: quarter", angle, half_way), width)
        x = o.total("turn: from the quarter", o.wrapped(moved, width - 2), o.negative(half_way))
        cosine, sine = _eighth(o, width, x)
    odd = o.at_least(o.wrapped(moved, width - 1), quarter)
    turned = Pair(o.choose(odd, o.negative(sine), cosine), o.choose(odd, cosine, sine))
    back = o.at_least(moved, o.const(2 ** (width - 1)))
    return Pair(*(o.choose(back, o.negative(value), value) for value in turned))


@cache
def sine_error(width: int) -> float:
    """Largest error of sine and cosine in codes: of all angles in 16 bits,
    of 200,000 in 32 bits.
    """
    angle = (
        np.arange(65_536)
        if width == 16
        else np.random.default_rng(_SEED).integers(0, 2**32, 200_000)
    )
    turn, one = rotation(Integers(), width, angle), 2.0 ** (width - 1)
    exact = angle * (2.0 * math.pi / 2.0**width)
    return float(
        max(
            np.max(np.abs(turn.x - one * np.cos(exact))),
            np.max(np.abs(turn.y - one * np.sin(exact))),
        )
    )


def full_scale(width: int) -> int:
    """The largest code, 2^(width - 1) - 1."""
    return int(2 ** (width - 1) - 1)


@dataclass(frozen=True, slots=True)
class Codes(Generic[N]):
    """Codes of ``width`` bits as the `Numbers` of the transforms: products have twice as many bits,
    ends saturate.
    """

    halves: ClassVar[bool] = False

    o: Arithmetic[N, Any]
    width: int

    @property
    def bits(self) -> int:
        """Bits of a code without its sign."""
        return self.width - 1

    def product(self, name: str, a: N, b: N) -> N:
        """The product a b."""
        return self.o.product(name, a, b)

    def total(self, name: str, *terms: N) -> N:
        """Sum of terms, added from the left."""
        return self.o.total(name, *terms)

    def negative(self, a: N) -> N:
        """The number -a."""
        return self.o.negative(a)

    def magnitude(self, a: N) -> N:
        """The magnitude of a."""
        return magnitude(self.o, a)

    def twice(self, name: str, a: N) -> N:
        """The number 2 a."""
        return self.o.product(name, self.o.const(2), a)

    def halved(self, a: N) -> N:
        """Half of a, downwards."""
        return self.o.shifted(a, 1)

    def part(self, name: str, a: N, share: float) -> N:
        """The product with a constant, which is rounded to a code."""
        return self.o.product(name, a, self.o.const(round(2**self.bits * share)))

    def lowered(self, a: N) -> N:
        """A product with the bits of a code, downwards."""
        return self.o.shifted(a, self.bits)

    def settled(self, name: str, a: N) -> N:
        """A product or sum of products with the bits of a code, to nearest and saturated."""
        return self.saturated(rounded(self.o, name, a, self.bits))

    def saturated(self, a: N) -> N:
        """The code nearest to a."""
        return self.o.clamp(a, -full_scale(self.width) - 1, full_scale(self.width))

    def ratio(self, name: str, a: N, b: N) -> N:
        """Quotient towards zero of a product by a code that is not negative, saturated."""
        return self.saturated(self.o.quotient(name, a, larger(self.o, b, self.o.const(1))))

    def at_least(self, a: N, b: N) -> Any:
        """Condition that a >= b."""
        return self.o.at_least(a, b)

    def choose(self, condition: Any, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""
        return self.o.choose(condition, a, b)

    def where_above(
        self,
        names: Sequence[str],  # noqa: ARG002
        a: N,
        b: N,
        x: Sequence[N],
        y: Sequence[N],
    ) -> list[N]:
        """Numbers x where a > b, else y."""
        keeps = self.o.at_least(b, a)
        return [self.o.choose(keeps, other, one) for one, other in zip(x, y, strict=True)]

    def let(self, name: str, value: N, meaning: str = "") -> N:  # noqa: ARG002
        """As it is."""
        return value


@dataclass(frozen=True, slots=True)
class WideCodes(Codes[N]):
    """Codes that keep what is beyond full scale."""

    def saturated(self, a: N) -> N:
        """As it is."""
        return a


def duties(
    o: Arithmetic[N, Any],
    width: int,
    modulation: ModulationName,
    scale: int,
    vector: Pair[N],
    v_dc: N,
    i: Triple[N],
) -> Triple[N]:
    """Duty cycles, 0 to 2^(width - 1), for a voltage vector and the dc link,
    whose full scale is 2^scale times larger.

    The vector is divided by the dc link (to nearest) and saturated at it;
    ``v_dc`` must be positive.
    """
    codes, one = Codes(o, width), 2 ** (width - 1)
    share = shares(o, width, scale, vector, v_dc)
    saturating = MODULATORS[modulation].kind == "third-harmonic"
    phase = clarke_inverse(codes if saturating else WideCodes(o, width), share)
    turn = None
    if MODULATORS[modulation].compared == "load angle":
        turn = integer_load_turn(o, width, vector, clarke(codes, i))
    seen = None if turn is None else share
    zero = zero_sequence_of(codes, modulation, phase, i, o.const(one), seen, turn)
    return Triple(*(o.clamp(o.total("duties: sum", value, zero), 0, one) for value in phase))


def shares(o: Arithmetic[N, Any], width: int, scale: int, vector: Pair[N], v_dc: N) -> Pair[N]:
    """A vector over the dc link, whose full scale is 2^scale times larger, to nearest and
    saturated.
    """
    codes, top = Codes(o, width), full_scale(width)
    m, doubled = o.normalised(o.clamp(v_dc, 1, top), 1 << (width - 2), 1)
    inverse = reciprocal(o, width, m)
    places = o.total("duties: places", o.const(width - 2 + scale), o.negative(doubled))
    alpha, beta = (
        codes.saturated(
            o.rounded_by("duties: v / v_dc", o.product("duties: v", x, inverse), places)
        )
        for x in vector
    )
    return Pair(alpha, beta)


def integer_load_turn(
    o: Arithmetic[N, Any], width: int, voltage: Pair[N], current: Pair[N]
) -> Pair[N]:
    """As `load_turn`, but for a common factor: the longer of both is at least half of full scale.

    No angle where voltage times current is below that.
    """
    top, name = full_scale(width), "load angle"

    def half(a: N, b: N) -> N:
        return o.shifted(o.product(name, a, b), 1)

    along = o.total(name, half(voltage.x, current.x), half(voltage.y, current.y))
    across = o.total(name, half(voltage.y, current.x), o.negative(half(voltage.x, current.y)))
    across = o.choose(o.at_least(along, o.const(0)), across, o.negative(across))
    along = magnitude(o, along)
    size = larger(o, magnitude(o, across), along)
    known = o.at_least(size, o.const(1 << (width - 2)))
    places = o.halvings(name, size, top - 1)
    # Change no number: a range does not know that the larger of both is a code now.
    along = o.clamp(o.rounded_by(name, along, places), 0, top)
    across = o.clamp(o.rounded_by(name, across, places), -top, top)
    part = o.product(name, along, o.const(round(2 ** (width - 1) / math.sqrt(3.0))))
    most = rounded(o, name, part, width - 1)
    one = 2 ** (width - 1)
    side, end = o.const(round(one * math.sqrt(0.75))), o.const(one >> 1)
    ahead = o.at_least(across, o.total(name, most, o.const(1)))
    behind = o.at_least(o.negative(across), o.total(name, most, o.const(1)))
    cosine = o.choose(ahead, side, o.choose(behind, side, along))
    sine = o.choose(ahead, end, o.choose(behind, o.negative(end), across))
    return Pair(o.choose(known, cosine, o.const(top)), o.choose(known, sine, o.const(0)))


# Current control in integers: controllers, decoupling, observer and the whole step,
# as the emitted C computes them.
#
# As in `fixed_transforms` every function takes its operations from an `Arithmetic`. Integrals and
# the observer's state have ``fraction`` more bits than a code and lie in words of twice the width.

PiForm = Literal["parallel", "velocity"]


@dataclass(frozen=True, slots=True)
class FixedPi:
    """A PI controller: ``ki`` and ``tracking`` lead to a state that has ``fraction`` more bits than
    a code.

    ``tracking`` is the back-calculation gain times t_s; the velocity form has no use for it.
    """

    kp: FixedGain
    ki: FixedGain
    tracking: FixedGain
    fraction: int


_NONE = FixedGain(0, 0, 0.0)
IDLE = FixedPi(_NONE, _NONE, _NONE, 0)  # A controller that does nothing.


@dataclass(frozen=True, slots=True)
class FixedDecoupling:
    """Per-unit reactances at the base speed and the back-EMF there."""

    x_d: FixedGain
    x_q: FixedGain
    back_emf: FixedGain


@dataclass(frozen=True, slots=True)
class FixedObserver:
    """Reduced-order observer: zeta' = zeta - decay zeta + b_u u_q + b_i i_q, omega = zeta - c i_q.

    ``decay`` = 1 - a, ``b_u`` and ``b_i`` lead to zeta, which has ``fraction`` more bits than a
    code and is held within ``reach`` full scales; ``x_d`` is that of the decoupling.
    """

    decay: FixedGain
    b_u: FixedGain
    b_i: FixedGain
    c: FixedGain
    x_d: FixedGain
    fraction: int
    reach: int


class FixedReferences(Protocol):
    """Current references in integers, in the scales of the control."""

    def currents(self, o: Arithmetic[N, Any], torque: N, v_dc: N, omega: N) -> Pair[N]:
        """Codes of the currents (d, q) for those of a torque, the dc link and the speed;
        every code of a word is allowed.
        """


@dataclass(frozen=True, slots=True)
class FixedControl:
    """Everything that ``<prefix>_control_q15.h`` holds.

    Args:
        width: Bits of a code, 16 or 32.
        bases: Full scales of current in A, voltage in V, mechanical speed in rad/s, torque in N m.
        modulation: The modulator of the duty cycles.
        dc_scale: Full scale of the dc link is 2^dc_scale times that of the voltage.
        dc_least: Code below which the dc link is taken as this.
        limit: Largest voltage amplitude over the dc link, between their codes.
        advance: Angle by which the drive turns in 1.5 samples at full speed, from codes of the
            speed to codes of the angle.
        i_d, i_q, speed: The controllers in both forms; ``speed`` is None where there is none.
        decoupling, observer: Feedforward of the currents, and the reduced-order observer, None
            where there is none.
        speed_filter: Share of a new sample of the speed, from codes to a state with width - 2 more
            bits.
        torque_max: Code of the speed controller's limit.
        ratio: Current samples per speed sample.
        reference: What makes current references from a torque; None where there is none in
            integers.
    """

    width: int
    bases: tuple[float, float, float, float]
    modulation: ModulationName
    dc_scale: int
    dc_least: int
    limit: FixedGain
    advance: FixedGain
    i_d: dict[PiForm, FixedPi]
    i_q: dict[PiForm, FixedPi]
    speed: dict[PiForm, FixedPi] | None
    decoupling: FixedDecoupling
    observer: FixedObserver | None
    speed_filter: FixedGain
    torque_max: int
    ratio: int
    reference: FixedReferences | None = None

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return "q15" if self.width == 16 else "q31"

    @property
    def top(self) -> int:
        """The largest code."""
        return full_scale(self.width)

    @property
    def one_code(self) -> tuple[float, float, float, float]:
        """What one code is: A, V, rad/s and N m."""
        current, voltage, speed, torque = (base / 2 ** (self.width - 1) for base in self.bases)
        return current, voltage, speed, torque

    @property
    def dc_least_voltage(self) -> float:
        """Voltage of the dc link in V below which it is taken as this."""
        share: float = self.dc_least / 2 ** (self.width - 1)
        return share * self.bases[1] * 2.0**self.dc_scale

    @property
    def zeta_max(self) -> int:
        """Magnitude within which the state of the observer is held; 0 without one."""
        return (
            0 if self.observer is None else self.observer.reach * self.top << self.observer.fraction
        )

    @property
    def turn(self) -> TurnSteps:
        """Integers of sine and cosine."""
        return turn_steps(self.width)

    @property
    def seeds(self) -> tuple[Seed, Seed]:
        """Polynomials of the reciprocal and of the reciprocal root."""
        return reciprocal_seed(self.width), root_seed(self.width)

    @property
    def newton(self) -> int:
        """Steps of Newton's rule after them."""
        return newton_steps(self.width)

    @property
    def loops(self) -> dict[str, dict[PiForm, FixedPi]]:
        """Controllers by name."""
        found = {"i_d": self.i_d, "i_q": self.i_q}
        return found if self.speed is None else found | {"speed": self.speed}


def pi_integral(o: Arithmetic[N, Any], pi: FixedPi, integral: N, error: N) -> N:
    """Integral with the present error, not yet clamped (backward Euler)."""
    return o.total("integral + ki t_s e", integral, scaled(o, "ki t_s e", pi.ki, error))


def pi_output(o: Arithmetic[N, Any], pi: FixedPi, integral: N, error: N) -> N:
    """Output in codes before any limit: kp e + the integral of `pi_integral`."""
    state = rounded(o, "integral + ki t_s e", integral, pi.fraction)
    return o.total("kp e + integral", scaled(o, "kp e", pi.kp, error), state)


def pi_update(o: Arithmetic[N, Any], width: int, pi: FixedPi, integral: N, excess: N) -> N:
    """Next integral: that of `pi_integral` + tracking excess, clamped to full scale;
    excess = limited - unlimited output.
    """
    top = full_scale(width)
    back = scaled(o, "tracking excess", pi.tracking, excess)
    total = o.total("integral + ki t_s e + tracking excess", integral, back)
    return o.clamp(total, -top << pi.fraction, top << pi.fraction)


def pi_step(
    o: Arithmetic[N, Any], width: int, pi: FixedPi, integral: N, error: N, limit: N
) -> tuple[N, N]:
    """Limited output and next integral."""
    present = pi_integral(o, pi, integral, error)
    output = pi_output(o, pi, present, error)
    limited = o.within(output, limit)
    excess = o.total("limited - output", limited, o.negative(output))
    return limited, pi_update(o, width, pi, present, excess)


@dataclass(frozen=True, slots=True)
class VelocityState(Generic[N]):
    """State of the velocity form: output with ``fraction`` more bits, and kp e of
    the last sample in codes.
    """

    output: N
    proportional: N


def pi_velocity(
    o: Arithmetic[N, Any], pi: FixedPi, state: VelocityState[N], error: N, limit: N
) -> tuple[N, VelocityState[N]]:
    """Limited output and next state: d[k] = d[k-1] + kp e[k] - kp e[k-1] + ki t_s e[k].

    kp e is rounded once and kept, so that its roundings cancel over time and nothing drifts; the
    product of kp with the difference of two errors, as paper 001 has it, would need two bits more.
    """
    now = scaled(o, "kp e", pi.kp, error)
    change = o.total("kp e - last", now, o.negative(state.proportional))
    power = o.const(1 << pi.fraction)
    fine = o.product("(kp e - last) 2^fraction", change, power)
    total = o.total("output + changes", state.output, fine, scaled(o, "ki t_s e", pi.ki, error))
    output = o.within(total, o.product("limit 2^fraction", limit, power))
    return rounded(o, "output", output, pi.fraction), VelocityState(output, now)


def decouple(
    o: Arithmetic[N, Any], width: int, part: FixedDecoupling, omega: N, current: Pair[N]
) -> Pair[N]:
    """Feedforward -omega l_q i_q of d and omega (l_d i_d + psi) of q."""
    bits = width - 1
    with_q = rounded(o, "omega i_q", o.product("omega i_q", omega, current.y), bits)
    with_d = rounded(o, "omega i_d", o.product("omega i_d", omega, current.x), bits)
    cross = scaled(o, "omega l_d i_d", part.x_d, with_d)
    return Pair(
        o.negative(scaled(o, "omega l_q i_q", part.x_q, with_q)),
        o.total("omega (l_d i_d + psi)", cross, scaled(o, "omega psi", part.back_emf, omega)),
    )


@dataclass(frozen=True, slots=True)
class ObserverState(Generic[N]):
    """zeta with ``fraction`` more bits, the estimated speed and the currents (d,
    q) of the last sample, in codes.
    """

    zeta: N
    omega: N
    current: Pair[N]


def observe(
    o: Arithmetic[N, Any],
    width: int,
    part: FixedObserver,
    state: ObserverState[N],
    voltage: Pair[N],
    current: Pair[N],
) -> ObserverState[N]:
    """State after a sample: ``voltage`` (d, q) acted until now, ``current`` is measured now."""
    top, most = full_scale(width), part.reach * full_scale(width) << part.fraction
    turning = rounded(
        o, "omega i_d", o.product("omega i_d", state.omega, state.current.x), width - 1
    )
    coupling = scaled(o, "omega l_d i_d", part.x_d, turning)
    u_q = o.total("v_q - omega l_d i_d", voltage.y, o.negative(coupling))
    u_q = o.clamp(u_q, 1 - 2**width, 2**width - 1)
    leak = scaled(o, "(1 - a) zeta", part.decay, rounded(o, "zeta", state.zeta, part.fraction))
    drive = scaled(o, "b_u u_q", part.b_u, u_q), scaled(o, "b_i i_q", part.b_i, state.current.y)
    zeta = o.clamp(o.total("next zeta", state.zeta, o.negative(leak), *drive), -most, most)
    shown = rounded(o, "zeta", zeta, part.fraction)
    omega = o.total("zeta - c i_q", shown, o.negative(scaled(o, "c i_q", part.c, current.y)))
    return ObserverState(zeta, o.clamp(omega, -top - 1, top), current)


@dataclass(frozen=True, slots=True)
class Measured(Generic[N]):
    """Codes of what is measured: phase currents, angle, mechanical speed and dc link."""

    i: Triple[N]
    theta_e: N
    omega: N
    v_dc: N


@dataclass(frozen=True, slots=True)
class ControlStep(Generic[N]):
    """What a step gives: duty cycles, next integrals (d, q), voltage (alpha, beta),
    currents and voltages (d, q).
    """

    duty: Triple[N]
    integral: Pair[N]
    voltage: Pair[N]
    current_dq: Pair[N]
    voltage_dq: Pair[N]


def current_control(
    o: Arithmetic[N, Any],
    control: FixedControl,
    integral: Pair[N],
    measured: Measured[N],
    reference: Pair[N],
) -> ControlStep[N]:
    """One sample of the current control, from phase currents to duty cycles."""
    width, codes = control.width, Codes(o, control.width)
    v_dc = o.clamp(measured.v_dc, control.dc_least, full_scale(width))
    current = park(codes, clarke(codes, measured.i), rotation(o, width, measured.theta_e))
    feed = decouple(o, width, control.decoupling, measured.omega, current)
    error = Pair(
        o.total("d error", reference.x, o.negative(current.x)),
        o.total("q error", reference.y, o.negative(current.y)),
    )
    d, q = control.i_d["parallel"], control.i_q["parallel"]
    present = Pair(pi_integral(o, d, integral.x, error.x), pi_integral(o, q, integral.y, error.y))
    asked = Pair(
        o.total("v_d", pi_output(o, d, present.x, error.x), feed.x),
        o.total("v_q", pi_output(o, q, present.y, error.y), feed.y),
    )
    limit = o.clamp(scaled(o, "voltage limit", control.limit, v_dc), 0, longest(width))
    found = shortened(o, width, asked, limit)
    excess = Pair(
        o.total("v_d excess", found.x, o.negative(asked.x)),
        o.total("v_q excess", found.y, o.negative(asked.y)),
    )
    after = Pair(
        pi_update(o, width, d, present.x, excess.x),
        pi_update(o, width, q, present.y, excess.y),
    )
    turn = o.total(
        "advanced angle",
        measured.theta_e,
        scaled(o, "angle advance", control.advance, measured.omega),
    )
    vector = park_inverse(codes, found, rotation(o, width, o.wrapped(turn, width)))
    duty = duties(o, width, control.modulation, control.dc_scale, vector, v_dc, measured.i)
    return ControlStep(duty, after, vector, current, found)


@dataclass(frozen=True, slots=True)
class SpeedState(Generic[N]):
    """State of the speed loop: ``filtered`` speed with width - 2 more bits than a code, integral,
    torque, and current samples since the controller ran.
    """

    filtered: N
    integral: N
    torque: N
    count: N


class SpeedControlled(Protocol):
    """A control in integers with a speed loop, as far as that goes; ``speed`` is None without."""

    @property
    def width(self) -> int:
        """Bits of a code."""

    @property
    def speed(self) -> Mapping[PiForm, FixedPi] | None:
        """The controller in its forms."""

    @property
    def speed_filter(self) -> FixedGain:
        """Share of a new sample, to a state with width - 2 more bits than a code."""

    @property
    def torque_max(self) -> int:
        """Limit of its output."""

    @property
    def ratio(self) -> int:
        """Current samples per speed sample."""


def filtered_speed(
    o: Arithmetic[N, Any], control: SpeedControlled, state: N, omega: N
) -> tuple[N, N]:
    """Next state of the speed's filter, and the speed in codes."""
    width, fraction = control.width, control.width - 2
    most = full_scale(width) << fraction
    lag = o.total("omega - filtered", omega, o.negative(rounded(o, "filtered", state, fraction)))
    step = scaled(o, "share of omega", control.speed_filter, lag)
    after = o.clamp(o.total("next filtered", state, step), -most, most)
    return after, rounded(o, "filtered", after, fraction)


def speed_loop(
    o: Arithmetic[N, Any], control: SpeedControlled, state: SpeedState[N], omega: N, reference: N
) -> tuple[SpeedState[N], N]:
    """State after a current sample, and the filtered speed; ``state.torque`` is the reference.

    The filter runs at every sample, the controller at every ratio-th.
    """
    filtered, speed = filtered_speed(o, control, state.filtered, omega)
    forms = control.speed
    pi = IDLE if forms is None else forms["parallel"]
    error = o.total("speed error", reference, o.negative(speed))
    torque, integral = pi_step(
        o, control.width, pi, state.integral, error, o.const(control.torque_max)
    )
    rests = o.at_least(state.count, o.const(1))
    count = o.total("speed: count", state.count, o.const(1))
    again = o.at_least(count, o.const(control.ratio))
    after = SpeedState(
        filtered,
        o.choose(rests, state.integral, integral),
        o.choose(rests, state.torque, torque),
        o.choose(again, o.const(0), count),
    )
    return after, speed


def torque_control(
    o: Arithmetic[N, Any],
    control: FixedControl,
    integral: Pair[N],
    measured: Measured[N],
    torque: N,
) -> tuple[ControlStep[N], Pair[N]]:
    """One sample with the current references of a torque, which are returned too."""
    assert control.reference is not None
    reference = control.reference.currents(o, torque, measured.v_dc, measured.omega)
    return current_control(o, control, integral, measured, reference), reference
