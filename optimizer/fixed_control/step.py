"""Current control in integers: controllers, decoupling, observer and the whole step,
as the emitted C computes them.

As in `fixed_transforms` every function takes its operations from an `Arithmetic`. Integrals and the
observer's state have ``fraction`` more bits than a code and lie in words of twice the width.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, Literal, Protocol

from dqforge.machines.names import ModulationName, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, Triple, clarke, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.fixed_control.shortening import (
    Seed,
    longest,
    newton_steps,
    reciprocal_seed,
    root_seed,
    shortened,
)
from dqforge.optimizer.fixed_control.transforms import (
    Codes,
    TurnSteps,
    duties,
    full_scale,
    rotation,
    turn_steps,
)
from dqforge.optimizer.loops.integer_gains import FixedGain

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
