"""The phases of the start-up in single precision, as ``phases.j2`` has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.transforms import Pair
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Dq
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.start_up.float32_model import (
    Drive,
    F,
    Fault,
    StartUpModel,
    State,
    Vector,
    angle_of,
    array,
    currents_of,
    enter,
    fade,
    low_start,
    observer_start,
    off,
    pair,
    restarted,
    scalar,
    towards,
    trip,
    turned_into,
    turned_out,
    wrapped,
)

if TYPE_CHECKING:
    from dqforge.optimizer.phase_control.phase_records import Control as PhaseState


_ZERO, _ONE, _HALF = F(0.0), F(1.0), F(0.5)


_DYING = 3  # samples in which the current of the last pulse dies


Duties = tuple[Any, Any, Any]


class Phases:
    """One drive and what its phases do; ``model``, its settings ``s`` and the ``drive``."""

    def __init__(self, model: StartUpModel, s: Any, drive: Drive) -> None:
        """Begin with a drive."""
        self.model, self.s, self.drive = model, s, drive
        self.pole_pairs = model.control.gains["pole_pairs"]
        self.phases: Duties = (_ZERO, _ZERO, _ZERO)
        self.v_dc: Any = _ZERO

    def measured(self, phases: Duties, theta: Any, omega_m: Any) -> Any:
        """Samples of an instant as the control takes them."""
        return np.array([[*phases, theta, omega_m, self.v_dc]], dtype=np.float32)

    def current(self, phases: Duties, theta: Any, omega_m: Any, reference: Vector) -> Duties:
        """One step of the current control."""
        made = self.model.control.current_control(
            self.drive.control, self.measured(phases, theta, omega_m), tuple(pair(*reference))
        )
        return scalar(made[0]), scalar(made[1]), scalar(made[2])

    def voltage(self, theta: Any, size: Any, current: Vector) -> Duties:
        """Duty cycles of a voltage along an angle."""
        most = self.model.control.gains["voltage_share"] * self.v_dc
        v = turned_out((size if size < most else most, _ZERO), theta)
        self.drive.control.v = pair(*v)
        made = self.model.control.duties(Pair(*pair(*v)), array(self.v_dc), pair(*current))
        return scalar(made[0]), scalar(made[1]), scalar(made[2])

    def speed(self, phases: Duties, wanted: Any) -> Duties:
        """Speed control in the frame that is used."""
        drive = self.drive
        drive.reference = towards(drive.reference, wanted, self.s.run_step)
        fade(drive)
        made = self.model.control.speed_control(
            drive.control,
            self.measured(phases, drive.theta_e, drive.omega_e / self.pole_pairs),
            array(drive.reference / self.pole_pairs),
        )
        return scalar(made[0]), scalar(made[1]), scalar(made[2])

    def turn_frame(self, current: Vector) -> None:
        """The frame of the observer replaces that of the ramp."""
        s, drive, control = self.s, self.drive, self.model.control
        gains, state = control.gains, drive.control
        omega, theta = scalar(drive.observer.omega_e), scalar(drive.observer.theta_e)
        i = turned_into(current, theta)
        by_angle = isinstance(control, PhaseControlModel)
        ahead = _HALF * s.t_s if by_angle else gains["advance"] - s.t_s
        v = turned_into(drive.made, theta + (omega * ahead))
        torque = (s.torque_per_A + (s.reluctance * i[0])) * i[1]
        share = _ONE / F(s.fade_samples)
        if isinstance(control, PhaseControlModel):
            usual = usual_currents(control, torque)
            turned_integrals(control, state, omega, i, v)
        else:
            usual = control.reference.currents(array(torque))
            put_integrals(
                state,
                d=v[0] + (omega * (gains["l_q"] * i[1])),
                q=v[1] - (omega * ((gains["l_d"] * i[0]) + gains["psi_pm"])),
            )
        put_integrals(state, speed=torque)
        state.torque = array(torque)
        state.omega_m = array(omega / self.pole_pairs)
        state.count = np.zeros(1, dtype=np.uint32)
        if not isinstance(control, PhaseControlModel) and control.moving is not None:
            if control.moving.torque_step is not None:
                state.references.torque = array(torque)
            if control.moving.current_step is not None:
                state.references.current = Dq(usual[0], usual[1])
        held = (i[0] - scalar(usual[0]), i[1] - scalar(usual[1]))
        drive.hold(*held)
        drive.fade = (share * held[0], share * held[1])
        drive.fading = s.fade_samples
        drive.reference, drive.emf = omega, omega * s.psi_pm_Wb

    def from_rest(self) -> None:
        """The first phase of a rotor at rest."""
        drive, s = self.drive, self.s
        if self.model.low is None:
            enter(drive, State.ALIGN)
            return
        enter(drive, State.SEARCH if s.method == 3 and s.alignment == 0 else State.ALIGN)
        drive.low = low_start(self.model, _ZERO, _ZERO)
        drive.share = _ZERO
        drive.ripple = [_ZERO, _ZERO]

    def begin(self, wanted: Any) -> None:
        """The first phase of a try."""
        drive = self.drive
        off(self.model, drive, State.CATCH)
        drive.tries += 1
        drive.direction = F(-1.0) if wanted < _ZERO else _ONE
        drive.theta_e = drive.current = drive.turning = drive.last_q = _ZERO
        drive.pulse, drive.length = 0, 1
        if self.s.flying == 0:
            self.from_rest()

    def begin_ramp(self, theta: Any, omega: Any) -> None:
        """The ramp begins at an angle."""
        drive = self.drive
        enter(drive, State.RAMP)
        drive.theta_e, drive.omega_e, drive.step = theta, omega, _ZERO
        drive.along = (_ONE, _ZERO)

    def shorted(self, omega: Any, duration: Any) -> Any:
        """Angle of the current of a short circuit."""
        s = self.s
        h = F(0.0625) * duration
        d, q = h / s.l_d_H, h / s.l_q_H
        x = y = _ZERO
        for _ in range(16):
            half_d = x + (_HALF * (d * ((omega * (s.l_q_H * y)) - (s.r_s_Ohm * x))))
            half_q = y - (_HALF * (q * ((omega * ((s.l_d_H * x) + s.psi_pm_Wb)) + (s.r_s_Ohm * y))))
            x = x + (d * ((omega * (s.l_q_H * half_q)) - (s.r_s_Ohm * half_d)))
            y = y - (q * ((omega * ((s.l_d_H * half_d) + s.psi_pm_Wb)) + (s.r_s_Ohm * half_q)))
        return angle_of((x, y))

    def caught(self) -> None:
        """A rotor that turns already is driven on."""
        drive, s = self.drive, self.s
        omega, theta = drive.omega_e, drive.theta_e
        drive.observer = observer_start(self.model, theta, omega)
        if abs(omega) >= s.hand_over:
            enter(drive, State.RUN)
        elif self.model.low is not None and s.method == 3:
            enter(drive, State.LOW)
            drive.low = low_start(self.model, theta, omega)
            drive.share = _ZERO
        else:
            self.begin_ramp(theta, omega)
        emf = omega * s.psi_pm_Wb
        drive.acted = turned_out((_ZERO, emf), theta + (_HALF * (s.t_s * omega)))
        gains = self.model.control.gains
        put_integrals(drive.control, q=omega * (s.psi_pm_Wb - gains["psi_pm"]))
        drive.control.omega_m = array(omega / self.pole_pairs)
        drive.reference, drive.emf = omega, emf

    def catch(self, current: Vector) -> bool:
        """Flying start; whether there are gate pulses."""
        drive, s = self.drive, self.s
        pause = 5 * s.pause_samples if drive.pulse == 2 else s.pause_samples
        pause = _DYING if drive.pulse >= 3 else pause
        if drive.time == drive.length + 1:
            if drive.pulse == 0:
                size = np.sqrt((current[0] * current[0]) + (current[1] * current[1]))
                drive.pulse = 1 if size >= s.catch_A else 0
                if drive.pulse == 0 and 2 * drive.length > s.catch_samples:
                    drive.pulse = 1 if size >= _HALF * s.catch_A else 4
                drive.agreed = 1 if drive.pulse == 0 else 0
            else:
                self._turned_between(current, pause)
            drive.first = current
        if drive.time >= drive.length + pause:
            if drive.pulse < 3:
                drive.length = 2 * drive.length if drive.agreed != 0 else drive.length
                drive.agreed = drive.time = 0
            elif drive.pulse == 4 or abs(drive.omega_e) < s.catch_least:
                drive.omega_e = drive.theta_e = _ZERO
                self.from_rest()
            else:
                ahead = drive.omega_e * (s.t_s * F(pause - 1))
                drive.theta_e = wrapped(drive.theta_e + ahead)
                self.caught()
        return drive.time < drive.length

    def _turned_between(self, current: Vector, pause: int) -> None:
        drive, s = self.drive, self.s
        time = F(drive.length + pause) * s.t_s
        turn = wrapped(angle_of(current) - angle_of(drive.first))
        missed = (drive.omega_e * time) - turn if drive.pulse == 2 else _ZERO
        drive.omega_e = (turn + (missed - wrapped(missed))) / time
        drive.theta_e = angle_of(current) - self.shorted(drive.omega_e, s.t_s * F(drive.length))
        again = drive.pulse == 1 and abs(drive.omega_e) < s.catch_slow
        drive.pulse = 2 if again else 3

    def against(self, i_q: Any, v_q: Any) -> Any:
        """A q current against the turning of the rotor."""
        drive, s = self.drive, self.s
        change = s.l_d_H * ((i_q - drive.last_q) / s.t_s)
        emf = v_q - ((s.r_s_Ohm * i_q) + change)
        most = _HALF * drive.current
        drive.last_q = i_q
        speed = emf / s.psi_pm_Wb
        drive.turning = drive.turning + (s.align_share * (speed - drive.turning))
        q = -(s.align_damping * drive.turning)
        return most if q > most else (-most if q < -most else q)

    def align(self, current: Vector, acted: Vector) -> Duties:
        """Alignment."""
        drive, s = self.drive, self.s
        passed = s.align_rise * F(drive.time)
        share = passed if passed < _ONE else _ONE
        left = _ONE if passed < _ONE else F(2.0) - passed
        theta = F(-1.5707964) * (drive.direction * left) if s.alignment == 2 else _ZERO
        drive.theta_e = theta
        if s.alignment == 3:
            return self.voltage(theta, share * s.align_V, current)
        drive.current = share * s.align_A
        i_q, v_q = turned_into(current, theta)[1], turned_into(acted, theta)[1]
        reference = (drive.current, self.against(i_q, v_q))
        return self.current(self.phases, theta, _ZERO, reference)

    def aligned(self, current: Vector, wanted: Any) -> None:
        """What follows the alignment."""
        drive, s = self.drive, self.s
        if s.alignment == 3:
            put_integrals(drive.control, d=s.align_V)
            drive.current = turned_into(current, _ZERO)[0]
        drive.observer = observer_start(self.model, _ZERO, _ZERO)
        if self.model.low is not None and s.method == 3:
            drive.low = low_start(self.model, _ZERO, _ZERO)
            enter(drive, State.SEARCH)
        elif s.method == 2 and abs(wanted) >= s.hand_over:
            share = _ONE / F(s.fade_samples)
            enter(drive, State.LOW)
            drive.hold(s.held_A, drive.held[1])
            drive.fade = (share * s.held_A, _ZERO)
            drive.fading = s.fade_samples
        else:
            self.begin_ramp(_ZERO, _ZERO)

    def ramp(self, i: Vector, acted: Vector, wanted: Any) -> Duties:
        """The ramp."""
        drive, s = self.drive, self.s
        size = np.sqrt((i[0] * i[0]) + (i[1] * i[1]))
        active = _ZERO
        if size > F(0.05) * s.ramp_A:
            active = ((acted[0] * i[0]) + (acted[1] * i[1])) / size
        target = (
            s.ramp_end if wanted > s.ramp_end else (-s.ramp_end if wanted < -s.ramp_end else wanted)
        )
        faster = drive.step + s.ramp_jerk
        drive.step = faster if faster < s.ramp_step else s.ramp_step
        drive.omega_e = towards(drive.omega_e, target, drive.step)
        if not abs(target - drive.omega_e) > _ZERO:
            drive.step = _ZERO
        moved = drive.power + (s.mean_share * (active - drive.power))
        drive.power = active if drive.time == 0 else moved
        slower = _ZERO if s.method == 1 else s.damping * (active - drive.power)
        signed = -slower if drive.omega_e < _ZERO else slower
        drive.theta_e = wrapped(drive.theta_e + (s.t_s * (drive.omega_e - signed)))
        if s.method == 1:
            return self.voltage(drive.theta_e, s.boost_V + (s.psi_pm_Wb * abs(drive.omega_e)), i)
        drive.current = towards(drive.current, s.ramp_A, s.ramp_A_step)
        reference = (drive.current * drive.along[0], drive.current * drive.along[1])
        omega_m = drive.omega_e / self.pole_pairs
        return self.current(self.phases, drive.theta_e, omega_m, reference)

    def watch_ramp(self, current: Vector, wanted: Any) -> None:
        """Whether the observer may take over from the ramp."""
        drive, s = self.drive, self.s
        speed, omega = abs(drive.omega_e), scalar(drive.observer.omega_e)
        i = turned_into(current, scalar(drive.observer.theta_e))
        fast = abs(wanted) >= s.hand_over and speed >= s.hand_over
        alike = abs(omega - drive.omega_e) < s.agree_share * speed
        ahead = s.method == 1 or i[0] > F(-0.5) * drive.current
        if self.model.hears:
            ahead = sees_current_ahead(i, drive.omega_e, drive.current)
        drive.agreed = drive.agreed + 1 if fast and alike and ahead else 0
        if drive.agreed >= s.agree_samples:
            self.turn_frame(current)
            enter(drive, State.RUN)
            return
        drive.late = drive.late + 1 if fast and not drive.step > _ZERO else 0
        if drive.late >= s.patience_samples:
            trip(self.model, s, drive, Fault.NO_HANDOVER)

    def watch_low(self) -> None:
        """Whether the speed rises far enough below the hand-over."""
        drive, s = self.drive, self.s
        asked = abs(drive.reference)
        found = -drive.omega_e if drive.reference < _ZERO else drive.omega_e
        mixing = self.model.low is not None and s.method == 3
        if drive.share >= _ONE if mixing else found >= s.hand_over:
            enter(drive, State.RUN)
            drive.emf = scalar(drive.observer.omega_e) * s.psi_pm_Wb
            if mixing:
                drive.fade = (drive.held[0] / F(s.fade_samples), _ZERO)
                drive.fading = s.fade_samples
                drive.control.added = AlphaBeta(array(0.0), array(0.0))
            return
        drive.late = drive.late + 1 if asked >= s.hand_over else 0
        if drive.late >= s.patience_samples:
            slow = not found >= _HALF * asked
            trip(self.model, s, drive, Fault.STALLED if slow else Fault.NO_HANDOVER)

    def back(self, current: Vector) -> None:
        """The current turns on as a ramp."""
        drive = self.drive
        theta = scalar(drive.observer.theta_e)
        i = turned_into(current, theta)
        size = np.sqrt((i[0] * i[0]) + (i[1] * i[1]))
        self.begin_ramp(theta, scalar(drive.observer.omega_e))
        drive.hold(_ZERO, _ZERO)
        drive.fading, drive.current = 0, size
        if size > _ZERO:
            drive.along = (i[0] / size, i[1] / size)

    def watch_run(self, acted: Vector, current: Vector) -> None:
        """The monitors at speed, and the way back."""
        drive, s = self.drive, self.s
        omega, theta = scalar(drive.observer.omega_e), scalar(drive.observer.theta_e)
        asked = abs(drive.reference)
        found = -omega if drive.reference < _ZERO else omega
        i = turned_into(current, theta)
        v_q = turned_into(acted, theta - (_HALF * (s.t_s * omega)))[1]
        emf = (v_q - (s.r_s_Ohm * i[1])) - (omega * (s.l_d_H * i[0]))
        usual = abs(omega) * s.psi_pm_Wb
        fast = asked >= F(0.8) * s.hand_over
        steady = (
            abs(omega) > s.ratio_above
            and drive.fading == 0
            and abs(drive.reference - omega) < F(0.2) * asked
        )
        drive.emf = drive.emf + (s.ratio_share * (emf - drive.emf))
        along = -drive.emf if omega < _ZERO else drive.emf
        drive.slow = drive.slow + 1 if fast and not found >= s.stall_below else 0
        drive.late = drive.late + 1 if fast and not found >= _HALF * asked else 0
        beyond = F(1.5) * (asked if asked > s.hand_over else s.hand_over)
        drive.over = drive.over + 1 if abs(omega) > beyond else 0
        if not steady:
            drive.settled = drive.outside = 0
        elif drive.settled < s.settled_samples:
            drive.settled += 1
        else:
            inside = s.ratio_low * usual <= along <= s.ratio_high * usual
            drive.outside = 0 if inside else drive.outside + 1
            if inside:
                drive.fault, drive.tries = Fault.NO_FAULT, 1
        if drive.slow >= s.stall_samples or drive.late >= s.patience_samples:
            trip(self.model, s, drive, Fault.STALLED)
        elif drive.outside >= s.ratio_samples or drive.over >= s.patience_samples:
            trip(self.model, s, drive, Fault.LOST)
        elif not fast and abs(omega) < s.back_below:
            self._leave_run(theta, omega, current)

    def _leave_run(self, theta: Any, omega: Any, current: Vector) -> None:
        drive = self.drive
        if self.model.low is not None and self.s.method == 3:
            enter(drive, State.LOW)
            drive.low = low_start(self.model, theta, omega)
            drive.share, drive.fading = _ONE, 0
        else:
            self.back(current)

    def search(self, current: Vector) -> Duties:
        """Axis and polarity by saliency."""
        drive, s, low = self.drive, self.s, self.drive.low
        assert low is not None
        seen = (scalar(low.current[0]), scalar(low.current[1]))
        theta, reference = scalar(low.theta_e), _ZERO
        if drive.state == State.POLARITY:
            place = 0 if drive.time < s.polarity_samples else 1
            passed = drive.time - place * s.polarity_samples
            reference = s.polarity_A if place == 0 else -s.polarity_A
            if 2 * passed >= s.polarity_samples:
                left = (current[0] - seen[0], current[1] - seen[1])
                drive.ripple[place] = drive.ripple[place] + abs(turned_into(left, theta)[0])
        drive.theta_e = theta
        omega_m = scalar(low.omega_e) / self.pole_pairs
        return self.current(currents_of(seen), theta, omega_m, (reference, _ZERO))

    def found(self) -> None:
        """What follows the search."""
        drive, s, low = self.drive, self.s, self.drive.low
        assert low is not None
        if drive.state == State.SEARCH and s.alignment == 0:
            enter(drive, State.POLARITY)
            return
        total, gap = drive.ripple[0] + drive.ripple[1], drive.ripple[0] - drive.ripple[1]
        settled = s.alignment != 0
        if not settled and not abs(gap) > s.polarity_share * total:
            trip(self.model, s, drive, Fault.NO_POLARITY)
            return
        if not settled and gap < _ZERO:
            low = drive.low = restarted(low, wrapped(scalar(low.theta_e) + F(3.1415927)))
        enter(drive, State.LOW)
        drive.omega_e = _ZERO
        put_integrals(drive.control, d=0.0, q=0.0)
        drive.observer = observer_start(self.model, scalar(low.theta_e), _ZERO)

    def mix(self) -> Duties:
        """Both estimators mixed; the currents for the controllers."""
        drive, s, low = self.drive, self.s, self.drive.low
        assert low is not None
        theta, omega = scalar(low.theta_e), scalar(low.omega_e)
        speed = abs(drive.omega_e)
        gap = wrapped(scalar(drive.observer.theta_e) - theta)
        wish = (speed - s.mix_from) / (s.hand_over - s.mix_from)
        bounded = _ONE if wish > _ONE else (wish if wish > _ZERO else _ZERO)
        target = bounded if abs(gap) < F(0.7) or drive.share >= _ONE else _ZERO
        drive.share = towards(drive.share, target, s.mix_step)
        drive.theta_e = wrapped(theta + (drive.share * gap))
        other = scalar(drive.observer.omega_e) - omega
        drive.omega_e = omega + (drive.share * other)
        held = drive.held
        drive.hold(towards(held[0], s.held_A, s.ramp_A_step), held[1])
        if speed < s.stall_below:
            drive.observer = observer_start(self.model, theta, omega)
        return currents_of((scalar(low.current[0]), scalar(low.current[1])))


# What the start-up of a machine of any back-EMF does besides: how its tracker follows the ramp,
# and how the control over the angle goes on in the frame of the tracker. As ``phases.j2`` and
# ``parts.j2`` have it, in single precision.

_STEEPEST = F(0.85)  # sine of the rotor's angle behind the current that is believed


_ALONG, _ACROSS = F(0.90630779), F(0.42261826)  # cosine and sine of 25 degrees


def follow_ramp(model: StartUpModel, s: Any, drive: Drive) -> None:
    """As ``<prefix>_startup_follow_ramp``: the tracker starts behind the current of the ramp.

    Args:
        model, s, drive: What the machine is made of, its settings and its state.
    """
    emf = s.psi_pm_Wb * abs(drive.omega_e)
    left = drive.power - (s.r_s_Ohm * drive.current)
    seen = left / emf if emf > _ZERO else _ZERO
    sine = _STEEPEST if seen > _STEEPEST else (seen if seen > _ZERO else _ZERO)
    delta = angle_of((np.sqrt(_ONE - (sine * sine)), sine))
    delta = -delta if drive.omega_e < _ZERO else delta
    ahead = (drive.theta_e + (s.t_s * drive.omega_e)) + angle_of(drive.along)
    drive.observer = observer_start(model, ahead - delta, drive.omega_e)


def sees_current_ahead(i: Vector, omega_e: Any, size: Any) -> bool:
    """Whether a current in A lies 35 degrees behind to 85 degrees ahead of the tracker's d axis.

    Args:
        i: The current in the tracker's frame.
        omega_e: Speed of the ramp in rad/s, whose sign says what ahead is.
        size: Of the current of the ramp.
    """
    across = -i[1] if omega_e < _ZERO else i[1]
    return bool((_ALONG * i[0]) + (_ACROSS * across) > _HALF * size)


def put_integrals(state: Any, **values: Any) -> None:
    """Set integrals of controllers.

    Args:
        state: Of either control.
        values: By the names of the controllers, in V or N m.
    """
    for name, value in values.items():
        getattr(state, name).integral = array(value)


def usual_currents(control: PhaseControlModel, torque: Any) -> tuple[Any, Any]:
    """Current references of a torque in N m, arrays of shape (1,).

    Args:
        control: The control over the angle.
        torque: In N m.
    """
    if control.reference is not None:
        d, q = control.reference.currents(array(torque))
        return d, q
    per_ampere = (F(1.5) * control.gains["pole_pairs"]) * control.gains["psi_pm"]
    return array(0.0), array(torque / per_ampere)


def turned_integrals(
    control: PhaseControlModel, state: PhaseState, omega: Any, i: Vector, v: Vector
) -> None:
    """The integrals of the control over the angle in a new frame; those of the harmonics go.

    Args:
        control, state: The control and its state.
        omega: Electrical speed in rad/s.
        i, v: Current in A and voltage in V in that frame.
    """
    gains, fed = control.gains, control.structure.feedforward
    state.harmonic = (AlphaBeta(array(0.0), array(0.0)),) * len(state.harmonic)
    d, q = v
    if fed == "emf":
        q = v[1] - (omega * gains["psi_pm"])
    elif fed != "none":
        d = v[0] + (omega * (gains["l_q"] * i[1]))
        q = v[1] - (omega * ((gains["l_d"] * i[0]) + gains["psi_pm"]))
        if fed == "references":
            d, q = d - (gains["r_s"] * i[0]), q - (gains["r_s"] * i[1])
    put_integrals(state, d=d, q=q)
