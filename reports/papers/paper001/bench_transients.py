"""Paper 001 recomputed: the integers of Table 8.1, and the transients of chapter 8
with the emitted controller.

The thesis controls i_q alone (v_d = 0), without decoupling, and holds the outputs of both
velocity-form controllers. The emitted controller does the same with other gains: those of the d
axis and the decoupling at 0, a tracking of 1, which makes back-calculation what holding the output
of the velocity form is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.integer_gains import to_q
from dqforge.optimizer.loops.loop_gains import LoopGains, per_unit
from dqforge.optimizer.observers.reduced_order import ObserverError, steady_state_error
from dqforge.optimizer.solution import Solution
from dqforge.reports.papers.paper001.alignment import Alignment, alignments
from dqforge.reports.papers.paper001.bench_sensorless import Estimator, estimator_errors
from dqforge.reports.papers.paper001.emitted_control import EmittedControl, emitted_control
from dqforge.reports.papers.paper001.estimator_methods import MethodFound, methods_found
from dqforge.reports.papers.paper001.program_findings import Finding, Program, program_results
from dqforge.reports.papers.paper001.sensorless_findings import sensorless_findings
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
    with the errors of the bench; ``encoder`` is the start without an estimator.
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
    section 8.3, ``figures`` what is read off the runs of Figures 8.29 to 8.33.
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
    with bench(design) as place:
        transients, reversal = _transients(place)
        sine, amplitude, lag = _sine(place)
        steps, step_time = _steps(place)
        sensorless, error = _sensorless(place)
        plain = _to_1500(place, Encoder(ENCODER_LINES))
        estimator, wrong = estimator_errors(thesis_gains(place, REVERSAL_CURRENT))
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
            program=program_results(design),
            emitted=emitted_control(),
            methods=methods_found(DESIGN_NAME),
            alignment=alignments(design),
            figures=sensorless_findings(plain, sensorless, wrong),
        )
