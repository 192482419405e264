"""Random drives started by one compiled program, method by method."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, StartUpSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.random_drives.random_drive import RandomDrive, random_drives
from dqforge.machines.records import dataclass
from dqforge.optimizer.saliency.injection import TRACKER
from dqforge.optimizer.solution import solve
from dqforge.optimizer.start_up.plan import LEAST_SALIENCY, StartUpPlan
from dqforge.optimizer.start_up.start_judgement import StartRate, judge_start
from dqforge.reports.control.header import plain_control
from dqforge.reports.simulation.design_run import controller_files
from dqforge.reports.start_up.header import start_up_files
from dqforge.reports.start_up_bench.bench_program import (
    BenchProgram,
    StartInput,
    bench_program,
    run_starts,
    start_record,
)
from dqforge.reports.start_up_bench.random_starts import (
    PREFIX,
    SETTLED,
    Conditions,
    plan_for,
    random_design,
    random_start,
    square_wave_bytes,
)

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
