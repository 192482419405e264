"""The step of the start-up: what samples and command permit, then what its phase does.

idle -> catch, align, search or ramp -> ... -> low or run, by the method
a failed start -> wait -> the next try, or the fault; a dangerous sample -> the fault
without the command the reference goes to zero on its slope, then idle
"""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import ControlGains
from dqforge.optimizer.start_up.phases import StartupPhases, aligned_by, started_by
from dqforge.optimizer.start_up.start_parts import fault_of, state_of
from dqforge.optimizer.start_up.start_records import (
    RESTING,
    Measured,
    Startup,
    StartupFault,
    StartupOutput,
    StartupSample,
    StartupSettings,
    StartupState,
)
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, where

# Beyond these a squared current in A^2, and a voltage in V or a speed, count as unknown; so does
# not-a-number.
_UNKNOWN_SQUARE, _UNKNOWN = 1.0e30, 1.0e15
_LONGEST = 2_147_483_647  # Where the samples of a state are counted no further.


@dataclass(frozen=True, slots=True)
class StartupSteps(StartupPhases):
    """The start-up of a design."""

    def resting(self, o: Arithmetic, drive: Startup) -> Any:
        """Whether all switches are off and nothing is under way."""
        idle, wait, fault = (_is(o, drive, state) for state in RESTING)
        return idle | wait | fault

    def guard(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        drive: Startup,
        i: AlphaBeta,
        v_dc: Reals,
        wanted: Reals,
        run: Any,
    ) -> None:
        """What samples and command permit: faults, the beginning of a try, the end."""
        square = o.let("square", i.alpha * i.alpha + i.beta * i.beta)
        known = (square < _UNKNOWN_SQUARE) & (o.magnitude(v_dc) < _UNKNOWN)
        told = o.let("told", known & (o.magnitude(wanted) < _UNKNOWN))
        resting = o.let("resting", o.call(self.resting, drive))
        commanded = o.negated(o.equal(run, 0))

        def ends() -> None:
            o.call(self.off, drive, state_of(o, StartupState.IDLE))
            drive.fault, drive.tries = fault_of(o, StartupFault.NO_FAULT), 0

        def stops() -> None:
            omega = o.let("omega", o.magnitude(drive.omega_e))
            referred = o.magnitude(drive.reference) > 0.0
            turns = referred | (omega > 0.1 * settings.hand_over)
            low = _is(o, drive, StartupState.LOW) & started_by(o, settings, "saliency") & turns
            ramps = _is(o, drive, StartupState.RAMP) & (omega > 0.0)
            moving = o.let("moving", _is(o, drive, StartupState.RUN) | ramps | low)
            where(o, o.negated(moving), ends, drive)

        def trips(fault: StartupFault) -> None:
            o.call(self.trip, settings, drive, fault_of(o, fault))

        def watched() -> None:
            o.cases(
                "",
                (_is(o, drive, StartupState.IDLE), lambda: o.remark("the command has gone")),
                (o.negated(told), lambda: trips(StartupFault.SAMPLE)),
                (
                    square > settings.trip_A * settings.trip_A,
                    lambda: trips(StartupFault.OVERCURRENT),
                ),
                (v_dc < settings.v_dc_min_V, lambda: trips(StartupFault.UNDERVOLTAGE)),
                otherwise=lambda: o.remark("all is well"),
                changing=(drive,),
            )

        def begins() -> None:
            waited = drive.time >= settings.wait_samples
            again = _is(o, drive, StartupState.WAIT) & waited
            begin = _is(o, drive, StartupState.IDLE) | again
            where(o, begin, lambda: o.call(self.begin, settings, drive, wanted), drive)

        where(o, o.equal(run, 0), stops, drive)
        o.cases(
            "",
            (o.negated(resting), watched),
            (commanded & told, begins),
            otherwise=lambda: o.remark("it rests"),
            changing=(drive,),
        )

    def step(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        observer: Any,
        drive: Startup,
        sample: StartupSample,
        reference: Reals,
        run: Any,
    ) -> StartupOutput:
        """One step: call it at every current sample, with the speed reference in rad/s (mechanical)
        and the command, 1 to run. Without the command the reference goes to zero on its slope, and
        the gate pulses end at rest.
        """
        return self._stepped(o, gains, settings, (observer, None), drive, sample, reference, run)

    def step_from_standstill(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        observer: Any,
        low: Any,
        drive: Startup,
        sample: StartupSample,
        reference: Reals,
        run: Any,
    ) -> StartupOutput:
        """As `step`, with the gains of an estimator from standstill on."""
        return self._stepped(o, gains, settings, (observer, low), drive, sample, reference, run)

    def _stepped(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        estimators: tuple[Any, Any],
        drive: Startup,
        sample: StartupSample,
        reference: Reals,
        run: Any,
    ) -> StartupOutput:
        acted = o.let("acted", drive.acted)
        current = o.let("current", o.clarke(sample.i))
        zero = o.full(0.0, reference)
        asked = o.choose(o.negated(o.equal(run, 0)), gains.pole_pairs * reference, zero)
        wanted = o.let("wanted", asked)
        measured = o.let("measured", Measured(sample.i, drive.theta_e, zero, sample.v_dc))
        half = o.full(0.5, reference)
        output = o.let("output", StartupOutput(self.duty(half, half, half), 1))
        o.remark("computed one period ago: it acts from now on")
        drive.acted = drive.control.v
        o.call(self.guard, settings, drive, current, sample.v_dc, wanted, run)
        shorted = o.cases(
            "shorted",
            (
                _is(o, drive, StartupState.CATCH),
                lambda: o.call(self.catch, gains, settings, drive, current),
            ),
            otherwise=lambda: True,
            changing=(drive,),
        )
        waited = (drive.time >= settings.align_samples) | aligned_by(o, settings, "none")
        where(
            o,
            _is(o, drive, StartupState.ALIGN) & waited,
            lambda: o.call(self.aligned, settings, drive, current, wanted),
            drive,
        )
        self._estimate(o, settings, estimators, drive, sample, (acted, current))
        self._watch(o, gains, settings, drive, measured, (acted, current), wanted)
        self._acts(o, gains, settings, drive, (measured, output), (acted, current), wanted)

        def rests() -> None:
            output.gate = 0

        open_ = _is(o, drive, StartupState.CATCH) & o.negated(shorted)
        where(o, o.call(self.resting, drive) | open_, rests, output)
        drive.time = o.choose(drive.time < _LONGEST, drive.time + 1, drive.time)
        return output

    def _estimate(
        self,
        o: Arithmetic,
        settings: StartupSettings,
        estimators: tuple[Any, Any],
        drive: Startup,
        sample: StartupSample,
        seen: tuple[AlphaBeta, AlphaBeta],
    ) -> None:
        """The estimators that the phase needs; ``seen`` are the voltage that acted and the
        current.
        """
        observer, low = estimators
        ramps = _is(o, drive, StartupState.RAMP)
        if drive.low is not None:
            searching = _is(o, drive, StartupState.SEARCH)
            testing = _is(o, drive, StartupState.POLARITY)
            searched = searching & (drive.time >= settings.search_samples)
            tested = testing & (drive.time >= 2 * settings.polarity_samples)
            where(o, searched | tested, lambda: o.call(self.found, settings, drive), drive)
            by_saliency = started_by(o, settings, "saliency")
            mixed = _is(o, drive, StartupState.LOW) & by_saliency
            searching = _is(o, drive, StartupState.SEARCH)
            testing = _is(o, drive, StartupState.POLARITY)
            where(
                o,
                searching | testing | mixed,
                lambda: o.call(self.low_step, low, drive, *seen),
                drive,
            )
        if self.hears:
            where(
                o,
                _is(o, drive, StartupState.RAMP) & o.equal(drive.agreed, 0),
                lambda: o.call(self.follow_ramp, settings, drive),
                drive,
            )
        ramps, slow, runs = (
            _is(o, drive, state)
            for state in (StartupState.RAMP, StartupState.LOW, StartupState.RUN)
        )
        heard = () if sample.u is None else (sample.u,)
        step = self.around.observer_step
        where(
            o,
            ramps | slow | runs,
            lambda: o.call(step, observer, drive.observer, *seen, *heard),
            drive,
        )

    def _watch(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        measured: Measured,
        seen: tuple[AlphaBeta, AlphaBeta],
        wanted: Reals,
    ) -> None:
        """What a phase ends by."""
        acted, current = seen

        def observed() -> None:
            drive.theta_e = drive.observer.theta_e
            drive.omega_e = drive.observer.omega_e

        def low() -> None:
            if drive.low is None:
                observed()
            else:
                o.cases(
                    "",
                    (
                        started_by(o, settings, "saliency"),
                        lambda: o.call(self.mix, settings, drive, measured),
                    ),
                    otherwise=observed,
                    changing=(drive, measured),
                )
            o.call(self.watch_low, settings, drive)

        def ramp() -> None:
            o.call(self.watch_ramp, gains, settings, drive, current, wanted)

        def runs() -> None:
            o.call(self.watch_run, settings, drive, acted, current)

        o.cases(
            "",
            (_is(o, drive, StartupState.RAMP), ramp),
            (_is(o, drive, StartupState.LOW), low),
            (_is(o, drive, StartupState.RUN), runs),
            otherwise=lambda: o.remark("nothing is watched"),
            changing=(drive, measured),
        )

    def _acts(
        self,
        o: Arithmetic,
        gains: ControlGains,
        settings: StartupSettings,
        drive: Startup,
        samples: tuple[Measured, StartupOutput],
        seen: tuple[AlphaBeta, AlphaBeta],
        wanted: Reals,
    ) -> None:
        """Duty cycles of the phase."""
        (measured, output), (acted, current) = samples, seen

        def align() -> None:
            output.duty = o.call(self.align, gains, settings, drive, measured, acted)

        def ramp() -> None:
            output.duty = o.call(self.ramp, gains, settings, drive, measured, acted, wanted)

        def search() -> None:
            output.duty = o.call(self.search, gains, settings, drive, measured, current)

        def low() -> None:
            output.duty = o.call(self.speed, gains, settings, drive, measured, wanted)

        def runs() -> None:
            drive.theta_e = drive.observer.theta_e
            drive.omega_e = omega = o.let("omega", drive.observer.omega_e)
            back = (wanted * omega) < 0.0
            aim = o.let("aim", o.choose(back, o.full(0.0, wanted), wanted))
            o.remark(
                "the way to the other direction leads through the phases below the observer's "
                "speeds"
            )
            output.duty = o.call(self.speed, gains, settings, drive, measured, aim)

        branches: dict[Any, Any] = {
            state_of(o, StartupState.ALIGN): align,
            state_of(o, StartupState.RAMP): ramp,
        }
        if drive.low is not None:
            places = StartupState.SEARCH, StartupState.POLARITY
            branches[tuple(state_of(o, place) for place in places)] = search
        branches[state_of(o, StartupState.LOW)] = low
        branches[state_of(o, StartupState.RUN)] = runs
        rests = lambda: o.remark("no gate pulses")  # noqa: E731
        changing = drive, measured, output
        o.switch("", drive.state, branches, rests, changing=changing)


def _is(o: Arithmetic, drive: Startup, state: StartupState) -> Any:
    """Whether a drive is in a state."""
    return o.equal(drive.state, state_of(o, state))
