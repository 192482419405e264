"""The phases of the start-up, one function each; docs/methods/start-up.md has the equations."""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import ControlGains
from dqforge.optimizer.start_up.start_parts import StartupParts, fault_of, state_of
from dqforge.optimizer.start_up.start_records import (
    ALIGNMENTS,
    METHODS,
    Measured,
    Startup,
    StartupFault,
    StartupSettings,
    StartupState,
)
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq, where

_PULSES = 16  # Steps of the current in a short circuit.
_DYING = 3  # Samples in which the current of the last pulse dies.
_ONE_PULSE, _TWO_PULSES, _KNOWN, _AT_REST = 1, 2, 3, 4  # What the flying start has found.

_STEEPEST = 0.85  # Sine of the rotor's angle behind the current that is believed.
_ALONG, _ACROSS = 0.90630779, 0.42261826  # Cosine and sine of 25 degrees.
_AGREES = 0.7  # Largest gap in rad of both estimators at which the observer's share rises.
_QUARTER, _HALF_TURN = 1.5707964, 3.1415927


@dataclass(slots=True)
class _Shorted:
    """Current of a short circuit in the rotor's coordinates, A."""

    i_d: Reals
    i_q: Reals


@dataclass(frozen=True, slots=True)
class StartupPhases(StartupParts):
    """What the phases of a start do."""

    def from_rest(self, o: Arithmetic, settings: StartupSettings, drive: Startup) -> None:
        """The first phase of a rotor at rest."""
        align = state_of(o, StartupState.ALIGN)
        if drive.low is None:
            o.call(self.enter, drive, align)
            return
        zero = o.full(0.0, settings.t_s)
        at_once = started_by(o, settings, "saliency") & aligned_by(o, settings, "none")
        first = o.let("first", o.choose(at_once, state_of(o, StartupState.SEARCH), align))
        o.call(self.enter, drive, first)
        o.call(self.around.standstill_start, drive.low, zero, zero)
        drive.share, drive.ripple = zero, (zero, zero)

    def begin(
        self, o: Arithmetic, settings: StartupSettings, drive: Startup, wanted: Reals
    ) -> None:
        """The first phase of a try."""
        zero, one = o.full(0.0, wanted), o.full(1.0, wanted)
        o.call(self.off, drive, state_of(o, StartupState.CATCH))
        drive.tries = drive.tries + 1
        drive.direction = o.choose(wanted < 0.0, -one, one)
        drive.theta_e, drive.current, drive.turning, drive.last_q = zero, zero, zero, zero
        drive.pulse, drive.length = 0, 1
        rests = o.equal(settings.flying, 0)
        where(o, rests, lambda: o.call(self.from_rest, settings, drive), drive)

    def begin_ramp(self, o: Arithmetic, drive: Startup, theta: Reals, omega: Reals) -> None:
        """The ramp begins at an angle, with the current as it is."""
        zero = o.full(0.0, omega)
        o.call(self.enter, drive, state_of(o, StartupState.RAMP))
        drive.theta_e, drive.omega_e, drive.step = theta, omega, zero
        drive.along = Dq(o.full(1.0, omega), zero)

    def shorted(
        self, o: Arithmetic, settings: StartupSettings, omega: Reals, duration: Reals
    ) -> Reals:
        """Angle in rad, from the d axis on, of the current that a short circuit of a duration makes
        from none at a speed.
        """
        h = o.let("h", 0.0625 * duration)
        d, q = o.let("d", h / settings.l_d_H), o.let("q", h / settings.l_q_H)
        zero = o.full(0.0, omega)
        r_s, psi = settings.r_s_Ohm, settings.psi_pm_Wb
        i = _Shorted(zero, zero)

        def rise(i_d: Reals, i_q: Reals) -> tuple[Reals, Reals]:
            across = omega * (settings.l_d_H * i_d + psi) + r_s * i_q
            return d * (omega * (settings.l_q_H * i_q) - r_s * i_d), q * across

        def moved(n: Any) -> None:  # noqa: ARG001
            along, across = rise(i.i_d, i.i_q)
            half_d = o.let("half_d", i.i_d + 0.5 * along)
            half_q = o.let("half_q", i.i_q - 0.5 * across)
            along, across = rise(half_d, half_q)
            i.i_d = i.i_d + along
            i.i_q = i.i_q - across

        o.repeated(i, _PULSES, moved)
        return o.call(self.angle, o.let("i", AlphaBeta(i.i_d, i.i_q)))

    def caught(
        self, o: Arithmetic, gains: ControlGains, settings: StartupSettings, drive: Startup
    ) -> None:
        """A rotor that turns already is driven from its angle and speed on."""
        omega, theta = o.let("omega", drive.omega_e), o.let("theta", drive.theta_e)
        o.call(self.around.observer_start, drive.observer, theta, omega)

        def at_speed() -> None:
            o.call(self.enter, drive, state_of(o, StartupState.RUN))

        def below() -> None:
            low = drive.low
            assert low is not None
            o.call(self.enter, drive, state_of(o, StartupState.LOW))
            o.call(self.around.standstill_start, low, theta, omega)
            drive.share = o.full(0.0, omega)

        branches: list[tuple[Any, Any]] = [(o.magnitude(omega) >= settings.hand_over, at_speed)]
        if drive.low is not None:
            branches.append((started_by(o, settings, "saliency"), below))
        ramps = lambda: o.call(self.begin_ramp, drive, theta, omega)  # noqa: E731
        o.cases("", *branches, otherwise=ramps, changing=(drive,))
        emf = o.let("emf", Dq(o.full(0.0, omega), omega * settings.psi_pm_Wb))
        turn = o.rotation(theta + 0.5 * (settings.t_s * omega))
        drive.acted = o.park_inverse(emf, turn)
        drive.control.q.integral = omega * (settings.psi_pm_Wb - gains.psi_pm)
        drive.control.omega_m = omega / gains.pole_pairs
        drive.reference = omega
        drive.emf = emf.q

    def catch(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
    ) -> Any:
        """Flying start: short circuits whose length doubles until their current shows, then one or
        two more; speed from the turn of the current between them, angle from the model's current at
        that speed. Returns whether there are gate pulses.
        """
        third = o.equal(drive.pulse, _TWO_PULSES)
        longer = o.choose(third, 5 * settings.pause_samples, settings.pause_samples)
        between = o.let("between", longer)
        over = o.choose(drive.pulse >= _KNOWN, _DYING, between)
        pause = o.let("pause", over, "behind the last pulse its current dies")

        def seen() -> None:
            first = o.equal(drive.pulse, 0)
            o.cases(
                "",
                (first, lambda: self._shows(o, settings, drive, current)),
                otherwise=lambda: self._turned(o, settings, drive, current, pause),
                changing=(drive,),
            )
            drive.first = current

        def known() -> None:
            slow = o.magnitude(drive.omega_e) < settings.catch_least
            zero = o.full(0.0, settings.t_s)

            def rests() -> None:
                drive.omega_e, drive.theta_e = zero, zero
                o.call(self.from_rest, settings, drive)

            def turns() -> None:
                left = o.let("left", pause - 1)
                ahead = drive.omega_e * (settings.t_s * o.real(left))
                drive.theta_e = o.wrap(drive.theta_e + ahead)
                o.call(self.caught, gains, settings, drive)

            at_rest = o.equal(drive.pulse, _AT_REST) | slow
            o.cases("", (at_rest, rests), otherwise=turns, changing=(drive,))

        def again() -> None:
            longer = o.negated(o.equal(drive.agreed, 0))
            drive.length = o.choose(longer, 2 * drive.length, drive.length)
            drive.agreed, drive.time = 0, 0

        def passed() -> None:
            found = drive.pulse >= _KNOWN
            o.cases("", (found, known), otherwise=again, changing=(drive,))

        where(o, o.equal(drive.time, drive.length + 1), seen, drive)
        where(o, drive.time >= drive.length + pause, passed, drive)
        return drive.time < drive.length

    def _shows(
        self, o: Arithmetic, settings: StartupSettings, drive: Startup, current: AlphaBeta
    ) -> None:
        """Whether the current of the first pulses is large enough."""
        square = current.alpha * current.alpha + current.beta * current.beta
        size = o.let("size", o.root(square))
        longest = o.let("longest", 2 * drive.length > settings.catch_samples)
        drive.agreed = 0

        def one() -> None:
            drive.pulse = _ONE_PULSE

        def rests() -> None:
            o.remark("it is at rest")
            drive.pulse = _AT_REST

        def goes_on() -> None:
            o.remark("the next one is longer")
            drive.agreed = 1

        half = longest & (size >= 0.5 * settings.catch_A)
        shows = (size >= settings.catch_A) | half
        o.cases("", (shows, one), (longest, rests), otherwise=goes_on, changing=(drive,))

    def _turned(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
        pause: Any,
    ) -> None:
        """Speed and angle from the currents of two pulses."""
        passed = o.let("passed", drive.length + pause)
        time = o.let("time", o.real(passed) * settings.t_s)
        risen = o.call(self.angle, current) - o.call(self.angle, drive.first)
        turn = o.let("turn", o.wrap(risen))
        third = o.equal(drive.pulse, _TWO_PULSES)
        gap = o.choose(third, drive.omega_e * time - turn, o.full(0.0, turn))
        missed = o.let("missed", gap)
        omega = o.let("omega", (turn + (missed - o.wrap(missed))) / time)
        drive.omega_e = omega
        one = o.equal(drive.pulse, _ONE_PULSE)
        slow = one & (o.magnitude(omega) < settings.catch_slow)

        def again() -> None:
            drive.pulse = _TWO_PULSES

        def known() -> None:
            o.remark("it is known")
            drive.pulse = _KNOWN

        o.cases("", (slow, again), otherwise=known, changing=(drive,))
        length = settings.t_s * o.real(drive.length)
        lag = o.call(self.shorted, settings, drive.omega_e, length)
        drive.theta_e = o.call(self.angle, current) - lag

    def against(
        self, o: Arithmetic, settings: StartupSettings, drive: Startup, i: Dq, v: Dq
    ) -> Reals:
        """A q current against the turning of the rotor, which a regulated current leaves without
        damping: the voltage across the current, less what resistance and inductance take of it, is
        psi times the rotor's speed.
        """
        rise = settings.l_d_H * ((i.q - drive.last_q) / settings.t_s)
        emf = o.let("emf", v.q - (settings.r_s_Ohm * i.q + rise))
        most = o.let("most", 0.5 * drive.current)
        gap = emf / settings.psi_pm_Wb - drive.turning
        turning = o.let("turning", drive.turning + settings.align_share * gap)
        q = o.let("q", -(settings.align_damping * turning))
        drive.last_q, drive.turning = i.q, turning
        return o.choose(q > most, most, o.choose(q < -most, -most, q))

    def align(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        measured: Measured,
        acted: AlphaBeta,
    ) -> Abc:
        """Alignment: a current, or a voltage, that rises over half of the time at rest; in two
        steps from a quarter turn behind, over which it is turned in the other half.
        """
        passed = o.let("passed", settings.align_rise * o.real(drive.time), "0 to 2")
        zero, one = o.full(0.0, passed), o.full(1.0, passed)
        share = o.let("share", o.choose(passed < 1.0, passed, one))
        left = o.let("left", o.choose(passed < 1.0, one, 2.0 - passed))
        behind = -(_QUARTER * (drive.direction * left))
        theta = o.let("theta", o.choose(aligned_by(o, settings, "two-step"), behind, zero))
        measured.theta_e, measured.omega_m, drive.theta_e = theta, zero, theta

        def by_voltage() -> Abc:
            return o.call(self.voltage, gains, drive, measured, share * settings.align_V)

        def by_current() -> Abc:
            turn = o.let("turn", o.rotation(theta))
            drive.current = current = o.let("current", share * settings.align_A)
            i, v = o.park(o.clarke(measured.i), turn), o.park(acted, turn)
            q = o.let("q", o.call(self.against, settings, drive, i, v))
            reference = o.let("reference", Dq(current, q))
            control = self.around.current_control
            return o.call(control, gains, drive.control, measured, reference)

        voltage = aligned_by(o, settings, "voltage")
        changing = drive, measured
        return o.cases("duty", (voltage, by_voltage), otherwise=by_current, changing=changing)

    def aligned(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
        wanted: Reals,
    ) -> None:
        """What follows the alignment."""
        zero = o.full(0.0, wanted)

        def by_voltage() -> None:
            drive.control.d.integral = settings.align_V
            drive.current = o.park(current, o.rotation(zero)).d

        def searches() -> None:
            low = drive.low
            assert low is not None
            o.call(self.around.standstill_start, low, zero, zero)
            o.call(self.enter, drive, state_of(o, StartupState.SEARCH))

        def direct() -> None:
            share = o.let("share", 1.0 / o.real(settings.fade_samples))
            held = drive.control.held
            assert held is not None
            o.call(self.enter, drive, state_of(o, StartupState.LOW))
            drive.control.held = Dq(settings.held_A, held.q)
            drive.fade = Dq(share * settings.held_A, zero)
            drive.fading = settings.fade_samples

        where(o, aligned_by(o, settings, "voltage"), by_voltage, drive)
        o.call(self.around.observer_start, drive.observer, zero, zero)
        fast = started_by(o, settings, "direct") & (o.magnitude(wanted) >= settings.hand_over)
        branches = [] if drive.low is None else [(started_by(o, settings, "saliency"), searches)]
        ramps = lambda: o.call(self.begin_ramp, drive, zero, zero)  # noqa: E731
        o.cases("", *branches, (fast, direct), otherwise=ramps, changing=(drive,))

    def ramp(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        measured: Measured,
        acted: AlphaBeta,
        wanted: Reals,
    ) -> Abc:
        """The ramp: its speed follows the wanted one with an acceleration that rises slowly, the
        active voltage damps it.
        """
        zero, end = o.full(0.0, wanted), settings.ramp_end
        i = o.let("i", o.clarke(measured.i))
        size = o.let("size", o.root(i.alpha * i.alpha + i.beta * i.beta))
        along = (acted.alpha * i.alpha + acted.beta * i.beta) / size
        active = o.let("active", o.choose(size > 0.05 * settings.ramp_A, along, zero))
        below = o.choose(wanted < -end, -end, wanted)
        target = o.let("target", o.choose(wanted > end, end, below))
        faster = o.let("faster", drive.step + settings.ramp_jerk)
        least = o.choose(faster < settings.ramp_step, faster, settings.ramp_step)
        drive.step = step = o.let("step", least)
        omega = o.let("omega", o.call(self.towards, drive.omega_e, target, step))
        drive.omega_e = omega

        def there() -> None:
            drive.step = zero

        where(o, o.negated(o.magnitude(target - omega) > 0.0), there, drive)
        moved = drive.power + settings.mean_share * (active - drive.power)
        power = o.let("power", o.choose(o.equal(drive.time, 0), active, moved))
        drive.power = power
        by_voltage = started_by(o, settings, "v-f")
        damped = settings.damping * (active - power)
        slower = o.let("slower", o.choose(by_voltage, zero, damped))
        signed = o.choose(omega < 0.0, -slower, slower)
        theta = o.let("theta", o.wrap(drive.theta_e + settings.t_s * (omega - signed)))
        drive.theta_e, measured.theta_e = theta, theta
        measured.omega_m = omega / gains.pole_pairs

        def turned_voltage() -> Abc:
            emf = settings.psi_pm_Wb * o.magnitude(omega)
            return o.call(self.voltage, gains, drive, measured, settings.boost_V + emf)

        def turned_current() -> Abc:
            step = settings.ramp_A_step
            risen = o.call(self.towards, drive.current, settings.ramp_A, step)
            drive.current = current = o.let("current", risen)
            along = drive.along
            reference = o.let("reference", Dq(current * along.d, current * along.q))
            control = self.around.current_control
            return o.call(control, gains, drive.control, measured, reference)

        return o.cases(
            "duty",
            (started_by(o, settings, "v-f"), turned_voltage),
            otherwise=turned_current,
            changing=(drive, measured),
        )

    def follow_ramp(self, o: Arithmetic, settings: StartupSettings, drive: Startup) -> None:
        """The tracker cannot follow from rest, nor find its third of a turn: until it agrees it is
        started at every sample, behind the current of the ramp by the angle that the active voltage
        tells, R i + omega psi sin delta.
        """
        zero = o.full(0.0, settings.t_s)
        emf = o.let("emf", settings.psi_pm_Wb * o.magnitude(drive.omega_e))
        left = o.let("left", drive.power - settings.r_s_Ohm * drive.current)
        seen = o.let("seen", o.choose(emf > 0.0, left / emf, zero))
        least = o.choose(seen > 0.0, seen, zero)
        sine = o.let("sine", o.choose(seen > _STEEPEST, o.full(_STEEPEST, zero), least))
        behind = o.let("behind", AlphaBeta(o.root(1.0 - sine * sine), sine))
        along = o.let("along", AlphaBeta(drive.along.d, drive.along.q))
        delta = o.let("delta", o.call(self.angle, behind))
        lag = o.let("lag", o.choose(drive.omega_e < 0.0, -delta, delta))
        ahead = (drive.theta_e + settings.t_s * drive.omega_e) + o.call(self.angle, along)
        theta = o.let("theta", ahead - lag)
        o.call(self.around.observer_start, drive.observer, theta, drive.omega_e)

    def watch_ramp(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
        wanted: Reals,
    ) -> None:
        """Whether the observer may take over from the ramp: it agrees with its speed, and sees the
        current ahead of the rotor's d axis by less than 120 degrees, or by -35 to 85 degrees where
        it is told the sum of the phase voltages.
        """
        speed = o.let("speed", o.magnitude(drive.omega_e))
        i = o.let("i", o.park(current, o.rotation(drive.observer.theta_e)))
        asked = o.magnitude(wanted) >= settings.hand_over
        fast = o.let("fast", asked & (speed >= settings.hand_over))
        gap = o.magnitude(drive.observer.omega_e - drive.omega_e)
        alike = o.let("alike", gap < settings.agree_share * speed)
        if self.hears:
            across = o.let("across", o.choose(drive.omega_e < 0.0, -i.q, i.q))
            seen = (_ALONG * i.d + _ACROSS * across) > 0.5 * drive.current
            ahead = o.let("ahead", seen, "-35 to 85 degrees")
        else:
            within = i.d > -(0.5 * drive.current)
            ahead = o.let("ahead", started_by(o, settings, "v-f") | within)
        more = o.choose(fast & alike & ahead, drive.agreed + 1, 0)
        drive.agreed = agreed = o.let("agreed", more)

        def hands_over() -> None:
            o.call(self.turn_frame, gains, settings, drive, current)
            o.call(self.enter, drive, state_of(o, StartupState.RUN))

        def waits() -> None:
            stands = fast & o.negated(drive.step > 0.0)
            drive.late = late = o.let("late", o.choose(stands, drive.late + 1, 0))
            failed = fault_of(o, StartupFault.NO_HANDOVER)
            where(
                o,
                late >= settings.patience_samples,
                lambda: o.call(self.trip, settings, drive, failed),
                drive,
            )

        agreed_long = agreed >= settings.agree_samples
        o.cases("", (agreed_long, hands_over), otherwise=waits, changing=(drive,))

    def watch_low(self, o: Arithmetic, settings: StartupSettings, drive: Startup) -> None:
        """Whether the speed rises far enough below the hand-over."""
        asked = o.let("asked", o.magnitude(drive.reference))
        back = drive.reference < 0.0
        found = o.let("found", o.choose(back, -drive.omega_e, drive.omega_e))
        by_saliency = started_by(o, settings, "saliency")
        over = found >= settings.hand_over
        if drive.share is not None:
            whole, fast = drive.share >= 1.0, over
            over = o.cases("over", (by_saliency, lambda: whole), otherwise=lambda: fast)

        def fades() -> None:
            held, zero = drive.control.held, o.full(0.0, asked)
            assert held is not None
            drive.fade = Dq(held.d / o.real(settings.fade_samples), zero)
            drive.fading = settings.fade_samples
            drive.control.added = AlphaBeta(zero, zero)

        def runs() -> None:
            o.call(self.enter, drive, state_of(o, StartupState.RUN))
            drive.emf = drive.observer.omega_e * settings.psi_pm_Wb
            if drive.low is not None:
                where(o, started_by(o, settings, "saliency"), fades, drive)

        def trips() -> None:
            near = found >= 0.5 * asked
            slow, stalled = StartupFault.NO_HANDOVER, StartupFault.STALLED
            fault = o.let("fault", o.choose(near, fault_of(o, slow), fault_of(o, stalled)))
            o.call(self.trip, settings, drive, fault)

        def rises() -> None:
            fast = asked >= settings.hand_over
            drive.late = late = o.let("late", o.choose(fast, drive.late + 1, 0))
            where(o, late >= settings.patience_samples, trips, drive)

        o.cases("", (over, runs), otherwise=rises, changing=(drive,))

    def back(self, o: Arithmetic, drive: Startup, current: AlphaBeta) -> None:
        """The current turns on as a ramp below the speeds of the observer."""
        theta = o.let("theta", drive.observer.theta_e)
        i = o.let("i", o.park(current, o.rotation(theta)))
        size = o.let("size", o.root(i.d * i.d + i.q * i.q))
        zero = o.full(0.0, size)
        o.call(self.begin_ramp, drive, theta, drive.observer.omega_e)
        drive.control.held = Dq(zero, zero)
        drive.fading, drive.current = 0, size

        def along() -> None:
            drive.along = Dq(i.d / size, i.q / size)

        where(o, size > 0.0, along, drive)

    def watch_run(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        drive: Startup,
        acted: AlphaBeta,
        current: AlphaBeta,
    ) -> None:
        """The monitors at speed, and the way back to the ramp."""
        omega = o.let("omega", drive.observer.omega_e)
        theta = o.let("theta", drive.observer.theta_e)
        asked = o.let("asked", o.magnitude(drive.reference))
        found = o.let("found", o.choose(drive.reference < 0.0, -omega, omega))
        i = o.let("i", o.park(current, o.rotation(theta)))
        middle = theta - 0.5 * (settings.t_s * omega)
        v = o.let("v", o.park(acted, o.rotation(middle)))
        emf = (v.q - settings.r_s_Ohm * i.q) - omega * (settings.l_d_H * i.d)
        emf = o.let("emf", emf)
        speed = o.let("speed", o.magnitude(omega))
        usual = o.let("usual", speed * settings.psi_pm_Wb)
        fast = o.let("fast", asked >= 0.8 * settings.hand_over)
        near = o.magnitude(drive.reference - omega) < 0.2 * asked
        held = o.equal(drive.fading, 0)
        steady = o.let("steady", (speed > settings.ratio_above) & held & near)
        mean = drive.emf + settings.ratio_share * (emf - drive.emf)
        drive.emf = mean = o.let("mean", mean)
        along = o.let("along", o.choose(omega < 0.0, -mean, mean))
        slow = fast & o.negated(found >= settings.stall_below)
        late = fast & o.negated(found >= 0.5 * asked)
        top = o.let("top", o.choose(asked > settings.hand_over, asked, settings.hand_over))
        drive.slow = slow = o.let("slow", o.choose(slow, drive.slow + 1, 0))
        drive.late = late = o.let("late", o.choose(late, drive.late + 1, 0))
        drive.over = over = o.let("over", o.choose(speed > 1.5 * top, drive.over + 1, 0))

        def unsettled() -> None:
            drive.settled, drive.outside = 0, 0

        def settles() -> None:
            drive.settled = drive.settled + 1

        def looks() -> None:
            above = along >= settings.ratio_low * usual
            inside = o.let("inside", above & (along <= settings.ratio_high * usual))
            drive.outside = o.choose(inside, 0, drive.outside + 1)
            where(o, inside, runs, drive)

        def runs() -> None:
            drive.fault, drive.tries = fault_of(o, StartupFault.NO_FAULT), 1

        o.cases(
            "",
            (o.negated(steady), unsettled),
            (drive.settled < settings.settled_samples, settles),
            otherwise=looks,
            changing=(drive,),
        )

        def trips(fault: StartupFault) -> None:
            o.call(self.trip, settings, drive, fault_of(o, fault))

        patience = settings.patience_samples
        stalled = (slow >= settings.stall_samples) | (late >= patience)
        lost = (drive.outside >= settings.ratio_samples) | (over >= patience)
        below = o.negated(fast) & (speed < settings.back_below)
        o.cases(
            "",
            (stalled, lambda: trips(StartupFault.STALLED)),
            (lost, lambda: trips(StartupFault.LOST)),
            (below, lambda: self._leaves(o, settings, drive, current, (theta, omega))),
            otherwise=lambda: o.remark("it continues"),
            changing=(drive,),
        )

    def _leaves(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        drive: Startup,
        current: AlphaBeta,
        estimate: tuple[Reals, Reals],
    ) -> None:
        """The way back below the speeds of the observer."""
        low = drive.low
        if low is None:
            o.call(self.back, drive, current)
            return

        def mixes() -> None:
            o.call(self.enter, drive, state_of(o, StartupState.LOW))
            o.call(self.around.standstill_start, low, *estimate)
            drive.share, drive.fading = o.full(1.0, estimate[0]), 0

        o.cases(
            "",
            (started_by(o, settings, "saliency"), mixes),
            otherwise=lambda: o.call(self.back, drive, current),
            changing=(drive,),
        )

    def low_step(
        self, o: Arithmetic, gains: Any, drive: Startup, acted: AlphaBeta, current: AlphaBeta
    ) -> None:
        """The estimator from standstill on, and the voltage that it asks for."""
        assert drive.low is not None
        o.call(self.around.standstill_step, gains, drive.low, acted, current)
        drive.control.added = drive.low.added

    def search(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        measured: Measured,
        current: AlphaBeta,
    ) -> Abc:
        """The axis is found without current along it, then the ripple that the injected voltage
        makes is compared with a current towards either end: it is larger where the magnet saturates
        the iron.
        """
        low, ripple, zero = drive.low, drive.ripple, o.full(0.0, settings.t_s)
        assert low is not None
        assert ripple is not None

        def tested() -> Reals:
            first = o.let("first", drive.time < settings.polarity_samples)
            later = drive.time - settings.polarity_samples
            passed = o.let("passed", o.choose(first, drive.time, later))
            gap = AlphaBeta(current.alpha - low.current.alpha, current.beta - low.current.beta)
            left = o.let("left", gap)

            def counts() -> None:
                seen = o.park(left, o.rotation(low.theta_e))
                size = o.let("size", o.magnitude(seen.d))

                def north() -> None:
                    drive.ripple = ripple[0] + size, ripple[1]

                def south() -> None:
                    drive.ripple = ripple[0], ripple[1] + size

                o.cases("", (first, north), otherwise=south, changing=(drive,))

            where(o, 2 * passed >= settings.polarity_samples, counts, drive)
            return o.choose(first, settings.polarity_A, -settings.polarity_A)

        polarity = o.equal(drive.state, state_of(o, StartupState.POLARITY))
        along = o.cases("along", (polarity, tested), otherwise=lambda: zero, changing=(drive,))
        reference = o.let("reference", Dq(along, zero))
        drive.theta_e = low.theta_e
        measured.i = o.clarke_inverse(low.current)
        measured.theta_e = low.theta_e
        measured.omega_m = low.omega_e / gains.pole_pairs
        control = self.around.current_control
        return o.call(control, gains, drive.control, measured, reference)

    def found(self, o: Arithmetic, settings: StartupSettings, drive: Startup) -> None:
        """What follows the search: the polarity where no alignment has settled it, then speed
        control with the d current that is held.
        """
        low, zero = drive.low, o.full(0.0, settings.t_s)
        assert low is not None

        def compares() -> None:
            ripple = drive.ripple
            assert ripple is not None
            settled = o.let("settled", o.negated(aligned_by(o, settings, "none")))
            total = o.let("sum", ripple[0] + ripple[1])
            gap = o.let("gap", ripple[0] - ripple[1])
            clear = o.magnitude(gap) > settings.polarity_share * total
            alike = o.negated(settled) & o.negated(clear)

            def trips() -> None:
                o.call(self.trip, settings, drive, fault_of(o, StartupFault.NO_POLARITY))

            def turns() -> None:
                low.theta_e = o.wrap(low.theta_e + _HALF_TURN)

            def known() -> None:
                where(o, o.negated(settled) & (gap < 0.0), turns, drive)
                o.call(self.enter, drive, state_of(o, StartupState.LOW))
                drive.omega_e = zero
                drive.control.d.integral, drive.control.q.integral = zero, zero
                o.call(self.around.observer_start, drive.observer, low.theta_e, zero)

            o.cases("", (alike, trips), otherwise=known, changing=(drive,))

        def tests() -> None:
            o.call(self.enter, drive, state_of(o, StartupState.POLARITY))

        searched = o.equal(drive.state, state_of(o, StartupState.SEARCH))
        unsettled = searched & aligned_by(o, settings, "none")
        o.cases("", (unsettled, tests), otherwise=compares, changing=(drive,))

    def mix(
        self, o: Arithmetic, settings: StartupSettings, drive: Startup, measured: Measured
    ) -> None:
        """Angle and speed of both estimators mixed: the observer counts from mix_from on, as far as
        it agrees.
        """
        low, held = drive.low, drive.control.held
        assert low is not None
        assert held is not None
        assert drive.share is not None
        zero = o.full(0.0, settings.t_s)
        speed = o.let("speed", o.magnitude(drive.omega_e))
        gap = o.let("gap", o.wrap(drive.observer.theta_e - low.theta_e))
        wish = (speed - settings.mix_from) / (settings.hand_over - settings.mix_from)
        wish = o.let("wish", wish)
        least = o.choose(wish > 0.0, wish, zero)
        bounded = o.let("bounded", o.choose(wish > 1.0, o.full(1.0, wish), least))
        agrees = (o.magnitude(gap) < _AGREES) | (drive.share >= 1.0)
        target = o.let("target", o.choose(agrees, bounded, zero))
        share = o.let("share", o.call(self.towards, drive.share, target, settings.mix_step))
        drive.share = share
        drive.theta_e = o.wrap(low.theta_e + share * gap)
        drive.omega_e = low.omega_e + share * (drive.observer.omega_e - low.omega_e)
        d = o.call(self.towards, held.d, settings.held_A, settings.ramp_A_step)
        drive.control.held = Dq(d, held.q)
        measured.i = o.clarke_inverse(low.current)

        def again() -> None:
            o.call(self.around.observer_start, drive.observer, low.theta_e, low.omega_e)

        where(o, speed < settings.stall_below, again, drive)


def started_by(o: Arithmetic, settings: StartupSettings, method: str) -> Any:
    """Whether it starts by a method."""
    return o.equal(settings.method, METHODS.index(method))


def aligned_by(o: Arithmetic, settings: StartupSettings, alignment: str) -> Any:
    """Whether it is aligned so."""
    return o.equal(settings.alignment, ALIGNMENTS.index(alignment))
