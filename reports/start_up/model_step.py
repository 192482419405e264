"""The step of the start-up in single precision, as ``step.j2`` has it."""

from __future__ import annotations

from typing import Any

from dqforge.reports.c_code.float32_functions import SINGLE
from dqforge.reports.start_up.float32_model import (
    RESTING,
    F,
    Fault,
    Settings,
    StartUpModel,
    State,
    Vector,
    first_drive,
    observer_step,
    off,
    pair,
    scalar,
    trip,
    vector_of,
)
from dqforge.reports.start_up.model_phases import Duties, Phases
from dqforge.reports.start_up.phase_hand_over import follow_ramp

_ZERO, _HALF = F(0.0), F(0.5)


_MOST = 2_147_483_647


def _guard(phases: Phases, i: Vector, v_dc: Any, wanted: Any, run: int) -> None:
    """As ``<prefix>_startup_guard``."""
    model, s, drive = phases.model, phases.s, phases.drive
    square = (i[0] * i[0]) + (i[1] * i[1])
    told = square < F(1e30) and abs(v_dc) < F(1e15) and abs(wanted) < F(1e15)
    resting = drive.state in RESTING
    if run == 0:
        low = drive.state == State.LOW and s.method == 3
        moving = (
            drive.state == State.RUN
            or (drive.state == State.RAMP and abs(drive.omega_e) > _ZERO)
            or (low and (abs(drive.reference) > _ZERO or abs(drive.omega_e) > F(0.1) * s.hand_over))
        )
        if not moving:
            off(model, drive, State.IDLE)
            drive.fault, drive.tries = Fault.NO_FAULT, 0
    if not resting:
        if drive.state == State.IDLE:
            return
        if not told:
            trip(model, s, drive, Fault.SAMPLE)
        elif square > s.trip_A * s.trip_A:
            trip(model, s, drive, Fault.OVERCURRENT)
        elif v_dc < s.v_dc_min_V:
            trip(model, s, drive, Fault.UNDERVOLTAGE)
    elif run != 0 and told:
        waited = drive.state == State.WAIT and drive.time >= s.wait_samples
        if drive.state == State.IDLE or waited:
            phases.begin(wanted)


class StartUpRun:
    """One drive that starts, step by step; ``settings`` None for those of the model."""

    def __init__(self, model: StartUpModel, settings: dict[str, float] | None = None) -> None:
        """As ``<prefix>_startup_init``."""
        own = Settings(model.settings if settings is None else settings)
        self.model, self.drive = model, first_drive(model)
        self.phases = Phases(model, own, self.drive)

    def _estimate(self, acted: Vector, current: Vector, u: Any) -> None:
        model, s, drive = self.model, self.phases.s, self.drive
        if model.low is not None:
            done = (drive.state == State.SEARCH and drive.time >= s.search_samples) or (
                drive.state == State.POLARITY and drive.time >= 2 * s.polarity_samples
            )
            if done:
                self.phases.found()
            if drive.state in (State.SEARCH, State.POLARITY) or (
                drive.state == State.LOW and s.method == 3
            ):
                tracker, gains = model.low
                assert drive.low is not None
                drive.low = tracker.step(gains, drive.low, pair(*acted), pair(*current), (), SINGLE)
                drive.control.added = drive.low.added
        if model.hears and drive.state == State.RAMP and drive.agreed == 0:
            follow_ramp(model, s, drive)
        if drive.state in (State.RAMP, State.LOW, State.RUN):
            drive.observer = observer_step(model, drive.observer, acted, current, u)

    def _watch(self, acted: Vector, current: Vector, wanted: Any) -> Duties:
        """Speed-driven changes; the currents for the controllers."""
        drive, phases = self.drive, self.phases
        seen = phases.phases
        if drive.state == State.RAMP:
            phases.watch_ramp(current, wanted)
        elif drive.state == State.LOW:
            if self.model.low is not None and phases.s.method == 3:
                seen = phases.mix()
            else:
                drive.theta_e = scalar(drive.observer.theta_e)
                drive.omega_e = scalar(drive.observer.omega_e)
            phases.watch_low()
        elif drive.state == State.RUN:
            phases.watch_run(acted, current)
        return seen

    def step(
        self, i: Duties, v_dc: Any, reference: Any, run: int, u: Any = _ZERO
    ) -> tuple[Duties, int]:
        """Duty cycles and whether there are gate pulses, as ``<prefix>_startup_step``; ``u`` in V
        is the mean sum of the phase voltages, for a tracker that is told it.
        """
        drive, phases, s = self.drive, self.phases, self.phases.s
        acted, current = drive.acted, vector_of(i)
        wanted = phases.pole_pairs * F(reference) if run != 0 else _ZERO
        phases.phases, phases.v_dc = i, F(v_dc)
        duty: Duties = (_HALF, _HALF, _HALF)
        shorted = True
        drive.acted = drive.made
        _guard(phases, current, F(v_dc), wanted, run)
        if drive.state == State.CATCH:
            shorted = phases.catch(current)
        if drive.state == State.ALIGN and (drive.time >= s.align_samples or s.alignment == 0):
            phases.aligned(current, wanted)
        self._estimate(acted, current, u)
        seen = self._watch(acted, current, wanted)
        if drive.state == State.ALIGN:
            duty = phases.align(current, acted)
        elif drive.state == State.RAMP:
            duty = phases.ramp(current, acted, wanted)
        elif drive.state in (State.SEARCH, State.POLARITY):
            duty = phases.search(current)
        elif drive.state == State.LOW:
            duty = phases.speed(seen, wanted)
        elif drive.state == State.RUN:
            drive.theta_e = scalar(drive.observer.theta_e)
            drive.omega_e = scalar(drive.observer.omega_e)
            duty = phases.speed(seen, _ZERO if wanted * drive.omega_e < _ZERO else wanted)
        resting = drive.state in RESTING or (drive.state == State.CATCH and not shorted)
        drive.time = min(drive.time + 1, _MOST)
        return duty, 0 if resting else 1
