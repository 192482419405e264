"""What is read off the runs of the program of paper 001 for each of its Figures 8.3 to 8.28, beside
what the thesis states in words.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.reports.papers.paper001.program_runs import (
    BAND,
    REVERSAL,
    SINE_FREQUENCY,
    TARGET,
    ProgramRuns,
    ProgramTransient,
    between,
    compare_values,
    phase_current,
    program_transients,
    simulated_runs,
)
from dqforge.reports.papers.paper001.thesis_program import (
    Constants,
    dead_band,
    held_rpm,
    program_bench,
)
from dqforge.reports.papers.transients import RPM, settling_time
from dqforge.reports.simulation.recorded_run import Simulation

_STEADY = 1.0


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number that is read off a run, in a unit."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Finding:
    """A figure of the thesis: its numbers, what it shows, what the text states of it (empty:
    nothing), and what is found in the run that recomputes it; none for a diagram.
    """

    numbers: str
    shows: str
    stated: str
    found: tuple[Quantity, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Everything that is found with the program's integers in the loop.

    ``dead_band`` in A is the error of i_q below which its integral does not act, ``held`` the speed
    in rpm for which the code of 1200 rpm stands.
    """

    transients: tuple[ProgramTransient, ...]
    findings: tuple[Finding, ...]
    dead_band: float
    held: float
    runs: ProgramRuns


def fundamental(theta_e: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Amplitude of what turns with the rotor, and the r.m.s. of the rest without the mean."""
    base = np.column_stack([np.cos(theta_e), np.sin(theta_e), np.ones_like(theta_e)])
    found, *_ = np.linalg.lstsq(base, values, rcond=None)
    return float(np.hypot(found[0], found[1])), float(np.std(values - base @ found))


def _mean_and_span(name: str, values: FloatArray, unit: str) -> tuple[Quantity, Quantity]:
    return (
        Quantity(f"{name}, mean", float(np.mean(values)), unit),
        Quantity("from peak to peak", float(np.ptp(values)), unit),
    )


def _wave(name: str, theta_e: FloatArray, values: FloatArray, unit: str) -> tuple[Quantity, ...]:
    size, rest = fundamental(theta_e, values)
    return (Quantity(f"{name}, fundamental", size, unit), Quantity("rest r.m.s.", rest, unit))


def _turn(found: Simulation, start: float, end: float) -> Quantity:
    """Time of an electrical turn."""
    chosen = between(found, start, end)
    angle = np.unwrap(found.theta_e[chosen])
    rate = (angle[-1] - angle[0]) / (found.t[chosen][-1] - found.t[chosen][0])
    return Quantity("electrical turn", 2e3 * np.pi / float(rate), "ms")


def _at_1200(run: Simulation, start: ProgramTransient) -> Iterable[Finding]:
    steady = between(run, _STEADY, REVERSAL)
    theta, counts = run.theta_e[steady], compare_values(run)[steady]
    reference, i_q = run.i_q_reference[steady], run.i_q[steady]
    error = _mean_and_span("i_q reference less i_q", reference - i_q, "A")
    yield Finding(
        "8.3",
        "speed, start to 1200 rpm",
        "steady after around 400 ms",
        (
            Quantity("within 2 % after", start.seconds, "s"),
            Quantity("overshoot", 100.0 * start.overshoot, "%"),
            Quantity("steady", float(np.mean(run.omega_m[steady])) / RPM, "rpm"),
        ),
    )
    yield Finding(
        "8.4",
        "current of a phase",
        "sinusoidal",
        _wave("i_a", theta, phase_current(run)[steady], "A"),
    )
    yield Finding(
        "8.5", "i_d", "not zero, by cross coupling", _mean_and_span("i_d", run.i_d[steady], "A")
    )
    yield Finding("8.6", "i_q", "", _mean_and_span("i_q", i_q, "A"))
    yield Finding("8.7", "reference of i_q", "", _mean_and_span("reference", reference, "A"))
    yield Finding("8.8, 8.9", "error of i_q; all three", "the current follows", error)
    yield Finding(
        "8.10", "reference of v_alpha", "", _wave("v_alpha", theta, run.v_alpha[steady], "V")
    )
    yield Finding("8.11", "position of the rotor", "", (_turn(run, _STEADY, REVERSAL),))
    yield Finding(
        "8.12",
        "CMPR1",
        "as Fig. 6.11: two humps",
        (
            Quantity("least", float(np.min(counts[:, 0])), "of 2949"),
            Quantity("largest", float(np.max(counts[:, 0])), "of 2949"),
            *_third(theta, counts[:, 0]),
        ),
    )
    yield Finding(
        "8.13",
        "CMPR1 less CMPR2",
        "sinusoidal",
        _wave("difference", theta, counts[:, 0] - counts[:, 1], "counts"),
    )


def _third(theta: FloatArray, values: FloatArray) -> tuple[Quantity, ...]:
    size, _ = fundamental(3.0 * theta, values)
    return (Quantity("third harmonic", size, "counts"),)


def _at_2700(runs: ProgramRuns) -> Iterable[Finding]:
    run = runs.climb
    last = between(run, 2.0, 2.5)
    theta = run.theta_e[last]
    reached = (
        float(np.mean(found.omega_m[last])) / RPM for found in (runs.limited, runs.ideal, run)
    )
    yield Finding(
        "8.14",
        "speed, 2700 rpm",
        "the program: 13000 holds about 2600 rpm",
        tuple(
            Quantity(name, value, "rpm")
            for name, value in zip(
                ("with 13000", "the same, no dead time", "without"), reached, strict=True
            )
        ),
    )
    yield Finding(
        "8.15", "current of a phase", "", _wave("i_a", theta, phase_current(run)[last], "A")
    )
    yield Finding(
        "8.16",
        "i_q and its reference",
        "",
        (
            Quantity("i_q, mean", float(np.mean(run.i_q[last])), "A"),
            Quantity("reference, mean", float(np.mean(run.i_q_reference[last])), "A"),
        ),
    )
    yield Finding("8.17", "position of the rotor", "", (_turn(run, 2.0, 2.5),))


def _at_2200(run: Simulation) -> Iterable[Finding]:
    last = between(run, 2.0, 2.5)
    climbing = between(run, 0.5, 1.0)
    seconds = settling_time(run, 0.5, 2.5, 2200.0 * RPM, BAND)
    yield Finding(
        "8.18, 8.19",
        "acceleration from 1200 to 2200 rpm",
        "",
        (
            Quantity("within 2 % after", seconds, "s"),
            Quantity("largest i_a", float(np.max(np.abs(phase_current(run)[climbing]))), "A"),
        ),
    )
    yield Finding(
        "8.20",
        "reference of v_alpha",
        "",
        _wave("v_alpha at 2200 rpm", run.theta_e[last], run.v_alpha[last], "V"),
    )


def _at_reversal(run: Simulation, reversal: ProgramTransient) -> Iterable[Finding]:
    after = between(run, REVERSAL, 3.0)
    zero = run.t[after][np.flatnonzero(run.omega_m[after] < 0.0)[0]] - REVERSAL
    yield Finding(
        "8.21",
        "speed, reversal from 1200 to -1200 rpm",
        "around 400 ms, as the start",
        (
            Quantity("within 2 % after", reversal.seconds, "s"),
            Quantity("overshoot", 100.0 * reversal.overshoot, "%"),
        ),
    )
    yield Finding(
        "8.22, 8.23",
        "current of a phase in it",
        "",
        (Quantity("largest", float(np.max(np.abs(phase_current(run)[after]))), "A"),),
    )
    yield Finding(
        "8.24",
        "i_q and its reference",
        "",
        (
            Quantity("least i_q", float(np.min(run.i_q[after])), "A"),
            Quantity("least reference", float(np.min(run.i_q_reference[after])), "A"),
        ),
    )
    yield Finding(
        "8.25",
        "i_d",
        "",
        (
            Quantity("least", float(np.min(run.i_d[after])), "A"),
            Quantity("largest", float(np.max(run.i_d[after])), "A"),
        ),
    )
    yield Finding(
        "8.26",
        "position of the rotor",
        "counts up, then down",
        (Quantity("turns after", zero, "s"),),
    )


def _faster(sine: Simulation, steps: Simulation) -> Iterable[Finding]:
    last = between(sine, 3.0 - 1.0 / SINE_FREQUENCY, 3.0)
    turn = np.exp(-2.0j * np.pi * SINE_FREQUENCY * sine.t[last])
    answer, asked = (2.0 * np.mean(v[last] * turn) for v in (sine.omega_m, sine.reference))
    yield Finding(
        "8.27",
        "speed under a sine reference about 1200 rpm",
        "2 Hz, 200 rpm",
        (
            Quantity("frequency", SINE_FREQUENCY, "Hz"),
            Quantity("amplitude", float(abs(answer)) / RPM, "rpm"),
            Quantity("behind by", float(np.degrees(np.angle(asked / answer))), "deg"),
        ),
    )
    levels = zip(
        steps.scenario.reference.times[1:], steps.scenario.reference.values[1:], strict=True
    )
    longest = max(
        settling_time(steps, start, start + 0.4999, level, BAND) for start, level in levels
    )
    yield Finding(
        "8.28",
        "speed under steps",
        "500 rpm every 0.5 s",
        (Quantity("within 2 % after at most", longest, "s"),),
    )


def program_results(design: Design) -> Program:
    """Runs and findings on the bench of a design.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    with program_bench(design) as place:
        runs = simulated_runs(place)
        transients = program_transients(place, runs.reversal)
    start, reversal = transients[:2]
    findings = (
        Finding("8.1, 8.2", "digitising the currents; the control", "diagrams, nothing to compute"),
        *_at_1200(runs.reversal, start),
        *_at_2700(runs),
        *_at_2200(runs.middle),
        *_at_reversal(runs.reversal, reversal),
        *_faster(runs.sine, runs.steps),
    )
    return Program(transients, findings, dead_band(Constants()), held_rpm(TARGET), runs)
