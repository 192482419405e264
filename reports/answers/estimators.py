"""What `dqforge estimators` answers: estimators and start-ups of a drive, and the pair to flash."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import StartUpSettings, ToleranceName
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.plants.scenario import CurrentSensor, PlantErrors, Scenario, constant
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.candidate import (
    HALF_TURN,
    LOCKED,
    CaptureMap,
    TriedStarts,
)
from dqforge.optimizer.estimator_comparison.compared import started_design
from dqforge.optimizer.estimator_comparison.solve import (
    NOBODY,
    EstimatorComparison,
    compare_estimators,
    named,
    with_success,
)
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.start_up.plan import StartUpPlan
from dqforge.optimizer.start_up.solve import StartRate, judge_start
from dqforge.reports.estimator_comparison.observer_errors import (
    estimator_tables,
    plain_comparison,
    with_cost,
)
from dqforge.reports.estimator_comparison.random_starts import (
    SETTLED,
    BenchProgram,
    StartInput,
    bench_program,
    duration_of,
    run_starts,
    start_record,
)
from dqforge.reports.observers.position_header import observer_files, tracker_files
from dqforge.reports.output.folder import ESTIMATORS
from dqforge.reports.pages.answer import Answer, Files, stage
from dqforge.reports.pages.figures_style import FAINT, MAP_INK, MUTED, SERIES, new_figure, style
from dqforge.reports.pages.templating import OTHERS, WINNERS, draw_cells
from dqforge.reports.simulation.design_run import controller_files, drive_of, in_float32
from dqforge.reports.simulation.plant_input import run_input
from dqforge.reports.start_up.header import start_up_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart


def answer_estimators(
    design: Design, only: str | None = None, starts: int = 0, *, write: bool
) -> Answer:
    """Compare the estimators and start-ups of a design.

    Raises:
        InputError: As `which_estimators`.
        NoSolutionError: Likewise, or there is no pair whose headers could be written.
    """
    found = which_estimators(design, only, starts)

    def figure() -> Figure:

        return plot_comparison(found)

    files = Files(pair_files(design, found), ESTIMATORS, design) if write else None
    tables = estimator_tables(design, found)
    return Answer(design.name, tables, {"estimators": plain_comparison(found)}, figure, files)


# Which estimators, and which pair to flash: the question of a design, with all that can be found
# out on this computer.

MOST_STARTS = 1000


def which_estimators(
    design: Design, only: str | None = None, starts: int = 0
) -> EstimatorComparison:
    """The comparison with the cost of each step on the design's core.

    Args:
        design: The drive.
        only: Names of the estimators to compare, with commas in between; all of them when None.
        starts: How many starts each start-up is tried with per load; 0 for none.

    Raises:
        InputError, NoSolutionError: As `compare_estimators`, there is no estimator of that name, or
            too many starts are asked for.
    """
    if not 0 <= starts <= MOST_STARTS:
        raise InputError(f"--starts must lie between 0 and {MOST_STARTS}, got {starts}")
    chosen = None if only is None else named(only)
    found = compare_estimators(design, chosen, lambda name: stage(f"comparing {name}"))
    stage("counting cycles")
    found = with_cost(found)
    if not starts:
        return found
    return with_success(
        found, tried_starts(found, starts, lambda name: stage(f"starting by {name}"))
    )


# Headers of the pair that a comparison advises: the estimators, and the start with the control
# that it calls.


def pair_files(design: Design, found: EstimatorComparison) -> dict[str, bytes]:
    """Names and bytes of the headers of the pair.

    Args:
        design: The drive.
        found: The comparison.

    Raises:
        InputError, NoSolutionError: No estimator holds anywhere, so that there is nothing to write,
            or the control of the start cannot be emitted.
    """
    pair = found.pair
    if pair.start is not None:
        return _with_start(found)
    figures = None if pair.at_speed is None else found.estimator(pair.at_speed).figures
    if figures is not None and figures.observer is not None:
        return observer_files(design, figures.observer)
    if figures is not None and figures.tracker is not None:
        return tracker_files(design, figures.tracker)
    raise NoSolutionError(
        "there is no pair to write: no estimator with its own header holds at speed; "
        "leave -o out to see why"
    )


def _with_start(found: EstimatorComparison) -> dict[str, bytes]:
    """Control, both estimators and the state machine of the start, with the hand-over of the
    pair.
    """
    start = next(row for row in found.starts if row.candidate.name == found.pair.start)
    made = started_design(found.asked, start.candidate.method, found.pair.up)
    plain = replace(made, losses=None, modulation_choice=None, weakening=None, simulation=None)
    solution = in_float32(solve(plain))
    assert solution.start_up is not None
    return controller_files(solution) | start_up_files(solution, solution.start_up)


# How often each start-up of the comparison succeeds: the emitted state machine on machines drawn
# from the design's own tolerances.

LOADS = (0.0, 0.3)  # Friction over the torque of the current limit with which starts are tried.


def tried_starts(
    found: EstimatorComparison, count: int, told: Callable[[str], None]
) -> tuple[ComparedStart, ...]:
    """The start-ups of a comparison with the share of starts that succeed.

    Args:
        found: The comparison.
        count: Starts per load.
        told: Called with the name of each before it is tried.
    """
    return tuple(_tried(row, count, told) for row in found.starts)


def _tried(row: ComparedStart, count: int, told: Callable[[str], None]) -> ComparedStart:
    figures = row.figures
    if figures is None or figures.design is None:
        return row
    told(row.candidate.name)
    plain = replace(
        figures.design,
        losses=None,
        modulation_choice=None,
        weakening=None,
        simulation=None,
    )
    try:
        rates = start_success(plain, None, LOADS, count)
    except (InputError, NoSolutionError, VerificationError) as error:
        return replace(row, figures=replace(figures, untried=error.message))
    tried = tuple(
        TriedStarts(rate.load, rate.count, rate.succeeded, rate.interval, _named(rate))
        for rate in rates
    )
    return replace(row, figures=replace(figures, tried=tried))


def _named(rate: StartRate) -> dict[str, int]:
    return {str(name): often for name, often in rate.failures.items()}


# How often the start of one design succeeds over its own tolerances.

# Relative deviations, to either side, of a design that names no tolerances.
USUAL_BOX = {"r_s": 0.3, "psi_pm": 0.04}

# Noise of each current over the current limit, r.m.s., where the design's scenario has none.
NOISE = 5e-3
_RELATIVE: tuple[ToleranceName, ...] = ("r_s", "l_d", "l_q", "psi_pm", "inertia", "v_dc")
_LEAST_SPEED, _ABOVE = 0.4, 1.25  # of the base speed, and over the hand-over
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
    per_second = inverter.lost_per_dead_time
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
            "the design requests no start without encoder; write control.start_up: {method: auto}"
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


# Figure of the comparison: who wins where, errors over the speed, and the starts from which the
# chosen estimator locks.

_TURN = 2.0 * math.pi

_LARGEST, _LEAST = 90.0, 0.1  # deg of the errors that are drawn

_DASHES = ("-", "--", ":")  # estimators that agree lie on each other

_HALF_TURN_COLOUR = WINNERS[1]


def plot_comparison(found: EstimatorComparison) -> Figure:
    """Winners over speed and load, errors over the speed, starts that lock.

    Args:
        found: The comparison.
    """
    known = _by_cells(found)
    chosen = _chosen(found)
    capture = None if chosen is None or chosen.figures is None else chosen.figures.capture
    height = 3.1 if capture is None else 5.4
    with style():
        figure = new_figure(
            "estimators",
            height,
            "Estimator with the least error over speed and load, and its errors",
        )
        upper = figure.add_axes((0.085, 1.0 - 2.2 / height, 0.4, 1.85 / height))
        _draw_winners(upper, found, known)
        right = figure.add_axes((0.585, 1.0 - 2.2 / height, 0.4, 1.85 / height))
        _draw_errors(right, found, known)
        if capture is not None and chosen is not None:
            _draw_captures(figure, capture, chosen.candidate.name, height)
    return figure


def _chosen(found: EstimatorComparison) -> ComparedEstimator | None:
    name = found.pair.at_speed
    return None if name is None else found.estimator(name)


def _by_cells(found: EstimatorComparison) -> list[ComparedEstimator]:
    """Estimators that are not refused, those that win most cells first: colours are few."""
    cells = np.bincount(found.winner[found.winner >= 0], minlength=len(found.estimators))
    known = [k for k, row in enumerate(found.estimators) if row.figures is not None]
    return [found.estimators[k] for k in sorted(known, key=lambda k: -int(cells[k]))]


def _colour(place: int) -> str:
    return WINNERS[place] if place < len(WINNERS) else OTHERS


def _draw_winners(axes: Axes, found: EstimatorComparison, known: list[ComparedEstimator]) -> None:
    """A cell per speed and load, equally wide; white where nobody holds, hatched out of reach."""
    from matplotlib.patches import Patch

    places = {found.estimators.index(row): k for k, row in enumerate(known)}
    code = np.array(
        [
            [places.get(int(index), -1 if index == NOBODY else len(known)) for index in line]
            for line in found.winner.T
        ]
    )
    colours = [_colour(k) for k in range(len(known))] + [FAINT]
    speeds, loads = len(found.asked.omega), len(found.asked.shares)
    draw_cells(axes, code, np.arange(speeds + 1.0), np.arange(loads + 1.0), colours)
    shares = 100.0 * found.asked.omega / found.asked.omega_max
    axes.set_xticks(np.arange(speeds) + 0.5, [f"{share:.3g}" for share in shares.tolist()])
    axes.set_yticks(
        np.arange(loads) + 0.5, [f"{100.0 * share:.0f}" for share in found.asked.shares.tolist()]
    )
    axes.tick_params(labelsize=7.0)
    axes.set(
        xlim=(0, speeds),
        ylim=(0, loads),
        xlabel="Speed in % of the largest",
        ylabel="Torque in % of the largest",
        title="Least error of those that hold",
    )
    axes.grid(visible=False)
    shown = [k for k in range(len(known)) if np.any(code == k)]
    handles = [Patch(color=_colour(k), label=known[k].candidate.name) for k in shown]
    if np.any(code == len(known)):
        handles.append(Patch(color=FAINT, label="beyond the voltage"))
    if handles:
        axes.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.24),
            frameon=False,
            fontsize=6.5,
            ncols=3,
            handlelength=1.0,
        )


def _draw_errors(axes: Axes, found: EstimatorComparison, known: list[ComparedEstimator]) -> None:
    """Error of the angle at the worst load over the speed."""
    omega, reached = found.asked.omega, found.asked.reached
    for k, row in enumerate(known):
        assert row.figures is not None
        worst = np.degrees(np.max(np.where(reached, row.figures.angle, 0.0), axis=1))
        shown = np.where(np.isfinite(worst) & (worst > 0.0), worst, np.nan)
        axes.plot(
            100.0 * omega[1:] / found.asked.omega_max,
            shown[1:],
            color=SERIES[k % len(SERIES)],
            label=row.candidate.name,
            linestyle=_DASHES[k % len(_DASHES)],
            marker=".",
        )
    axes.axhline(math.degrees(ANGLE_LIMIT), color=MUTED, linewidth=0.7, linestyle="--")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set(
        ylim=(_LEAST, _LARGEST),
        xlabel="Speed in % of the largest",
        ylabel="Angle in deg r.m.s.",
        title="Error at the worst load",
    )
    if known:
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.24),
            frameon=False,
            fontsize=6.5,
            ncols=3,
            handlelength=1.4,
        )


def draw_capture(axes: Axes, found: CaptureMap, speed: int) -> None:
    """Starts at one speed: coloured where they lock, white where they are lost.

    Args:
        axes: To draw into.
        found: The map.
        speed: Index of the speed.
    """
    outcome = found.outcome[speed]
    code = np.where(outcome == LOCKED, 0, np.where(outcome == HALF_TURN, 1, -1))
    draw_cells(
        axes,
        code.astype(np.int64),
        _edges(np.degrees(found.angles)),
        _edges(100.0 * found.speeds),
        (WINNERS[2], _HALF_TURN_COLOUR),
        ("locks", "half a turn off"),
    )
    axes.set(
        xlim=(-180, 180),
        ylim=(100.0 * found.speeds[0], 100.0 * found.speeds[-1]),
        title=f"{found.omega[speed] / _TURN:.3g} Hz",
    )
    axes.set_xticks([-180, -90, 0, 90, 180])
    axes.tick_params(labelsize=7.0)
    axes.plot([0.0], [0.0], marker="+", color=MAP_INK, label="_")
    axes.grid(visible=False)


def _edges(
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Borders halfway between ascending values that lie unevenly."""
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([values[:1], middle, values[-1:]])


def _draw_captures(figure: Figure, found: CaptureMap, name: str, height: float) -> None:
    count = len(found.omega)
    width = 0.9 / count
    first = None
    for k in range(count):
        box = (0.085 + k * width, 0.45 / height, 0.82 * width, 1.25 / height)
        axes = figure.add_axes(box, sharey=first)
        draw_capture(axes, found, k)
        axes.set_xlabel("Start angle off by deg", fontsize=7.5)
        if first is None:
            first = axes
            axes.set_ylabel("Speed off by %")
        else:
            axes.tick_params(labelleft=False)
    figure.text(
        0.5,
        1.98 / height,
        f"Starts from which {name} locks (orange: half a turn off)",
        ha="center",
        fontsize=8,
    )
