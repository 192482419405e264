"""What is proven of each loop by itself: margins over the tolerances, the speed loop, changing
inductances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.machines.units.quantities import signed_percent
from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    CurrentLoopBox,
    largest_moduli,
    loop_matrices,
    parameters_of,
)
from dqforge.optimizer.certificates.current_loop_proof import (
    CurrentLoopProof,
    prove_current_loops,
    prove_sensitivity,
)
from dqforge.optimizer.dynamic_references import DynamicReferences, dynamic_references
from dqforge.optimizer.estimators import TunedTracker, solve_tracker
from dqforge.optimizer.loops.integer_gains import (
    LoopResponse,
    PerUnitGains,
    inductance_range,
    loop_responses,
    per_unit_gains,
)
from dqforge.optimizer.loops.loop_gains import speed_delay, tune_current_loop, tune_speed_loop
from dqforge.optimizer.loops.pi_methods import vendor_inductance
from dqforge.optimizer.loops.robustness import (
    Axis,
    DriveBox,
    RobustSet,
    RotatingAxes,
    current_robustness,
    drive_box,
    rotating_axes,
    speed_robustness,
    turning_robustness,
    unstable_together,
    zero_robustness,
)
from dqforge.optimizer.observers.solve import solve_observer

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.settings import ControlSettings
    from dqforge.optimizer.axis_margins import ProvenMargins
    from dqforge.optimizer.changing_loops import ChangingAxis
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.optimizer.firmware.gain_search import FirmwareLoops
    from dqforge.optimizer.loops.gain_schedule import GainSchedule
    from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
    from dqforge.optimizer.loops.pi_methods import PlantBatch
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver, SpeedErrorSlopes
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.optimizer.phase_control.design import PhaseLoops
    from dqforge.optimizer.speed_box import SpeedProof


@dataclass(frozen=True, slots=True)
class LoopProofs:
    """Proofs of single loops.

    Args:
        margins: Of each current loop over the tolerances; empty without them.
        speed: Of the speed loop over the tolerances; None without them, or with an observer.
        observed: Whether there is a speed loop with tolerances whose speed is observed, of which
            nothing is proven.
        changing: Of both axes of a machine that saturates while the inductances change; empty for
            others.
        measured: The same as ``observed`` where an encoder's edges make the speed.
    """

    margins: Mapping[LoopName, ProvenMargins] = field(default_factory=dict)
    speed: SpeedProof | None = None
    observed: bool = False
    changing: tuple[ChangingAxis, ...] = ()
    measured: bool = False


def prove_margins_of(
    box: DriveBox, loops: tuple[LoopGains | None, ...], robust: RobustSet
) -> dict[LoopName, ProvenMargins]:
    """Margins of the current loops over the tolerances.

    Args:
        box: The drive with its tolerances.
        loops: Loops of d, q and the zero sequence, None where there is none.
        robust: What corners and samples found.
    """
    found = {"i_d": robust.i_d, "i_q": robust.i_q, "i_0": robust.i_0}
    proven: dict[LoopName, ProvenMargins] = {}
    for loop in loops:
        worst = None if loop is None else found[loop.loop]
        if loop is not None and worst is not None:
            from dqforge.optimizer.axis_margins import prove_margins

            proven[loop.loop] = prove_margins(box, loop, worst)
    return proven


def prove_loops(
    box: DriveBox,
    largest: tuple[float, float],
    currents: tuple[LoopGains, LoopGains, LoopGains | None],
    speed: LoopGains | None,
    found: tuple[RobustSet | None, GainSchedule | None],
) -> LoopProofs:
    """All proofs of single loops of a design whose gains are found.

    Args:
        box: The drive with its tolerances.
        largest: Largest incremental inductances (l_d, l_q) along the reference, in H.
        currents: Current loops of d, q and the zero sequence (None where there is none).
        speed: The speed loop, None where there is none.
        found: What corners and samples found (None without tolerances), and the gains over the
            current.

    Raises:
        NoSolutionError: The speed loop is unstable between the corners and samples; names the
            drive.
    """
    i_d, i_q, _ = currents
    robust, schedule = found
    changing: tuple[ChangingAxis, ...] = ()
    if box.design.phase_machine is None and not isinstance(box.design.machine, LinearMachine):
        from dqforge.optimizer.changing_loops import prove_changing_currents

        changing = prove_changing_currents(box, largest, (i_d, i_q), schedule)
    if robust is None:
        return LoopProofs(changing=changing)
    observed = speed is not None and speed.observed is not None
    proof = None
    if speed is not None and not observed:
        from dqforge.optimizer.speed_box import prove_speed_loop

        proof = prove_speed_loop(box, speed, i_q, thorough=box.tolerances.thorough)
        if proof.unstable is not None:
            raise _refusal(proof.unstable)
    return LoopProofs(prove_margins_of(box, currents, robust), proof, observed, changing)


def _refusal(unstable: Mapping[str, float]) -> NoSolutionError:
    at = ", ".join(f"{name} {signed_percent(value)}" for name, value in unstable.items())
    return NoSolutionError(
        f"control.speed_loop: within control.tolerances the speed loop is unstable at {at}, "
        "between the corners and points that were tried; ask for a slower loop, or narrow "
        "control.tolerances"
    )


# Gains of every loop and observer that a design asks for.

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
    speed and what that leaves of the speed loop, None where the speed counts as exact. ``rotating``
    are both current loops together on the data alone, None for machines that are judged in phases.
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
    rotating: RotatingAxes | None = None

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
        from dqforge.optimizer.control_design.measured_speed_loop import judge_observed

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
    scaled = per_unit_of(control, (i_d, i_q, zero, speed))
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
        rotating_axes(box, i_d, i_q) if phases is None else None,
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

    return turning_proof(box, i_d, i_q)


def _schedule(
    design: Design, box: DriveBox | None, i_d: LoopGains, i_q: LoopGains
) -> GainSchedule | None:
    if not design.control.current_loop.schedule:
        return None
    from dqforge.optimizer.loops.gain_schedule import schedule_gains

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

    v_d = linear_voltage(design.inverter.v_dc)
    return speed_error_slopes(design.machine, observer, design.control.bases.speed, v_d)


def _firmware(
    design: Design, box: DriveBox, loops: tuple[LoopGains, LoopGains, LoopGains | None]
) -> FirmwareLoops | None:
    if design.control.firmware is None:
        return None
    from dqforge.optimizer.firmware.gain_search import firmware_loops

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
    from dqforge.optimizer.control_design.design_drive import speed_lag

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
    from dqforge.optimizer.control_design.measured_speed_loop import held_by_corners

    factor = held_by_corners(design, loops, position)
    return None if factor is None or factor == 1.0 else settings.spread / factor


def _with_spread(control: ControlSettings, spread: float) -> ControlSettings:
    assert control.speed_loop is not None
    return replace(control, speed_loop=replace(control.speed_loop, spread=spread))


def per_unit_of(
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
        return None, f"no loop was requested and none was found: {error.message}"


# Both current loops of a design together, proven stable over its tolerances.


def current_loop_box(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentLoopBox | None:
    """All that a proof of both current loops depends on; None where the machine states no largest
    speed.

    Args:
        box: The drive with its tolerances.
        i_d, i_q: The current loops.
    """
    machine, control = box.design.machine, box.design.control
    if machine.omega_m_max is None:
        return None
    low_d, high_d = box.inductance_limits("i_d")
    low_q, high_q = box.inductance_limits("i_q")
    low_r, high_r = box.tolerances.limits("r_s")
    low_v, high_v = box.tolerances.limits("v_dc")
    low_t, high_t = box.tolerances.limits("dead_time")
    per_second = box.dead_time_resistance if high_t > low_t else 0.0
    return CurrentLoopBox(
        t_s=control.t_s,
        kp=(i_d.kp, i_q.kp),
        ki_ts=(i_d.ki_ts, i_q.ki_ts),
        decoupling=(machine.l_d, machine.l_q),
        r_s=(machine.r_s * (1.0 + low_r), machine.r_s * (1.0 + high_r)),
        dead_time=(per_second * low_t + 0.0, per_second * high_t),  # no -0
        l_d=(box.nominal[0] * (1.0 + low_d), box.nominal[0] * (1.0 + high_d)),
        l_q=(box.nominal[1] * (1.0 + low_q), box.nominal[1] * (1.0 + high_q)),
        gain=(1.0 + low_v, 1.0 + high_v),
        omega_e=machine.pole_pairs * machine.omega_m_max,
    )


def turning_proof(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentLoopProof | None:
    """What is proven of both current loops together over the tolerances; None where the machine
    states no largest speed.

    Args:
        box: The drive with its tolerances.
        i_d, i_q: The current loops.

    Raises:
        NoSolutionError: The loops are unstable at a drive between the corners and points that were
            tried; names it.
    """
    inputs = current_loop_box(box, i_d, i_q)
    if inputs is None:
        return None
    proof = prove_current_loops(inputs)
    if proof.counterexample is not None:
        raise _turning_proof_refusal(box, inputs, proof.counterexample)
    if not proof.proven:
        return proof
    return replace(proof, sensitivity=prove_sensitivity(inputs, proof.left))


def _turning_proof_refusal(
    box: DriveBox, inputs: CurrentLoopBox, drive: BoxDrive
) -> NoSolutionError:
    machine = box.design.machine
    rpm = in_rpm(drive.omega_e / machine.pole_pairs)
    point = parameters_of(inputs, drive)
    radius = float(largest_moduli(loop_matrices(inputs, point[None]))[0])
    shares = (
        ("l_d", drive.l_d / box.nominal[0]),
        ("l_q", drive.l_q / box.nominal[1]),
        ("v_dc", drive.gain),
    )
    parts = [f"{rpm:.4g} rpm, {drive.r_s:.4g} Ohm"]
    parts += [f"{name} {signed_percent(share - 1.0)}" for name, share in shares]
    return unstable_together(", ".join(parts), radius)
