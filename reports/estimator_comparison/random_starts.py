"""Random drives as the bench starts them: gains by rule, and a plant that is not what they say."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, fields, replace
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.from_machine import RandomDrive, make_design, random_drives
from dqforge.machines.design.settings import ObserverSettings, StartUpSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import NoSolutionError, VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    ElasticBrake,
    PlantErrors,
    Profile,
    Scenario,
    constant,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.optimizer.observers.methods.flux import design as flux_gains
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import LARGEST_TURN, ObserverTuning
from dqforge.optimizer.saliency.injection import TRACKER, InjectionGains
from dqforge.optimizer.solution import solve
from dqforge.optimizer.start_up.plan import LEAST_SALIENCY, StartUpPlan, start_up_plan
from dqforge.optimizer.start_up.solve import StartRate, StartRecord, judge_start
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.operating_system.host_compiler import compile_program, require_compiler
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.design_run import controller_files
from dqforge.reports.simulation.plant_input import (
    PLANT,
    Drive,
    RunInput,
    run_input,
    share_tables,
)
from dqforge.reports.simulation.recorded_run import PLANT_FLAGS
from dqforge.reports.start_up.header import settings_bytes, start_up_files
from dqforge.reports.steps.observer_text import gains_bytes

# Noise of each current over the rated one, how resistance and flux differ from the data, and the
# share of the dead time that nothing compensates.
PREFIX = "bench"
NOISE, R_ERROR, PSI_ERROR, DEAD_TIME_LEFT = 5e-3, 0.3, -0.04, 0.5
RATIO = 10  # Current samples per sample of the speed controller.
_SPREAD = 3.0
_LOOP = 0.05  # bandwidth of the phase-locked loop times the sampling period
_CROSSOVER = 1.0 / 3.0  # of a current loop by the magnitude optimum, times the sampling period
_SPEED_GAIN, _FASTER = 0.7, 5.0
_LEAST_SPEED = 0.4  # of the rated speed, at which a drive has to be held
_ROWS = 1500
SETTLED = 0.3  # Length in s of the last part of a start, in which everything must hold.


def usual_errors() -> PlantErrors:
    """Resistance and flux as the bench has them."""
    return PlantErrors(r_s=R_ERROR, psi_pm=PSI_ERROR)


@dataclass(frozen=True, slots=True)
class Blocked:
    """A friction that comes during the run: ``load`` in N m from ``time`` in s on."""

    time: float
    load: float


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a start meets.

    Args:
        blocked, brake: What stops the shaft during the run, None for nothing.
        duration: In s; None for that of the start.
        errors: How the plant differs from the data.
        dead_time_left: Share of the dead time that nothing compensates.
        turning: Mechanical speed in rad/s that the shaft has at the beginning.
    """

    blocked: Blocked | None = None
    brake: ElasticBrake | None = None
    duration: float | None = None
    errors: PlantErrors = field(default_factory=usual_errors)
    dead_time_left: float = DEAD_TIME_LEFT
    turning: float = 0.0


def speed_gains(drive: RandomDrive) -> tuple[float, float]:
    """Gains of the speed controller in N m s/rad and N m/rad by the symmetrical optimum, the lag of
    the observer's loop among the delays.

    Args:
        drive: What is driven.
    """
    t_s, inertia = 1.0 / drive.f_s, drive.machine.inertia or 0.0
    delay = t_s / _CROSSOVER + 0.5 * RATIO * t_s + 2.0 * t_s / _LOOP
    kp = inertia / (_SPREAD * delay)
    return kp, kp / (_SPREAD**2 * delay)


def observer_tuning(drive: RandomDrive) -> ObserverTuning:
    """Numbers of the flux observer, five times the usual correction at rest.

    Args:
        drive: What is driven.
    """
    machine = drive.machine
    usual = 0.25 * machine.r_s * (1.0 / machine.l_d + 1.0 / machine.l_q)
    bandwidth = _FASTER * min(usual, 0.02 * drive.omega_rated)
    return ObserverTuning(bandwidth, _LOOP * drive.f_s, speed_gain=_SPEED_GAIN)


def random_design(drive: RandomDrive) -> Design:
    """The design of a random drive; the dead time is what is left of it.

    Args:
        drive: What is driven.
    """
    kp, ki = speed_gains(drive)
    tuning = observer_tuning(drive)
    return make_design(
        drive.machine,
        v_dc=drive.v_dc,
        f_sw=drive.f_s,
        name="Random drive",
        prefix=PREFIX,
        inverter={"dead_time": DEAD_TIME_LEFT * drive.dead_time},
        operation={"strategy": "id0"},
        control={
            "speed_loop": {
                "method": "given",
                "kp": kp,
                "ki": ki,
                "ratio": RATIO,
                "min_phase_margin": math.radians(1.0),
            },
            "observer": {
                "method": "flux",
                "bandwidth": tuning.bandwidth,
                "speed_gain": tuning.speed_gain,
                "pll_bandwidth": tuning.pll_bandwidth,
            },
            "start_up": {"method": "i-f"},
        },
        export={"control": "float32"},
    )


def _pi(kp: float, ki_ts: float) -> list[float]:
    return [kp, ki_ts, min(1.0, ki_ts / kp)]


def control_gains(drive: RandomDrive, template: Mapping[str, object]) -> PlainData:
    """Gains of the control functions: current loops by the magnitude optimum, the speed loop by
    `speed_gains`.

    Args:
        drive: What is driven.
        template: Gains of a design of the same controller, for what all drives share.
    """
    machine, t_s = drive.machine, 1.0 / drive.f_s
    kp, ki = speed_gains(drive)
    current = {
        axis: _pi(inductance / (3.0 * t_s), machine.r_s / 3.0)
        for axis, inductance in (("d", machine.l_d), ("q", machine.l_q))
    }
    return {
        **template,
        **current,
        "speed": _pi(kp, ki * RATIO * t_s),
        "ratio": RATIO,
        "pole_pairs": float(machine.pole_pairs),
        "r_s": machine.r_s,
        "l_d": machine.l_d,
        "l_q": machine.l_q,
        "psi_pm": machine.psi_pm,
        "advance": CURRENT_DELAY * t_s,
        "torque_max": drive.torque_rated,
    }


def flux_bytes_of(drive: RandomDrive) -> bytes:
    """Bytes of the gains of a drive's flux observer.

    Args:
        drive: What is driven.
    """
    t_s = 1.0 / drive.f_s
    top = min(1.2 * drive.omega_rated, LARGEST_TURN / t_s)
    return gains_bytes(METHODS["flux"], flux_gains(drive.machine, observer_tuning(drive), t_s, top))


def saturation_table(drive: RandomDrive) -> FloatArray:
    """Flux map of one cell: psi_d = psi + L_d (i_d - s i_d^2/(2 I)), psi_q = L_q i_q, as the plant
    reads it.

    Args:
        drive: What is driven.
    """
    machine = drive.machine
    cell = np.zeros((4, 4, 2))  # power of i_q, of i_d, flux (d, q)
    cell[0, 0, 0] = machine.psi_pm
    cell[0, 1, 0] = machine.l_d
    cell[0, 2, 0] = -0.5 * machine.l_d * drive.saturation / machine.i_max
    cell[1, 0, 1] = machine.l_q
    return np.concatenate([[1.0, 1.0, 0.0, 0.0], cell.reshape(-1)])


def plan_for(design: Design, settings: StartUpSettings) -> StartUpPlan:
    """The plan of a design with other settings of its start.

    Args:
        design: Of `random_design`.
        settings: Of the start.
    """
    plan = start_up_plan(replace(design, control=replace(design.control, start_up=settings)))
    assert plan is not None
    return plan


def speed_wanted(drive: RandomDrive, plan: StartUpPlan) -> float:
    """Mechanical speed in rad/s to which a drive is started: 40 % of the rated one, or a quarter
    above the hand-over where that is more.

    Args:
        drive: What is driven.
        plan: Of its start.
    """
    least = max(_LEAST_SPEED * drive.omega_rated, 1.25 * plan.hand_over)
    return least / drive.machine.pole_pairs


def duration_of(plan: StartUpPlan, omega_e: float, load: float) -> float:
    """Time in s in which a start to ``omega_e`` rad/s must have ended, its settling among it.

    Args:
        plan: Of the start.
        omega_e: Electrical speed in rad/s.
        load: Load torque in N m.
    """
    left = max(plan.rated_torque - load, 0.05 * plan.rated_torque) * plan.pole_pairs / plan.inertia
    ramp = plan.ramp_end / plan.ramp_acceleration + plan.ramp_rise
    rise = omega_e / min(plan.run_acceleration, left)
    return plan.align_time + ramp + rise + plan.fade_time + plan.patience + 0.7 + SETTLED


def random_start(
    drive: RandomDrive,
    plan: StartUpPlan,
    load: float,
    template: Mapping[str, object],
    conditions: Conditions,
    low: bytes = b"",
) -> StartInput:
    """One start of a random drive against a friction of ``load`` N m.

    Args:
        drive: What is driven.
        plan: Of its start.
        load: In N m.
        template: Gains of a design of the same controller.
        conditions: What it meets.
        low: Bytes of the gains of the estimator from standstill on.
    """
    t_s, machine = 1.0 / drive.f_s, drive.machine
    wanted = speed_wanted(drive, plan)
    length = conditions.duration or duration_of(plan, machine.pole_pairs * wanted, load)
    profile = constant(load)
    if conditions.blocked is not None:
        profile = Profile((0.0, conditions.blocked.time), (load, conditions.blocked.load))
    scenario = Scenario(
        duration=length,
        mode="speed",
        reference=constant(wanted),
        load=profile,
        dead_time=conditions.dead_time_left * drive.dead_time,
        sensor=CurrentSensor(noise=NOISE * machine.i_max),
        errors=conditions.errors,
        omega_m=conditions.turning,
        theta_e=drive.theta_e,
        seed=drive.seed,
        sub_steps=4,
        load_kind="friction",
        brake=conditions.brake,
    )
    whole = Drive(machine, Inverter(drive.v_dc, drive.f_s, dead_time=drive.dead_time), t_s, RATIO)
    stride = max(1, math.ceil(length / t_s / _ROWS))
    gains = gain_bytes(control_gains(drive, template))
    plain = run_input(whole, scenario, stride=stride, gains=gains, observer=flux_bytes_of(drive))
    tables = list(plain.tables)
    tables[5] = saturation_table(drive)
    saturated = {"kind": 1.0, "psi_pm": machine.psi_pm, "i_stop": 5.0 * machine.i_max}
    return StartInput(
        plant=RunInput(plain.parameters | saturated, tuple(tables)),
        settings=settings_bytes(plan),
        low=low,
        torque_per_ampere=machine.torque_per_ampere,
    )


_SQUARE_WAVE = (
    *("t_s", "k_p", "k_i", "omega_max", "notch", "per_ampere"),
    *("scale", "shift", "rest", "carrier", "reference"),
)


def square_wave_bytes(gains: InjectionGains) -> bytes:
    """Bytes of ``<prefix>_injection_gains_t`` of a square wave on this machine.

    Args:
        gains: Of the injection.
    """
    assert {one.name for one in fields(gains)} == {*_SQUARE_WAVE, "carrier_beta", "reference_beta"}
    values = np.concatenate([np.atleast_1d(getattr(gains, name)) for name in _SQUARE_WAVE])
    return values.astype(np.float32).tobytes()


# Random drives started by one compiled program, method by method.

_INJECTION = ObserverSettings(method="injection")
_OBSERVER = "flux"


@dataclass(frozen=True, slots=True, eq=False)
class RandomBench:
    """Drives with their designs, and the program that starts them.

    Args:
        drives, designs: As many.
        low: Bytes of the gains of the estimator from standstill on, empty for none.
        refused: Drives whose start by saliency the tool refuses, with the reason: among ``drives``
            no more.
        template: Gains of the control functions that all drives share.
        program: The compiled program.
    """

    drives: tuple[RandomDrive, ...]
    designs: tuple[Design, ...]
    low: tuple[bytes, ...]
    refused: tuple[tuple[RandomDrive, str], ...]
    template: Mapping[str, object]
    program: BenchProgram

    @property
    def saliency(self) -> bool:
        """Whether the drives start by their saliency."""
        return any(self.low)


# (drive, its plan) -> the plan that is used, and what the start meets.
Adjust = Callable[[RandomDrive, StartUpPlan], tuple[StartUpPlan, Conditions]]


def _as_planned(_: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
    return plan, Conditions()


def _trackers(
    drives: tuple[RandomDrive, ...],
) -> tuple[list[tuple[RandomDrive, Design, bytes]], list[tuple[RandomDrive, str]]]:
    """Salient drives with their designs and gains, and those that are refused."""
    found, refused = [], []
    for drive in drives:
        if drive.saliency < LEAST_SALIENCY:
            continue
        design = random_design(drive)
        try:
            gains = square_wave_bytes(TRACKER.design(design, _INJECTION))
        except NoSolutionError as error:
            refused.append((drive, str(error)))
            continue
        found.append((drive, design, gains))
    return found, refused


@contextmanager
def random_bench(count: int, *, seed: int = 1, saliency: bool = False) -> Iterator[RandomBench]:
    """The first drives of a series with their compiled program.

    Args:
        count: How many are drawn.
        seed: Of the series.
        saliency: Whether they start by their saliency: only the salient ones are then there.

    Raises:
        VerificationError: There is no compiler, or the headers do not compile.
    """
    drawn = random_drives(count, seed)
    refused: list[tuple[RandomDrive, str]] = []
    if saliency:
        found, refused = _trackers(drawn)
    else:
        found = [(drive, random_design(drive), b"") for drive in drawn]
    settings = settings_for("saliency" if saliency else "i-f", 0.0)
    if saliency:
        settings = replace(settings, alignment="two-step")  # constant inductances: no polarity
    first = found[0][1]
    solution = solve(replace(first, control=replace(first.control, start_up=settings)))
    assert solution.start_up is not None
    files = controller_files(solution) | start_up_files(solution, solution.start_up)
    low = _INJECTION.method if saliency else ""
    with bench_program(files, PREFIX, _OBSERVER, low, shared=True) as program:
        drives, designs, gains = zip(*found, strict=True)
        template = plain_control(solution)
        yield RandomBench(drives, designs, gains, tuple(refused), template, program)


def settings_for(method: StartUpMethodName, load: float) -> StartUpSettings:
    """How the bench starts: what the design leaves open is computed, and no start is tried again.

    Args:
        method: The method.
        load: Largest load torque in N m.
    """
    if method == "saliency":
        return StartUpSettings(
            method, load_torque=load, retries=0, alignment="none", observer=_INJECTION
        )
    return StartUpSettings(method, load_torque=load, retries=0)


def planned_starts(
    bench: RandomBench, method: StartUpMethodName, load: float, adjust: Adjust = _as_planned
) -> list[tuple[StartUpPlan, StartInput]]:
    """The starts of all drives with their plans.

    Args:
        bench: The drives.
        method: The method.
        load: Friction over the rated torque, known to the plan.
        adjust: What is otherwise in a start.
    """
    starts = []
    for drive, design, low in zip(bench.drives, bench.designs, bench.low, strict=True):
        torque = load * drive.torque_rated
        plan = plan_for(design, settings_for(method, torque))
        used, conditions = adjust(drive, plan)
        given = random_start(drive, used, torque, bench.template, conditions, low)
        starts.append((used, given))
    return starts


def recorded_starts(
    bench: RandomBench, method: StartUpMethodName, load: float, adjust: Adjust = _as_planned
) -> list[dict[str, FloatArray]]:
    """What was recorded of the start of each drive.

    Args:
        bench, method, load, adjust: As `planned_starts`.
    """
    starts = planned_starts(bench, method, load, adjust)
    return run_starts(bench.program, [start for _, start in starts])


def start_rate(
    bench: RandomBench, method: StartUpMethodName, load: float, adjust: Adjust = _as_planned
) -> StartRate:
    """How often the drives start against a load.

    Args:
        bench, method, load, adjust: As `planned_starts`.
    """
    rows = recorded_starts(bench, method, load, adjust)
    return StartRate(load, tuple(judge_start(start_record(row), SETTLED) for row in rows))


# A program that starts any number of drives with the emitted state machine, and its runs.

# What is recorded at a sampling instant, in this order; ``fault`` is the last one there was.
COLUMNS = (
    *("t", "omega_m", "theta_e", "theta_e_observed", "omega_e_observed"),
    *("theta_e_used", "omega_e_used", "state", "fault", "tries"),
    *("reference", "current", "peak", "broken"),
)

RUN_STATE = 7.0  # Number of the state in which the observer at speed rules.


@dataclass(frozen=True, slots=True)
class BenchProgram:
    """A compiled program; ``shared`` where the current references of the machine are data."""

    program: Path
    shared: bool


@dataclass(frozen=True, slots=True, eq=False)
class StartInput:
    """One start: the plant as the simulation reads it, and the numbers of the controller.

    Args:
        plant: Parameters and tables of the plant, its gains those of the control functions.
        settings, low: Bytes of the structures of the start-up and of the gains of the estimator
            from standstill on; empty for those of the headers.
        torque_per_ampere: In N m/A, where the program's current references are data.
    """

    plant: RunInput
    settings: bytes = b""
    low: bytes = b""
    torque_per_ampere: float = 0.0

    def run(self) -> RunInput:
        """What the program reads."""
        further = (
            _doubles(self.settings),
            _doubles(self.low),
            np.array([self.torque_per_ampere]),
        )
        return RunInput(self.plant.parameters, (*self.plant.tables, *further))


def _doubles(content: bytes) -> FloatArray:
    return np.frombuffer(content + bytes(-len(content) % 8), dtype=np.float64)


def _sources(prefix: str, code: str, low: str, *, shared: bool) -> dict[str, str]:
    context = PLANT | {
        "prefix": prefix,
        "macro": prefix.upper(),
        "code": code,
        "low": low,
        "shared": shared,
        "columns": COLUMNS,
    }
    sources = {
        "plant.c": render("simulation/plant.c.j2", context),
        "phase_plant.c": render("simulation/phase_plant.c.j2", context),
        "main.c": render("estimator_comparison/bench_main.c.j2", context),
    }
    if shared:
        sources[f"{prefix}.h"] = render("estimator_comparison/any_machine.h.j2", context)
    return sources


@contextmanager
def bench_program(
    files: Mapping[str, bytes], prefix: str, code: str, low: str = "", *, shared: bool
) -> Iterator[BenchProgram]:
    """A compiled program in a folder that goes with the block.

    Args:
        files: Emitted headers by name, that of the start-up among them.
        prefix: That of the headers.
        code: Name in C of the observer at speed.
        low: That of the estimator from standstill on, empty for none.
        shared: Whether the current references are those of any machine without d current, with the
            torque per ampere as data, in place of the design's header.

    Raises:
        VerificationError: There is no compiler, or the headers do not compile.
    """
    compiler = require_compiler()
    with scratch_folder() as folder:
        for file_name, content in files.items():
            (folder / file_name).write_bytes(content)
        for file_name, text in _sources(prefix, code, low, shared=shared).items():
            (folder / file_name).write_text(text, encoding="ascii", newline="\n")
        failed = "the bench of starts does not compile"
        program = compile_program(compiler, PLANT_FLAGS, "main.c", folder, "bench", failed)
        yield BenchProgram(program, shared)


def run_starts(program: BenchProgram, starts: Sequence[StartInput]) -> list[dict[str, FloatArray]]:
    """What was recorded of each start, by the names of `COLUMNS`.

    Args:
        program: The compiled program.
        starts: What it runs.

    Raises:
        VerificationError: The program cannot be run, or the numbers are not those of its headers.
    """
    runs = share_tables([start.run() for start in starts])
    content = np.array([float(len(runs))]).tobytes() + b"".join(run.content() for run in runs)
    done = subprocess.run([str(program.program)], input=content, capture_output=True, check=False)
    if done.returncode != 0:
        raise VerificationError(f"the bench of starts stopped with exit code {done.returncode}")
    numbers, place = np.frombuffer(done.stdout, dtype=np.float64), 0
    found = []
    for _ in runs:
        count = int(numbers[place])
        rows = numbers[place + 1 : place + 1 + count * len(COLUMNS)].reshape(count, len(COLUMNS))
        place += 1 + count * len(COLUMNS)
        found.append({name: rows[:, n].copy() for n, name in enumerate(COLUMNS)})
    return found


def start_record(rows: dict[str, FloatArray]) -> StartRecord:
    """A recorded start as it is judged.

    Args:
        rows: Of `run_starts`.
    """
    gap = rows["theta_e_observed"] - rows["theta_e"]
    return StartRecord(
        time=rows["t"],
        omega_m=rows["omega_m"],
        reference=rows["reference"],
        angle_error=np.asarray((gap + np.pi) % (2.0 * np.pi) - np.pi),
        ruling=(rows["state"] == RUN_STATE).astype(np.float64),
        reported=bool(rows["fault"][-1] != 0.0),
        broken=bool(rows["broken"][-1] != 0.0),
    )
