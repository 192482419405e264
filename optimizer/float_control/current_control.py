"""Field-oriented control: current control, and control of torque and speed around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.duties import Duties, centred_duties
from dqforge.optimizer.float_control.hexagon_step import Overmodulated
from dqforge.optimizer.float_control.records import UNKNOWN_SQUARE, Control, ControlGains, Measured
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.steps.angle_functions import small_rotation, turned
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq

# How the references of the control move: no faster than their slopes, off the voltage's end.


def torque_ramp(o: Arithmetic, gains: ControlGains, state: Control, torque: Reals) -> Reals:
    """The torque reference in N m, no faster than its slope; not-a-number asks for none."""
    assert gains.references is not None
    assert state.references is not None
    step, last = gains.references.torque_step, state.references.torque
    assert step is not None
    assert last is not None
    asked = o.let("asked", o.choose(o.is_number(torque), torque, o.full(0.0, torque)))
    high, low = o.let("high", last + step), o.let("low", last - step)
    ramped = o.choose(asked > high, high, o.choose(asked < low, low, asked))
    state.references.torque = given = o.let("given", ramped)
    return given


def weakened(o: Arithmetic, gains: ControlGains, state: Control, v_max: Reals, reference: Dq) -> Dq:
    """The current references with what the voltage lacks taken from the d current: an integrator
    whose output is 0 or below. Within the limit the q current gives way.
    """
    assert gains.references is not None
    assert state.references is not None
    moving, kept = gains.references, state.references
    limit, most, gain = moving.i_max, moving.feedback_max, moving.feedback
    assert limit is not None
    assert most is not None
    assert gain is not None
    assert kept.square is not None
    assert kept.added is not None
    lack = o.let("lack", v_max * v_max - kept.square)
    sum_ = o.let("sum", kept.added + gain * lack)
    below = o.let("below", o.choose(sum_ < 0.0, sum_, o.full(0.0, sum_)))
    added = o.let("added", o.choose(below > -most, below, -most))
    shifted = o.let("shifted", reference.d + added)
    d = o.let("d", o.choose(shifted > -limit, shifted, -limit))
    left = o.let("left", limit * limit - d * d)
    room = o.let("room", o.choose(left > 0.0, left, o.full(0.0, left)))
    kept.added = added

    def at_the_edge() -> Reals:
        edge = o.let("edge", o.root(room))
        return o.choose(reference.q < 0.0, -edge, edge)

    beyond = (added < 0.0) & (reference.q * reference.q > room)
    return Dq(d, o.cases("q", (beyond, at_the_edge), otherwise=lambda: reference.q))


def current_ramp(o: Arithmetic, gains: ControlGains, state: Control, reference: Dq) -> Dq:
    """The current references, no faster than their slope, along a straight line."""
    assert gains.references is not None
    assert state.references is not None
    assert state.references.current is not None
    step, last = gains.references.current_step, state.references.current
    assert step is not None
    d, q = o.let("d", reference.d - last.d), o.let("q", reference.q - last.q)
    square = o.let("square", d * d + q * q)

    def moved() -> Dq:
        share = o.let("share", step / o.root(square))
        return Dq(last.d + share * d, last.q + share * q)

    given = o.cases("given", (square > step * step, moved), otherwise=lambda: reference)
    state.references.current = given
    return given


# Field-oriented control: current control, and control of torque and speed around it.

Numbers = Callable[..., Iterable[Any]]  # From numbers and vectors to the numbers of a vector.


@dataclass(frozen=True, slots=True)
class ControlSteps:
    """The control functions of one header.

    Args:
        currents: Current references in A of a torque in N m and, with ``weakens``, of voltage in V
            and electrical speed in rad/s.
        modulation: The modulator.
        overmodulated: Voltage that the duty cycles make of one beyond the circle in the hexagon and
            the DC-link voltage, None where none goes beyond it.
        weakens: Whether the references weaken the field.
        reference_share: What the references have of the controllers' voltage; the rest is kept free
            for control.
    """

    currents: Numbers
    modulation: ModulationName
    overmodulated: Overmodulated | None = None
    weakens: bool = False
    reference_share: float = 1.0

    def current_control(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, reference: Dq
    ) -> Abc:
        """One step of both current controllers: duty cycles for the next period from the samples of
        this instant. A voltage beyond the limit is shortened along its direction: an axis that took
        all of it would leave the other without control. The controllers take back what was cut off.
        It is turned on by the angle that the rotor moves until it acts. A sample that is not a
        number makes no voltage and leaves the integrals as they are.
        """
        omega_e = o.let("omega_e", gains.pole_pairs * measured.omega_m)
        v_max = o.let("v_max", _room(o, gains, state, measured))
        current = o.let("current", o.clarke(measured.i))
        now = o.let("now", o.rotation(measured.theta_e))
        ahead = o.let("ahead", o.call(small_rotation, omega_e * gains.advance))
        wanted, integral = _wanted(
            o, gains, state, omega_e, reference, o.let("i", o.park(current, now))
        )
        square = o.let("square", wanted.d * wanted.d + wanted.q * wanted.q)
        kept = state.references
        if kept is not None and kept.square is not None:
            kept.square = o.choose(_known(square, v_max), square, kept.square)

        def within() -> Dq:
            state.d.integral, state.q.integral = integral
            return wanted

        def shortened() -> Dq:
            share = o.let("share", v_max / o.root(square))
            cut = o.let("cut", Dq(share * wanted.d, share * wanted.q))
            state.d.integral = integral.d + gains.d.tracking * (cut.d - wanted.d)
            state.q.integral = integral.q + gains.q.tracking * (cut.q - wanted.q)
            return cut

        v = o.cases(
            "v",
            (square - v_max * o.magnitude(v_max) <= 0.0, within),
            (_known(square, v_max), shortened),
            otherwise=lambda: Dq(o.full(0.0, square), o.full(0.0, square)),
            changing=(state,),
        )
        acting = o.let("acting", o.call(turned, now, ahead))
        voltage = o.let("voltage", o.park_inverse(v, acting))
        state.reference = reference
        state.v = made = self._made(o, state, voltage, measured.v_dc)
        if MODULATORS[self.modulation].kind == "centred" and self.overmodulated is None:
            return o.call(centred_duties, made, measured.v_dc)
        return o.call(Duties(self.modulation).duties, made, measured.v_dc, current)

    def _made(self, o: Arithmetic, state: Control, voltage: AlphaBeta, v_dc: Reals) -> AlphaBeta:
        """The voltage with what is injected, as the duty cycles make it."""
        if state.added is not None:
            alpha, beta = state.added
            with_added = AlphaBeta(voltage.alpha + alpha, voltage.beta + beta)
            voltage = o.let("with_added", with_added)
        if self.overmodulated is None:
            return voltage
        return o.let("made", o.call(self.overmodulated, voltage, v_dc))

    def torque_control(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, torque: Reals
    ) -> Abc:
        """Current control with the current references for a torque in N m."""
        moving, asked = gains.references, torque
        if moving is not None and moving.torque_step is not None:
            asked = o.let("asked", o.call(torque_ramp, gains, state, torque))
        reference = self._references(o, gains, measured, asked)
        state.torque = torque
        if moving is not None and moving.feedback is not None:
            v_max = o.let("v_all", gains.voltage_share * measured.v_dc)
            reference = o.let("weaker", o.call(weakened, gains, state, v_max, reference))
        if moving is not None and moving.current_step is not None:
            reference = o.let("ramped", o.call(current_ramp, gains, state, reference))
        if state.held is not None:
            d, q = state.held
            with_held = Dq(reference.d + d, reference.q + q)
            reference = o.let("with_held", with_held)
        return o.call(self.current_control, gains, state, measured, reference)

    def _references(
        self, o: Arithmetic, gains: ControlGains, measured: Measured, torque: Reals
    ) -> Dq:
        if not self.weakens:
            return o.outside(Dq, "current_reference", self.currents, torque, filled="reference")
        v_max = gains.voltage_share * measured.v_dc
        if self.reference_share != 1.0:
            v_max = self.reference_share * v_max
            v_max = o.let("v_max", v_max, "the rest is kept free for control")
        else:
            v_max = o.let("v_max", v_max)
        omega_e = o.let("omega_e", gains.pole_pairs * measured.omega_m)
        name = "weakening_reference"
        return o.outside(Dq, name, self.currents, torque, v_max, omega_e, filled="reference")

    def speed_control(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        measured: Measured,
        reference: Reals,
    ) -> Abc:
        """Speed and current control: duty cycles for the next period."""
        wanted = o.call(speed_loop, gains, state, measured.omega_m, reference)
        torque = o.let("torque", wanted)
        return o.call(self.torque_control, gains, state, measured, torque)


def _room(o: Arithmetic, gains: ControlGains, state: Control, measured: Measured) -> Reals:
    """Voltage in V that the controllers have: what is injected has its room within the limit."""
    v_max = gains.voltage_share * measured.v_dc
    if state.added is None:
        return v_max
    alpha, beta = state.added
    return v_max - o.let("room", o.root(alpha * alpha + beta * beta), "of what is added, V")


def _known(square: Reals, v_max: Reals) -> Any:
    return (square < UNKNOWN_SQUARE) & (v_max >= 0.0)


def _wanted(
    o: Arithmetic, gains: ControlGains, state: Control, omega_e: Reals, reference: Dq, i: Dq
) -> tuple[Dq, Dq]:
    """Voltages in V that the controllers ask for, and their integrals after this sample."""
    error_d, error_q = o.let("error_d", reference.d - i.d), o.let("error_q", reference.q - i.q)
    integral_d = o.let("integral_d", state.d.integral + gains.d.ki_ts * error_d)
    integral_q = o.let("integral_q", state.q.integral + gains.q.ki_ts * error_q)
    wanted = Dq(
        ((gains.d.kp * error_d) + integral_d) - (omega_e * (gains.l_q * i.q)),
        ((gains.q.kp * error_q) + integral_q) + (omega_e * ((gains.l_d * i.d) + gains.psi_pm)),
    )
    return o.let("wanted", wanted), Dq(integral_d, integral_q)
