"""How often the start of one design succeeds over its own tolerances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import StartUpSettings, ToleranceName
from dqforge.machines.errors import InputError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.plants.scenario import CurrentSensor, PlantErrors, Scenario, constant
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.start_up.plan import StartUpPlan
from dqforge.optimizer.start_up.solve import StartRate, judge_start
from dqforge.reports.simulation.design_run import controller_files, drive_of, in_float32
from dqforge.reports.simulation.plant_input import run_input
from dqforge.reports.start_up.header import start_up_files
from dqforge.reports.start_up_bench.random_starts import (
    SETTLED,
    BenchProgram,
    StartInput,
    bench_program,
    duration_of,
    run_starts,
    start_record,
)

# Relative deviations, to either side, of a design that names no tolerances.
USUAL_BOX = {"r_s": 0.3, "psi_pm": 0.04}

# Noise of each current over the current limit, r.m.s., where the design's scenario has none.
NOISE = 5e-3
_RELATIVE: tuple[ToleranceName, ...] = ("r_s", "l_d", "l_q", "psi_pm", "inertia", "v_dc")
_LEAST_SPEED, _ABOVE = 0.4, 1.25  # of the base speed, and over the hand-over
_FUNDAMENTAL = 4.0 / math.pi
_ROWS = 1000


@dataclass(frozen=True, slots=True)
class DrawnPlant:
    """One drive of the box: how it differs from the data, the dead time in s that is left, and the
    electrical angle in rad at rest.
    """

    errors: PlantErrors
    dead_time: float
    theta_e: float
    seed: int


def drawn_plants(design: Design, count: int, seed: int) -> tuple[DrawnPlant, ...]:
    """Drives drawn evenly from the tolerances of a design, at any angle.

    Args:
        design: The design; the dead time is what its tolerances leave, or the whole of it.
        count: How many.
        seed: Of the draws.
    """
    rng = np.random.default_rng(seed)
    tolerances, inverter = design.control.tolerances, design.inverter
    limits: dict[str, tuple[float, float]] = {
        name: (-usual, usual) for name, usual in USUAL_BOX.items()
    }
    if tolerances is not None:
        limits = {name: tolerances.limits(name) for name in _RELATIVE}
    per_second = _FUNDAMENTAL * inverter.f_sw * inverter.v_dc
    least, most = (max(volts, 0.0) / per_second for volts in lost_voltage(design))
    found = []
    for _ in range(count):
        errors = {name: float(rng.uniform(*pair)) for name, pair in limits.items()}
        found.append(
            DrawnPlant(
                PlantErrors(**errors),
                float(rng.uniform(least, most)),
                float(rng.uniform(-math.pi, math.pi)),
                int(rng.integers(1, 2**31)),
            )
        )
    return tuple(found)


def with_method(design: Design, method: StartUpMethodName | None) -> Design:
    """The design with a start by another method; its own for None.

    Args:
        design: The design.
        method: The method.

    Raises:
        InputError: It has no start, and no method is named.
    """
    settings = design.control.start_up
    if settings is None and method is None:
        raise InputError(
            "the design asks for no start without encoder; write control.start_up: {method: auto}"
        )
    if method is None:
        return design
    changed = replace(settings or StartUpSettings(), method=method)
    if settings is not None and settings.method != method:
        changed = replace(changed, alignment=None)
    return replace(design, control=replace(design.control, start_up=changed))


def wanted_speed(plan: StartUpPlan) -> float:
    """Mechanical speed in rad/s that the drive is started to: 40 % of the base speed, or a quarter
    above the hand-over.

    Args:
        plan: Of the start.
    """
    return max(_LEAST_SPEED * plan.base_speed, _ABOVE * plan.hand_over) / plan.pole_pairs


def _input(solution: Solution, plan: StartUpPlan, drawn: DrawnPlant, load: float) -> StartInput:
    design = solution.design
    speed = wanted_speed(plan)
    length = duration_of(plan, plan.pole_pairs * speed, load)
    length += plan.retry_pause if plan.retries else 0.0
    given = None if design.simulation is None else design.simulation.sensor
    sensor = given or CurrentSensor()
    if sensor.noise == 0.0:
        sensor = replace(sensor, noise=NOISE * design.i_max)
    scenario = Scenario(
        duration=length,
        mode="speed",
        reference=constant(speed),
        load=constant(load),
        dead_time=drawn.dead_time,
        sensor=sensor,
        errors=drawn.errors,
        theta_e=drawn.theta_e,
        seed=drawn.seed,
        load_kind="friction",
    )
    stride = max(1, math.ceil(length / design.control.t_s / _ROWS))
    return StartInput(run_input(drive_of(design), scenario, stride=stride))


def _rates(
    program: BenchProgram, solution: Solution, loads: Sequence[float], plants: Sequence[DrawnPlant]
) -> tuple[StartRate, ...]:
    assert solution.start_up is not None
    plan = solution.start_up.plan
    found = []
    for load in loads:
        torque = load * plan.rated_torque
        starts = [_input(solution, plan, drawn, torque) for drawn in plants]
        rows = run_starts(program, starts)
        found.append(
            StartRate(load, tuple(judge_start(start_record(row), SETTLED) for row in rows))
        )
    return tuple(found)


@on_design("control")
def start_success(
    design: Design,
    method: StartUpMethodName | None = None,
    loads: Sequence[float] = (0.0, 0.3),
    count: int = 100,
    seed: int = 1,
) -> tuple[StartRate, ...]:
    """How often a design starts, its machine anywhere in its tolerances and at any angle.

    The emitted state machine runs with the design's own numbers; a try that it repeats by itself
    and that succeeds within the time of one more counts as a success.

    Args:
        design: The design.
        method: The method to start by; None for that of the design.
        loads: Friction over the torque of the current limit in the q axis, one rate each.
        count: Starts per load.
        seed: Of the draws.

    Raises:
        InputError: There is no start, or the machine is one in phase quantities.
        NoSolutionError: Physics forbids the method; the message has the number.
        VerificationError: There is no C compiler.
    """
    if design.phase_machine is not None:
        raise InputError("starts are tried with machines of a sinusoidal back-EMF")
    solution = in_float32(solve(with_method(design, method)))
    started, position = solution.start_up, solution.gains.position
    assert started is not None
    assert position is not None
    files = controller_files(solution) | start_up_files(solution, started)
    low = "" if started.low is None else started.low.tracker.code
    prefix, plants = design.export.prefix, drawn_plants(design, count, seed)
    with bench_program(files, prefix, position.method.code, low, shared=False) as program:
        return _rates(program, solution, loads, plants)
