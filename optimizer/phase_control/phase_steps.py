"""The control of phase machines: one step of all controllers, and what starts them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, Reals
from dqforge.optimizer.float_control.duties import Duties
from dqforge.optimizer.float_control.records import UNKNOWN
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.phase_control.leg_duties import ThreeLegs, legs_of
from dqforge.optimizer.phase_control.phase_records import (
    Alphabetazero,
    Control,
    ControlGains,
    Measured,
    Multiples,
    Structure,
)
from dqforge.optimizer.phase_control.shape_frame import Frame, RotorFrame, shape_frame
from dqforge.optimizer.phase_control.shape_references import (
    ShapeSteps,
    WaveformSteps,
    balanced,
    linkage,
    mean_of_phases,
    reference_at,
    turning_reference,
)
from dqforge.optimizer.phase_control.torque_limits import LimitedSteps, LimitSteps, TorqueSteps
from dqforge.optimizer.steps.angle_functions import FAR, small_rotation, turned
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, Dq, Rotation, where

Numbers = Callable[..., Iterable[Any]]  # From numbers to the numbers of a vector.


def reset_integrals(o: Arithmetic, state: Control) -> None:
    """All integrals to nothing."""
    none = o.full(0.0, state.v_0)
    state.d.integral = state.q.integral = none
    if state.zero is not None:
        state.zero.integral = none
    rest = AlphaBeta(none, none)

    def in_plane(n: Any) -> None:
        state.harmonic = o.with_item(state.harmonic, n, rest)

    def of_zero(n: Any) -> None:
        state.harmonic_zero = o.with_item(state.harmonic_zero, n, rest)

    if state.harmonic:
        o.repeated(None, len(state.harmonic), in_plane)
    if state.harmonic_zero:
        o.repeated(None, len(state.harmonic_zero), of_zero)


def control_start(o: Arithmetic, state: Control) -> None:
    """Everything at rest: no torque, no voltage, no phase open. Call it before the first sample and
    after every pulse lock.
    """
    o.call(reset_integrals, state)
    none = o.full(0.0, state.v_0)
    state.speed.integral = none
    state.reference, state.v = Dq(none, none), AlphaBeta(none, none)
    state.v_0 = state.omega_m = state.torque = none
    state.count = o.full(0, state.count)
    if state.held is not None:
        state.held = Dq(none, none)
    if state.open is not None:
        state.open = o.full(0, state.open)


def open_phase(o: Arithmetic, state: Control, phase: Reals) -> None:
    """Phase 1 to 3 (a to c) carries no current from now on, 0: all do again. The other two make the
    torque, with up to twice the current; what the integrals hold belongs to three phases and is
    forgotten.
    """
    state.open = o.choose(phase > 3, o.full(0, phase), phase)
    o.call(reset_integrals, state)


def harmonic_share(o: Arithmetic, gains: ControlGains, order: Reals, omega_e: Reals) -> Reals:
    """Share of a harmonic at an electrical speed in rad/s: 1 up to four fifths of the highest
    frequency, 0 beyond it.
    """
    assert gains.harmonic_fade is not None
    share = o.let("share", 5.0 - (gains.harmonic_fade * o.magnitude(order * omega_e)))
    none, all_ = o.full(0.0, share), o.full(1.0, share)
    return o.choose(share > 1.0, all_, o.choose(share > 0.0, share, none))


def harmonic_gain(
    o: Arithmetic,  # noqa: ARG001
    kp: Reals,
    r_s: Reals,
    reactance: Reals,
    now: Rotation,
    acting: Rotation,
) -> AlphaBeta:
    """What turns an integral of an order into its voltage in V/A: the controller now, the machine
    where the voltage acts.
    """
    return AlphaBeta(
        (kp * now.cosine) + ((r_s * acting.cosine) - (reactance * acting.sine)),
        (kp * now.sine) + ((r_s * acting.sine) + (reactance * acting.cosine)),
    )


@dataclass(slots=True)
class _PlaneSums:
    """Voltages in V, to which those of the integrals are added one after the other."""

    alpha: Reals
    beta: Reals


@dataclass(slots=True)
class _ZeroSum:
    """A zero sequence in V, as `_PlaneSums`."""

    zero: Reals


@dataclass(frozen=True, slots=True)
class HarmonicSteps:
    """The integrators of one header.

    Args:
        plane, zero: Their orders in alpha and beta, signed, and of the zero sequence.
    """

    plane: tuple[int, ...]
    zero: tuple[int, ...]

    @property
    def ascending(self) -> tuple[int, ...]:
        """Multiples of the angle that they need."""
        return tuple(sorted({abs(order) for order in (*self.plane, *self.zero)}))

    def blank(self, like: Rotation) -> Multiples:
        """Rotations that `multiples` will give their numbers."""
        return Multiples(
            (like,) * len(self.plane) if self.plane else None,
            (like,) * len(self.zero) if self.zero else None,
        )

    def multiples(self, o: Arithmetic, turn: Rotation, multiple: Multiples) -> None:
        """Rotations by the multiples of an angle that the integrators turn with."""
        found, reached = {1: turn}, 1
        steps = {1: turn}
        if any(b - a > 1 for a, b in zip((1, *self.ascending), self.ascending, strict=False)):
            steps[2] = o.let("twice", o.call(turned, turn, turn))
        for order in self.ascending:
            while reached < order:
                step = min(order - reached, 2)
                before = found[reached]
                reached += step
                found[reached] = o.let(f"turn_{reached}", o.call(turned, before, steps[step]))
        if multiple.plane is not None:
            signed = (found[abs(order)] for order in self.plane)
            multiple.plane = tuple(
                turn if order > 0 else Rotation(turn.cosine, -turn.sine)
                for order, turn in zip(self.plane, signed, strict=True)
            )
        if multiple.zero is not None:
            multiple.zero = tuple(found[order] for order in self.zero)

    def harmonic_voltage(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        omega_e: Reals,
        now: Multiples,
        acting: Multiples,
        v: Alphabetazero,
    ) -> Alphabetazero:
        """Adds the voltages in V of all integrals; now and acting: multiples of the angles of the
        sample and of the voltage.
        """
        alpha, beta, zero = v
        if now.plane is not None and acting.plane is not None:
            kp = o.let("kp", 0.5 * (gains.d.kp + gains.q.kp))
            inductance = o.let("inductance", 0.5 * (gains.l_d + gains.l_q))
            sums = _PlaneSums(alpha, beta)
            seen, made = now.plane, acting.plane
            orders = o.table("plane_order", self.plane)

            def in_plane(n: Any) -> None:
                order = o.let("order", o.at(orders, n))
                share = o.let("share", o.call(harmonic_share, gains, order, omega_e))
                r: Any = o.let("r", o.at(state.harmonic, n))
                reactance = (order * omega_e) * inductance
                turns: Any = o.at(seen, n), o.at(made, n)
                gain = o.let("gain", o.call(harmonic_gain, kp, gains.r_s, reactance, *turns))
                sums.alpha = sums.alpha + (share * ((r.alpha * gain.alpha) - (r.beta * gain.beta)))
                sums.beta = sums.beta + (share * ((r.alpha * gain.beta) + (r.beta * gain.alpha)))

            o.repeated(sums, len(self.plane), in_plane)
            alpha, beta = sums.alpha, sums.beta
        if now.zero is not None and acting.zero is not None:
            total = _ZeroSum(zero)
            seen_0, made_0 = now.zero, acting.zero
            orders_0 = o.table("zero_order", self.zero)

            def of_zero(n: Any) -> None:
                order = o.let("order", o.at(orders_0, n))
                share = o.let("share", o.call(harmonic_share, gains, order, omega_e))
                r: Any = o.let("r", o.at(state.harmonic_zero, n))
                reactance = (order * omega_e) * gains.l_0
                turns: Any = o.at(seen_0, n), o.at(made_0, n)
                own = o.call(harmonic_gain, gains.zero.kp, gains.r_s, reactance, *turns)
                gain = o.let("gain", own)
                total.zero = total.zero + (share * ((r.alpha * gain.alpha) - (r.beta * gain.beta)))

            o.repeated(total, len(self.zero), of_zero)
            zero = total.zero
        return Alphabetazero(alpha, beta, zero)

    def harmonic_update(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        omega_e: Reals,
        now: Multiples,
        error: Alphabetazero,
    ) -> None:
        """The step of all integrals for errors in A."""
        if now.plane is not None:
            seen = now.plane
            orders = o.table("plane_order", self.plane)

            def in_plane(n: Any) -> None:
                turn: Any = o.let("turn", o.at(seen, n))
                rate = self._rate(o, gains, o.at(orders, n), omega_e)
                r: Any = o.let("r", o.at(state.harmonic, n))
                along = (error.alpha * turn.cosine) + (error.beta * turn.sine)
                across = (error.beta * turn.cosine) - (error.alpha * turn.sine)
                grown = AlphaBeta(r.alpha + (rate * along), r.beta + (rate * across))
                state.harmonic = o.with_item(state.harmonic, n, grown)

            o.repeated(None, len(self.plane), in_plane)
        if now.zero is not None:
            seen_0 = now.zero
            orders_0 = o.table("zero_order", self.zero)

            def of_zero(n: Any) -> None:
                turn: Any = o.let("turn", o.at(seen_0, n))
                rate = self._rate(o, gains, o.at(orders_0, n), omega_e)
                r: Any = o.let("r", o.at(state.harmonic_zero, n))
                alpha = r.alpha + (rate * (error.zero * turn.cosine))
                grown = AlphaBeta(alpha, r.beta - (rate * (error.zero * turn.sine)))
                state.harmonic_zero = o.with_item(state.harmonic_zero, n, grown)

            o.repeated(None, len(self.zero), of_zero)

    def _rate(self, o: Arithmetic, gains: ControlGains, order: Reals, omega_e: Reals) -> Reals:
        assert gains.harmonic_rate is not None
        share = o.call(harmonic_share, gains, order, omega_e)
        return o.let("rate", gains.harmonic_rate * share)


@dataclass(frozen=True, slots=True)
class _Sample:
    """What a step knows of its sample: speed, angles now, at the next samples and where the voltage
    acts, places in the table of the shape, the shape at both, currents, and shares of the
    references.
    """

    omega_e: Reals
    turns: dict[str, Rotation]
    place: Any = None
    step: Any = None
    acting_f: Any = None
    f: Any = None
    fade: Any = None
    zero: Any = None
    balance: Any = None
    beyond: Any = None


@dataclass(frozen=True, slots=True)
class PhaseSteps:
    """The control functions of one header.

    Args:
        made: What stands in the code.
        shape: Reading of the back-EMF.
        limits: The torque within its limits.
        currents: Current references in A of a torque in N m, where they are constant in rotor
            coordinates.
        waveform: Phase currents in A of a torque in N m and the sine and cosine of the angle, where
            the references are theirs.
    """

    made: Structure
    shape: ShapeSteps
    limits: TorqueSteps
    currents: Numbers | None = None
    waveform: Numbers | None = None

    def control_step(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        measured: Measured,
        reference: Dq,
        torque: Reals,
    ) -> Any:
        """One step of all current controllers: duty cycles for the next period from the samples of
        this instant, with references in A and a torque in N m. Where they follow the back-EMF, d is
        added to those that make the torque. A voltage beyond the limit is shortened along its
        direction, and all integrals rest. A sample that is not a number makes no voltage and leaves
        the integrals as they are.
        """
        made = self.made
        sample = self._sample(o, gains, state, measured, torque)
        current = o.let("current", o.clarke(measured.i))

        def wanted(name: str, at: str, place: Any) -> Alphabetazero:
            return self._wanted(o, name, gains, state, sample, place, at, reference, torque)

        first = wanted("wanted", "now", sample.place)
        none = o.full(0.0, sample.omega_e)
        common = none
        if made.neutral:
            common = o.let("current_0", mean_of_phases(measured.i))
        error_0 = first.zero - common if made.neutral else none
        error = Alphabetazero(first.alpha - current.alpha, first.beta - current.beta, error_0)
        error = o.let("error", error)
        v, integral = self._controllers(o, gains, state, sample, error)
        if made.feedforward != "none":
            v = self._with_emf(o, sample, v)
        if made.feedforward == "references":
            coming = wanted("coming", "next", sample.place + sample.step)
            later = wanted("later", "last", sample.place + (2.0 * sample.step))
            v = self._with_references(o, gains, sample, v, (coming, later))
        elif made.feedforward == "measured":
            v = self._with_coupling(o, gains, state, sample, v, current, common)
        turning = HarmonicSteps(made.plane, made.zero)
        multiple, acting = self._multiples(o, turning, sample)
        if made.multiples:
            more = (gains, state, sample.omega_e, multiple, acting, v)
            v = o.let("v_whole", o.call(turning.harmonic_voltage, *more))
        legs, link = legs_of(made.topology, made.modulation), self._link(measured)
        flat = o.magnitude(v.alpha) + o.magnitude(v.beta)
        size = o.let("size", flat + o.magnitude(v.zero))
        share = o.let("share", o.call(legs.voltage_share, v, gains.voltage_share, *link))

        def learn() -> None:
            o.call(turning.harmonic_update, gains, state, sample.omega_e, multiple, error)

        def within() -> Alphabetazero:
            state.d.integral, state.q.integral = integral[0], integral[1]
            if state.zero is not None:
                state.zero.integral = integral[2]
            if made.multiples:
                far = o.magnitude(error.alpha) + o.magnitude(error.beta)
                near = far + o.magnitude(error.zero) <= gains.harmonic_error_max
                where(o, near, learn, state)
            return v

        def known() -> Alphabetazero:
            def cut() -> Alphabetazero:
                return Alphabetazero(share * v.alpha, share * v.beta, share * v.zero)

            return o.cases("limited", (share >= 1.0, within), otherwise=cut, changing=(state,))

        is_known = (
            (size < UNKNOWN)
            & (share >= 0.0)
            & (o.magnitude(measured.theta_e) < FAR)
            & (o.magnitude(sample.omega_e) < UNKNOWN)
        )
        given = o.cases(
            "given",
            (is_known, known),
            otherwise=lambda: Alphabetazero(none, none, none),
            changing=(state,),
        )
        plane = AlphaBeta(given.alpha, given.beta)
        if isinstance(legs, ThreeLegs):
            plane = o.let("plane", plane)
        state.reference, state.v, state.v_0 = reference, plane, given.zero
        if isinstance(legs, ThreeLegs):
            return o.call(Duties(made.modulation).duties, plane, measured.v_dc, current)
        return o.call(legs.duties, given, *link)

    def _link(self, measured: Measured) -> Any:
        if measured.v_m is None:
            return (measured.v_dc,)
        return (measured.v_dc, measured.v_m)

    def _opened(self, state: Control) -> Any:
        return () if state.open is None else (state.open,)

    def _sample(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, torque: Reals
    ) -> _Sample:
        made = self.made
        omega_e = o.let("omega_e", gains.pole_pairs * measured.omega_m)
        sample = _Sample(omega_e, self._turns(o, gains, measured, omega_e))
        opened = self._opened(state)
        if made.shaped:
            theta = measured.theta_e
            theta = o.wrap(theta) if made.turns == 1 else theta
            sample = replace(sample, place=o.let("place", theta * self.made.per_rad))
        if made.acts:
            step = o.let("step", (omega_e * gains.t_s) * self.made.per_rad)
            found = o.call(
                self.shape.shape_at, gains.shape, sample.place + (CURRENT_DELAY * step), *opened
            )
            sample = replace(sample, step=step, acting_f=o.let("acting_f", found))
        if made.follows:
            found = o.call(self.shape.shape_at, gains.shape, sample.place, *opened)
            sample = replace(sample, f=o.let("f", found))
        if made.proportional:
            sample = replace(sample, fade=self._fade(o, gains, state, omega_e))
        sample = replace(sample, zero=self._zero_share(o, gains, state, omega_e))
        if self.limits.limited is not None:
            place = self.limits.limited.limited_place
            at = o.call(place, torque, omega_e, measured.v_dc, *opened)
            sample = replace(sample, beyond=o.let("beyond", at))
        if measured.v_m is not None:
            assert gains.balance is not None
            off = measured.v_m - (0.5 * measured.v_dc)
            sample = replace(sample, balance=o.let("balance", gains.balance * off))
        return sample

    def _turns(
        self, o: Arithmetic, gains: ControlGains, measured: Measured, omega_e: Reals
    ) -> dict[str, Rotation]:
        turns = {"now": o.let("now", Rotation(*o.rotation(measured.theta_e)))}
        if not self.made.turning:
            return turns
        half = o.let("half", o.call(small_rotation, 0.5 * (omega_e * gains.t_s)))
        before = turns["now"]
        for name in ("middle", "next", "acting", "last"):
            if name == "last" and self.made.feedforward != "references":
                break
            turns[name] = before = o.let(name, o.call(turned, before, half))
        return turns

    def _multiples(
        self, o: Arithmetic, turning: HarmonicSteps, sample: _Sample
    ) -> tuple[Multiples, Multiples]:
        """Rotations of the integrators now and where the voltage acts."""
        now = sample.turns["now"]
        if not self.made.multiples:
            return turning.blank(now), turning.blank(now)
        acting = sample.turns["acting"]
        seen = o.local("now_multiple", turning.blank(now))
        made = o.local("acting_multiple", turning.blank(acting))
        o.call(turning.multiples, now, seen)
        o.call(turning.multiples, acting, made)
        return seen, made

    def _fade(self, o: Arithmetic, gains: ControlGains, state: Control, omega_e: Reals) -> Reals:
        """Share of the shape beside its fundamental."""
        faded = o.let("faded", gains.fade_end - (gains.fade * o.magnitude(omega_e)))
        none, one = o.full(0.0, faded), o.full(1.0, faded)
        fade = o.choose(faded > 1.0, one, o.choose(faded > 0.0, faded, none))
        if state.open is None:
            return o.let("fade", fade)
        return o.let("fade", o.choose(state.open > 0, one, o.let("whole_fade", fade)))

    def _zero_share(
        self, o: Arithmetic, gains: ControlGains, state: Control, omega_e: Reals
    ) -> Any:
        """Share of the zero sequence of the shape in the references."""
        none, one = o.full(0.0, omega_e), o.full(1.0, omega_e)
        if not self.made.has_balance_share:
            return one if self.made.neutral else none
        assert state.open is not None
        if self.made.frame == "dqx":
            return o.let("zero", o.choose(state.open > 0, one, none))
        assert gains.zero_fade is not None
        share = o.let("zero_share", gains.zero_fade * o.magnitude(omega_e))
        unless = o.choose(state.open > 0, one, share)
        return o.let("zero", o.choose(share > 1.0, one, unless))

    def _wanted(
        self,
        o: Arithmetic,
        name: str,
        gains: ControlGains,
        state: Control,
        sample: _Sample,
        place: Any,
        at: str,
        reference: Dq,
        torque: Reals,
    ) -> Alphabetazero:
        """Currents in A that belong to an angle."""
        made, turn, opened = self.made, sample.turns[at], self._opened(state)
        where = place
        reads = made.proportional or made.neutral or self.limits.limited is not None
        if reads and place is not sample.place:
            where = o.let(f"{name}_place", place)

        def shape(own: str = "") -> Alphabetazero:
            if sample.f is not None and where is sample.place:
                found: Alphabetazero = sample.f
                return found
            read = o.call(self.shape.shape_at, gains.shape, where, *opened)
            return o.let(own or f"{name}_f", read)

        def proportional(f: Alphabetazero, d: Any, fade: Any, zero: Any) -> Alphabetazero:
            return o.call(reference_at, gains, f, turn, torque, d, fade, zero)

        def usual() -> Alphabetazero:
            if self.waveform is None:
                return o.call(turning_reference, reference, turn)
            steps = WaveformSteps(self.waveform)
            return o.call(steps.waveform_reference, turn, torque, reference.d, sample.zero)

        f = shape() if made.proportional or made.midpoint else None

        def without() -> Alphabetazero:
            none, one = o.full(0.0, sample.omega_e), o.full(1.0, sample.omega_e)
            return proportional(shape("whole") if f is None else f, none, one, one)

        if made.proportional:
            assert f is not None
            i = o.let(name, proportional(f, reference.d, sample.fade, sample.zero))
        elif state.open is not None:
            i = o.cases(name, (state.open > 0, without), otherwise=usual)
        else:
            i = o.let(name, usual())
        if self.limits.limited is not None:
            beyond = self.limits.limited
            moved = o.call(beyond.deviated, beyond.table, i, sample.beyond, where)
            i = o.let(f"{name}_beyond", moved)
        if made.midpoint:
            assert state.open is not None
            assert f is not None
            i = o.let(f"{name}_balanced", o.call(balanced, i, f, sample.balance, state.open))
        return i

    def _controllers(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        sample: _Sample,
        error: Alphabetazero,
    ) -> tuple[Alphabetazero, tuple[Any, Any, Any]]:
        """Voltages of the PI controllers, and their integrals after this sample."""
        frame, none = shape_frame(self.made.frame), o.full(0.0, sample.omega_e)
        now = sample.turns["now"]
        o.remark("The gains as they are now, the integrals where the voltage acts.")
        seen = o.let("error_plane", AlphaBeta(error.alpha, error.beta))
        turned_error = o.let("turned_error", o.park(seen, now))
        integral_0: Any = none
        if frame is not None:
            along = o.call(frame.to_frame, sample.f, error, gains.psi_pm)
            along = o.let("error_along", along)
            if state.zero is not None:
                integral_0 = state.zero.integral + (gains.zero.ki_ts * along.zero)
            integral = Frame(
                state.d.integral + (gains.d.ki_ts * along.d),
                state.q.integral + (gains.q.ki_ts * along.q),
                integral_0,
            )
            inside = o.let("integral", integral)
            back = o.call(frame.from_frame, sample.acting_f, inside, gains.psi_pm)
            kept: Any = o.let("kept", back)
            integrals = inside.d, inside.q, inside.zero
        else:
            turning = Dq(
                state.d.integral + (gains.d.ki_ts * turned_error.d),
                state.q.integral + (gains.q.ki_ts * turned_error.q),
            )
            own = o.let("integral", turning)
            plane = o.let("kept", o.park_inverse(own, sample.turns["acting"]))
            if state.zero is not None:
                integral_0 = state.zero.integral + (gains.zero.ki_ts * error.zero)
                integral_0 = o.let("integral_0", integral_0)
            kept = Alphabetazero(plane.alpha, plane.beta, integral_0)
            integrals = own.d, own.q, integral_0
        gained = Dq(gains.d.kp * turned_error.d, gains.q.kp * turned_error.q)
        part = o.let("part", o.park_inverse(o.let("gained", gained), now))
        zero = kept.zero + (gains.zero.kp * error.zero) if self.made.neutral else none
        v = Alphabetazero(kept.alpha + part.alpha, kept.beta + part.beta, zero)
        return o.let("v_controllers", v), integrals

    def _with_emf(self, o: Arithmetic, sample: _Sample, v: Alphabetazero) -> Alphabetazero:
        f, omega_e = sample.acting_f, sample.omega_e
        zero = v.zero + (omega_e * f.zero) if self.made.neutral else v.zero
        fed = Alphabetazero(v.alpha + (omega_e * f.alpha), v.beta + (omega_e * f.beta), zero)
        return o.let("v_emf", fed)

    def _with_references(
        self,
        o: Arithmetic,
        gains: ControlGains,
        sample: _Sample,
        v: Alphabetazero,
        both: tuple[Alphabetazero, Alphabetazero],
    ) -> Alphabetazero:
        """The voltage with that of resistance and inductances for the references."""
        first, second = both
        if self.made.salient:
            before = o.let("before", o.call(linkage, gains, first, sample.turns["next"]))
            after = o.let("after", o.call(linkage, gains, second, sample.turns["last"]))
            alpha = gains.sampling * (after.alpha - before.alpha)
            beta = gains.sampling * (after.beta - before.beta)
        else:
            alpha = (gains.l_q * gains.sampling) * (second.alpha - first.alpha)
            beta = (gains.l_q * gains.sampling) * (second.beta - first.beta)
        zero = v.zero
        if self.made.neutral:
            risen = (gains.l_0 * gains.sampling) * (second.zero - first.zero)
            zero = (zero + ((0.5 * gains.r_s) * (first.zero + second.zero))) + risen
        fed = Alphabetazero(
            (v.alpha + ((0.5 * gains.r_s) * (first.alpha + second.alpha))) + alpha,
            (v.beta + ((0.5 * gains.r_s) * (first.beta + second.beta))) + beta,
            zero,
        )
        return o.let("v_fed", fed)

    def _with_coupling(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        sample: _Sample,
        v: Alphabetazero,
        current: AlphaBeta,
        common: Reals,
    ) -> Alphabetazero:
        """The voltage with that which the measured currents need, were they constant."""
        frame = shape_frame(self.made.frame)
        if frame is None:
            turned_current = o.let("turned_current", o.park(current, sample.turns["now"]))
            acting, omega_e = sample.turns["acting"], sample.omega_e
            added = o.call(RotorFrame().coupling, gains, turned_current, acting, omega_e)
        else:
            seen = o.let("seen", Alphabetazero(current.alpha, current.beta, common))
            inside = o.call(frame.to_frame, sample.f, seen, gains.psi_pm)
            inside = o.let("inside", inside)
            place = sample.place + (CURRENT_DELAY * sample.step)
            rate = o.call(self.shape.slope_at, gains.shape, place, *self._opened(state))
            slope = o.let("slope", rate)
            f, omega_e = sample.acting_f, sample.omega_e
            added = o.call(frame.coupling, gains, f, slope, inside, omega_e)
        part = o.let("coupling", added)
        zero = v.zero + part.zero if self.made.neutral and frame is not None else v.zero
        return o.let("v_fed", Alphabetazero(v.alpha + part.alpha, v.beta + part.beta, zero))

    def of_currents(
        self, o: Arithmetic, gains: ControlGains, measured: Measured, reference: Dq
    ) -> Reals:
        """The torque in N m that `control_step` takes beside references in A."""
        if not (self.made.by_torque or self.made.neutral):
            return o.full(0.0, measured.omega_m)
        torque = o.let("torque", torque_per_ampere(gains.pole_pairs, gains.psi_pm) * reference.q)
        return self._limited(o, gains, measured, torque)

    def _limited(
        self, o: Arithmetic, gains: ControlGains, measured: Measured, torque: Reals
    ) -> Reals:
        omega_e = gains.pole_pairs * measured.omega_m
        found = o.call(self.limits.limited_torque, gains, torque, omega_e, measured.v_dc)
        return o.let("limited", found)

    def of_torque(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, torque: Reals
    ) -> tuple[Dq, Reals]:
        """References in A of a torque in N m, with what its limits leave of it."""
        held, asked = state.held, torque
        if held is not None and self.made.by_torque:
            own = torque_per_ampere(gains.pole_pairs, gains.psi_pm) * held.q
            asked = o.let("asked", torque + o.let("held", own))
        limited = self._limited(o, gains, measured, asked)
        if self.made.by_torque:
            d = o.full(0.0, limited) if held is None else held.d
            q = limited / torque_per_ampere(gains.pole_pairs, gains.psi_pm)
            return o.let("reference", Dq(d, q)), limited
        assert self.currents is not None
        made = o.outside(Dq, "current_reference", self.currents, limited, filled="reference")
        if held is not None:
            made = o.let("with_held", Dq(made.d + held.d, made.q + held.q))
        return made, limited

    def current_control(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, reference: Dq
    ) -> Any:
        """Current control with a reference in A; where the references follow the back-EMF, q stands
        for the torque 3/2 p psi_pm i_q, and d is a constant current beside it.
        """
        torque = self.of_currents(o, gains, measured, reference)
        return o.call(self.control_step, gains, state, measured, reference, torque)

    def torque_control(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, torque: Reals
    ) -> Any:
        """Current control for a torque in N m."""
        reference, limited = self.of_torque(o, gains, state, measured, torque)
        state.torque = torque
        return o.call(self.control_step, gains, state, measured, reference, limited)

    def speed_control(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        measured: Measured,
        reference: Reals,
    ) -> Any:
        """Speed and current control: duty cycles for the next period."""
        loop: Any = speed_loop
        torque = o.let("torque", o.call(loop, gains, state, measured.omega_m, reference))
        return o.call(self.torque_control, gains, state, measured, torque)


def phase_steps(
    made: Structure,
    shape: Any,
    limit_at: float | None,
    limited: LimitedSteps | None,
    currents: Numbers | None,
    waveform: Numbers | None,
) -> PhaseSteps:
    """The control functions of one header.

    Args:
        made: What stands in the code.
        shape: Table of the back-EMF in Wb, shape (1 or 3, nodes + 1).
        limit_at: Link voltage in V of the speeds in the table of torques, None where they are at
            any.
        limited: Currents beyond the proportional ones, None without.
        currents, waveform: As `PhaseSteps`.
    """
    rows, nodes = np.shape(shape)[0], np.shape(shape)[1] - 1
    per_rad = float(np.float32(nodes / (2.0 * np.pi * made.turns)))
    limit = LimitSteps(limit_at) if made.torque_limit else None
    reading = ShapeSteps(nodes, rows, per_rad)
    return PhaseSteps(made, reading, TorqueSteps(limit, limited), currents, waveform)
