"""The start and the reversal of paper 001 by the control that the design emits, in every format.

Both axes are controlled and decoupled, as the thesis does not; sensors, converter and machine are
those of its bench. Beside the program of the thesis this shows what the rounding of each costs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import NumberFormat
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.papers.paper001.thesis_program import CONVERTER
from dqforge.reports.papers.transients import RPM, settling_time
from dqforge.reports.simulation.compiled_plant import simulate, simulator
from dqforge.reports.simulation.design_run import drive_of, emitted_files, observers_of
from dqforge.reports.simulation.recorded_run import Simulation

DESIGN_NAME = "paper001-pmsm-bench"


HELD = "float32, speed output held"


FORMATS: tuple[NumberFormat, ...] = ("float32", "q15", "q31")


_TARGET, _REVERSAL, _END = 1200.0, 1.5, 3.0


_BAND = 0.02


@dataclass(frozen=True, slots=True)
class EmittedRun:
    """One format, by its name or with what was changed.

    Times in s until the speed stays within 2 %, the largest speed beyond 1200 rpm as a share, the
    largest current in A, and by how much i_q stays below its reference in A at 1200 rpm.
    """

    name: str
    start: float
    reversal: float
    overshoot: float
    peak_current: float
    error: float


@dataclass(frozen=True, slots=True)
class EmittedControl:
    """All formats that have a speed control, and the names of those that have none."""

    runs: tuple[EmittedRun, ...]
    left_out: tuple[NumberFormat, ...]


def has_speed_control(files: dict[str, bytes], number_format: NumberFormat) -> bool:
    """Whether emitted headers control a speed."""
    suffix = "" if number_format == "float32" else f"_{number_format}"
    wanted = f"_speed_control{suffix}(".encode()
    return any(wanted in content for content in files.values())


def _run(
    solution: Solution, files: dict[str, bytes], number_format: NumberFormat, gains: bytes = b""
) -> Simulation:
    design = solution.design
    reference = Profile((0.0, _REVERSAL), (_TARGET * RPM, -_TARGET * RPM))
    scenario = Scenario(_END, "speed", reference, encoder=Encoder(1024), sensor=CONVERTER)
    observers = observers_of(solution)[1] if number_format == "float32" else ()
    with simulator(files, design.export.prefix, observers, number_format=number_format) as program:
        return simulate(program, drive_of(design), scenario, gains=gains)


def _held(solution: Solution) -> bytes:
    """Gains in float32 whose speed controller holds its output at the limit, as the thesis does."""
    plain = plain_control(solution)
    return gain_bytes({**plain, "speed": [*plain["speed"][:2], 1.0]})


def _figures(found: Simulation, name: str) -> EmittedRun:
    steady = (found.t >= 1.0) & (found.t < _REVERSAL)
    return EmittedRun(
        name=name,
        start=_settling(found, 0.0, _TARGET),
        reversal=_settling(found, _REVERSAL, -_TARGET),
        overshoot=float(np.max(np.abs(found.omega_m))) / (_TARGET * RPM) - 1.0,
        peak_current=float(np.max(np.hypot(found.i_d, found.i_q))),
        error=float(np.mean((found.i_q_reference - found.i_q)[steady])),
    )


def _settling(found: Simulation, start: float, target: float) -> float:
    """Time in s, nan where the speed does not settle."""
    try:
        return settling_time(found, start, start + _REVERSAL, target * RPM, _BAND)
    except NoSolutionError:
        return float("nan")


def emitted_control() -> EmittedControl:
    """Every format on the bench.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    shipped = catalogue.load(DESIGN_NAME)
    design = replace(
        shipped, losses=None, simulation=None, export=replace(shipped.export, control=FORMATS)
    )
    solution = solve(design)
    runs: list[EmittedRun] = []
    left_out: list[NumberFormat] = []
    for number_format in FORMATS:
        files = emitted_files(solution, number_format)
        if has_speed_control(files, number_format):
            runs.append(_figures(_run(solution, files, number_format), number_format))
        else:
            left_out.append(number_format)
    held = _run(solution, emitted_files(solution, "float32"), "float32", _held(solution))
    runs.append(_figures(held, HELD))
    return EmittedControl(tuple(runs), tuple(left_out))
