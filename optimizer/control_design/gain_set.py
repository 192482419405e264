"""Gains of every loop and observer that a design asks for."""

from __future__ import annotations

from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.loop_proofs import LoopProofs, prove_loops
from dqforge.optimizer.dynamic_references.solve import DynamicReferences, dynamic_references
from dqforge.optimizer.estimators.solve import TunedTracker, solve_tracker
from dqforge.optimizer.loops.gains import speed_delay, tune_current_loop, tune_speed_loop
from dqforge.optimizer.loops.inductances import inductance_range
from dqforge.optimizer.loops.integer_gains import PerUnitGains, per_unit_gains
from dqforge.optimizer.loops.responses import LoopResponse, loop_responses
from dqforge.optimizer.loops.robustness import (
    RobustSet,
    current_robustness,
    speed_robustness,
    turning_robustness,
    zero_robustness,
)
from dqforge.optimizer.loops.tolerance_box import Axis, DriveBox, drive_box
from dqforge.optimizer.loops.vendor_methods import vendor_inductance
from dqforge.optimizer.observers.solve import solve_observer

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.settings import ControlSettings
    from dqforge.optimizer.box_proofs.current_loop_proof import CurrentLoopProof
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.optimizer.firmware.firmware_loops import FirmwareLoops
    from dqforge.optimizer.loops.loop_batch import PlantBatch
    from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
    from dqforge.optimizer.loops.schedule.gain_schedule import GainSchedule
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver, SpeedErrorSlopes
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.optimizer.phase_control.design import PhaseLoops


AXES: tuple[Axis, Axis] = ("i_d", "i_q")


@dataclass(frozen=True, slots=True)
class GainSet:
    """Gains of both current loops and, where the design asks for them, of the
    speed loop and an observer.

    ``per_unit`` are the gains of each loop between per-unit quantities.
    ``observer`` is the reduced-order speed observer with its errors in ``observer_slopes``,
    ``position`` one of the position; a design has at most one.
    ``robust`` is what they keep over the tolerances (the speed loop only without an observer), None
    where the design names none; ``schedule`` the current loops' gains over the current, None where
    it asks for none. ``phases`` is the current control of a machine whose back-EMF is not
    sinusoidal, None for all others. ``references`` are slopes of the references and voltage
    feedback, None where the design asks for none.
    ``proofs`` are those of single loops. ``firmware`` is what `control.firmware` makes of the
    loops, None where the design names none. ``tracker`` is the tracker of the position in place of
    an observer, None where the design names none. ``measured_speed`` is how an encoder measures the
    speed and what that leaves of the speed loop, None where the speed counts as exact.
    """

    i_d: LoopGains
    i_q: LoopGains
    speed: LoopGains | None
    per_unit: dict[LoopName, PerUnitGains]
    observer: ReducedOrderObserver | None
    observer_slopes: SpeedErrorSlopes | None = None
    robust: RobustSet | None = None
    schedule: GainSchedule | None = None
    position: PositionObserver | None = None
    phases: PhaseLoops | None = None
    proofs: LoopProofs = field(default_factory=LoopProofs)
    references: DynamicReferences | None = None
    firmware: FirmwareLoops | None = None
    tracker: TunedTracker | None = None
    measured_speed: MeasuredSpeed | None = None

    @property
    def loops(self) -> tuple[LoopGains, ...]:
        """All loops: of d, q, the zero sequence and the speed, as far as there are."""
        zero = None if self.phases is None else self.phases.zero
        every = (self.i_d, self.i_q, zero, self.speed)
        return tuple(loop for loop in every if loop is not None)

    def responses(self) -> tuple[LoopResponse, ...]:
        """Answers of the loops over time and frequency, for whom wants to draw them."""
        zero = None if self.phases is None else self.phases.zero
        return loop_responses(self.i_d, self.i_q, self.speed, zero)


@on_design("control")
def solve_current_loops(design: Design) -> tuple[LoopGains, LoopGains]:
    """Gains of both current loops alone, with the data as they are.

    Raises:
        InputError: As `solve_gains`.
        NoSolutionError: A loop is unstable or has too little margin.
    """
    _require_loops(design)
    return _current_loops(design, inductance_range(design.machine, design.i_max)[0], None)


def _require_loops(design: Design) -> None:
    """Refuse a design that has no current loops with gains."""
    if design.control.six_step is not None:
        raise InputError(
            "control.observer: a six-step drive has no loops in rotor coordinates; ask check, run, "
            "tune or simulate about it, or write another observer"
        )
    if design.control.current_loop.switches:
        raise InputError(f"control.current_loop: {_no_gains(design)}")


def _current_loops(
    design: Design, nominal: tuple[float, float], box: DriveBox | None
) -> tuple[LoopGains, LoopGains]:
    """Both current loops at inductances (l_d, l_q) in H, the method ``optimised`` over the corners
    of a box where there is one.
    """
    machine, control = design.machine, design.control
    settings = control.current_loop

    def corners(axis: Axis) -> PlantBatch | None:
        if settings.method != "optimised" or box is None:
            return None
        points = box.current_points(axis)
        return box.current_loop_plants(axis, points).some(np.arange(points.corners))

    i_d, i_q = (
        tune_current_loop(
            machine.r_s,
            nominal[place],
            control.t_s,
            settings,
            axis,
            corners(axis),
            vendor_inductance(settings.method, nominal, place),
        )
        for place, axis in enumerate(AXES)
    )
    return i_d, i_q


@on_design("control")
def solve_gains(design: Design, *, proofs: bool = True) -> GainSet:
    """Gains of the design, every loop checked as it is sampled, and over the
    tolerances where it names any.

    Args:
        design: The design.
        proofs: Whether what takes long is proven and explained, too: margins between the corners of
            the tolerances, corners of an observed loop. Gains, margins and refusals do without, but
            for a drive between the corners that is proven unstable.

    Raises:
        InputError: The design is a six-step drive, or its current loop switches the bridge itself.
    """
    _require_loops(design)
    machine, control = design.machine, design.control
    nominal, largest = inductance_range(machine, design.i_max)
    box = drive_box(design, nominal, largest)
    named = control.tolerances is not None

    def speed_corners() -> PlantBatch | None:
        if control.speed_loop is None or control.speed_loop.method != "optimised":
            return None
        points = box.speed_points()
        return box.speed_loop_plants(points, (i_q.kp, i_q.ki)).some(np.arange(points.corners))

    i_d, i_q = _current_loops(design, nominal, box)
    observer, position = solve_observer(design)
    tracker = solve_tracker(design)
    speed = None
    if control.speed_loop is not None:
        lag = _observer_lag(design, i_q, position, tracker)
        speed = tune_speed_loop(machine, i_q, control, speed_corners(), lag)
    slowed = None
    if speed is not None and position is not None:
        slowed = _spread_of_corners(design, (i_d, i_q, speed), position)
        if slowed is not None:
            speed = tune_speed_loop(machine, i_q, _with_spread(control, slowed), None, lag)
    phases = _phases(design, i_d, i_q)
    robust = None
    zero = None if phases is None else phases.zero
    if named:
        robust = RobustSet(
            current_robustness(box, i_d, "i_d"),
            current_robustness(box, i_q, "i_q"),
            None if speed is None else speed_robustness(box, speed, i_q),
            turning_robustness(box, i_d, i_q) if phases is None else None,
            box.named_limits(),
            None if zero is None else zero_robustness(box, zero),
            _turning(box, i_d, i_q) if phases is None and proofs else None,
        )
    phases = _judged(design, box, phases)
    schedule = _schedule(design, box if named else None, i_d, i_q)
    if speed is not None and any(each is not None for each in (observer, position, tracker)):
        from dqforge.optimizer.control_design.observed_speed_loop import judge_observed

        loops = (i_d, i_q, speed)
        speed = judge_observed(
            design, loops, observer, position, tracker, thorough=proofs, slowed=slowed
        )
        robust = None if robust is None else replace(robust, speed=None)
    measured = _measured(design, i_q, speed)
    if measured is not None:  # corners and proofs know nothing of its delay
        robust = None if robust is None else replace(robust, speed=None)
    exact = speed if measured is None else None
    proven = LoopProofs()
    if proofs:
        proven = prove_loops(box, largest, (i_d, i_q, zero), exact, (robust, schedule))
    if measured is not None and named:
        proven = replace(proven, measured=True)
    scaled = _per_unit(control, (i_d, i_q, zero, speed))
    references = dynamic_references(design, box, (i_d, i_q), speed)
    return GainSet(
        i_d,
        i_q,
        speed,
        scaled,
        observer,
        _slopes(design, observer),
        robust,
        schedule,
        position,
        phases,
        proven,
        references,
        _firmware(design, box, (i_d, i_q, speed)),
        tracker,
        measured,
    )


# What not every design asks for is loaded where one does.


def _phases(design: Design, i_d: LoopGains, i_q: LoopGains) -> PhaseLoops | None:
    if design.phase_machine is None:
        return None
    from dqforge.optimizer.phase_control.design import phase_control

    return phase_control(design, i_d, i_q)


def _judged(design: Design, box: DriveBox, phases: PhaseLoops | None) -> PhaseLoops | None:
    if phases is None:
        return None
    from dqforge.optimizer.phase_control.design import judged

    return judged(design, box, phases)


def _turning(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentLoopProof | None:
    from dqforge.optimizer.control_design.turning_proof import turning_proof

    return turning_proof(box, i_d, i_q)


def _schedule(
    design: Design, box: DriveBox | None, i_d: LoopGains, i_q: LoopGains
) -> GainSchedule | None:
    if not design.control.current_loop.schedule:
        return None
    from dqforge.optimizer.loops.schedule.gain_schedule import schedule_gains

    return schedule_gains(design, box, i_d, i_q)


def _measured(design: Design, i_q: LoopGains, speed: LoopGains | None) -> MeasuredSpeed | None:
    settings = design.control.speed_loop
    if settings is None or settings.measurement is None:
        return None
    from dqforge.optimizer.control_design.measured_speed_loop import measured_speed

    return measured_speed(design, i_q, speed)


def _slopes(design: Design, observer: ReducedOrderObserver | None) -> SpeedErrorSlopes | None:
    if observer is None:
        return None
    from dqforge.optimizer.observers.reduced_order import speed_error_slopes

    return speed_error_slopes(design.machine, observer, design.control.bases.speed)


def _firmware(
    design: Design, box: DriveBox, loops: tuple[LoopGains, LoopGains, LoopGains | None]
) -> FirmwareLoops | None:
    if design.control.firmware is None:
        return None
    from dqforge.optimizer.firmware.firmware_loops import firmware_loops

    return firmware_loops(design, box, loops)


def _observer_lag(
    design: Design,
    i_q: LoopGains,
    position: PositionObserver | None,
    tracker: TunedTracker | None,
) -> float:
    """Lag of the observer in s that the speed loop counts; 0 where it does not."""
    settings = design.control.speed_loop
    if settings is None or not settings.counts_observer:
        return 0.0
    if tracker is not None and tracker.loop is not None:
        return tracker.loop.lag
    if position is None:
        return 0.0
    delays = speed_delay(i_q, design.control.t_s, settings)
    from dqforge.optimizer.observed_drive.tuning_rule import speed_lag

    return speed_lag(position, delays, settings.spread)


def _spread_of_corners(
    design: Design, loops: tuple[LoopGains, LoopGains, LoopGains], position: PositionObserver
) -> float | None:
    """Spread with which the rule's speed loop holds at every corner; None where its own one does,
    no slower one does, or the spread is given.
    """
    settings = design.control.speed_loop
    if settings is None or not settings.counts_observer:
        return None
    from dqforge.optimizer.control_design.observed_speed_loop import held_by_corners

    factor = held_by_corners(design, loops, position)
    return None if factor is None or factor == 1.0 else settings.spread / factor


def _with_spread(control: ControlSettings, spread: float) -> ControlSettings:
    assert control.speed_loop is not None
    return replace(control, speed_loop=replace(control.speed_loop, spread=spread))


def _per_unit(
    control: ControlSettings, loops: tuple[LoopGains | None, ...]
) -> dict[LoopName, PerUnitGains]:
    """Gains of every loop per unit, with the integers that its section asks for."""
    found = {}
    for loop in loops:
        if loop is not None:
            section = control.speed_loop if loop.loop == "speed" else control.current_loop
            found[loop.loop] = per_unit_gains(
                loop, control.bases, None if section is None else section.q_formats
            )
    return found


def _no_gains(design: Design) -> str:
    method = design.control.current_loop.method
    return f"the method '{method}' switches the bridge itself and has no gains"


def gains_or_reason(design: Design, *, proofs: bool = True) -> tuple[GainSet | None, str]:
    """Gains of the design, or None and why there are none where it can do without.

    Args:
        design: The design.
        proofs: As in `solve_gains`.

    Raises:
        NoSolutionError: As `solve_gains`, of a design that asks for control.
    """
    if design.control.six_step is not None:
        return None, "a six-step drive has no loops in rotor coordinates"
    if design.control.gains == "none":
        return None, "control.gains is false"
    if design.control.current_loop.switches:
        return None, _no_gains(design)
    try:
        return solve_gains(design, proofs=proofs), ""
    except NoSolutionError as error:
        if design.control.gains == "required":
            raise
        return None, f"no loop was asked for and none was found: {error.message}"
