"""A drive whose regulator switches the bridge itself, in the time domain: the emitted speed loop,
references and sampled rule around a plant with every switching instant, dead time and voltage drop.

Comparators, triangle and analogue integrators are hardware: they are part of the plant, exact in
time, with the errors of the current sensors but without their converters.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.machines.names import ANALOGUE_METHODS
from dqforge.machines.plants.scenario import Profile, Scenario, constant
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.current_feedback.closed_drive import (
    COUNTED,
    ClosedPoint,
    CountedLosses,
    counted_losses,
    iron_losses,
    least_pattern_speed,
    not_run,
    own_feedback,
    pattern_table,
)
from dqforge.optimizer.current_feedback.regulator_runs import (
    METHODS,
    RegulatorPlan,
    WorkingPoints,
)
from dqforge.optimizer.losses.drive_budget import known_bridge
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.simulation.design_run import (
    DriveSimulation,
    controller_files,
    drive_of,
    evaluate,
    recorded_stride,
    require_scenario,
)
from dqforge.reports.simulation.plant_input import (
    BRIDGE_PARAMETERS,
    BRIDGE_STATES,
    COLUMNS,
    PARAMETERS,
    STATES,
    SUMMARY,
    RunInput,
    run_input,
    sub_steps,
)
from dqforge.reports.simulation.recorded_run import (
    BINS,
    MOST_ANGLES,
    BridgeFigures,
    BridgeRecord,
    BridgeUse,
    Progress,
    Simulation,
    Simulator,
    Switching,
    as_recorded,
    execute,
    records_of,
    simulator,
)
from dqforge.reports.single_headers.current_feedback import rule_files

_FAMILY = math.radians(6.0)  # Between neighbours of one family the angles differ by less.
_BEYOND = 1.15  # Speed up to which patterns are made, over the largest asked for.
_LEAST_FUNDAMENTAL = 0.02  # Of the largest current: below, distortion says nothing.
_REACH = 2.5  # Last place of the grid of currents over the largest current.
_PIECES = 20  # Pieces of a control period at least, between which comparators are looked at.
_NEVER = 1e30  # Sampling period in s of a regulator that does not sample.
_ACCURACY = 1e-9  # Of a comparator's instant, over its threshold's scale.
_SETTLED = 60.0  # Time in which a speed loop settles, times its crossover.
_PERIODS, _WATCHED = 40.0, 20.0  # Electrical periods after that, and those that are looked at.
_SMALL = 1e-3  # Share of the largest current within which the drops pass through zero.


def closed_solution(design: Design, solution: Solution | None = None) -> Solution:
    """What the controller around the regulator is emitted from.

    Args:
        design: Its current loop switches the bridge.
        solution: That of the design, where it is there already; else the least that is needed.
    """
    if solution is not None and solution.current_feedback is not None:
        return replace(solution, loops=solution.current_feedback.gains)
    found = own_feedback(design)
    control = solve_control(design)
    return replace(control, loops=found.gains, current_feedback=found)


def feedback_files(design: Design, solution: Solution) -> dict[str, bytes]:
    """Headers that the simulation compiles: references, speed loop, and a sampled rule's."""
    found = solution.current_feedback
    rule = {} if found is None else rule_files(design, found)
    return controller_files(solution) | rule


def _plan_parameters(design: Design, plan: RegulatorPlan | None) -> dict[str, float]:
    """Numbers of the regulator, zeros with a carrier."""
    v_dc, machine = design.inverter.v_dc, linearised(design.machine)
    values = dict.fromkeys(BRIDGE_PARAMETERS, 0.0) | {
        "triangle": v_dc,
        "most_volts": linear_voltage(v_dc),
        "interval": _NEVER,
    }
    if plan is None:
        return values
    ramp = plan.method == "ramp-comparison"
    sampled = plan.method not in ANALOGUE_METHODS
    return values | {
        "band": plan.band,
        "kp": plan.kp,
        "ki": plan.ki,
        "carrier": plan.carrier,
        "comparator_band": plan.comparator_band,
        "interval": 0.5 / plan.carrier if ramp else plan.t_s if sampled else _NEVER,
        "accuracy": _ACCURACY * (v_dc if ramp else plan.band),
        "pulses": float(plan.pulses),
        "family": _FAMILY,
        "least_speed": least_pattern_speed(design, plan),
        "model_r": machine.r_s,
        "model_l_d": machine.l_d,
        "model_l_q": machine.l_q,
        "model_psi": machine.psi_pm,
    }


def _fastest(design: Design, scenario: Scenario) -> float:
    """Largest electrical speed in rad/s that a scenario is to reach."""
    asked = [abs(scenario.omega_m), scenario.reference.largest if scenario.mode == "speed" else 0.0]
    if scenario.shaft is not None:
        asked.append(scenario.shaft.largest)
    elif scenario.mode != "speed":
        asked.append(design.machine.omega_m_max or design.control.bases.speed)
    return _BEYOND * design.machine.pole_pairs * max(asked)


def _pattern_rows(design: Design, scenario: Scenario, plan: RegulatorPlan) -> FloatArray:
    """Angles in a quarter, fundamental over half the link, first level, and the angles: (P, 15)."""
    patterns = pattern_table(design, plan, _fastest(design, scenario))
    rows = np.zeros((len(patterns), 3 + MOST_ANGLES))
    for row, pattern in zip(rows, patterns, strict=True):
        index = float(pattern.amplitudes(np.ones(1))[0])
        row[:3] = pattern.angles.size, index, pattern.sign
        row[3 : 3 + pattern.angles.size] = pattern.angles
    return rows


def bridge_input(
    design: Design,
    scenario: Scenario,
    plan: RegulatorPlan | None,
    stride: int,
    tail: float = 0.9,
) -> RunInput:
    """Numbers of one run with a counted bridge.

    Args:
        design: The drive.
        scenario: What it goes through; every switching instant is simulated.
        plan: The regulator, None for a carrier.
        stride: Samples per recorded row.
        tail: Share of the duration from which the figures of the last part count.
    """
    drive, inverter = drive_of(design), design.inverter
    run = run_input(drive, scenario, stride=stride, tail=tail)
    tables = known_bridge(inverter)
    top = _REACH * design.i_max
    size = np.linspace(0.0, top, BINS)
    coolant = tables.coolant_temperature
    drops = [
        np.array([np.interp(coolant, tables.temperatures, column) for column in table.at(size).T])
        for table in (tables.channel, tables.diode or tables.channel)
    ]
    pieces = max(sub_steps(drive, scenario), _PIECES)
    machine = linearised(design.machine)
    # Around zero the drop is a resistance; its time constant stays longer than a piece.
    offset, least = max(float(drop[1]) for drop in drops), min(machine.l_d, machine.l_q)
    parameters = _plan_parameters(design, plan) | {
        "grid": drive.t_s / pieces,
        "usage_top": top,
        "drop_band": max(_SMALL * design.i_max, offset * drive.t_s / pieces / least),
        "synchronous": 1.0 if tables.synchronous else 0.0,
    }
    if plan is not None and plan.method == "trajectory":
        rows = _pattern_rows(design, scenario, plan)
        parameters["patterns"] = float(len(rows))
        drops.append(rows.ravel())
    return RunInput(
        run.parameters | parameters,
        (*run.tables, np.concatenate(drops)),
        PARAMETERS + BRIDGE_PARAMETERS,
    )


def _uses(numbers: FloatArray) -> tuple[BridgeUse, BridgeUse, float]:
    """What was counted over the run, and over its last part; peak to peak of the torque in N m
    there.
    """
    size = 2 * len(COUNTED) * BINS
    width = size + 7 + len(STATES) + len(BRIDGE_STATES)
    whole, before = numbers[:width], numbers[width : 2 * width]
    low, high = numbers[2 * width : 2 * width + 2]

    def use(row: FloatArray) -> BridgeUse:
        states = dict(zip((*STATES, *BRIDGE_STATES), row[size + 7 :], strict=True))
        return BridgeUse(
            counted=row[:size].reshape(2, len(COUNTED), BINS),
            edges=row[size : size + 3],
            up=row[size + 3 : size + 6],
            duration=float(row[size + 6]),
            states={name: float(value) for name, value in states.items()},
        )

    return use(whole), use(whole - before), float(high - low)


def _figures(design: Design, numbers: FloatArray) -> BridgeFigures:
    whole, tail, ripple = _uses(numbers)
    tables, top = known_bridge(design.inverter), _REACH * design.i_max
    losses: list[CountedLosses] = [
        counted_losses(tables, use.counted, top, use.duration) for use in (whole, tail)
    ]
    time, states = tail.duration, tail.states
    i_d, i_q = states["charge_d"] / time, states["charge_q"] / time
    torque = states["torque"] / time
    # The vector's mean square, of which that of the mean is the fundamental.
    square = 2.0 * states["i_square"] / time
    fundamental = i_d * i_d + i_q * i_q
    beside = max(square - fundamental, 0.0)
    least = (_LEAST_FUNDAMENTAL * design.i_max) ** 2
    return BridgeFigures(
        use=whole,
        tail=tail,
        frequency=float(np.sum(whole.edges)) / (6.0 * whole.duration),
        tail_frequency=float(np.sum(tail.edges)) / (6.0 * time),
        distortion=math.sqrt(beside / fundamental) if fundamental > least else math.nan,
        ripple_current=math.sqrt(0.5 * beside),
        torque=torque,
        torque_ripple=ripple,
        torque_rms=math.sqrt(max(states["torque_square"] / time - torque * torque, 0.0)),
        i_d=i_d,
        i_q=i_q,
        copper=states["e_copper"] / time,
        shaft=states["e_shaft"] / time,
        link=states["e_link"] / time,
        conduction=(losses[0].conduction, losses[1].conduction),
        switching=(losses[0].switching, losses[1].switching),
        blanked=(losses[0].blanked, losses[1].blanked),
        junction_temperature=losses[1].junction_temperature,
    )


def simulate_bridge(
    program: Simulator,
    design: Design,
    scenario: Scenario,
    plan: RegulatorPlan | None,
    *,
    stride: int = 1,
    tail: float = 0.9,
    progress: Progress | None = None,
) -> Simulation:
    """Run a drive whose bridge is counted.

    Args:
        program: Compiled for what switches.
        design, scenario, plan, stride, tail: As for `bridge_input`.
        progress: Called with the share that is done.

    Raises:
        NoSolutionError: The comparators chatter.
        VerificationError: The program cannot be run.
    """
    switched = replace(scenario, inverter="switched")
    run = bridge_input(design, switched, plan, stride, tail)
    if progress is not None:
        run.parameters["progress"] = 1.0
    written = execute(program.program, np.array([1.0]).tobytes() + run.content(), progress)
    ((figures, rows),) = records_of(written, 1)
    if figures[0] == 2.0:
        raise NoSolutionError(
            "control.current_loop: the comparators chatter: the regulators' output is steeper than "
            "the triangle; write a smaller kp, a faster carrier, or comparator_band: 5 V"
        )
    numbers = np.frombuffer(written, dtype=np.float64)[len(SUMMARY) + 3 + rows.size :]
    recorded = as_recorded(switched, figures, rows, None)
    edges = np.ascontiguousarray(rows[:, len(COLUMNS)])
    return replace(recorded, bridge=BridgeRecord(edges, _figures(design, numbers)))


@on_design("simulation")
def simulate_feedback(
    design: Design, *, solution: Solution | None = None, progress: Progress | None = None
) -> DriveSimulation:
    """Run the scenario of a design whose current loop switches the bridge.

    Args:
        design: With a section ``simulation``.
        solution: That of the design, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: There is no such section.
        NoSolutionError: The comparators chatter, or there is no speed loop over the regulator.
        VerificationError: There is no C compiler, or a header does not compile.
    """
    scenario = require_scenario(design)
    whole = closed_solution(design, solution)
    found = whole.current_feedback
    assert found is not None
    stride = recorded_stride(scenario, design.control.t_s)
    files, prefix = feedback_files(design, whole), design.export.prefix
    with simulator(files, prefix, bridge=found.plan.method) as program:
        run = simulate_bridge(
            program, design, scenario, found.plan, stride=stride, progress=progress
        )
    return evaluate(design, run)


# All regulators in the closed drive at loads, and the carrier beside them.


def _with_loop(design: Design, loop: CurrentLoopSettings) -> Design:
    return replace(design, control=replace(design.control, current_loop=loop))


def _periods_per_second(design: Design, omega_m: float) -> float:
    return design.machine.pole_pairs * abs(omega_m) / (2.0 * math.pi)


def load_scenario(design: Design, torque: float, omega_m: float, crossover: float) -> Scenario:
    """A drive that turns already meets a load that grows, and settles.

    A load that comes at once may hold a drive at its voltage limit, below its speed.

    Args:
        design: The drive.
        torque, omega_m: Of the machine in N m, and mechanical speed in rad/s.
        crossover: Of its speed loop in rad/s.
    """
    electrical = _periods_per_second(design, omega_m)
    load = torque - design.machine.friction * omega_m
    return Scenario(
        duration=_SETTLED / crossover + _PERIODS / electrical,
        mode="speed",
        reference=constant(omega_m),
        load=Profile((0.0, 0.5 * _SETTLED / crossover), (0.0, load), "linear"),
        omega_m=omega_m,
    )


def _point(design: Design, name: str, run: Simulation, omega_m: float) -> ClosedPoint:
    assert run.bridge is not None
    seen = run.bridge.figures
    time = seen.tail.duration
    # The angle through which the shaft turned, over the time.
    speed = seen.tail.states["theta_m"] / time
    fundamental = 1.5 * design.machine.r_s * (seen.i_d**2 + seen.i_q**2)
    iron, ripple = iron_losses(design, seen.i_d, seen.i_q, speed, seen.tail_frequency)
    return ClosedPoint(
        name=name,
        torque=seen.torque,
        omega_m=speed,
        speed_error=speed - omega_m,
        frequency=seen.tail_frequency,
        distortion=seen.distortion,
        torque_ripple=seen.torque_rms,
        copper=fundamental,
        ripple_copper=max(seen.copper - fundamental, 0.0),
        iron=iron,
        ripple_iron=ripple,
        conduction=seen.conduction[1],
        switching=seen.switching[1],
    )


def closed_points(
    design: Design, points: WorkingPoints, switching: Switching
) -> tuple[ClosedPoint, ...]:
    """A regulator, or the carrier, at points in the closed drive.

    Args:
        design: The drive; its speed loop is tuned over the regulator, or over PI current loops.
        points: Torques and speeds.
        switching: What switches the bridge.

    Raises:
        VerificationError: There is no C compiler.
    """
    require_compiler()
    name = design.operation.modulation if switching == "carrier" else switching
    count = points.torque.size
    try:
        return _closed_points(design, points, switching, name)
    except DqforgeError as error:
        return (not_run(name, error.message),) * count


def _closed_points(
    design: Design, points: WorkingPoints, switching: Switching, name: str
) -> tuple[ClosedPoint, ...]:
    plan = None
    if switching == "carrier":
        design = _with_loop(design, CurrentLoopSettings(method="magnitude-optimum"))
        solution = solve_control(design)
        files = controller_files(solution)
    else:
        loop = design.control.current_loop
        kept = loop if loop.method == switching else CurrentLoopSettings(method=switching)
        design = _with_loop(design, kept)
        solution = closed_solution(design)
        files = feedback_files(design, solution)
        assert solution.current_feedback is not None
        plan = solution.current_feedback.plan
    speed = solution.gains.speed
    if speed is None:
        raise InputError("the closed drive needs control.speed_loop")
    found = []
    with simulator(files, design.export.prefix, bridge=switching) as program:
        for torque, omega_m in zip(points.torque, points.omega_m, strict=True):
            scenario = load_scenario(design, float(torque), float(omega_m), speed.margins.crossover)
            tail = 1.0 - _WATCHED / (scenario.duration * _periods_per_second(design, omega_m))
            run = simulate_bridge(program, design, scenario, plan, tail=tail)
            found.append(_point(design, name, run, float(omega_m)))
    return tuple(found)


def closed_loads(design: Design, points: WorkingPoints) -> dict[str, tuple[ClosedPoint, ...]]:
    """All regulators at points in the closed drive by their methods, and the carrier, last.

    Args:
        design: The drive.
        points: Torques and speeds.

    Raises:
        VerificationError: There is no C compiler.
    """
    every: tuple[Switching, ...] = (*METHODS, "carrier")
    return {name: closed_points(design, points, name) for name in every}
