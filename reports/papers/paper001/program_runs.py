"""The runs of Figures 8.3 to 8.28 of paper 001 with the program's own integers in the loop."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.scenario import InverterModel, Profile
from dqforge.machines.records import dataclass
from dqforge.reports.papers.paper001.thesis_program import (
    BASE_CURRENT,
    LISTED_LINE,
    SINE_INCREMENT,
    TIMER_PERIOD,
    Constants,
    ProgramBench,
)
from dqforge.reports.papers.transients import RPM, settling_time
from dqforge.reports.simulation.recorded_run import Simulation

TARGET = 1200.0
REVERSAL = 1.5  # Instant of the reversal in s.

# Of the program's sine reference in Hz; the thesis says 2.
SINE_FREQUENCY = SINE_INCREMENT / 32_768 * 5_000.0

# Limits of the i_q reference in A for which the start, the reversal, and both alike take about the
# printed time; the thesis states none but 32000 of 32768.
START_LIMIT, REVERSAL_LIMIT, COMMON_LIMIT = 2.2, 3.0, 2.5
BAND = 0.02  # Share of a speed within which it counts as reached.


@dataclass(frozen=True, slots=True)
class ProgramTransient:
    """A start or a reversal with the program: what limits i_q in A, and what came out."""

    name: str
    limit: float
    origin: str
    seconds: float
    overshoot: float
    peak_current: float


@dataclass(frozen=True, slots=True, eq=False)
class ProgramRuns:
    """Runs of the program: start and reversal, the two climbs, the two faster references.

    ``limited`` is the climb to 2700 rpm with the program's limit of v_q, ``ideal`` the same without
    dead time, ``climb`` the one without the limit; ``middle`` goes from 1200 to 2200 rpm.
    """

    reversal: Simulation
    limited: Simulation
    ideal: Simulation
    climb: Simulation
    middle: Simulation
    sine: Simulation
    steps: Simulation


def codes_of(current: float) -> int:
    """Code in Q15 of a current in A."""
    return int(current / BASE_CURRENT * 32_768.0)


def _run_reversal(
    place: ProgramBench,
    constants: Constants,
    dead_time: float | None = None,
    inverter: InverterModel = "averaged",
) -> Simulation:
    reference = Profile((0.0, REVERSAL), (TARGET * RPM, -TARGET * RPM))
    return place.run(3.0, reference, constants, dead_time, inverter)


def _transient(found: Simulation, name: str, limit: float, origin: str) -> ProgramTransient:
    start, target = (0.0, TARGET * RPM) if name == "start" else (REVERSAL, -TARGET * RPM)
    end = start + REVERSAL
    chosen = (found.t >= start) & (found.t < end)
    beyond = np.max(found.omega_m[chosen] * np.sign(target)) / abs(target) - 1.0
    peak = np.max(np.hypot(found.i_d[chosen], found.i_q[chosen]))
    seconds = settling_time(found, start, end, target, BAND)
    return ProgramTransient(name, limit, origin, seconds, float(beyond), float(peak))


def program_transients(place: ProgramBench, listed: Simulation) -> tuple[ProgramTransient, ...]:
    """Starts and reversals with the limits of the program and others; ``listed`` is the run with
    its own.
    """
    whole = Constants().max_w / 32_768.0 * BASE_CURRENT
    rows = [
        _transient(listed, name, whole, "program: 32000 in Q15") for name in ("start", "reversal")
    ]
    switched = _run_reversal(place, Constants(), inverter="switched")
    rows += [
        _transient(switched, name, whole, "the same, every switching instant")
        for name in ("start", "reversal")
    ]
    wanted: tuple[tuple[Constants, float | None, float, str, tuple[str, ...]], ...] = (
        (LISTED_LINE, None, whole, "the same, 25 for 26", ("start", "reversal")),
        (Constants(), 0.0, whole, "the same, no dead time", ("start", "reversal")),
        (_limit(START_LIMIT), None, START_LIMIT, "chosen for the printed time", ("start",)),
        (_limit(REVERSAL_LIMIT), None, REVERSAL_LIMIT, "chosen for it", ("reversal",)),
        (_limit(COMMON_LIMIT), None, COMMON_LIMIT, "one for both", ("start", "reversal")),
    )
    for constants, dead_time, limit, origin, names in wanted:
        found = _run_reversal(place, constants, dead_time)
        rows += [_transient(found, name, limit, origin) for name in names]
    return tuple(rows)


def _limit(current: float) -> Constants:
    return Constants(max_w=codes_of(current))


def simulated_runs(place: ProgramBench) -> ProgramRuns:
    """Every run from which figures are read."""

    def climb(
        target: float, constants: Constants | None = None, dead_time: float | None = None
    ) -> Simulation:
        reference = Profile((0.0, 0.5), (TARGET * RPM, target * RPM))
        return place.run(2.5, reference, constants, dead_time)

    sine = Profile((0.0,), (TARGET * RPM,), amplitude=200.0 * RPM, frequency=SINE_FREQUENCY)
    times = (0.0, 1.0, 1.5, 2.0, 2.5)
    levels = (1500.0, 2000.0, 1500.0, 1000.0, 1500.0)
    return ProgramRuns(
        reversal=_run_reversal(place, Constants()),
        limited=climb(2700.0),
        ideal=climb(2700.0, dead_time=0.0),
        climb=climb(2700.0, Constants(max_iq=32_767)),
        middle=climb(2200.0),
        sine=place.run(3.0, sine),
        steps=place.run(3.0, Profile(times, tuple(level * RPM for level in levels))),
    )


def between(found: Simulation, start: float, end: float) -> np.ndarray:
    """Samples of a span of time in s."""
    return np.asarray((found.t >= start) & (found.t < end))


def compare_values(found: Simulation) -> FloatArray:
    """Values of the three compare registers that act from each sample on, shape (N, 3)."""
    return np.asarray(np.rint(found.duty * TIMER_PERIOD))


def phase_current(run: Simulation) -> FloatArray:
    """Current of phase a in A."""
    return run.i_d * np.cos(run.theta_e) - run.i_q * np.sin(run.theta_e)
