"""What every phase of the start-up uses, and what it asks of control and estimators."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.names import Feedforward
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import Control, ControlGains
from dqforge.optimizer.start_up.start_records import (
    Followed,
    FollowedFromRest,
    Measured,
    Startup,
    StartupFault,
    StartupSettings,
    StartupState,
)
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq, where

# The angle of a vector over the ratio of its smaller to its larger component, odd powers from the
# first on: within 1e-5 rad from 0 to 1.
_ANGLE = (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.0117212)
_HALF_PI, _PI = 1.5707964, 3.1415927


class Neighbours:
    """Functions of other headers that the start-up calls; one who runs them says what they do.

    The control is that of any header, its references and duty cycles those of its voltages. Angles
    in rad and speeds in rad/s are electrical.
    """

    __slots__ = ()

    def control_start(self, o: Arithmetic, state: Control) -> None:
        """Everything at rest."""
        raise NotImplementedError

    def reset_integrals(self, o: Arithmetic, state: Control) -> None:
        """Integrals of a control over the angle, those of its harmonics as well."""
        raise NotImplementedError

    def current_control(
        self, o: Arithmetic, gains: ControlGains, state: Control, measured: Measured, reference: Dq
    ) -> Abc:
        """Duty cycles by current references in A."""
        raise NotImplementedError

    def speed_control(
        self,
        o: Arithmetic,
        gains: ControlGains,
        state: Control,
        measured: Measured,
        reference: Reals,
    ) -> Abc:
        """Duty cycles by a mechanical speed in rad/s."""
        raise NotImplementedError

    def duties(self, o: Arithmetic, voltage: AlphaBeta, v_dc: Reals, i: AlphaBeta) -> Abc:
        """Duty cycles of a voltage in V and currents in A."""
        raise NotImplementedError

    def currents(self, torque: Reals) -> Iterable[Any]:
        """Current references d and q in A of a torque in N m."""
        raise NotImplementedError

    def observer_start(
        self, o: Arithmetic, observer: Followed, theta_e: Reals, omega_e: Reals
    ) -> None:
        """The estimator at speed begins."""
        raise NotImplementedError

    def observer_step(
        self,
        o: Arithmetic,
        gains: Any,
        observer: Followed,
        v: AlphaBeta,
        i: AlphaBeta,
        *heard: Reals,
    ) -> None:
        """Its next sample, with what else it is told."""
        raise NotImplementedError

    def standstill_start(
        self, o: Arithmetic, low: FollowedFromRest, theta_e: Reals, omega_e: Reals
    ) -> None:
        """The estimator from standstill on begins."""
        raise NotImplementedError

    def standstill_step(
        self, o: Arithmetic, gains: Any, low: FollowedFromRest, v: AlphaBeta, i: AlphaBeta
    ) -> None:
        """Its next sample."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class StartupParts:
    """What the start-up of a design is made of.

    Args:
        around: The functions of other headers.
        hears: Whether the estimator at speed is told the sum of the phase voltages.
        feedforward: That of the control over the angle, None for field-oriented control.
        by_torque: Whether that control makes its currents of the torque.
        duty: The vector of the duty cycles.
    """

    around: Neighbours
    hears: bool = False
    feedforward: Feedforward | None = None
    by_torque: bool = False
    duty: type[Any] = Abc

    def towards(self, o: Arithmetic, value: Reals, target: Reals, step: Reals) -> Reals:
        """A value that moves towards its target by at most a step."""
        gap = o.let("gap", target - value)
        return o.choose(gap > step, value + step, o.choose(gap < -step, value - step, target))

    def angle(self, o: Arithmetic, x: AlphaBeta) -> Reals:
        """Angle of a vector in rad, -pi to pi, within 1e-5 rad; 0 of none."""
        along = o.let("along", o.magnitude(x.alpha))
        across = o.let("across", o.magnitude(x.beta))
        large = o.let("large", o.choose(across > along, across, along))
        small = o.let("small", o.choose(across > along, along, across))
        ratio = o.let("ratio", o.choose(large > 0.0, small / large, o.full(0.0, large)))
        square = o.let("square", ratio * ratio)
        value: Any = _ANGLE[-1]
        for coefficient in _ANGLE[-2::-1]:
            value = coefficient + square * value
        first = o.let("first", ratio * value)
        second = o.let("second", o.choose(across > along, _HALF_PI - first, first))
        third = o.let("third", o.choose(x.alpha < 0.0, _PI - second, second))
        return o.choose(x.beta < 0.0, -third, third)

    def enter(self, o: Arithmetic, drive: Startup, state: Any) -> None:  # noqa: ARG002
        """A new phase begins."""
        drive.state = state
        drive.time, drive.agreed, drive.late, drive.slow = 0, 0, 0, 0
        drive.settled, drive.over, drive.outside = 0, 0, 0

    def off(self, o: Arithmetic, drive: Startup, state: Any) -> None:
        """No gate pulses; the controllers are at rest."""
        zero = o.full(0.0, drive.theta_e)
        o.call(self.around.control_start, drive.control)
        drive.acted = drive.control.v
        drive.fading = 0
        drive.omega_e, drive.reference = zero, zero
        o.call(self.enter, drive, state)

    def init(self, o: Arithmetic, drive: Startup) -> None:
        """Everything at rest; call it once before the first step."""
        zero, one = o.full(0.0, drive.theta_e), o.full(1.0, drive.theta_e)
        o.call(self.around.observer_start, drive.observer, zero, zero)
        o.call(self.off, drive, state_of(o, StartupState.IDLE))
        drive.fault = fault_of(o, StartupFault.NO_FAULT)
        drive.tries, drive.pulse, drive.length = 0, 0, 0
        drive.direction, drive.theta_e, drive.step, drive.current = one, zero, zero, zero
        drive.power, drive.turning, drive.last_q, drive.emf = zero, zero, zero, zero
        drive.along, drive.fade = Dq(one, zero), Dq(zero, zero)
        drive.first = drive.acted
        if drive.low is not None:
            o.call(self.around.standstill_start, drive.low, zero, zero)
            drive.share, drive.ripple = zero, (zero, zero)

    def trip(self, o: Arithmetic, settings: StartupSettings, drive: Startup, fault: Any) -> None:
        """A fault that a new try may cure is followed by one while there are any left."""
        curable = o.let("curable", fault >= fault_of(o, StartupFault.NO_HANDOVER))
        again = curable & (drive.tries <= settings.retries)
        wait, stop = state_of(o, StartupState.WAIT), state_of(o, StartupState.FAULT)
        state = o.let("state", o.choose(again, wait, stop))
        drive.fault = fault
        o.call(self.off, drive, state)

    def voltage(
        self, o: Arithmetic, gains: ControlGains, drive: Startup, measured: Measured, size: Reals
    ) -> Abc:
        """Duty cycles of a voltage in V along the angle of the samples, as far as the DC link has
        it.
        """
        most = o.let("most", gains.voltage_share * measured.v_dc)
        zero = o.full(0.0, most)
        v = o.let("v", Dq(o.choose(size < most, size, most), zero))
        drive.control.v = made = o.let("made", o.park_inverse(v, o.rotation(measured.theta_e)))
        return o.call(self.around.duties, made, measured.v_dc, o.clarke(measured.i))

    def turn_frame(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
    ) -> None:
        """The frame of the observer replaces that of the ramp: the current stays where it is, the
        controllers go on from it.
        """
        control, none = drive.control, cast("Any", 0)
        omega = o.let("omega", drive.observer.omega_e)
        theta = o.let("theta", drive.observer.theta_e)
        i = o.let("i", o.park(current, o.rotation(theta)))
        ahead = 0.5 * settings.t_s if self.feedforward else gains.advance - settings.t_s
        turn = o.rotation(theta + omega * ahead)
        v = o.let("v", o.park(control.v, turn))
        per_ampere = settings.torque_per_A + settings.reluctance * i.d
        torque = o.let("torque", per_ampere * i.q)
        share = o.let("share", 1.0 / o.real(settings.fade_samples))
        usual = self._usual(o, gains, torque)
        if self.feedforward is not None:
            o.remark("those of the harmonics have turned")
            o.call(self.around.reset_integrals, control)
        control.d.integral, control.q.integral = self._integrals(gains, omega, i, v)
        control.speed.integral = torque
        control.torque = torque
        control.omega_m = omega / gains.pole_pairs
        control.count = none
        if control.references is not None and control.references.torque is not None:
            control.references.torque = torque
        if control.references is not None and control.references.current is not None:
            control.references.current = usual
        held = o.let("held", Dq(i.d - usual.d, i.q - usual.q))
        control.held = held
        drive.fade = Dq(share * held.d, share * held.q)
        drive.fading = settings.fade_samples
        drive.reference = omega
        drive.emf = omega * settings.psi_pm_Wb

    def _usual(self, o: Arithmetic, gains: ControlGains, torque: Reals) -> Dq:
        """Current references of a torque in N m."""
        if not self.by_torque:
            return o.outside(Dq, "current_reference", self.around.currents, torque, filled="usual")
        per_ampere = torque_per_ampere(gains.pole_pairs, gains.psi_pm)
        return o.let("usual", Dq(o.full(0.0, torque), torque / per_ampere))

    def _integrals(self, gains: ControlGains, omega: Reals, i: Dq, v: Dq) -> tuple[Reals, Reals]:
        """Those of the current controllers in V by which the voltage goes on as it is."""
        if self.feedforward == "none":
            return v.d, v.q
        if self.feedforward == "emf":
            return v.d, v.q - omega * gains.psi_pm
        d = v.d + omega * (gains.l_q * i.q)
        q = v.q - omega * (gains.l_d * i.d + gains.psi_pm)
        if self.feedforward == "references":
            return d - gains.r_s * i.d, q - gains.r_s * i.q
        return d, q

    def fade(self, o: Arithmetic, drive: Startup) -> None:
        """The held current goes."""

        def goes() -> None:
            held, zero = drive.control.held, o.full(0.0, drive.theta_e)
            assert held is not None
            drive.fading = left = o.let("left", drive.fading - 1)
            drive.control.held = Dq(
                o.choose(left > 0, held.d - drive.fade.d, zero),
                o.choose(left > 0, held.q - drive.fade.q, zero),
            )

        where(o, drive.fading > 0, goes, drive)

    def speed(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        measured: Measured,
        wanted: Reals,
    ) -> Abc:
        """Speed control in the frame that is used, the reference on its slope."""
        moved = o.call(self.towards, drive.reference, wanted, settings.run_step)
        drive.reference = moved
        o.call(self.fade, drive)
        measured.theta_e = drive.theta_e
        measured.omega_m = drive.omega_e / gains.pole_pairs
        reference = drive.reference / gains.pole_pairs
        return o.call(self.around.speed_control, gains, drive.control, measured, reference)


def state_of(o: Arithmetic, state: StartupState) -> Any:
    """A state by its name."""
    return o.constant(f"STARTUP_{state.name}", state)


def fault_of(o: Arithmetic, fault: StartupFault) -> Any:
    """A fault by its name."""
    return o.constant(f"STARTUP_{fault.name}", fault)
