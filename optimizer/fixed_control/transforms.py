"""Current control in integers: duty cycles, controllers, decoupling, observer and the whole step.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof, expressions its text in C. Integrals and the observer's state have ``fraction`` more bits
than a code and lie in words of twice the width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Generic, Literal, Protocol

from dqforge.machines import transforms
from dqforge.machines.modulation.modulator import Modulator
from dqforge.machines.modulation.registry import MODULATORS, zero_sequence_of
from dqforge.machines.names import ModulationName, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, Triple
from dqforge.optimizer.fixed_control.codes import (
    Codes,
    TurnSteps,
    WideCodes,
    code_clarke,
    code_clarke_inverse,
    code_park,
    code_park_inverse,
    full_scale,
    rotation,
    turn_steps,
)
from dqforge.optimizer.fixed_control.shortening import (
    Seed,
    longest,
    newton_steps,
    reciprocal,
    reciprocal_seed,
    root_seed,
    shortened,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import (
    CODE,
    COUNT,
    FEW,
    Abc,
    AlphaBeta,
    Coded,
    Dq,
    Duties,
    Feedforward,
    Rotation,
    Turned,
)
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    larger,
    magnitude,
    rounded,
    saturated,
    scaled,
)
from dqforge.optimizer.steps.step_arithmetic import Member, where

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


def duty(o: Arithmetic[N, Any], width: int, x: N) -> Turned[N]:
    """A duty cycle within its ends."""
    return o.clamp(x, 0, 1 << (width - 1))


def code_load_turn(
    o: Arithmetic[N, Any], width: int, v: AlphaBeta[N], i: AlphaBeta[N]
) -> Rotation[N]:
    """Cosine and sine of the angle by which the current lags the voltage, within 30 degrees, but
    for a common factor: the longer of both is at least half of full scale. Generating counts as
    motoring with the current reversed. 0 for little power: voltage times current below half of full
    scale.
    """
    top, one, name = full_scale(width), 1 << (width - 1), "load angle"

    def half(a: N, b: N) -> N:
        return o.shifted(o.product(name, a, b), 1)

    power = o.let("power", o.total(name, half(v.x, i.x), half(v.y, i.y)))
    reactive = o.total(name, half(v.y, i.x), o.negative(half(v.x, i.y)))
    reactive = o.let("reactive", reactive)
    forward = o.at_least(power, o.const(0))
    across = o.let("across", o.choose(forward, reactive, o.negative(reactive)))
    along = o.let("along", magnitude(o, power))
    aside = o.let("aside", magnitude(o, across))
    longer = o.let("longer", larger(o, aside, along))

    def known() -> Rotation[N]:
        places = o.halvings(name, longer, top - 1, into=("size", "places"))
        x = o.let("x", o.known(o.rounded_by(name, along, places), 0, top))
        y = o.let("y", o.known(o.rounded_by(name, across, places), -top, top))
        part = o.product(name, x, o.const(round(one / math.sqrt(3.0))))
        most = o.let("most", o.call(rounded, name, part, width - 1))
        side, end = o.const(round(one * math.sqrt(0.75))), o.const(one >> 1)
        return o.cases(
            "held",
            (o.above(y, most), lambda: Rotation(side, end)),
            (o.above(o.negative(y), most), lambda: Rotation(side, o.negative(end))),
            otherwise=lambda: Rotation(x, y),
        )

    return o.cases(
        "turn",
        (o.at_least(longer, o.const(1 << (width - 2))), known),
        otherwise=lambda: Rotation(o.const(top), o.const(0)),
    )


@dataclass(frozen=True, slots=True)
class DutySteps:
    """Duty cycles of a modulator.

    Args:
        width: Bits of a code.
        modulation: The modulator.
        scale: Full scale of the dc link is 2^scale times that of the voltage.
    """

    width: int
    modulation: ModulationName
    scale: int

    def shares(self, o: Arithmetic[N, Any], v: AlphaBeta[N], v_dc: Coded[N]) -> AlphaBeta[N]:
        """Shares of the dc link, to nearest and saturated; one reciprocal serves both."""
        width, top = self.width, full_scale(self.width)
        link, places = o.normalised(
            o.known(v_dc, 1, top),
            1 << (width - 2),
            1,
            width - 2 + self.scale,
            into=("link", "places"),
        )
        inverse = o.let("inverse", o.call(reciprocal, width, link))
        share = (
            o.rounded_by("duties: v / v_dc", o.product("duties: v", x, inverse), places) for x in v
        )
        return AlphaBeta(*(o.call(saturated, width, x) for x in share))

    def duties(
        self, o: Arithmetic[N, Any], v: AlphaBeta[N], v_dc: Coded[N], i: Abc[N]
    ) -> Duties[N]:
        """Duty cycles with the zero sequence of the modulator; v_dc must be positive."""
        width, rule = self.width, MODULATORS[self.modulation]
        codes = Codes(o, width)
        share = o.let("share", o.call(self.shares, v, v_dc))
        phase: Triple[N]
        if rule.kind == "third-harmonic":
            phase = o.let("x", o.call(code_clarke_inverse, width, share))
        else:
            beyond = transforms.clarke_inverse(WideCodes(o, width), share)
            names = ("x_a", "x_b", "x_c")
            phase = Triple(*(o.let(n, x) for n, x in zip(names, beyond, strict=True)))
        one, seen = o.const(1 << (width - 1)), None
        if rule.compared == "load angle":
            current = o.let("current", o.call(code_clarke, width, i))
            lag = o.let("lag", o.call(code_load_turn, width, v, current))
            turned = o.let("turned", o.call(code_park, width, share, lag))
            vector = o.let("vector", AlphaBeta(*turned))
            seen = o.let("seen", o.call(code_clarke_inverse, width, vector))
        zero = zero_sequence_of(codes, self.modulation, phase, i, one, seen=seen)
        zero = o.let("zero", zero)
        return Duties(*(o.call(duty, width, o.total("duties: sum", x, zero)) for x in phase))


# What the firmware has of them. Numbers are integers, or those of an arithmetic.


@dataclass(frozen=True, slots=True)
class PiGains:
    """PI controllers: ki and tracking lead to a state that has so many more bits than a code."""

    kp: FixedGain
    ki: FixedGain
    tracking: Annotated[FixedGain, Member("back-calculation gain times the sampling period")]
    fraction: Annotated[int, COUNT]
    half: Annotated[int, Member("of a code, in the state")]
    most: Annotated[int, Member("largest magnitude of the state")]


def pi_gains(width: int, pi: FixedPi) -> PiGains:
    """Gains of a controller in words of so many bits."""
    half, most = (1 << pi.fraction) >> 1, full_scale(width) << pi.fraction
    return PiGains(pi.kp, pi.ki, pi.tracking, pi.fraction, half, most)


@dataclass(slots=True)
class Pi(Generic[N]):
    """State of a PI controller."""

    integral: N


@dataclass(slots=True)
class PiVelocity(Generic[N]):
    """State of the velocity form: output with ``fraction`` more bits than a code, and kp e of the
    last sample in codes.
    """

    output: N
    proportional: N


def pi_integral(o: Arithmetic[N, Any], gains: PiGains, state: Pi[N], error: N) -> N:
    """The integral with ki t_s e (backward Euler), not yet clamped; the error is the difference of
    two codes.
    """
    change = o.call(scaled, "ki t_s e", gains.ki, error)
    return o.total("integral + ki t_s e", state.integral, change)


def pi_output(o: Arithmetic[N, Any], gains: PiGains, integral: N, error: N) -> N:
    """The output kp e + integral + ki t_s e before any limit; integral as of pi_integral."""
    present = o.total("integral + ki t_s e", integral, o.const(gains.half))
    proportional = o.call(scaled, "kp e", gains.kp, error)
    return o.total("kp e + integral", proportional, o.shifted(present, gains.fraction))


def pi_update(o: Arithmetic[N, Any], gains: PiGains, state: Pi[N], integral: N, excess: N) -> None:
    """The state after a sample: integral + tracking excess, clamped to full scale; excess = limited
    - unlimited output.
    """
    back = o.call(scaled, "tracking excess", gains.tracking, excess)
    total = o.total("integral + ki t_s e + tracking excess", integral, back)
    state.integral = o.within(total, o.const(gains.most))


def pi_step(o: Arithmetic[N, Any], gains: PiGains, state: Pi[N], error: N, limit: N) -> Coded[N]:
    """The limited output; limit is 0 to full scale."""
    integral = o.let("integral", o.call(pi_integral, gains, state, error))
    output = o.let("output", o.call(pi_output, gains, integral, error))
    limited = o.let("limited", o.within(output, limit))
    excess = o.total("limited - output", limited, o.negative(output))
    o.call(pi_update, gains, state, integral, excess)
    return limited


def pi_velocity_step(
    o: Arithmetic[N, Any], gains: PiGains, state: PiVelocity[N], error: N, limit: N
) -> Coded[N]:
    """Velocity form with the gains of that name: d[k] = d[k-1] + kp e[k] - kp e[k-1] + ki t_s e[k],
    limited.

    kp e is rounded once and kept, so that its roundings cancel over time and nothing drifts; the
    product of kp with the difference of two errors, as paper 001 has it, would need two bits more.
    """
    unit = o.let("unit", o.const(1 << gains.fraction))
    now = o.let("now", o.call(scaled, "kp e", gains.kp, error))
    change = o.total("kp e - last", now, o.negative(state.proportional))
    fine = o.product("(kp e - last) 2^fraction", change, unit)
    step = o.call(scaled, "ki t_s e", gains.ki, error)
    total = o.total("output + changes", state.output, fine, step)
    output = o.within(total, o.product("limit 2^fraction", limit, unit))
    output = o.let("output", output)
    state.output, state.proportional = output, now
    return o.shifted(o.total("output", output, o.const(gains.half)), gains.fraction)


def decoupling(
    o: Arithmetic[N, Any], width: int, gains: FixedDecoupling, omega_m: Coded[N], i: Dq[N]
) -> Feedforward[N]:
    """Feedforward -omega l_q i_q of d and omega (l_d i_d + psi) of q."""
    with_q = o.call(rounded, "omega i_q", o.product("omega i_q", omega_m, i.y), width - 1)
    with_d = o.call(rounded, "omega i_d", o.product("omega i_d", omega_m, i.x), width - 1)
    cross = o.call(scaled, "omega l_d i_d", gains.x_d, with_d)
    own = o.call(scaled, "omega psi", gains.back_emf, omega_m)
    return Feedforward(
        o.negative(o.call(scaled, "omega l_q i_q", gains.x_q, with_q)),
        o.total("omega (l_d i_d + psi)", cross, own),
    )


@dataclass(frozen=True, slots=True)
class ReducedOrderGains:
    """Reduced-order speed observer; zeta has fraction more bits than a code."""

    decay: Annotated[FixedGain, Member("1 - a")]
    b_u: FixedGain
    b_i: FixedGain
    c: FixedGain
    x_d: FixedGain
    zeta_max: int
    fraction: Annotated[int, FEW]


def reduced_order_gains(width: int, part: FixedObserver) -> ReducedOrderGains:
    """Gains of the observer in words of so many bits."""
    most = part.reach * full_scale(width) << part.fraction
    return ReducedOrderGains(part.decay, part.b_u, part.b_i, part.c, part.x_d, most, part.fraction)


@dataclass(slots=True)
class ReducedOrder(Generic[N]):
    """zeta, the estimated speed, and the currents of the last sample."""

    zeta: N
    omega_m: Coded[N]
    i: Dq[N]


def reduced_order_step(
    o: Arithmetic[N, Any],
    width: int,
    gains: ReducedOrderGains,
    state: ReducedOrder[N],
    v: Dq[N],
    i: Dq[N],
) -> None:
    """One sample of the observer; v acted over the period that ends at the sampling instant of
    i.
    """
    turning = o.product("omega i_d", state.omega_m, state.i.x)
    with_d = o.call(rounded, "omega i_d", turning, width - 1)
    coupling = o.call(scaled, "omega l_d i_d", gains.x_d, with_d)
    u_q = o.total("v_q - omega l_d i_d", v.y, o.negative(coupling))
    u_q = o.let("u_q", o.within(u_q, o.const((1 << width) - 1)))
    kept = o.call(rounded, "zeta", state.zeta, gains.fraction)
    leak = o.let("leak", o.call(scaled, "(1 - a) zeta", gains.decay, kept))
    drive = (
        o.call(scaled, "b_u u_q", gains.b_u, u_q),
        o.call(scaled, "b_i i_q", gains.b_i, state.i.y),
    )
    total = o.total("next zeta", state.zeta, o.negative(leak), *drive)
    zeta = o.let("zeta", o.within(total, o.const(gains.zeta_max)))
    fine = o.call(rounded, "zeta", zeta, gains.fraction)
    omega = o.total("zeta - c i_q", fine, o.negative(o.call(scaled, "c i_q", gains.c, i.y)))
    state.zeta, state.omega_m, state.i = zeta, o.call(saturated, width, omega), i


@dataclass(frozen=True, slots=True)
class ControlGains:
    """The control as a whole: everything that differs from drive to drive."""

    d: PiGains
    q: PiGains
    decoupling: FixedDecoupling
    voltage_limit: Annotated[FixedGain, Member("of the code of the dc link")]
    angle_advance: Annotated[FixedGain, Member("turn in 1.5 samples, of the code of the speed")]
    speed_filter: Annotated[FixedGain, Member("share of a new sample, to the state of the filter")]
    speed: Annotated[PiGains, Member("gains of 0: no speed loop")]
    dc_least: Annotated[int, CODE, Member("a dc link below counts as this; above 0")]
    torque_max: Annotated[int, CODE, Member("limit of the speed controller's output")]
    ratio: Annotated[int, COUNT, Member("current samples per speed sample")]


@dataclass(slots=True)
class Control(Generic[N]):
    """State of the control."""

    d: Pi[N]
    q: Pi[N]
    speed: Pi[N]
    reference: Annotated[Dq[N], Member("of the currents")]
    i: Annotated[Dq[N], Member("measured")]
    v_dq: Annotated[Dq[N], Member("that the duty cycles make")]
    v: Annotated[AlphaBeta[N], Member("the same; it acts from the next sample on")]
    filtered: Annotated[N, Member("speed with as many more bits as a code has, less 2")]
    omega_m: Annotated[N, CODE, Member("filtered speed")]
    torque: Annotated[N, CODE, Member("reference of the torque")]
    count: Annotated[N, COUNT, Member("current samples since the speed controller ran")]


def control_at_rest(zero: N) -> Control[N]:
    """No torque and no voltage, of numbers that are all 0."""
    pair = Dq(zero, zero)
    own = Pi(zero), Pi(zero), Pi(zero)
    return Control(*own, pair, pair, pair, AlphaBeta(zero, zero), zero, zero, zero, zero)


@dataclass(frozen=True, slots=True)
class Measured(Generic[N]):
    """Codes of what is measured: phase currents, angle, mechanical speed and dc link."""

    i: Abc[N]
    theta_e: Turned[N]
    omega_m: Coded[N]
    v_dc: Coded[N]


class SpeedGains(Protocol):
    """Gains of a control with a speed loop, as far as that goes."""

    @property
    def speed(self) -> PiGains:
        """The controller."""

    @property
    def speed_filter(self) -> FixedGain:
        """Share of a new sample, to a state with width - 2 more bits than a code."""

    @property
    def torque_max(self) -> int:
        """Limit of its output."""

    @property
    def ratio(self) -> int:
        """Current samples per speed sample."""


class SpeedState(Protocol[N]):
    """State of a control with a speed loop, as far as that goes."""

    speed: Pi[N]
    filtered: N
    omega_m: N
    torque: N
    count: N


@dataclass(frozen=True, slots=True)
class SpeedLoopGains:
    """Gains of a speed loop alone."""

    speed: PiGains
    speed_filter: FixedGain
    torque_max: int
    ratio: int


@dataclass(slots=True)
class SpeedLoop(Generic[N]):
    """State of a speed loop alone."""

    speed: Pi[N]
    filtered: N
    omega_m: N
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


def speed_loop_gains(control: SpeedControlled) -> SpeedLoopGains:
    """What the speed loop has of a control."""
    pi = IDLE if control.speed is None else control.speed["parallel"]
    gains = pi_gains(control.width, pi)
    return SpeedLoopGains(gains, control.speed_filter, control.torque_max, control.ratio)


def speed_loop(
    o: Arithmetic[N, Any],
    width: int,
    gains: SpeedGains,
    state: SpeedState[N],
    omega_m: Coded[N],
    reference: Coded[N],
) -> Coded[N]:
    """Reference of the torque for a mechanical speed; call it at every current sample: the filter
    runs at each, the controller at every ratio-th.
    """
    fraction = width - 2
    kept = o.call(rounded, "filtered", state.filtered, fraction)
    lag = o.total("omega - filtered", omega_m, o.negative(kept))
    step = o.call(scaled, "share of omega", gains.speed_filter, lag)
    filtered = o.total("next filtered", state.filtered, step)
    filtered = o.within(filtered, o.const(full_scale(width) << fraction))
    filtered = o.let("filtered", filtered)
    omega = o.let("omega", o.call(rounded, "filtered", filtered, fraction))
    state.filtered, state.omega_m = filtered, omega

    def controlled() -> None:
        error = o.total("speed error", reference, o.negative(omega))
        found = o.call(pi_step, gains.speed, state.speed, error, o.const(gains.torque_max))
        state.torque = o.let("torque", found)

    where(o, o.equal(state.count, o.const(0)), controlled, state, state.speed)
    count = o.let("count", o.total("speed: count", state.count, o.const(1)))
    again = o.at_least(count, o.const(gains.ratio))
    state.count = o.choose(again, o.const(0), count)
    return state.torque


@dataclass(frozen=True, slots=True)
class ControlSteps:
    """The control functions of one header.

    Args:
        duties: Those of the modulator.
        currents: Codes of the current references (d, q) for those of a torque, the dc link and the
            speed; None where there are none in integers.
    """

    duties: DutySteps
    currents: Callable[..., Iterable[Any]] | None = None

    def current_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        reference: Dq[N],
    ) -> Duties[N]:
        """One sample: duty cycles that act from the next sampling instant on, for one period. A
        voltage beyond the limit is shortened along its direction; the integrals take back what was
        cut off.
        """
        width = self.duties.width
        v_dc = o.let("v_dc", o.clamp(measured.v_dc, gains.dc_least, None))
        now = o.let("now", o.call(rotation, width, measured.theta_e))
        current = o.let("current", o.call(code_clarke, width, measured.i))
        i = o.let("i", o.call(code_park, width, current, now))
        feed = o.call(decoupling, width, gains.decoupling, measured.omega_m, i)
        feed = o.let("feed", feed)
        error_d = o.let("error_d", o.total("d error", reference.x, o.negative(i.x)))
        error_q = o.let("error_q", o.total("q error", reference.y, o.negative(i.y)))
        integral_d = o.let("integral_d", o.call(pi_integral, gains.d, state.d, error_d))
        integral_q = o.let("integral_q", o.call(pi_integral, gains.q, state.q, error_q))
        asked_d = o.total("v_d", o.call(pi_output, gains.d, integral_d, error_d), feed.x)
        asked_q = o.total("v_q", o.call(pi_output, gains.q, integral_q, error_q), feed.y)
        v_d, v_q = o.let("v_d", asked_d), o.let("v_q", asked_q)
        share = o.let("most", o.call(scaled, "voltage limit", gains.voltage_limit, v_dc))
        limit = o.known(o.clamp(share, None, longest(width)), 0, longest(width))
        v = o.let("v", o.call(shortened, width, v_d, v_q, o.let("limit", limit)))
        advance = o.call(scaled, "angle advance", gains.angle_advance, measured.omega_m)
        turn = o.let("turn", o.total("advanced angle", measured.theta_e, advance))
        excess_d = o.total("v_d excess", v.x, o.negative(v_d))
        excess_q = o.total("v_q excess", v.y, o.negative(v_q))
        o.call(pi_update, gains.d, state.d, integral_d, excess_d)
        state.reference, state.i, state.v_dq = reference, i, v
        o.call(pi_update, gains.q, state.q, integral_q, excess_q)
        then = o.let("then", o.call(rotation, width, o.wrapped(turn, width)))
        voltage = o.let("voltage", o.call(code_park_inverse, width, v, then))
        state.v = voltage
        return o.call(self.duties.duties, voltage, v_dc, measured.i)

    def torque_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        torque: Coded[N],
    ) -> Duties[N]:
        """Current control with the current references of their own header for a torque."""
        assert self.currents is not None
        args = torque, measured.v_dc, measured.omega_m
        asked: Dq[N] = o.outside(Dq, "reference", self.currents, *args)
        state.torque = torque
        wanted = o.let("wanted", asked)
        return o.call(self.current_control, gains, state, measured, wanted)

    def speed_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        speed_reference: Coded[N],
    ) -> Duties[N]:
        """Speed and current control: duty cycles for the next period."""
        width = self.duties.width
        torque = o.call(speed_loop, width, gains, state, measured.omega_m, speed_reference)
        return o.call(self.torque_control, gains, state, measured, o.let("torque", torque))


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
    def modulator(self) -> Modulator:
        """The modulator."""
        return MODULATORS[self.modulation]

    @property
    def steps(self) -> ControlSteps:
        """The functions of the firmware."""
        duties = DutySteps(self.width, self.modulation, self.dc_scale)
        return ControlSteps(duties, None if self.reference is None else self.reference.currents)

    @property
    def gains(self) -> ControlGains:
        """Gains of the firmware."""
        loop = speed_loop_gains(self)
        return ControlGains(
            pi_gains(self.width, self.i_d["parallel"]),
            pi_gains(self.width, self.i_q["parallel"]),
            self.decoupling,
            self.limit,
            self.advance,
            self.speed_filter,
            loop.speed,
            self.dc_least,
            self.torque_max,
            self.ratio,
        )

    @property
    def loops(self) -> dict[str, dict[PiForm, FixedPi]]:
        """Controllers by name."""
        found = {"i_d": self.i_d, "i_q": self.i_q}
        return found if self.speed is None else found | {"speed": self.speed}
