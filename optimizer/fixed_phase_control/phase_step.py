"""Current control of a phase machine in integers: the functions of the firmware.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges the
proof that nothing overflows, expressions its text in C. Vectors are alpha, beta and zero sequence
(mean of the phases).
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.codes import (
    Codes,
    code_clarke,
    code_park,
    code_park_inverse,
    rotation,
)
from dqforge.optimizer.fixed_control.transforms import speed_loop
from dqforge.optimizer.fixed_phase_control.integers import (
    Axis,
    Control,
    ControlGains,
    FixedPhaseControl,
    Measured,
    Shape,
    Turning,
    Vector,
)
from dqforge.optimizer.fixed_phase_control.leg_steps import COARSE, LegSteps
from dqforge.optimizer.fixed_phase_control.reference_steps import (
    ReferenceSteps,
    added,
    ahead,
    axes_of,
    bounded,
    code_product,
    multiple,
    zero,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import (
    Abc,
    AlphaBeta,
    Coded,
    Dq,
    Filling,
    Rotation,
)
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    magnitude,
    rounded,
    saturated,
    scaled,
)
from dqforge.optimizer.steps.step_arithmetic import where


@dataclass(frozen=True, slots=True)
class HarmonicSteps:
    """Integrators that turn with harmonics."""

    control: FixedPhaseControl

    def weight(self, o: Arithmetic[N, Any], fade: FixedGain, end: N, omega_m: Coded[N]) -> N:
        """A harmonic's weight: it fades before its frequency comes near the sampling."""
        lack = o.total("harmonic: lack", end, o.negative(o.call(magnitude, omega_m)))
        lack = o.let("lack", o.call(bounded, lack, 0, self.control.top))
        return o.call(bounded, o.call(scaled, "harmonic: fade", fade, lack), 0, self.control.top)

    def harmonic_voltage(
        self,
        o: Arithmetic[N, Any],
        axis: Axis,
        reactance: FixedGain,
        weight: N,
        state: Turning[N],
        now: Rotation[N],
        turn: Rotation[N],
        omega_m: Coded[N],
        order: N,
    ) -> AlphaBeta[N]:
        """Voltage of an integrator: (kp + (R + j w L) exp(1.5 j w t_s)) r, turned to now; negative
        orders turn backwards.
        """
        width, bits = self.control.width, self.control.harmonic_fraction
        codes = Codes(o, width)
        kept = (
            codes.saturated(o.call(rounded, "harmonic: state", x, bits)) for x in (state.x, state.y)
        )
        held = o.let("held", Dq(*kept))
        here = o.let("here", o.call(code_park_inverse, width, held, now))
        onwards = o.let("onwards", Dq(*here))
        then = o.let("then", o.call(code_park_inverse, width, onwards, turn))
        reactive = []
        for name, x in (("x_alpha", then.x), ("x_beta", then.y)):
            turning = o.call(code_product, width, "harmonic: omega i", omega_m, x)
            reactive.append(o.let(name, o.call(scaled, "harmonic: X i", reactance, turning)))
        forwards = (o.negative(reactive[1]), reactive[0])
        across = o.cases(
            ("across_alpha", "across_beta"),
            (o.above(o.const(0), order), lambda: (reactive[1], o.negative(reactive[0]))),
            otherwise=lambda: forwards,
        )
        found = []
        for x, y, z in zip(here, then, across, strict=True):
            near = o.call(scaled, "harmonic: kp i", axis.kp, x)
            drop = o.call(scaled, "harmonic: R i", axis.resistance, y)
            whole = codes.saturated(o.total("harmonic: voltage", near, drop, z))
            found.append(o.call(code_product, width, "harmonic: weighted", whole, weight))
        return AlphaBeta(*found)

    def harmonic_update(
        self,
        o: Arithmetic[N, Any],
        state: Turning[N],
        weight: N,
        error: AlphaBeta[N],
        now: Rotation[N],
    ) -> None:
        """What an integrator learns from an error."""
        control, width = self.control, self.control.width
        rate = o.let("rate", control.rate)
        most = o.const(control.top << control.harmonic_fraction)
        turned = o.let("turned", o.call(code_park, width, error, now))

        def learnt(old: N, seen: N) -> N:
            part = o.call(code_product, width, "harmonic: error", seen, weight)
            step = o.call(scaled, "harmonic: rate", rate, part)
            return o.within(o.total("harmonic: next", old, step), most)

        state.x, state.y = learnt(state.x, turned.x), learnt(state.y, turned.y)


@dataclass(slots=True)
class _Sums:
    """A vector that a loop adds up."""

    alpha: Any
    beta: Any
    zero: Any


@dataclass(frozen=True, slots=True)
class FrameSteps:
    """Integrators in dqx and dqy without angles: errors and voltages along the flux.

    In these frames of paper 002 quantities are divided by a = c / |f|. An axis b of length |f| then
    sees b'e and makes I b / |f|^2, so that neither a root nor an angle of dqx is needed. The inner
    product counts the zero sequence twice, as the mean of the phases asks for.
    """

    control: FixedPhaseControl

    def frame(
        self, o: Arithmetic[N, Any], flux: Vector[N]
    ) -> Annotated[tuple[Vector[N], Vector[N], Vector[N]], Filling("axes")]:
        """Axes of the frame, each as long as the flux."""
        none = o.const(0)
        across = Vector(flux.beta, o.negative(flux.alpha), none)
        if self.control.frame == "dqx":
            return across, Vector(flux.alpha, flux.beta, none), Vector(none, none, none)
        width, bits = self.control.width, self.control.width - 1
        codes, end = Codes(o, width), (1 << (2 * bits + 1)) - 1
        quarter = [o.shifted(o.product("frame: length", x, x), 2) for x in flux]
        plane = o.known(o.let("plane", o.total("frame: length", *quarter[:2])), 0, end)
        upright = o.let("zero", quarter[2])
        whole = o.known(o.total("frame: length", plane, upright, upright), 0, end)
        half_plane = o.let("half_plane", o.call(bounded, o.root(plane), 1, 2 << bits))
        half_whole = o.let("half_whole", o.call(bounded, o.root(whole), 0, 1 << bits))
        # Ratios in codes of one half, since they may pass 1.
        over = o.product("frame: |f|", half_whole, o.const(1 << (bits - 1)))
        ratio = o.quotient("frame: |f| / plane", over, half_plane)
        longer = o.let("longer", codes.saturated(ratio))
        over = o.product("frame: zero", flux.zero, o.const(1 << (bits - 2)))
        ratio = o.quotient("frame: zero / plane", over, half_plane)
        steep = o.let("steep", codes.saturated(ratio))
        twice = o.product("frame: plane", o.const(2), half_plane)
        full_plane = o.call(bounded, twice, 0, self.control.top)

        def doubled(name: str, a: N, b: N) -> N:
            return codes.saturated(o.call(rounded, name, o.product(name, a, b), bits - 1))

        root_half = o.const(round(2**bits * math.sqrt(0.5)))
        alpha = o.let("inclined_alpha", doubled("frame: 0", flux.alpha, steep))
        beta = o.let("inclined_beta", doubled("frame: 0", flux.beta, steep))
        down = codes.saturated(o.call(code_product, width, "frame: 0", full_plane, root_half))
        return (
            Vector(
                doubled("frame: d", across.alpha, longer),
                doubled("frame: d", across.beta, longer),
                none,
            ),
            flux,
            # sqrt 2 times, as twice the product with its half.
            Vector(
                doubled("frame: 0", alpha, root_half),
                doubled("frame: 0", beta, root_half),
                o.negative(down),
            ),
        )

    def frame_errors(
        self, o: Arithmetic[N, Any], flux: Vector[N], error: Vector[N]
    ) -> Annotated[tuple[N, N, N], Filling("seen")]:
        """Errors on the axes of the frame."""
        width, name = self.control.width, "frame: error"
        axes = o.let("axes", o.call(self.frame, flux))

        def seen(k: Any) -> N:
            axis: Vector[N] = o.at(axes, k)
            along, side, none = (
                o.shifted(o.product(name, x, y), 2) for x, y in zip(axis, error, strict=True)
            )
            none = o.let("zero", none)
            total = o.total(name, along, side, none, none)
            return o.call(saturated, width, o.call(rounded, name, total, width - 3))

        a, b, c = o.each("seen", 3, seen)
        return a, b, c

    def frame_voltage(
        self, o: Arithmetic[N, Any], flux: Vector[N], held: tuple[N, N, N]
    ) -> Vector[N]:
        """Voltage of what the integrators hold on the axes of the frame."""
        control, width, bits = self.control, self.control.width, self.control.width - 1
        squares = [o.shifted(o.product("frame: square", x, x), bits) for x in flux[:2]]
        if control.frame == "dqy":
            none = o.shifted(o.product("frame: square", flux.zero, flux.zero), bits)
            squares += [o.let("upright", none)] * 2
        total, least = o.total("frame: square", *squares), control.least_square
        square = o.let("square", o.call(bounded, total, least, 4 << bits))
        axes = o.let("axes", o.call(self.frame, flux))
        name, sums = "frame: voltage", _Sums(*[o.const(0)] * 3)

        def add(k: Any) -> None:
            axis: Vector[N] = o.at(axes, k)
            whole = o.product("frame: I", o.at(held, k), o.const(1 << (bits - 1)))
            ratio = o.quotient("frame: I / |f|^2", whole, square)
            part = o.let("part", o.call(saturated, width, ratio))
            sums.alpha = o.total(name, sums.alpha, o.shifted(o.product(name, part, axis.alpha), 1))
            sums.beta = o.total(name, sums.beta, o.shifted(o.product(name, part, axis.beta), 1))
            sums.zero = o.total(name, sums.zero, o.shifted(o.product(name, part, axis.zero), 1))

        o.repeated(sums, 3, add)
        found = (o.call(rounded, name, x, bits - 2) for x in (sums.alpha, sums.beta, sums.zero))
        return Vector(*(o.call(saturated, width, x) for x in found))


@dataclass(frozen=True, slots=True)
class PhaseSteps:
    """The control functions of one header."""

    control: FixedPhaseControl

    @property
    def references(self) -> ReferenceSteps:
        """References and flux."""
        return ReferenceSteps(self.control)

    @property
    def harmonics(self) -> HarmonicSteps:
        """Integrators that turn with harmonics."""
        return HarmonicSteps(self.control)

    @property
    def frames(self) -> FrameSteps:
        """Integrators along the flux."""
        return FrameSteps(self.control)

    @property
    def legs(self) -> LegSteps:
        """Voltages and duty cycles of the legs."""
        return LegSteps(self.control)

    def _flux(self, o: Arithmetic[N, Any], name: str, shape: Shape, theta: N) -> Vector[N]:
        """Flux of the machine at an angle."""
        steps = self.references
        flux = o.let(f"{name}_phases", o.call(steps.flux, shape, theta))
        return o.let(name, o.call(steps.flux_vector, flux))

    def _feedforward(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        omega: N,
        currents: tuple[Vector[N], Vector[N]],
        flux: Vector[N],
        error: Vector[N],
    ) -> Vector[N]:
        """Voltage of the references: resistance, inductance, back-EMF; and that of the error."""
        found = []
        for place, axis in enumerate(axes_of(gains)):
            if axis is None:
                found.append(o.const(0))
                continue
            terms = [o.const(0)]
            if self.control.feedforward != "none":
                turning = o.call(code_product, self.control.width, "omega f", omega, flux[place])
                terms = [o.call(scaled, "back-EMF", gains.back_emf, turning)]
            if self.control.feedforward == "references":
                now, then = (x[place] for x in currents)
                rise = o.total("reference: rise", then, o.negative(now))
                terms.append(o.call(scaled, "L di", axis.inductance, rise))
                mean = o.shifted(o.total("reference: mean", now, then), 1)
                terms.append(o.call(scaled, "R i", axis.resistance, mean))
            fed = o.total("feedforward", *terms)
            found.append(o.total("voltage", fed, o.call(scaled, "kp e", axis.kp, error[place])))
        return Vector(*found)

    def _held(
        self, o: Arithmetic[N, Any], gains: ControlGains, integral: tuple[N, N, N]
    ) -> tuple[N, N, N]:
        """What the integrals hold, in codes."""
        width = self.control.width
        d, q, upright = (
            o.const(0)
            if axis is None
            else o.call(saturated, width, o.call(rounded, "integral", x, axis.fraction))
            for x, axis in zip(integral, axes_of(gains), strict=True)
        )
        return d, q, upright

    def _integrals(
        self, o: Arithmetic[N, Any], gains: ControlGains, state: Control[N], seen: tuple[N, ...]
    ) -> None:
        """The integrals after a sample."""
        found = []
        for old, axis, error in zip(state.integral, axes_of(gains), seen, strict=True):
            if axis is None:
                found.append(old)
                continue
            step = o.call(scaled, "ki e", axis.ki, error)
            most = o.const(self.control.top << axis.fraction)
            found.append(o.within(o.total("integral + ki e", old, step), most))
        state.integral = (found[0], found[1], found[2])

    def _currents(
        self,
        o: Arithmetic[N, Any],
        given: tuple[ControlGains, Control[N], Measured[N]],
        torque: N,
        constant: Dq[N],
        turned: N,
    ) -> tuple[Vector[N], Vector[N], Vector[N]]:
        """References now, and, where they are fed forward, at the next sample and after it."""
        gains, state, measured = given
        steps, width = self.references, self.control.width

        def named(name: str, theta: N) -> Vector[N]:
            found = o.call(steps.reference, gains, state, measured, theta, torque, constant)
            return o.let(name, found)

        now = named("now", measured.theta)
        if self.control.feedforward != "references":
            return now, now, now
        then = named("then", o.call(ahead, width, "angle: next", measured.theta, turned))
        double, name = o.total("angle: after next", turned, turned), "angle: after next"
        return now, then, named("after", o.call(ahead, width, name, measured.theta, double))

    def _error(self, o: Arithmetic[N, Any], i: Abc[N], wanted: Vector[N]) -> Vector[N]:
        """What the currents lack of their reference."""
        width = self.control.width
        current = o.let("current", o.call(code_clarke, width, i))
        mean = o.call(zero, width, i) if self.control.has_zero else o.const(0)
        error = Vector(
            o.total("error", wanted.alpha, o.negative(current.x)),
            o.total("error", wanted.beta, o.negative(current.y)),
            o.total("error", wanted.zero, o.negative(mean)),
        )
        return o.let("error", error)

    def _integrated(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        acting: N,
        flux: Vector[N],
    ) -> Vector[N]:
        """Voltage of the integrals, at the angle at which it acts."""
        width, held = self.control.width, self._held(o, gains, state.integral)
        if self.control.framed:
            kept = o.let("held", held)
            return o.let("integrated", o.call(self.frames.frame_voltage, flux, kept))
        turn = o.call(rotation, width, o.call(self.references.electrical, acting))
        turn, pair = o.let("turn", turn), o.let("held", Dq(held[0], held[1]))
        plain = o.let("integrated", o.call(code_park_inverse, width, pair, turn))
        return Vector(plain.x, plain.y, held[2])

    def shaped_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        torque: Coded[N],
        constant: Dq[N],
    ) -> Any:
        """One sample: duty cycles that act from the next sampling instant on, for one period;
        torque and constant dq currents as codes.
        """
        control, width, legs = self.control, self.control.width, self.legs
        codes, theta, omega = Codes(o, width), measured.theta, measured.omega_m
        v_dc = o.let("v_dc", o.call(bounded, measured.v_dc, control.dc_least, control.top))
        turned = o.let("turned", o.call(scaled, "angle: sample", gains.sample, omega))
        half = o.shifted(turned, 1)
        middle = o.let("middle", o.total("angle: 1.5 samples", turned, half))
        acting = o.let("acting", o.call(ahead, width, "angle: acting", theta, middle))
        given = gains, state, measured
        now, then, after = self._currents(o, given, torque, constant, turned)
        error = self._error(o, measured.i, now)
        plane = AlphaBeta(codes.saturated(error.alpha), codes.saturated(error.beta))
        plane, upright = o.let("plane", plane), o.const(0)
        if control.has_zero:
            upright = o.let("upright", codes.saturated(error.zero))
        flux, electrical = now, theta
        if control.framed or control.feedforward != "none":
            flux = self._flux(o, "flux", gains.shape, acting)
        if control.harmonics or not control.framed:
            electrical = o.let("electrical", o.call(self.references.electrical, theta))
        fed = self._feedforward(o, gains, omega, (then, after), flux, error)
        held = self._integrated(o, gains, state, acting, flux)
        asked = o.let("v_held", added(o, o.let("v_fed", fed), held))
        turning, asked = self._turning(o, gains, state, omega, (electrical, middle), asked)
        coarse = Vector(*(codes.saturated(o.shifted(x, COARSE)) for x in asked))
        coarse = o.let("coarse", coarse)
        most = legs.link(o, v_dc, measured.v_m)
        share = o.let("share", o.call(legs.fitting, coarse, most))
        v = o.let("v", o.call(legs.shortened, asked, coarse, share))
        seen = self._seen(o, gains, theta, electrical, (plane, upright))
        whole = o.above(share, o.const(control.top))
        where(o, whole, lambda: self._integrals(o, gains, state, seen), state)
        if control.harmonics:
            size = o.total("harmonic: sum of errors", *(o.call(magnitude, x) for x in error))
            small = o.at_least(o.const(control.error_max), size)
            whole = o.above(share, o.const(control.top))
            where(
                o,
                o.every(whole, small),
                lambda: self._learn(o, state, turning, plane, upright),
                state,
                *state.harmonic,
            )
        state.v, state.reference = v, now
        last = () if measured.v_m is None else (measured.v_m,)
        return o.call(legs.duties, v, v_dc, *last)

    def _seen(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        theta: N,
        electrical: N,
        error: tuple[AlphaBeta[N], N],
    ) -> tuple[N, N, N]:
        """Errors on the axes of the frame."""
        plane, upright = error
        if self.control.framed:
            here = self._flux(o, "here", gains.shape, theta)
            near = o.let("near", Vector(plane.x, plane.y, upright))
            return o.let("seen", o.call(self.frames.frame_errors, here, near))
        rotor = o.let("rotor", o.call(rotation, self.control.width, electrical))
        pair = o.let("seen", o.call(code_park, self.control.width, plane, rotor))
        return pair.x, pair.y, upright

    def _turning(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        omega: N,
        angles: tuple[N, N],
        v: Vector[N],
    ) -> tuple[list[tuple[Rotation[N], N]], Vector[N]]:
        """Directions and weights of the integrators that turn with harmonics, and the voltage with
        theirs.

        ``angles`` are the electrical angle, and that by which the drive turns in 1.5 samples.
        """
        width, steps, found = self.control.width, self.harmonics, []
        if not self.control.harmonics:
            return [], v
        turn = o.call(self.references.electrical, o.wrapped(angles[1], width))
        turn = o.let("turn_e", turn)
        for k, (part, held) in enumerate(zip(self.control.harmonics, state.harmonic, strict=True)):
            order = o.const(part.order)
            fade = o.let(f"fade_{k}", part.fade)
            reactance = o.let(f"reactance_{k}", part.reactance)
            now = o.call(rotation, width, o.call(multiple, width, angles[0], order))
            now = o.let(f"at_{k}", now)
            then = o.call(rotation, width, o.call(multiple, width, turn, order))
            then = o.let(f"turn_{k}", then)
            weight = o.let(f"weight_{k}", o.call(steps.weight, fade, o.const(part.end), omega))
            axis = gains.zero if part.zero and gains.zero is not None else gains.q
            made = o.call(
                steps.harmonic_voltage, axis, reactance, weight, held, now, then, omega, order
            )
            made = o.let(f"made_{k}", made)
            none = o.const(0)
            own = Vector(none, none, made.x) if part.zero else Vector(made.x, made.y, none)
            v = o.let(f"v_{k}", added(o, v, own))
            found.append((now, weight))
        return found, v

    def _learn(
        self,
        o: Arithmetic[N, Any],
        state: Control[N],
        turning: list[tuple[Rotation[N], N]],
        plane: AlphaBeta[N],
        none: N,
    ) -> None:
        """The integrators that turn with harmonics after a sample."""
        parts, update, single = self.control.harmonics, self.harmonics.harmonic_update, plane
        if any(part.zero for part in parts):
            single = o.let("single", AlphaBeta(none, o.const(0)))
        for part, held, (now, weight) in zip(parts, state.harmonic, turning, strict=True):
            o.call(update, held, weight, single if part.zero else plane, now)

    def current_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        reference: Dq[N],
    ) -> Any:
        """Duty cycles for constant dq currents, without a torque over the shape."""
        return o.call(self.shaped_control, gains, state, measured, o.const(0), reference)

    def torque_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        torque: Coded[N],
    ) -> Any:
        """Duty cycles for a torque."""
        none = o.const(0)
        state.torque = torque
        if self.control.frame == "dq":
            asked = o.let("sinusoids", o.call(self.references.sinusoids, gains, torque))
            return o.call(self.shaped_control, gains, state, measured, none, asked)
        constant = o.let("none", Dq(none, none))
        return o.call(self.shaped_control, gains, state, measured, torque, constant)

    def speed_control(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        speed_reference: Coded[N],
    ) -> Any:
        """Speed and current control: duty cycles for the next period."""
        width, omega = self.control.width, measured.omega_m
        torque = o.call(speed_loop, width, gains, state, omega, speed_reference)
        return o.call(self.torque_control, gains, state, measured, o.let("torque", torque))
