"""Gains of every loop and observer that a design asks for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import ControlSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.control_design.loop_proofs import LoopProofs, prove_loops
from dqforge.optimizer.control_design.observed_speed_loop import judge_observed
from dqforge.optimizer.control_design.turning_proof import turning_proof
from dqforge.optimizer.dynamic_references.solve import DynamicReferences, dynamic_references
from dqforge.optimizer.firmware.firmware_loops import FirmwareLoops, firmware_loops
from dqforge.optimizer.loops.gains import tune_current_loop, tune_speed_loop
from dqforge.optimizer.loops.inductances import inductance_range
from dqforge.optimizer.loops.integer_gains import PerUnitGains, per_unit_gains
from dqforge.optimizer.loops.loop_batch import PlantBatch
from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
from dqforge.optimizer.loops.responses import LoopResponse, loop_responses
from dqforge.optimizer.loops.robustness import (
    RobustSet,
    current_robustness,
    speed_robustness,
    turning_robustness,
    zero_robustness,
)
from dqforge.optimizer.loops.schedule.gain_schedule import GainSchedule, schedule_gains
from dqforge.optimizer.loops.tolerance_box import Axis, drive_box
from dqforge.optimizer.loops.vendor_methods import vendor_inductance
from dqforge.optimizer.observers.reduced_order import (
    ReducedOrderObserver,
    SpeedErrorSlopes,
    speed_error_slopes,
)
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.phase_control.design import PhaseLoops, judged, phase_control

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
    loops, None where the design names none.
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
def solve_gains(design: Design) -> GainSet:
    """Gains of the design, every loop checked as it is sampled, and over the
    tolerances where it names any.
    """
    machine, control = design.machine, design.control
    nominal, largest = inductance_range(machine, design.i_max)
    box = drive_box(design, nominal, largest)
    named = control.tolerances is not None

    def axis_corners(axis: Axis) -> PlantBatch | None:
        if control.current_loop.method != "optimised":
            return None
        points = box.current_points(axis)
        return box.current_loop_plants(axis, points).some(np.arange(points.corners))

    def speed_corners() -> PlantBatch | None:
        if control.speed_loop is None or control.speed_loop.method != "optimised":
            return None
        points = box.speed_points()
        return box.speed_loop_plants(points, (i_q.kp, i_q.ki)).some(np.arange(points.corners))

    settings = control.current_loop
    i_d, i_q = (
        tune_current_loop(
            machine.r_s,
            nominal[place],
            control.t_s,
            settings,
            axis,
            axis_corners(axis),
            vendor_inductance(settings.method, nominal, place),
        )
        for place, axis in enumerate(AXES)
    )
    speed = (
        tune_speed_loop(machine, i_q, control, speed_corners())
        if control.speed_loop is not None
        else None
    )
    observer, position = solve_observer(design)
    phases = None if design.phase_machine is None else phase_control(design, i_d, i_q)
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
            turning_proof(box, i_d, i_q) if phases is None else None,
        )
    phases = None if phases is None else judged(design, box, phases)
    wanted = control.current_loop.schedule
    schedule = schedule_gains(design, box if named else None, i_d, i_q) if wanted else None
    if speed is not None and (observer is not None or position is not None):
        speed = judge_observed(design, (i_d, i_q, speed), observer, position)
        robust = None if robust is None else replace(robust, speed=None)
    proofs = prove_loops(box, largest, (i_d, i_q, zero), speed, (robust, schedule))
    scaled = _per_unit(control, (i_d, i_q, zero, speed))
    slopes = (
        None if observer is None else speed_error_slopes(machine, observer, control.bases.speed)
    )
    references = dynamic_references(design, box, (i_d, i_q), speed)
    firmware = firmware_loops(design, box, (i_d, i_q, speed))
    return GainSet(
        i_d,
        i_q,
        speed,
        scaled,
        observer,
        slopes,
        robust,
        schedule,
        position,
        phases,
        proofs,
        references,
        firmware,
    )


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


def gains_or_reason(design: Design) -> tuple[GainSet | None, str]:
    """Gains of the design, or None and why there are none where it can do without.

    Raises
    ------
    NoSolutionError
        As `solve_gains`, of a design that asks for control.
    """
    if design.control.gains == "none":
        return None, "control.gains is false"
    try:
        return solve_gains(design), ""
    except NoSolutionError as error:
        if design.control.gains == "required":
            raise
        return None, f"no loop was asked for and none was found: {error.message}"
