"""The start and the reversal of paper 001 by the control that the design emits, in every format.

Both axes are controlled and decoupled, as the thesis does not; sensors, converter and machine are
those of its bench. Beside the program of the thesis this shows what the rounding of each costs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import NumberFormat
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    InverterModel,
    PlantErrors,
    Profile,
    Scenario,
    Sensorless,
    constant,
)
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.integer_gains import to_q
from dqforge.optimizer.observers.reduced_order import reduced_order_observer
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.transients import RPM, settled_or_nan, settling_time
from dqforge.reports.simulation.design_run import drive_of, emitted_files, observers_of
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    solution: Solution,
    files: dict[str, bytes],
    number_format: NumberFormat,
    gains: Sequence[bytes] = (b"",),
) -> list[Simulation]:
    """A run for each set of gains, empty for those of the header."""
    design = solution.design
    reference = Profile((0.0, _REVERSAL), (_TARGET * RPM, -_TARGET * RPM))
    scenario = Scenario(_END, "speed", reference, encoder=Encoder(1024), sensor=CONVERTER)
    observers = observers_of(solution)[1] if number_format == "float32" else ()
    with simulator(files, design.export.prefix, observers, number_format=number_format) as program:
        return [simulate(program, drive_of(design), scenario, gains=own) for own in gains]


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
    return settled_or_nan(found, start, start + _REVERSAL, target * RPM, _BAND)


def emitted_control() -> EmittedControl:
    """Every format on the bench.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    shipped = catalogue.load(DESIGN_NAME)
    design = replace(
        shipped, losses=None, simulation=None, export=replace(shipped.export, control=FORMATS)
    )
    solution = solve_control(design)
    runs: list[EmittedRun] = []
    left_out: list[NumberFormat] = []
    for number_format in FORMATS:
        files = emitted_files(solution, number_format)
        if has_speed_control(files, number_format):
            held = [_held(solution)] if number_format == "float32" else []
            found = _run(solution, files, number_format, [b"", *held])
            runs += [
                _figures(run, name) for run, name in zip(found, (number_format, HELD), strict=False)
            ]
        else:
            left_out.append(number_format)
    runs.sort(key=lambda run: run.name == HELD)
    return EmittedControl(tuple(runs), tuple(left_out))


# The control program of paper 001 in its own integers, compiled into the plant of the bench.
#
# Listing and section 8.2 of the thesis give the integers; the C is ours. What the thesis leaves
# open: the size of its sine table (256 entries a turn here), which angle 0x8000 is (its text says
# half a turn, its own increment of the sine reference a whole one, and only that fits three pole
# pairs at 24 a count), a quotient by zero before the second line of the encoder, and the constant
# with which it starts v_q (0 here).

# Full scales of the program's codes of current in A and of speed in rpm.
PREFIX = "thesis"
BASE_CURRENT, BASE_RPM = 12.8, 6750.0
CLOCK = 29.4912e6  # Of the signal processor in Hz: 33.9 ns.

# Of the pulse-width modulation, up and down: 29.4912 MHz x 200 us / 2, its fraction dropped.
TIMER_PERIOD = 2949

# 2^20 / 6750 with its fraction dropped; 155.34 would be exact, so that references are 0.22 % low.
INVERSE_BASE = 155

# Of 32768 a turn and period: 2 Hz are 13.1, so that the sine reference has 1.98 Hz.
SINE_INCREMENT = 13
CONVERTER = CurrentSensor(bits=10, full_scale=6.4)  # 10 bits from -6.4 to 6.4 A.

# Angle by counts; the adapter times the lines by the exact speed, as the capture unit does.
ENCODER = Encoder(1024, speed="exact")
_SINE_ENTRIES = 256


@dataclass(frozen=True, slots=True)
class Constants:
    """Integers of the program: gains in Q10, Q10, Q10, Q15 and limits in Q15; periods for which the
    first phase is fed before it begins, after which the encoder's count is set to zero, 0 for a
    program that knows the angle.
    """

    kp_w: int = 20000
    kih_w: int = 2500
    kp_iq: int = 136
    kih_iq: int = 26
    max_w: int = 32000
    max_iq: int = 13000
    align: int = 0

    def content(self) -> bytes:
        """Bytes of the structure in C."""
        return np.array(list(asdict(self).values()), dtype=np.int32).tobytes()


# As the listing's active line works it out: 32767 x 200e-6 x 3.967285 = 25.999 becomes 25; 26
# stands in the line beside it, which is a comment.
LISTED_LINE = Constants(kih_iq=25)


def reference_code(rpm: float) -> int:
    """Code of a speed reference in rpm."""
    return (round(rpm) * INVERSE_BASE) >> 5


def held_rpm(rpm: float) -> float:
    """Speed in rpm that the code of a reference in rpm stands for."""
    return reference_code(rpm) * BASE_RPM / 32768.0


def dead_band(constants: Constants) -> float:
    """Error of i_q in A from which on the integral of its controller acts.

    The shift rounds down: between 0 and this nothing is added, just below 0 one is taken off in
    every period.
    """
    return BASE_CURRENT / constants.kih_iq


@dataclass(frozen=True, slots=True)
class EstimatorWords:
    """Integers of the estimator of section 8.5: coefficients in Q15 of codes of current, speed and
    voltage.
    """

    a: int
    b: int
    k: int
    c: int
    l_d: int
    l_q: int
    r_s: int
    kp: int
    kih: int


ESTIMATOR = "estimator"  # Its name in C.
_WIDTH = 200.0  # rad/s: of the correction, as `usual_matsui` has it


def estimator_words(design: Design) -> EstimatorWords:
    """The estimator of the bench in the words of the program: the reduced-order observer of the
    design, and the correction of the angle with both poles at `_WIDTH` at 1500 rpm.
    """
    known = design.control.observer
    assert known is not None
    assert known.pole is not None
    machine, t_s = design.machine, design.control.t_s
    own = reduced_order_observer(machine, known.pole, t_s)
    speed, volt = BASE_RPM * RPM, design.control.bases.voltage
    electrical = machine.pole_pairs * speed
    emf = machine.pole_pairs * 1500.0 * RPM * machine.psi_pm
    values = (
        1.0 - own.a,
        own.b_u * volt / speed,
        own.b_i * BASE_CURRENT / speed,
        own.c * BASE_CURRENT / speed,
        machine.l_d * electrical * BASE_CURRENT / volt,
        machine.l_q * electrical * BASE_CURRENT / volt,
        machine.r_s * BASE_CURRENT / volt,
        2.0 * _WIDTH / emf * volt / electrical,
        _WIDTH**2 / emf * t_s * volt / electrical,
    )
    return EstimatorWords(*(to_q(value, 15) for value in values))


def program_files(design: Design) -> dict[str, bytes]:
    """The three headers by name: the program, what stands around it, its estimator.

    Args:
        design: The bench.
    """
    electrical = design.machine.pole_pairs * BASE_RPM * RPM
    turn = 2.0 * np.pi * np.arange(_SINE_ENTRIES + 1) / _SINE_ENTRIES
    context = {
        "prefix": PREFIX,
        "sine": np.rint(32767.0 * np.sin(turn)).astype(int).tolist(),
        "sine_shift": 15 - _SINE_ENTRIES.bit_length() + 1,
        "timer_period": TIMER_PERIOD,
        "inverse_base": INVERSE_BASE,
        "encoder_lines": float(ENCODER.lines),
        "clock": CLOCK,
        "period": design.control.t_s,
        "constants": list(asdict(Constants()).values()),
        "torque_per_ampere": design.machine.torque_per_ampere,
        "estimator": list(asdict(estimator_words(design)).values()),
        "current": BASE_CURRENT,
        "voltage": design.control.bases.voltage,
        "speed_codes": 32768.0 / electrical,
        "step": round(electrical / 32768.0 * design.control.t_s / (2.0 * np.pi) * 2.0**32),
    }
    names = {
        "thesis_program.h": "thesis_program",
        f"{PREFIX}_control.h": "thesis_control",
        f"{PREFIX}_observer.h": "thesis_observer",
    }
    return {
        name: render(f"papers/paper001/{text}.h.j2", context).encode("ascii")
        for name, text in names.items()
    }


@dataclass(frozen=True, slots=True)
class ProgramBench:
    """The bench with the program of the thesis compiled in."""

    program: Simulator
    drive: Drive

    def run(
        self,
        duration: float,
        reference: Profile,
        constants: Constants | None = None,
        dead_time: float | None = None,
        inverter: InverterModel = "averaged",
        theta_e: float = 0.0,
        friction: float = 0.0,
        errors: PlantErrors | None = None,
        *,
        encoderless: bool = False,
    ) -> Simulation:
        """One run from standstill: seconds, reference in rad/s, other integers or dead time in s
        where they are given, duty cycles as voltages or every switching instant; the electrical
        angle in rad at which the rotor lies, and a torque in N m that resists and holds it; how the
        machine differs; whether the program runs on its estimator above 500 rpm.
        """
        scenario = Scenario(
            duration,
            "speed",
            reference,
            encoder=ENCODER,
            sensor=CONVERTER,
            dead_time=dead_time,
            inverter=inverter,
            theta_e=theta_e,
            load=constant(friction),
            load_kind="friction" if friction else "active",
            errors=errors or PlantErrors(),
            sensorless=Sensorless(500.0 * RPM, 300.0 * RPM) if encoderless else None,
        )
        gains = (constants or Constants()).content()
        return simulate(self.program, self.drive, scenario, gains=gains)


@contextmanager
def program_bench(design: Design) -> Iterator[ProgramBench]:
    """The bench of a design with the program of the thesis, as long as the block.

    Raises:
        VerificationError: There is no compiler.
    """
    with simulator(program_files(design), PREFIX, (ESTIMATOR,)) as program:
        yield ProgramBench(program, drive_of(design))


# Figures 8.3 to 8.28 of paper 001, drawn from the runs of its program's integers.

_POINTS = 900
Line = tuple[FloatArray, str, str]  # Values, colour, label (empty: none).


def _draw(
    axes: Axes,
    run: Simulation,
    span: tuple[float, float],
    title: str,
    unit: str,
    lines: Sequence[Line],
) -> None:
    """Lines over a span of time in s, in ms where it is short."""
    chosen = np.flatnonzero((run.t >= span[0]) & (run.t < span[1]))
    chosen = chosen[:: max(1, chosen.size // _POINTS)]
    short = span[1] - span[0] < 0.3
    time = (run.t[chosen] - span[0]) * 1e3 if short else run.t[chosen]
    for values, colour, label in lines:
        width = 0.9 if colour == MUTED else 1.1
        axes.plot(time, values[chosen], color=colour, linewidth=width, label=label or None)
    axes.set(title=title, ylabel=unit, xlabel="Time in ms" if short else "Time in s")
    if any(label for _, _, label in lines):
        axes.legend(frameon=False, loc="best", fontsize=6.5)


def _speed(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    lines = ((run.reference / RPM, MUTED, "reference"), (run.omega_m / RPM, BLUE, "speed"))
    _draw(axes, run, span, title, "rpm", lines)


def _currents(
    axes: Axes, run: Simulation, span: tuple[float, float], title: str, *, error: bool = False
) -> None:
    lines = [(run.i_q_reference, MUTED, "reference"), (run.i_q, ORANGE, "$i_q$")]
    if error:
        lines.append((run.i_q_reference - run.i_q, TEAL, "error"))
    _draw(axes, run, span, title, "A (peak)", lines)


def _angle(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    degrees = np.degrees(run.theta_e_measured) % 360.0
    _draw(axes, run, span, title, "deg (electrical)", ((degrees, BLUE, ""),))


def _phase(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    _draw(axes, run, span, title, "A", ((phase_current(run), BLUE, ""),))


def _places(rows: int) -> list[tuple[float, float, float, float]]:
    """Axes of two columns from the top down."""
    height = 0.96 / rows
    return [
        (x, 0.99 - (row + 1) * height + 0.27 * height, 0.38, 0.54 * height)
        for row in range(rows)
        for x in (0.09, 0.59)
    ]


def plot_at_1200(runs: ProgramRuns) -> Figure:
    """Figures 8.3 to 8.13: start to 1200 rpm, and 50 ms at that speed."""
    run, start, late = runs.reversal, (0.0, 1.0), (1.2, 1.25)
    counts = compare_values(run)
    with style():
        figure = new_figure("paper-001-8.3-to-8.13", 8.6, "Start to 1200 rpm and steady operation")
        axes = [figure.add_axes(place) for place in _places(5)]
        _speed(axes[0], run, start, "Figure 8.3: start to 1200 rpm")
        _phase(axes[1], run, late, "Figure 8.4: current of phase a")
        _draw(axes[2], run, late, "Figure 8.5: $i_d$", "A (peak)", ((run.i_d, BLUE, ""),))
        _draw(axes[3], run, late, "Figure 8.6: $i_q$", "A (peak)", ((run.i_q, ORANGE, ""),))
        _currents(axes[4], run, start, "Figures 8.7 to 8.9: the start", error=True)
        _currents(axes[5], run, late, "Figures 8.7 to 8.9: steady", error=True)
        _draw(
            axes[6],
            run,
            late,
            "Figure 8.10: reference of $v_\u03b1$",
            "V",
            ((run.v_alpha, BLUE, ""),),
        )
        _angle(axes[7], run, late, "Figure 8.11: position of the rotor")
        _draw(axes[8], run, late, "Figure 8.12: CMPR1", "of 2949", ((counts[:, 0], BLUE, ""),))
        _draw(
            axes[9],
            run,
            late,
            "Figure 8.13: CMPR1 - CMPR2",
            "counts",
            ((counts[:, 0] - counts[:, 1], BLUE, ""),),
        )
    return figure


def plot_climbs(runs: ProgramRuns) -> Figure:
    """Figures 8.14 to 8.20: 2700 rpm, and from 1200 to 2200 rpm."""
    run, late, climb = runs.climb, (2.2, 2.25), (0.3, 1.3)
    with style():
        figure = new_figure("paper-001-8.14-to-8.20", 7.0, "2700 rpm, and from 1200 to 2200 rpm")
        axes = [figure.add_axes(place) for place in _places(4)]
        lines = (
            (run.reference / RPM, MUTED, "reference"),
            (run.omega_m / RPM, BLUE, "without limit of $v_q$"),
            (runs.limited.omega_m / RPM, TEAL, "with 13000"),
        )
        _draw(axes[0], run, climb, "Figure 8.14: to 2700 rpm", "rpm", lines)
        _phase(axes[1], run, late, "Figure 8.15: current of phase a")
        _currents(axes[2], run, late, "Figure 8.16: $i_q$ and its reference")
        _angle(axes[3], run, late, "Figure 8.17: position of the rotor")
        _speed(axes[4], runs.middle, climb, "Figure 8.18: from 1200 to 2200 rpm")
        _phase(axes[5], runs.middle, (0.45, 0.7), "Figure 8.19: current of phase a")
        _draw(
            axes[6],
            runs.middle,
            (0.45, 0.7),
            "Figure 8.20: reference of $v_\u03b1$",
            "V",
            ((runs.middle.v_alpha, BLUE, ""),),
        )
        _currents(axes[7], runs.middle, climb, "its $i_q$ and reference")
    return figure


def plot_reversal(runs: ProgramRuns) -> Figure:
    """Figures 8.21 to 8.28: the reversal, the sine and the steps."""
    run, whole, turn = runs.reversal, (1.3, 2.3), (1.45, 1.7)
    with style():
        figure = new_figure("paper-001-8.21-to-8.28", 7.0, "Reversal, sine and steps of the speed")
        axes = [figure.add_axes(place) for place in _places(4)]
        _speed(axes[0], run, whole, "Figure 8.21: reversal")
        _phase(axes[1], run, turn, "Figures 8.22, 8.23: current of phase a")
        _currents(axes[2], run, whole, "Figure 8.24: $i_q$ and its reference")
        _draw(axes[3], run, whole, "Figure 8.25: $i_d$", "A (peak)", ((run.i_d, BLUE, ""),))
        _angle(axes[4], run, turn, "Figure 8.26: position of the rotor")
        _speed(axes[5], runs.sine, (1.0, 3.0), "Figure 8.27: sine reference")
        _speed(axes[6], runs.steps, (0.9, 3.0), "Figure 8.28: steps of 500 rpm")
        _currents(axes[7], runs.steps, (0.9, 3.0), "its $i_q$ and reference")
    return figure


# The runs of Figures 8.3 to 8.28 of paper 001 with the program's own integers in the loop.

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


# Section 8.3 of paper 001: the rotor is drawn to phase a, its angle is called zero, and the
# program starts from there.
#
# The listing sets the compare register of phase a to three quarters of the timer's period and the
# others to half of it while an empty loop counts to 800 000, then clears the encoder's counter. How
# long the loop takes its compiler decides; ten to twenty clock periods a turn are 0.27 to 0.54 s.

SECONDS = 0.4  # Of the alignment here.

# Torques in N m that resist the motion; the machine's rated torque is 0.47 N m.
FRICTIONS = (0.0, 0.05, 0.2)
START_ANGLES = tuple(range(0, 360, 15))  # In degrees (electrical), at which the rotor lies before.
_TYPICAL = 105  # of the angles: the one from which the starts are shown
_AFTER = 0.8  # s from the end of the alignment
_STUCK = 90.0  # degrees: the rotor stayed where the torque of the current is nought


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignments against one friction in N m.

    ``current`` in A is that of phase a at their end; ``error_deg`` the largest electrical angle by
    which the rotor misses zero, ``formula_deg`` the arc sine of friction over the current's torque,
    ``stuck_deg`` the angles at which it stayed half a turn off. ``seconds`` from the end of the
    alignment until the speed stays within 2 % of 1200 rpm, nan where it never does, ``reached_rpm``
    at the end; ``backwards_rpm`` is the speed that a start from half a turn off comes to, nan where
    none lay there.
    """

    friction: float
    current: float
    error_deg: float
    formula_deg: float
    stuck_deg: tuple[int, ...]
    seconds: float
    reached_rpm: float
    backwards_rpm: float


def _aligned_run(place: ProgramBench, angle: int, friction: float, after: float) -> Simulation:
    reference = Profile((0.0,), (TARGET * RPM,))
    constants = Constants(align=round(SECONDS / place.drive.t_s))
    return place.run(
        SECONDS + after, reference, constants, theta_e=np.radians(angle), friction=friction
    )


def _missed(run: Simulation) -> float:
    """Electrical angle in degrees at the end of the alignment."""
    last = int(np.searchsorted(run.t, SECONDS)) - 1
    return float(np.degrees(np.angle(np.exp(1j * run.theta_e[last]))))


def _aligned(place: ProgramBench, friction: float, torque_per_ampere: float) -> Alignment:
    found = {angle: _missed(_aligned_run(place, angle, friction, 1e-3)) for angle in START_ANGLES}
    stuck = tuple(angle for angle, missed in found.items() if abs(missed) > _STUCK)
    run = _aligned_run(place, _TYPICAL, friction, _AFTER)
    current = float(phase_current(run)[int(np.searchsorted(run.t, SECONDS)) - 1])
    end = SECONDS + _AFTER
    reached = float(run.omega_m[-1]) / RPM
    there = abs(reached - TARGET) < BAND * TARGET
    seconds = settling_time(run, SECONDS, end, TARGET * RPM, BAND) if there else float("nan")
    back = _aligned_run(place, stuck[0], friction, _AFTER) if stuck else None
    return Alignment(
        friction,
        current,
        max(abs(missed) for angle, missed in found.items() if angle not in stuck),
        float(np.degrees(np.arcsin(friction / (torque_per_ampere * current)))),
        stuck,
        seconds,
        reached,
        float("nan") if back is None else float(back.omega_m[-1]) / RPM,
    )


def alignments(place: ProgramBench) -> tuple[Alignment, ...]:
    """The start of section 8.3 against every friction."""
    torque = place.drive.machine.torque_per_ampere
    return tuple(_aligned(place, friction, torque) for friction in FRICTIONS)
