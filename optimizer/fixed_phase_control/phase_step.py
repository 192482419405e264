"""Current control of a phase machine in integers, as the emitted C computes it.

Every function takes its operations from an `Arithmetic`: numbers make it the model of the C, ranges
the proof that nothing overflows. Vectors are alpha, beta and zero sequence (mean of the phases).
"""

from __future__ import annotations

import math
from typing import Any, Generic

from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import N, Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    larger,
    magnitude,
    rounded,
    scaled,
)
from dqforge.optimizer.fixed_control.codes import Codes, rotation
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedPhaseControl,
    Vector,
)


@dataclass(frozen=True, slots=True)
class Sample(Generic[N]):
    """Codes of one instant: phase currents, angle of the shape, mechanical speed, link, midpoint.

    ``open_phase`` is 0, or 1 to 3 for a phase that carries no current.
    """

    i: Triple[N]
    theta: N
    omega: N
    v_dc: N
    v_m: N
    open_phase: N


@dataclass(frozen=True, slots=True)
class PhaseState(Generic[N]):
    """Integrals of the frame's axes and those of the harmonics, with their further bits."""

    integral: Triple[N]
    harmonics: tuple[Pair[N], ...]


@dataclass(frozen=True, slots=True)
class PhaseStep(Generic[N]):
    """What a step gives: duty cycles of the legs, next state, voltage, reference, errors."""

    duty: tuple[N, ...]
    state: PhaseState[N]
    voltage: Vector[N]
    reference: Vector[N]


def has_zero(control: FixedPhaseControl) -> bool:
    """Whether the topology drives a zero-sequence current."""
    return TOPOLOGIES[control.topology].neutral


def zero_of(o: Arithmetic[N, Any], width: int, phase: Triple[N]) -> N:
    """Mean of the phases in codes."""
    bits = width - 1
    total = o.total("zero: a + b + c", *phase)
    share = o.const(round(2**bits / 3))
    return Codes(o, width).settled("zero", o.product("zero: / 3", total, share))


def flux_at(o: Arithmetic[N, Any], control: FixedPhaseControl, angle: N) -> Triple[N]:
    """Flux of the phases at an angle of the shape, in codes, by straight lines."""
    width, nodes = control.width, control.nodes
    place = o.product("shape: place", angle, o.const(nodes))
    index = o.clamp(o.shifted(place, width), 0, nodes - 1)
    share = o.shifted(o.wrapped(place, width), 1)
    found = []
    for phase in range(3):
        row = control.shape[phase if len(control.shape) == 3 else 0]
        moved = index
        if len(control.shape) == 1 and phase:
            ahead = o.total("shape: index", index, o.const(nodes - nodes * phase // 3))
            past = o.total("shape: index", ahead, o.const(-nodes))
            moved = o.choose(o.at_least(ahead, o.const(nodes)), past, ahead)
            moved = o.clamp(moved, 0, nodes - 1)  # changes no number
        here = o.entry(row, moved)
        gap = o.total("shape: slope", o.entry(row[1:], moved), o.negative(here))
        rise = rounded(o, "shape: rise", o.product("shape: rise", gap, share), width - 1)
        found.append(Codes(o, width).saturated(o.total("shape: value", here, rise)))
    return Triple(*found)


def flux_vector(
    o: Arithmetic[N, Any], control: FixedPhaseControl, phases: Triple[N], *, zero_sequence: bool
) -> Vector[N]:
    """Flux on alpha, beta and zero; none on zero without a ``zero_sequence``."""
    pair = clarke(Codes(o, control.width), phases)
    zero = zero_of(o, control.width, phases) if zero_sequence else o.const(0)
    return Vector(pair.x, pair.y, zero)


def electrical_angle(o: Arithmetic[N, Any], control: FixedPhaseControl, angle: N) -> N:
    """Electrical angle of an angle of the shape."""
    if control.turns == 1:
        return angle
    turned = o.product("angle: turns", angle, o.const(control.turns))
    return o.wrapped(turned, control.width)


def harmonic_share(o: Arithmetic[N, Any], control: FixedPhaseControl, speed: N) -> N:
    """Share of the harmonics in the references, 0 to full scale, at a magnitude of the speed."""
    lack = o.total("fade: lack", o.const(control.fade_end), o.negative(speed))
    lack = o.clamp(lack, 0, control.top)
    return o.clamp(scaled(o, "fade", control.fade, lack), 0, control.top)


def reference_flux(
    o: Arithmetic[N, Any], control: FixedPhaseControl, angle: N, share: N, open_phase: N
) -> Vector[N]:
    """Flux that the references follow: faded to its fundamental, without an open phase."""
    width, codes = control.width, Codes(o, control.width)
    whole = flux_at(o, control, angle)
    turn = rotation(o, width, electrical_angle(o, control, angle))
    size = o.const(control.fundamental)
    sinusoidal = clarke_inverse(
        codes,
        Pair(
            o.negative(codes.settled("fundamental", o.product("fundamental", size, turn.y))),
            codes.settled("fundamental", o.product("fundamental", size, turn.x)),
        ),
    )
    full = o.at_least(share, o.const(control.top))
    left = []
    for number, (flux, sine) in enumerate(zip(whole, sinusoidal, strict=True), start=1):
        gap = codes.saturated(o.total("fade: harmonics", flux, o.negative(sine)))
        part = rounded(o, "fade: part", o.product("fade: part", gap, share), width - 1)
        faded = codes.saturated(o.total("fade: flux", sine, part))
        value = o.choose(full, flux, faded)
        if has_zero(control):
            is_open = o.at_least(o.const(0), magnitude(o, _less(o, open_phase, number)))
            value = o.choose(is_open, o.const(0), value)
        left.append(value)
    shaped = has_zero(control) and control.frame != "dqx"
    return flux_vector(o, control, Triple(*left), zero_sequence=shaped)


def _less(o: Arithmetic[N, Any], value: N, number: int) -> N:
    return o.total("open phase", value, o.const(-number))


def unit_square(o: Arithmetic[N, Any], control: FixedPhaseControl, flux: Vector[N]) -> N:
    """Square alpha^2 + beta^2 + 2 zero^2 of the flux in codes, at least the least of the shape."""
    bits = control.width - 1
    square = o.total(
        "square",
        *(o.shifted(o.product("square: axis", x, x), bits) for x in flux),
        o.shifted(o.product("square: axis", flux.zero, flux.zero), bits),
    )
    return o.clamp(square, control.least_square, 4 << bits)


def reference_currents(
    o: Arithmetic[N, Any], control: FixedPhaseControl, torque: N, flux: Vector[N]
) -> Vector[N]:
    """Currents T f / (p |f|^2) in codes for the code of a torque."""
    codes, bits = Codes(o, control.width), control.width - 1
    wanted = codes.saturated(scaled(o, "torque", control.unit, torque))
    wide = o.product("torque 2^bits", wanted, o.const(1 << bits))
    per_flux = codes.saturated(o.quotient("torque / square", wide, unit_square(o, control, flux)))
    return Vector(
        *(
            codes.saturated(
                rounded(
                    o, "reference", o.product("reference", per_flux, x), bits - control.unit_bits
                )
            )
            for x in flux
        )
    )


def references(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    sample: Sample[N],
    angles: tuple[N, ...],
    torque: N,
    constant: Pair[N],
) -> list[Vector[N]]:
    """References at some angles: of a torque over the shape, and of constant dq currents."""
    codes, speed = Codes(o, control.width), magnitude(o, sample.omega)
    share = harmonic_share(o, control, speed)
    found = []
    for angle in angles:
        turn = rotation(o, control.width, electrical_angle(o, control, angle))
        pair = park_inverse(codes, constant, turn)
        current = Vector(pair.x, pair.y, o.const(0))
        if control.frame != "dq":
            flux = reference_flux(o, control, angle, share, sample.open_phase)
            shaped = reference_currents(o, control, torque, flux)
            current = Vector(
                *(
                    codes.saturated(o.total("reference: sum", x, y))
                    for x, y in zip(shaped, current, strict=True)
                )
            )
        found.append(_balanced(o, control, sample, speed, current))
    return found


def _balanced(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    sample: Sample[N],
    speed: N,
    current: Vector[N],
) -> Vector[N]:
    """The reference with a zero sequence that keeps the midpoint of a split link."""
    if control.midpoint is None:
        return current
    codes, part = Codes(o, control.width), control.midpoint
    weight = o.clamp(scaled(o, "midpoint: fade", part.fade, speed), 0, control.top)
    kept = rounded(
        o, "midpoint: zero", o.product("midpoint: zero", current.zero, weight), control.width - 1
    )
    gap = o.total("midpoint: gap", sample.v_m, o.negative(o.shifted(sample.v_dc, 1)))
    back = scaled(o, "midpoint: balance", part.balance, codes.saturated(gap))
    zero = codes.saturated(o.total("midpoint: reference", kept, o.negative(back)))
    return current._replace(zero=zero)


def axes_of(control: FixedPhaseControl) -> tuple[tuple[int, FixedAxis], ...]:
    """Axes that are driven, by their place in a vector, with their controllers."""
    found = ((0, control.d), (1, control.q))
    return found if control.zero is None else (*found, (2, control.zero))


def feedforward(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    omega: N,
    currents: tuple[Vector[N], Vector[N]],
    flux: Vector[N],
) -> list[N]:
    """Voltage of the references in codes: resistance, inductance, back-EMF."""
    found = [o.const(0)] * 3
    for place, axis in axes_of(control):
        terms = []
        if control.feedforward != "none":
            turning = rounded(
                o, "omega f", o.product("omega f", omega, flux[place]), control.width - 1
            )
            terms.append(scaled(o, "back-EMF", control.electrical, turning))
        if control.feedforward == "references":
            now, then = currents[0][place], currents[1][place]
            rise = o.total("reference: rise", then, o.negative(now))
            terms.append(scaled(o, "L di", axis.inductance, rise))
            mean = o.shifted(o.total("reference: mean", now, then), 1)
            terms.append(scaled(o, "R i", axis.resistance, mean))
        if terms:
            found[place] = o.total("feedforward", *terms) if len(terms) > 1 else terms[0]
    return found


def harmonic_weight(
    o: Arithmetic[N, Any], control: FixedPhaseControl, part: FixedHarmonic, speed: N
) -> N:
    """Weight of a harmonic, 0 to full scale."""
    lack = o.total("harmonic: lack", o.const(part.end), o.negative(speed))
    return o.clamp(
        scaled(o, "harmonic: fade", part.fade, o.clamp(lack, 0, control.top)), 0, control.top
    )


def order_angle(
    o: Arithmetic[N, Any], control: FixedPhaseControl, part: FixedHarmonic, angle: N
) -> N:
    """The harmonic's order times an electrical angle."""
    return o.wrapped(o.product("harmonic: angle", angle, o.const(part.order)), control.width)


def harmonic_voltage(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    part: FixedHarmonic,
    state: Pair[N],
    angles: tuple[N, N],
    omega: N,
) -> Pair[N]:
    """Voltage of one integrator in the plane, or (voltage, 0) of the zero sequence.

    ``angles`` are the electrical angle, and that by which the drive turns in 1.5 samples.
    """
    width, codes = control.width, Codes(o, control.width)
    axis = control.zero if part.zero and control.zero is not None else control.q
    bits = control.harmonic_fraction
    held = Pair(*(codes.saturated(rounded(o, "harmonic: state", x, bits)) for x in state))
    now = park_inverse(codes, held, rotation(o, width, order_angle(o, control, part, angles[0])))
    then = park_inverse(codes, now, rotation(o, width, order_angle(o, control, part, angles[1])))
    sign = 1 if part.order > 0 else -1
    turning = [
        rounded(o, "harmonic: omega i", o.product("harmonic: omega i", omega, x), width - 1)
        for x in then
    ]
    reactive = [scaled(o, "harmonic: X i", part.reactance, x) for x in turning]
    across = (o.negative(reactive[1]), reactive[0])
    if sign < 0:
        across = (o.negative(across[0]), o.negative(across[1]))
    weight = harmonic_weight(o, control, part, magnitude(o, omega))
    found = []
    for x, y, z in zip(now, then, across, strict=True):
        whole = codes.saturated(
            o.total(
                "harmonic: voltage",
                scaled(o, "harmonic: kp i", axis.kp, x),
                scaled(o, "harmonic: R i", axis.resistance, y),
                z,
            )
        )
        found.append(
            rounded(
                o, "harmonic: weighted", o.product("harmonic: weighted", whole, weight), width - 1
            )
        )
    return Pair(found[0], found[1])


def harmonic_update(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    part: FixedHarmonic,
    state: Pair[N],
    angle: N,
    error: tuple[N, ...],
    omega: N,
) -> Pair[N]:
    """Next state of one integrator for an error in codes of one word."""
    width, codes = control.width, Codes(o, control.width)
    turn = rotation(o, width, order_angle(o, control, part, angle))
    seen = Pair(error[2], o.const(0)) if part.zero else Pair(error[0], error[1])
    turned = park(codes, seen, turn)
    weight = harmonic_weight(o, control, part, magnitude(o, omega))
    most = control.top << control.harmonic_fraction
    found = []
    for x, y in zip(state, turned, strict=True):
        part_of = rounded(o, "harmonic: error", o.product("harmonic: error", y, weight), width - 1)
        step = scaled(o, "harmonic: rate", control.rate, part_of)
        found.append(o.clamp(o.total("harmonic: next", x, step), -most, most))
    return Pair(found[0], found[1])


def control_step(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    state: PhaseState[N],
    sample: Sample[N],
    torque: N,
    constant: Pair[N],
) -> PhaseStep[N]:
    """One sample: duty cycles that act from the next one on, for one period.

    Args:
        o: The arithmetic.
        control: The integers.
        state: What the last step left.
        sample: What is measured now.
        torque: Code of the torque; of no account in frame dq.
        constant: Codes of constant dq currents; in frame dq the reference.
    """
    width, codes = control.width, Codes(o, control.width)
    v_dc = o.clamp(sample.v_dc, control.dc_least, control.top)
    ahead = scaled(o, "angle: sample", control.sample, sample.omega)
    half = o.shifted(ahead, 1)
    middle = o.total("angle: 1.5 samples", ahead, half)
    angles = (
        sample.theta,
        o.wrapped(o.total("angle: next", sample.theta, ahead), width),
        o.wrapped(o.total("angle: after next", sample.theta, ahead, ahead), width),
    )
    acting = o.wrapped(o.total("angle: acting", sample.theta, middle), width)
    now, then, after = references(o, control, sample, angles, torque, constant)
    pair = clarke(codes, sample.i)
    zero = zero_of(o, width, sample.i) if has_zero(control) else o.const(0)
    error = [
        o.total("error", wanted, o.negative(found))
        for wanted, found in zip(now, (pair.x, pair.y, zero), strict=True)
    ]
    near = tuple(codes.saturated(x) for x in error)
    neutral = has_zero(control)
    flux = flux_vector(o, control, flux_at(o, control, acting), zero_sequence=neutral)
    terms = [[x] for x in feedforward(o, control, sample.omega, (then, after), flux)]
    for place, axis in axes_of(control):
        terms[place].append(scaled(o, "kp e", axis.kp, error[place]))
    electrical = electrical_angle(o, control, sample.theta)
    turned = electrical_angle(o, control, o.wrapped(middle, width))
    acting_angles = (acting, electrical_angle(o, control, acting))
    held = frame_voltage(o, control, state.integral, acting_angles, flux)
    for place in range(3):
        terms[place].append(held[place])
    for part, r in zip(control.harmonics, state.harmonics, strict=True):
        made = harmonic_voltage(o, control, part, r, (electrical, turned), sample.omega)
        for place, value in ((2, made.x),) if part.zero else ((0, made.x), (1, made.y)):
            terms[place].append(value)
    asked = Vector(*(o.total("voltage", *parts) for parts in terms))
    voltage, limited = within_region(o, control, asked, v_dc, sample.v_m)
    seen = flux_vector(o, control, flux_at(o, control, sample.theta), zero_sequence=neutral)
    integral = _integrals(
        o, control, state, frame_errors(o, control, near, electrical, seen), limited
    )
    size = o.total("harmonic: sum of errors", *(magnitude(o, x) for x in error))
    rests = o.at_least(size, o.const(control.error_max + 1))
    harmonics = []
    for part, r in zip(control.harmonics, state.harmonics, strict=True):
        new = harmonic_update(o, control, part, r, electrical, near, sample.omega)
        harmonics.append(_unless(o, limited, r, _unless(o, rests, r, new)))
    duty = leg_duties(o, control, voltage, v_dc, sample.v_m)
    return PhaseStep(duty, PhaseState(integral, tuple(harmonics)), voltage, now)


def _unless(o: Arithmetic[N, Any], stopped: Any, old: Pair[N], new: Pair[N]) -> Pair[N]:
    """The new values, or the old ones where they are stopped."""
    return Pair(o.choose(stopped, old.x, new.x), o.choose(stopped, old.y, new.y))


def _integrals(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    state: PhaseState[N],
    errors: Triple[N],
    limited: Any,
) -> Triple[N]:
    """Integrals of the frame's axes after a sample; they stop where the voltage was shortened."""
    axes = (control.d, control.q, control.zero)
    return Triple(
        *(
            o.choose(limited, old, _integrated(o, control, axis, old, e))
            for old, axis, e in zip(state.integral, axes, errors, strict=True)
        )
    )


def _integrated(
    o: Arithmetic[N, Any], control: FixedPhaseControl, axis: FixedAxis | None, old: N, error: N
) -> N:
    if axis is None:
        return old
    most = control.top << axis.fraction
    step = scaled(o, "ki e", axis.ki, error)
    return o.clamp(o.total("integral + ki e", old, step), -most, most)


def torque_reference(o: Arithmetic[N, Any], control: FixedPhaseControl, torque: N) -> Pair[N]:
    """Currents (d, q) in codes for a torque where the references are sinusoids."""
    asked = scaled(o, "current per torque", control.current_per_torque, torque)
    return Pair(o.const(0), Codes(o, control.width).saturated(asked))


# Integrators in dq0, dqx and dqy without angles: errors and voltages along the flux.
#
# In dqx and dqy of paper 002 quantities are divided by a = c / |f|. An axis b of length |f| then
# sees b'e and makes I b / |f|^2, so that neither a root nor an angle of dqx is needed. The inner
# product counts the zero sequence twice, as the mean of the phases asks for.

Vectors = tuple[N, N, N]


def frame_errors(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    error: tuple[N, ...],
    electrical: N,
    flux: Vector[N],
) -> Triple[N]:
    """Errors on the axes of the frame, in codes; flux and angle are those of the sample."""
    codes = Codes(o, control.width)
    if control.frame in ("dq", "table"):
        pair = park(codes, (error[0], error[1]), rotation(o, control.width, electrical))
        return Triple(pair.x, pair.y, error[2])
    found = []
    for axis in frame_axes(o, control, flux):
        terms = [
            o.shifted(o.product("frame: error", part, value), 2)
            for part, value in zip(axis, error, strict=True)
        ]
        total = o.total("frame: error", *terms, terms[2])
        found.append(codes.saturated(rounded(o, "frame: error", total, control.width - 3)))
    return Triple(*found)


def frame_voltage(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    integral: Triple[N],
    acting: tuple[N, N],
    flux: Vector[N],
) -> Vectors[N]:
    """Voltage of the integrals in codes, at the angle at which it acts.

    ``acting`` are the angle of the shape and the electrical angle there, ``flux`` is that there.
    """
    codes = Codes(o, control.width)
    held = [
        o.const(0)
        if axis is None
        else codes.saturated(rounded(o, "integral", value, axis.fraction))
        for value, axis in zip(integral, (control.d, control.q, control.zero), strict=True)
    ]
    if control.frame in ("dq", "table"):
        turn = rotation(o, control.width, acting[1])
        pair = park_inverse(codes, (held[0], held[1]), turn)
        return pair.x, pair.y, held[2]
    bits = control.width - 1
    square = axis_square(o, control, flux)
    parts = [
        codes.saturated(
            o.quotient(
                "frame: I / |f|^2", o.product("frame: I", x, o.const(1 << (bits - 1))), square
            )
        )
        for x in held
    ]
    axes = frame_axes(o, control, flux)
    found = [
        codes.saturated(
            rounded(
                o,
                "frame: voltage",
                o.total(
                    "frame: voltage",
                    *(
                        o.shifted(o.product("frame: voltage", part, axis[place]), 1)
                        for part, axis in zip(parts, axes, strict=True)
                    ),
                ),
                bits - 2,
            )
        )
        for place in range(3)
    ]
    return found[0], found[1], found[2]


def axis_square(o: Arithmetic[N, Any], control: FixedPhaseControl, flux: Vector[N]) -> N:
    """Square of the length of the axes in codes: of the flux in the plane, in dqy of all of it."""
    bits = control.width - 1
    squares = [o.shifted(o.product("frame: square", x, x), bits) for x in flux]
    terms = squares[:2] if control.frame == "dqx" else [*squares, squares[2]]
    return o.clamp(o.total("frame: square", *terms), control.least_square, 4 << bits)


def frame_axes(
    o: Arithmetic[N, Any], control: FixedPhaseControl, flux: Vector[N]
) -> tuple[Vectors[N], Vectors[N], Vectors[N]]:
    """Axes d, q and 0 of dqx or dqy, each as long as the flux, in codes."""
    none = o.const(0)
    across: Vectors[N] = (flux.beta, o.negative(flux.alpha), none)
    if control.frame == "dqx":
        return across, (flux.alpha, flux.beta, none), (none, none, none)
    codes, bits = Codes(o, control.width), control.width - 1
    quarter = [o.shifted(o.product("frame: length", x, x), 2) for x in flux]
    plane = o.total("frame: length", quarter[0], quarter[1])
    whole = o.total("frame: length", plane, quarter[2], quarter[2])
    end = (1 << (2 * bits + 1)) - 1
    half_plane = o.clamp(o.root(o.clamp(plane, 0, end)), 1, 2 << bits)
    half_whole = o.root(o.clamp(whole, 0, end))
    # Ratios in codes of one half, since they may pass 1.
    longer = codes.saturated(
        o.quotient(
            "frame: |f| / plane",
            o.product("frame: |f|", o.clamp(half_whole, 0, 1 << bits), o.const(1 << (bits - 1))),
            half_plane,
        )
    )
    steep = codes.saturated(
        o.quotient(
            "frame: zero / plane",
            o.product("frame: zero", flux.zero, o.const(1 << (bits - 2))),
            half_plane,
        )
    )

    def doubled(name: str, a: N, b: N) -> N:
        return codes.saturated(rounded(o, name, o.product(name, a, b), bits - 1))

    d: Vectors[N] = (
        doubled("frame: d", across[0], longer),
        doubled("frame: d", across[1], longer),
        none,
    )
    root_half = o.const(round(2**bits * math.sqrt(0.5)))
    inclined = [doubled("frame: 0", x, steep) for x in (flux.alpha, flux.beta)]
    # sqrt 2 times, as twice the product with its half.
    zero: Vectors[N] = (
        doubled("frame: 0", inclined[0], root_half),
        doubled("frame: 0", inclined[1], root_half),
        o.negative(
            codes.settled(
                "frame: 0",
                o.product(
                    "frame: 0", o.clamp(_twice(o, half_plane), 0, (1 << bits) - 1), root_half
                ),
            )
        ),
    )
    return d, (flux.alpha, flux.beta, flux.zero), zero


def _twice(o: Arithmetic[N, Any], a: N) -> N:
    return o.product("frame: plane", o.const(2), a)


# Voltages that the legs of a topology can make, and their duty cycles, in integers.

_COARSE = 3  # bits that a voltage beyond full scale is lowered by before it is shortened


def smaller(o: Arithmetic[N, Any], a: N, b: N) -> N:
    """The smaller of two numbers."""
    return o.choose(o.at_least(a, b), b, a)


def phase_voltages(
    o: Arithmetic[N, Any], control: FixedPhaseControl, alpha: N, beta: N, zero: N
) -> tuple[N, N, N]:
    """Phases of a vector in codes of one word; sums of two have a bit more."""
    bits = control.width - 1
    half = o.product("phases: alpha / 2", alpha, o.const(1 << (bits - 1)))
    side = o.product("phases: beta", beta, o.const(round(2**bits * math.sqrt(0.75))))
    b = rounded(o, "phases: b", o.total("phases: b", side, o.negative(half)), bits)
    c = rounded(o, "phases: c", o.total("phases: c", o.negative(side), o.negative(half)), bits)
    return (
        o.total("phases: a", alpha, zero),
        o.total("phases: b", b, zero),
        o.total("phases: c", c, zero),
    )


def ends(o: Arithmetic[N, Any], values: tuple[N, ...]) -> tuple[N, N]:
    """Largest and least of some numbers."""
    high = low = values[0]
    for value in values[1:]:
        high, low = larger(o, high, value), smaller(o, low, value)
    return high, low


def link_demand(o: Arithmetic[N, Any], control: FixedPhaseControl, phases: tuple[N, N, N]) -> N:
    """What phase voltages ask of the link (of half of it where it is split), as their codes."""
    high, low = ends(o, phases)
    rule = TOPOLOGIES[control.topology]
    if rule.between is None:
        return larger(o, high, o.negative(low))
    if rule.neutral:
        high, low = larger(o, high, o.const(0)), smaller(o, low, o.const(0))
    spread = o.total("demand: spread", high, o.negative(low))
    return spread if rule.between == 1.0 else o.shifted(spread, 1)


def link_voltage(o: Arithmetic[N, Any], control: FixedPhaseControl, v_dc: N, v_m: N) -> N:
    """What there is of it, in codes of the voltage."""
    there = v_dc
    if control.midpoint is not None:
        above = o.total("link: above the midpoint", v_dc, o.negative(v_m))
        there = o.clamp(smaller(o, v_m, above), 1, control.top)
    return o.product("link", there, o.const(1 << control.dc_scale))


def within_region(
    o: Arithmetic[N, Any], control: FixedPhaseControl, asked: Vector[N], v_dc: N, v_m: N
) -> tuple[Vector[N], Any]:
    """A voltage shortened along its direction into what the legs can make, and whether it was."""
    codes, bits = Codes(o, control.width), control.width - 1
    coarse = [codes.saturated(o.shifted(x, _COARSE)) for x in asked]
    # A range does not know that the larger of two is positive; 8 full scales are never passed.
    demand = o.clamp(link_demand(o, control, phase_voltages(o, control, *coarse)), 1, 8 << bits)
    most = o.clamp(o.shifted(link_voltage(o, control, v_dc, v_m), _COARSE), 0, (1 << bits) - 1)
    limited = o.at_least(demand, most)
    share = o.quotient("region: share", o.product("region: link", most, o.const(1 << bits)), demand)
    share = o.clamp(share, 0, control.top)
    found = []
    for whole, part in zip(asked, coarse, strict=True):
        short = rounded(
            o, "region: shortened", o.product("region: shortened", part, share), bits - _COARSE
        )
        found.append(codes.saturated(o.choose(limited, short, whole)))
    return asked._replace(alpha=found[0], beta=found[1], zero=found[2]), limited


def centred(o: Arithmetic[N, Any], phases: tuple[N, N, N], middle: N) -> tuple[N, N, N]:
    """Phases less what is common to them."""
    back = o.negative(middle)
    a, b, c = (o.total("duties: centred", x, back) for x in phases)
    return a, b, c


def leg_duties(
    o: Arithmetic[N, Any], control: FixedPhaseControl, voltage: Vector[N], v_dc: N, v_m: N
) -> tuple[N, ...]:
    """Duty cycles of the legs, 0 to 2^(width - 1), in the order of the topology."""
    codes, one = Codes(o, control.width), 1 << (control.width - 1)
    factor = o.const(one >> control.dc_scale)
    phases = phase_voltages(o, control, voltage.alpha, voltage.beta, voltage.zero)
    rule = TOPOLOGIES[control.topology]
    bridges = len(rule.legs) == 6
    if bridges and not rule.neutral:
        high, low = ends(o, phases)
        middle = o.shifted(o.total("duties: ends", high, low), 1)
        phases = centred(o, phases, middle)
    share = tuple(
        codes.saturated(
            o.quotient("duties: v / v_dc", o.product("duties: v", codes.saturated(x), factor), v_dc)
        )
        for x in phases
    )
    half = o.const(one >> 1)

    def limited(*terms: N) -> N:
        return o.clamp(o.total("duties: sum", *terms), 0, one)

    if bridges:
        halves = [o.shifted(x, 1) for x in share]
        first = [limited(half, x) for x in halves]
        return (*first, *(limited(half, o.negative(x)) for x in halves))
    if rule.midpoint:
        wide = o.product("duties: v_m", v_m, o.const(one))
        zero = o.clamp(o.quotient("duties: v_m / v_dc", wide, v_dc), 0, one)
        return tuple(limited(x, zero) for x in share)
    high, low = ends(o, (*share, o.const(0)) if rule.neutral else share)
    zero = o.shifted(o.total("duties: offset", o.const(one), o.negative(high), o.negative(low)), 1)
    legs = tuple(limited(x, zero) for x in share)
    return (*legs, limited(zero)) if rule.neutral else legs
