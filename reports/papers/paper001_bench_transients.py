"""Paper 001 recomputed: the integers of Table 8.1, and the transients of chapter 8
with the emitted controller.

The thesis controls i_q alone (v_d = 0), without decoupling, and holds the outputs of both
velocity-form controllers. The emitted controller does the same with other gains: those of the d
axis and the decoupling at 0, a tracking of 1, which makes back-calculation what holding the output
of the velocity form is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.integer_gains import to_q
from dqforge.optimizer.loops.loop_gains import LoopGains, per_unit
from dqforge.optimizer.observers.reduced_order import ObserverError, steady_state_error
from dqforge.optimizer.solution import Solution
from dqforge.reports.papers.explanations import Explanation, explain_transients
from dqforge.reports.papers.paper001_bench_sensorless import (
    Estimator,
    MethodFound,
    estimator_errors,
    explain_start,
    methods_found,
)
from dqforge.reports.papers.paper001_emitted_control import (
    BAND,
    REVERSAL,
    SINE_FREQUENCY,
    TARGET,
    Alignment,
    Constants,
    EmittedControl,
    ProgramBench,
    ProgramRuns,
    ProgramTransient,
    alignments,
    between,
    compare_values,
    dead_band,
    emitted_control,
    held_rpm,
    phase_current,
    program_bench,
    program_transients,
    simulated_runs,
)
from dqforge.reports.papers.transients import RPM, Bench, bench, settling_time
from dqforge.reports.simulation.recorded_run import Simulation

DESIGN_NAME = "paper001-pmsm-bench"

# Table 8.1 in the formats of the program: Q10, Q10, Q10, Q15.
PRINTED_INTEGERS = {"speed kp": 20000, "speed ki h": 2500, "current kp": 136, "current ki h": 26}

# Start to 1200 rpm and reversal between +-1200 rpm, s ("around 400 ms", section 8.4).
PRINTED_TIME = 0.4

# Largest v_q of the program over v_dc/sqrt(3); "limits the largest speed to about 2600 rpm", says
# its comment.
ENCODER_LINES = 1024
VOLTAGE_LIMIT = 13_000 / 32_768

# Largest i_q reference of the program over the full scale of the current, 12.8 A.
CURRENT_LIMIT = 32_000 / 32_768

# Limits of the current reference in A for which the transients take the printed time; the thesis
# states none.
_BAND = 0.02
_TARGET = 1200.0
START_CURRENT, REVERSAL_CURRENT = 1.7, 3.5
_SENSORLESS_RPM = 1500.0
_REACHED = 1.8  # s: a climb has come to its end


@dataclass(frozen=True, slots=True)
class Transient:
    """How long a change of speed takes: printed, and found with a limit of
    the current reference in A.

    ``asked`` is the largest i_q reference in A of the run and ``dead_time``
    that of the inverter in s.
    """

    name: str
    limit: float
    origin: str
    seconds: float
    overshoot: float
    peak_current: float
    asked: float
    dead_time: float


@dataclass(frozen=True, slots=True)
class Climb:
    """A step of the speed reference in rpm, the share of v_dc/sqrt(3) that v_q may take,
    and the speed at the end.

    ``seconds`` until the speed stays within 2 % of the reference, nan where it does not get there.
    """

    start: float
    target: float
    share: float
    origin: str
    reached: float
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Recorded transients: start and reversal, sine reference, steps, and starts without sensor.

    ``sensorless`` has the speed from the exact observer, ``estimator`` angle and speed
    with the errors of the bench, in the program's integers; ``encoder`` is the start without an
    estimator.
    """

    reversal: Simulation
    sine: Simulation
    steps: Simulation
    sensorless: Simulation
    estimator: Simulation
    encoder: Simulation


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """Everything that is shown of the thesis.

    ``integers`` by name as in `PRINTED_INTEGERS`; ``sine_lag`` in degrees, ``sine_amplitude`` in
    rpm, ``step_time`` in s; ``sensorless_error`` and ``sensorless`` are steady speed errors at 1500
    rpm, relative, with exact parameters in simulation, and by formula with what is stated in the
    key; ``estimator`` the errors of angle and speed without encoder; ``program`` is what
    the program of the thesis does with its own integers, ``emitted`` what the design's own control
    does in each format; ``methods`` are those of chapter 7 on the bench, ``alignment`` the start of
    section 8.3, ``figures`` what is read off the runs of Figures 8.29 to 8.33, ``start`` what the
    numbers of Figure 8.29 follow from.
    """

    integers: dict[str, int]
    transients: tuple[Transient, ...]
    climbs: tuple[Climb, ...]
    sine_amplitude: float
    sine_lag: float
    step_time: float
    sensorless_error: float
    sensorless: dict[str, float]
    estimator: tuple[Estimator, ...]
    runs: Runs
    program: Program
    emitted: EmittedControl
    methods: tuple[MethodFound, ...]
    alignment: tuple[Alignment, ...]
    figures: tuple[Finding, ...]
    start: Explanation


def _integers(solution: Solution) -> dict[str, int]:
    control = solution.design.control
    bases, speed = control.bases, solution.gains.speed
    assert speed is not None
    assert control.speed_loop is not None
    found: dict[str, int] = {}
    loops: tuple[tuple[str, LoopGains, float, float, Any], ...] = (
        ("speed", speed, bases.speed, bases.torque, control.speed_loop.q_formats),
        (
            "current",
            solution.gains.i_q,
            bases.current,
            bases.voltage,
            control.current_loop.q_formats,
        ),
    )
    for name, gains, base_in, base_out, formats in loops:
        values = per_unit(gains, base_in, base_out)
        for label, value, bits in zip(("kp", "ki h"), values, formats, strict=True):
            found[f"{name} {label}"] = to_q(value, bits)
    return found


def bench_design() -> Design:
    """The shipped drive with the current range of the program: 12.8 A where the
    drive's own limit is 6.4 A.

    The emitted reference ends at the torque of the design's current limit;
    a smaller one would cut the program's.
    """
    design = catalogue.load(DESIGN_NAME)
    if not isinstance(design.machine, LinearMachine):
        raise TypeError(design.name)
    return replace(
        design, losses=None, machine=replace(design.machine, i_max=design.control.bases.current)
    )


def thesis_gains(
    place: Bench, current: float, voltage_share: float = VOLTAGE_LIMIT
) -> dict[str, Any]:
    """Members of the gains that make the emitted controller that of the thesis,
    with a limit of i_q in A.

    ``voltage_share`` is the limit of v_q over v_dc/sqrt(3).
    """
    design = place.solution.design
    voltage = voltage_share * design.control.bases.voltage
    return {
        "d": [0.0, 0.0, 0.0],
        "q": [*place.gains["q"][:2], 1.0],
        "speed": [*place.gains["speed"][:2], 1.0],
        "l_d": 0.0,
        "l_q": 0.0,
        "psi_pm": 0.0,
        "advance": 0.0,
        "voltage_share": voltage / design.inverter.v_dc,
        "torque_max": current * design.machine.torque_per_ampere,
    }


def _scenario(duration: float, reference: Profile, **changes: Any) -> Scenario:
    return Scenario(duration, "speed", reference, encoder=Encoder(ENCODER_LINES), **changes)


def _reversal(place: Bench, current: float, dead_time: float | None = None) -> Simulation:
    """Start to 1200 rpm, reversal after 1.5 s; the dead time in s, None for that of the program."""
    reference = Profile((0.0, 1.5), (_TARGET * RPM, -_TARGET * RPM))
    return place.run(_scenario(3.0, reference, dead_time=dead_time), thesis_gains(place, current))


def _transient(
    name: str, limit: float, origin: str, found: Simulation, dead_time: float
) -> Transient:
    start, end, target = (
        (0.0, 1.5, _TARGET * RPM) if name == "start" else (1.5, 3.0, -_TARGET * RPM)
    )
    chosen = (found.t >= start) & (found.t < end)
    beyond = np.max(found.omega_m[chosen] * np.sign(target)) / abs(target) - 1.0
    peak = float(np.max(np.hypot(found.i_d[chosen], found.i_q[chosen])))
    asked = float(np.max(np.abs(found.i_q_reference[chosen])))
    seconds = settling_time(found, start, end, target, _BAND)
    return Transient(name, limit, origin, seconds, float(beyond), peak, asked, dead_time)


def _transients(place: Bench) -> tuple[tuple[Transient, ...], Simulation]:
    design = place.solution.design
    program, dead_time = CURRENT_LIMIT * design.control.bases.current, design.inverter.dead_time
    wanted = (
        ("start", program, "program: 32000 in Q15", dead_time),
        ("reversal", program, "program: 32000 in Q15", dead_time),
        ("start", program, "the same, no dead time", 0.0),
        ("reversal", program, "the same, no dead time", 0.0),
        ("start", START_CURRENT, "chosen for the printed time", dead_time),
        ("reversal", REVERSAL_CURRENT, "chosen for the printed time", dead_time),
    )
    runs = {
        key: _reversal(place, *key) for key in dict.fromkeys((row[1], row[3]) for row in wanted)
    }
    rows = tuple(_transient(*row[:3], runs[row[1], row[3]], row[3]) for row in wanted)
    return rows, runs[REVERSAL_CURRENT, dead_time]


def _climb(place: Bench, start: float, target: float, share: float, origin: str) -> Climb:
    """A step in rpm after 0.5 s at the speed from which it starts."""
    reference = Profile((0.0, 0.5), (start * RPM, target * RPM))
    scenario = _scenario(2.0, reference, omega_m=start * RPM)
    found = place.run(scenario, thesis_gains(place, REVERSAL_CURRENT, share))
    reached = float(np.mean(found.omega_m[found.t >= _REACHED])) / RPM
    there = abs(reached - target) < _BAND * target
    seconds = settling_time(found, 0.5, 2.0, target * RPM, _BAND) if there else float("nan")
    return Climb(start, target, share, origin, reached, seconds)


def _climbs(place: Bench) -> tuple[Climb, ...]:
    """Figures 8.14 to 8.20: 2700 rpm, and from 1200 to 2200 rpm."""
    limited, whole = "program: 13000 in Q15", "the linear range"
    return (
        _climb(place, 1200.0, 2200.0, VOLTAGE_LIMIT, limited),
        _climb(place, 1200.0, 2700.0, VOLTAGE_LIMIT, limited),
        _climb(place, 1200.0, 2700.0, 1.0, whole),
    )


def _sine(place: Bench) -> tuple[Simulation, float, float]:
    """2 Hz and 200 rpm about 1200 rpm: the run, amplitude in rpm, lag in
    degrees over the last second.
    """
    reference = Profile((0.0,), (_TARGET * RPM,), amplitude=200.0 * RPM, frequency=2.0)
    found = place.run(_scenario(3.0, reference), thesis_gains(place, REVERSAL_CURRENT))
    last = found.t >= 2.0
    turn = np.exp(-2.0j * np.pi * 2.0 * found.t[last])
    answer = 2.0 * np.mean(found.omega_m[last] * turn)
    asked = 2.0 * np.mean(found.reference[last] * turn)
    return found, abs(answer) / RPM, float(np.degrees(np.angle(asked / answer)))


def _steps(place: Bench) -> tuple[Simulation, float]:
    """Steps of 500 rpm every 0.5 s between 1000 and 2000 rpm, as in the program.

    The longest settling time in s.
    """
    levels = np.array([1500.0, 2000.0, 1500.0, 1000.0, 1500.0]) * RPM
    times = np.array([0.0, 1.0, 1.5, 2.0, 2.5])
    reference = Profile(tuple(times.tolist()), tuple(levels.tolist()))
    found = place.run(_scenario(3.0, reference), thesis_gains(place, REVERSAL_CURRENT))
    longest = max(
        settling_time(found, start, start + 0.4999, float(level), _BAND)
        for start, level in zip(times[1:].tolist(), levels[1:].tolist(), strict=True)
    )
    return found, longest


def _to_1500(place: Bench, encoder: Encoder) -> Simulation:
    """Start to 1500 rpm without dead time."""
    reference = Profile((0.0,), (_SENSORLESS_RPM * RPM,))
    scenario = Scenario(1.2, "speed", reference, encoder=encoder, dead_time=0.0)
    return place.run(scenario, thesis_gains(place, REVERSAL_CURRENT))


def _sensorless(place: Bench) -> tuple[Simulation, float]:
    """Start to 1500 rpm with the speed of the corrected observer.

    The error of the estimate over the last 0.2 s.
    """
    found = _to_1500(place, Encoder(speed="observer"))
    last = found.t >= 1.0
    error = np.mean(found.omega_m_measured[last] - found.omega_m[last]) / (_SENSORLESS_RPM * RPM)
    return found, float(error)


def _stated_errors(place: Bench) -> dict[str, float]:
    """Steady relative errors of the estimate at 1500 rpm without load, by formula,
    and what makes the printed 4 %.
    """
    design = place.solution.design
    observer = place.solution.gains.observer
    assert observer is not None
    omega = _SENSORLESS_RPM * RPM

    def error(**changes: float) -> ObserverError:
        return steady_state_error(design.machine, observer.g, design.control.t_s, omega, **changes)

    rated = 0.47
    return {
        "exact parameters": error().relative,
        "psi_pm 4 % too small": error(psi_error=-0.04).relative,
        "R 30 % too large": error(r_error=0.3).relative,
        "0.47 N m of load": error(torque_load=rated).relative,
        "0.47 N m of load and R 30 % too large": error(torque_load=rated, r_error=0.3).relative,
    }


def reproduce_paper() -> Reproduction:
    """Everything that is shown of the thesis.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    design = bench_design()
    with bench(design) as place, program_bench(design) as program:
        transients, reversal = _transients(place)
        sine, amplitude, lag = _sine(place)
        steps, step_time = _steps(place)
        sensorless, error = _sensorless(place)
        plain = _to_1500(place, Encoder(ENCODER_LINES))
        estimator, wrong = estimator_errors(thesis_gains(place, REVERSAL_CURRENT), program)
        return Reproduction(
            integers=_integers(place.solution),
            transients=transients,
            climbs=_climbs(place),
            sine_amplitude=amplitude,
            sine_lag=lag,
            step_time=step_time,
            sensorless_error=error,
            sensorless=_stated_errors(place),
            estimator=estimator,
            runs=Runs(reversal, sine, steps, sensorless, wrong, plain),
            program=program_results(program),
            emitted=emitted_control(),
            methods=methods_found(DESIGN_NAME),
            alignment=alignments(program),
            figures=sensorless_findings(plain, sensorless, wrong),
            start=explain_start(design),
        )


# What is read off the runs of the program of paper 001 for each of its Figures 8.3 to 8.28, beside
# what the thesis states in words.

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
    explanation: Explanation


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


def program_results(place: ProgramBench) -> Program:
    """Runs and findings on the bench with the program of the thesis."""
    runs = simulated_runs(place)
    transients = program_transients(place, runs.reversal)
    explanation = explain_transients(place)
    start, reversal = transients[:2]
    findings = (
        Finding("8.1, 8.2", "digitising the currents; the control", "diagrams, nothing to compute"),
        *_at_1200(runs.reversal, start),
        *_at_2700(runs),
        *_at_2200(runs.middle),
        *_at_reversal(runs.reversal, reversal),
        *_faster(runs.sine, runs.steps),
    )
    held = held_rpm(TARGET)
    return Program(transients, findings, dead_band(Constants()), held, runs, explanation)


# Figures 8.29 to 8.33 of paper 001: simulation with and without estimator, and the bench without
# encoder.


def _lag(run: Simulation) -> FloatArray:
    """Electrical angle in turns by which the estimated position is behind, shape (N,)."""
    gap = run.theta_e - run.theta_e_observed
    return np.asarray(np.angle(np.exp(1j * gap)) / (2.0 * np.pi))


def sensorless_findings(
    without: Simulation, observed: Simulation, bench: Simulation
) -> tuple[Finding, ...]:
    """What is read off the runs.

    Args:
        without: The start with the speed of the encoder.
        observed: The start with the speed of the exact observer.
        bench: The program of the thesis on its estimator, with the errors of the bench.
    """
    target = float(bench.reference[-1])
    last = np.asarray(bench.t >= _STEADY)
    seen = float(np.mean(bench.omega_m_observed[last])) / RPM
    true = float(np.mean(bench.omega_m[last])) / RPM
    behind = 100.0 * _lag(bench)[last]
    ends = (float(np.mean(run.omega_m[run.t >= _STEADY])) for run in (without, observed))
    plain, estimated = (100.0 * (end / target - 1.0) for end in ends)
    apart = float(np.max(np.abs(observed.omega_m_measured - observed.omega_m))) / RPM
    span = bench.t[last]
    turns = np.unwrap(bench.theta_e[last])
    rate = float((turns[-1] - turns[0]) / (span[-1] - span[0]))
    return (
        Finding(
            "8.29",
            "simulated start with and without estimator",
            "no significant error after 80 ms from the start; about 1 % off the reference",
            (
                Quantity("largest error of the estimate on the way", apart, "rpm"),
                Quantity("off the reference with the estimator", estimated, "%"),
                Quantity("without", plain, "%"),
            ),
        ),
        Finding("8.30", "the control without encoder", "diagram, nothing to compute"),
        Finding(
            "8.31",
            "estimated and measured speed at 1500 rpm",
            "about 60 rpm apart, 4 %",
            (
                Quantity("estimated", seen, "rpm"),
                Quantity("measured", true, "rpm"),
                Quantity("apart", seen - true, "rpm"),
            ),
        ),
        Finding(
            "8.32",
            "estimated and measured position",
            "",
            (
                Quantity("electrical turn", 2e3 * np.pi / rate, "ms"),
                Quantity("behind by", 3.6 * float(np.mean(behind)), "deg"),
            ),
        ),
        Finding(
            "8.33",
            "error of the position in percent",
            "about 10 % electrical, 3.33 % mechanical",
            (
                Quantity("mean", float(np.mean(behind)), "% of an electrical turn"),
                Quantity("from peak to peak", float(np.ptp(behind)), "%"),
                Quantity("mechanical, mean", float(np.mean(behind)) / 3.0, "% of a turn"),
            ),
        ),
    )
