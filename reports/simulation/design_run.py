"""A design simulated with its emitted controller: the run, the figures of its steps and of its
start, and the file of its samples.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.flux_map import ripple_of_map
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware, NumberFormat, Topology
from dqforge.machines.plants.scenario import Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.online_estimation import FLUX, RESISTANCE
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.optimizer.start_up.start_records import StartupFault, StartupState
from dqforge.reports.fixed_observers.fixed_observer_header import fixed_observer_files
from dqforge.reports.main_header import header_files
from dqforge.reports.observers.online_estimation import estimation_files
from dqforge.reports.observers.position_header import (
    REDUCED_ORDER,
    estimator_files,
    observer_files,
    speed_observer_files,
)
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.phase_control.emitted_integers import (
    emitted_control_files,
    integer_files,
    phase_control_of,
)
from dqforge.reports.simulation.plant_input import Drive, not_simulated, simulated
from dqforge.reports.simulation.recorded_run import (
    ApplicationRecord,
    BlockFigures,
    BlockRecord,
    BridgeRecord,
    EstimationRecord,
    PhaseRecord,
    Progress,
    Simulation,
    StartRecord,
    Summary,
    simulate,
    simulator,
)
from dqforge.reports.single_headers.application import application_files
from dqforge.reports.single_headers.field_weakening import weakening_files
from dqforge.reports.single_headers.fixed_reference import reference_files
from dqforge.reports.single_headers.speed_measurement import measurement_files
from dqforge.reports.start_up.header import every_start_file
from dqforge.reports.waveforms.tables import waveform_files

SETTLED = 0.02  # Share of a step within which the answer counts as settled.
_LAST = 0.1  # share of an interval over which its final error is averaged
_MOST_STEPS = 12
_MOST_ROWS = 2_000_000


@dataclass(frozen=True, slots=True)
class StepFigures:
    """The answer to one step of the reference.

    ``time`` in s; ``before`` and ``after`` the value and its reference (rad/s, N m, A); ``rise``
    from 10 to 90 % and ``settling`` into 2 % of the step in s, nan where that is not reached before
    the next step; ``overshoot`` as a share of the step; ``error`` the mean of value less reference
    over the last tenth of the interval.
    """

    time: float
    before: float
    after: float
    rise: float
    overshoot: float
    settling: float
    error: float


@dataclass(frozen=True, slots=True)
class ObservedFigures:
    """Errors of the observers over a run: of the electrical angle in rad (None without one),
    of the mechanical speed.

    ``speed_largest`` in rad/s; ``sensorless_share`` is the share of the samples that were
    controlled by the estimates.
    """

    angle_rms: float | None
    angle_largest: float | None
    speed_largest: float
    sensorless_share: float


@dataclass(frozen=True, slots=True)
class EstimationFigures:
    """How parameters were estimated on line: at the end the resistance in Ohm and the flux linkage
    in Wb, estimated and of the plant, and the shares of the samples that moved each estimate.
    """

    r_s: float
    r_s_plant: float
    psi_pm: float
    psi_pm_plant: float
    r_s_share: float
    psi_pm_share: float


@dataclass(frozen=True, slots=True)
class PhaseFigures:
    """What a phase machine did over the last tenth of a run.

    ``torque`` is the mean in N m, ``ripple_means`` the peak to peak of its means over control
    periods, ``ripple`` that of every instant, the pulses' included. ``neutral_rms`` in A;
    ``copper`` in W of the phases a, b, c; ``midpoint`` is the largest distance of the midpoint from
    half of the link in V, None where the link is not split.
    """

    torque: float
    ripple_means: float
    ripple: float
    neutral_rms: float
    copper: tuple[float, float, float]
    midpoint: float | None


@dataclass(frozen=True, slots=True)
class TurningFigures:
    """What a machine whose map knows the rotor angle did over the last tenth of a run.

    ``torque`` is the mean in N m; peak to peak ``ripple`` of every instant of it (``relative`` to
    the mean, None where that is next to nothing) and ``ripple_means`` of its means over control
    periods, ``speed`` in rad/s, and ``current`` of the magnitude of the current vector in A, at the
    recorded samples.
    """

    torque: float
    ripple: float
    relative: float | None
    ripple_means: float
    speed: float
    current: float


def angle_error(run: Simulation) -> FloatArray:
    """Observed less true electrical angle in rad, wrapped to -pi to pi, shape (N,);
    nan where none is observed.
    """
    gap = run.theta_e_observed - run.theta_e
    return np.asarray((gap + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def observed(run: Simulation) -> ObservedFigures | None:
    """How well the observers did over the run, None where none ran."""
    seen = np.isfinite(run.omega_m_observed)
    if run.start is not None:
        seen = estimated(run, run.start)
    if not (np.all(seen) if run.start is None else np.any(seen)):
        return None
    speed = float(np.max(np.abs(run.omega_m_observed - run.omega_m)[seen]))
    error, share = angle_error(run)[seen], float(np.mean(run.sensorless))
    if not np.all(np.isfinite(error)):
        return ObservedFigures(None, None, speed, share)
    return ObservedFigures(
        float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error))), speed, share
    )


# Of a simulation, what is no array: records of their own among it.
_RECORDS = frozenset(
    ("scenario", "figures", "phases", "start", "blocks", "application", "bridge", "estimation")
)


def npz_bytes(run: Simulation) -> bytes:
    """The samples as a NumPy archive: float64 arrays by name, without a date,
    the same bytes for the same run.
    """
    more = (run.phases, run.start, run.blocks, run.application, run.bridge, run.estimation)
    parts: list[
        Simulation
        | PhaseRecord
        | StartRecord
        | BlockRecord
        | ApplicationRecord
        | BridgeRecord
        | EstimationRecord
    ] = [
        run,
        *(part for part in more if part is not None),
    ]
    arrays = {
        name: getattr(part, name)
        for part in parts
        for name in type(part).__dataclass_fields__
        if name not in _RECORDS
    }
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            array = io.BytesIO()
            np.lib.format.write_array(array, np.ascontiguousarray(values), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, array.getvalue())
    return content.getvalue()


def simulation_files(found: DriveSimulation, label: str = "") -> dict[str, bytes]:
    """Names and bytes of the files of samples: one per format and for the firmware of others, the
    first without its name. ``label`` is a part of all names.
    """
    stem = f"{found.design.export.prefix}_simulation{f'_{label}' if label else ''}"
    first = {f"{stem}.npz": npz_bytes(found.run)}
    return first | {f"{stem}_{other.label}.npz": npz_bytes(other.run) for other in found.others}


@dataclass(frozen=True, slots=True)
class StartFigures:
    """A start.

    ``state`` and ``fault`` are those at the end, by their names in C; ``failed`` names the faults
    on the way. ``hand_over`` is the instant in s at which the observer took over first, ``speed``
    in rad/s (mechanical) and ``angle_error`` in rad those at that instant, ``current_step`` in A
    the largest change of the current vector in the rotor's frame over the next ten samples; nan
    where it never did. ``reached`` is the time in s to 10 % of the last reference, nan for never;
    ``back`` the largest electrical angle in rad against the direction of the reference,
    ``crossings`` how often the observer took over or was left.
    """

    state: str
    fault: str
    failed: tuple[str, ...]
    hand_over: float
    speed: float
    angle_error: float
    current_step: float
    reached: float
    back: float
    crossings: int


def estimated(run: Simulation, record: StartRecord) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Samples at which the observer ruled, shape (N,).

    Args:
        run, record: What was recorded.
    """
    ruled = (record.start_state == StartupState.RUN) & np.isfinite(run.omega_m_observed)
    return np.asarray(ruled)


@dataclass(frozen=True, slots=True, eq=False)
class DriveSimulation:
    """A run with what is read off it.

    ``unit`` is that of the reference and of `StepFigures`; ``steps`` are the answers to steps, none
    where the reference does not step; ``tracking`` the largest and the r.m.s. deviation from the
    reference over the run. ``copper`` is the mean copper loss in W; ``speed_largest`` in rad/s and
    ``torque_largest`` in N m are the largest magnitudes of the run; ``observed`` says how well
    observers did, None where none ran; ``phases`` are the figures of a phase machine, None for
    others, ``turning`` those of a map over the rotor angle. ``format`` is that of the control
    functions that ran, ``others`` are the same run with those in further formats; ``not_simulated``
    are formats that the design emits and nothing ran. ``firmware`` names that of others whose loops
    ran in place of the emitted code, None for the latter; ``remarks`` say what is otherwise in a
    run, one sentence each. ``six_step`` are the figures of a six-step drive, None for others;
    ``start`` those of a start without encoder, ``estimation`` those of parameters estimated on
    line.
    """

    design: Design
    run: Simulation
    unit: str
    steps: tuple[StepFigures, ...]
    tracking: tuple[float, float]
    copper: float
    speed_largest: float
    torque_largest: float
    observed: ObservedFigures | None
    not_simulated: tuple[NumberFormat, ...] = ()
    phases: PhaseFigures | None = None
    turning: TurningFigures | None = None
    format: NumberFormat = "float32"
    others: tuple[DriveSimulation, ...] = ()
    firmware: Firmware | None = None
    remarks: tuple[str, ...] = ()
    six_step: BlockFigures | None = None
    start: StartFigures | None = None
    estimation: EstimationFigures | None = None

    @property
    def every(self) -> tuple[DriveSimulation, ...]:
        """The run and those of further formats."""
        return (self, *self.others)

    @property
    def formats(self) -> tuple[NumberFormat, ...]:
        """Formats of the control functions that ran, without the loops of firmware of others."""
        return tuple(found.format for found in self.every if found.firmware is None)

    @property
    def label(self) -> str:
        """What ran: a format, or the firmware of others."""
        return self.format if self.firmware is None else self.firmware

    @property
    def angle_error(self) -> FloatArray:
        """Observed less true electrical angle in rad, as `angle_error` has it, shape (N,)."""
        return angle_error(self.run)

    def files(self) -> dict[str, bytes]:
        """Names and bytes of the files of samples."""
        return simulation_files(self)


def drive_of(design: Design) -> Drive:
    """What is simulated of a design."""
    speed = design.control.speed_loop
    ratio = 1 if speed is None else speed.ratio
    return Drive(design.machine, design.inverter, design.control.t_s, ratio, design.phase_machine)


def emitted_files(solution: Solution, number_format: NumberFormat) -> dict[str, bytes]:
    """The headers that the controller in a format consists of.

    Raises:
        ValueError: The design does not emit that format.
    """
    measured = measurement_of_design(solution)
    if number_format == "float32":
        program = (
            {}
            if solution.application is None
            else application_files(solution, solution.application)
        )
        estimation = (
            {}
            if solution.online_estimation is None
            else estimation_files(solution.design, solution.online_estimation)
        )
        return controller_files(in_float32(solution)) | measured | program | estimation
    fits = [fit for fit in solution.fixed if fit.control.format == number_format]
    if not fits:
        raise ValueError(f"the design emits no control functions in {number_format}")
    files = integer_files(solution.design, fits[0]) | measured
    for reference in solution.fixed_references:
        if reference.reference.format == number_format:
            files |= reference_files(solution.design, reference)
    for observer in solution.fixed_observers:
        if observer.observer.format == number_format:
            files |= fixed_observer_files(solution.design, observer)
    return files


def controller_files(solution: Solution) -> dict[str, bytes]:
    """The headers that the controller in float32 consists of.

    Raises:
        InputError: The current references are in fixed point.
    """
    files = header_files(solution) | emitted_control_files(solution) | observers_of(solution)[0]
    if solution.start_up is not None:
        files |= every_start_file(solution, solution.start_up)
    if solution.phases is not None:
        files |= waveform_files(solution.design, solution.phases)
    return (
        files
        if solution.weakening is None
        else files | weakening_files(solution.design, solution.weakening)
    )


def measurement_of_design(solution: Solution) -> dict[str, bytes]:
    """Header of the measured speed; none where the design has no such measurement."""
    loops = solution.loops
    if loops is None or loops.measured_speed is None:
        return {}
    return measurement_files(solution.design, loops.measured_speed)


def controlled_topology(solution: Solution) -> Topology | None:
    """That of the emitted control of a phase machine, None for machines with a sinusoidal
    back-EMF.
    """
    control = phase_control_of(solution)
    return None if control is None else control.topology


def observers_of(solution: Solution) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Headers of the observers of a design, and their names in C."""
    design, gains = solution.design, solution.gains
    if gains.position is not None:
        return observer_files(design, gains.position), (gains.position.method.code,)
    if gains.tracker is not None:
        return estimator_files(design, gains.tracker), (gains.tracker.tracker.code,)
    if gains.observer is not None:
        return speed_observer_files(design, gains.observer), (REDUCED_ORDER,)
    return {}, ()


@on_design("simulation")
def require_scenario(design: Design, *, switched: bool = False) -> Scenario:
    """The simulation that a design asks for.

    Raises:
        InputError: It asks for none.
    """
    if design.simulation is None:
        raise InputError(
            "the design requests no simulation; add a section such as simulation: "
            "{duration: 0.5 s, speed: 1000 rpm}"
        )
    return replace(design.simulation, inverter="switched") if switched else design.simulation


def in_float32(solution: Solution) -> Solution:
    """The solution with its current reference in float32: the same form,
    fitted for that arithmetic.

    Control in float32 cannot call a reference in fixed point.
    """
    fit = solution.fit
    if not isinstance(fit.reference, FixedReference):
        return solution
    settings = replace(fit.settings, format="float32", full_scale=None, budget=None)
    return replace(
        solution, fit=fit_reference(current_choice(solution.design), settings), certificate=None
    )


def part_of(progress: Progress | None, place: int, count: int) -> Progress | None:
    """The progress of one of several runs, from 0 on."""
    if progress is None:
        return None
    return lambda share: progress((place + share) / count)


@on_design("simulation")
def simulate_design(
    design: Design,
    *,
    switched: bool = False,
    solution: Solution | None = None,
    progress: Progress | None = None,
) -> DriveSimulation:
    """Solve the controller of a design, emit it in every format that it asks for, compile each with
    the plant, and run the scenario.

    Args:
        design: With a section ``simulation``.
        switched: Whether every switching instant is simulated, whatever the section says.
        solution: That of the design, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: There is no such section, or it does not fit the design.
        VerificationError: There is no C compiler, or the header does not compile.
    """
    scenario = require_scenario(design, switched=switched)
    require_compiler()
    whole = solve_control(design) if solution is None else solution
    formats = simulated(whole)
    if formats != ("float32",):
        _require_full_scale(design, scenario)
    found = [
        replace(
            _simulated_in(
                design, whole, scenario, number_format, part_of(progress, place, len(formats))
            ),
            not_simulated=not_simulated(whole),
        )
        for place, number_format in enumerate(formats)
    ]
    return replace(found[0], others=tuple(found[1:]))


def _require_full_scale(design: Design, scenario: Scenario) -> None:
    """Refuse speeds that integers cannot be told."""
    most, base = scenario.reference.largest, design.control.bases.speed
    if scenario.mode == "speed" and most > base * (1.0 + 1e-9):
        raise InputError(
            f"simulation.speed: {format_quantity(most, 'rpm')} is beyond full scale in fixed "
            f"point, {format_quantity(base, 'rpm')}; write control.per_unit.speed: "
            f"{format_quantity(1.25 * most, 'rpm', 4)}, or a lower speed"
        )


def _simulated_in(
    design: Design,
    solution: Solution,
    scenario: Scenario,
    number_format: NumberFormat,
    progress: Progress | None,
) -> DriveSimulation:
    """The run of the control functions in one format."""
    stride = recorded_stride(scenario, design.control.t_s)
    with simulator(
        emitted_files(solution, number_format),
        design.export.prefix,
        observers_of(solution)[1],
        controlled_topology(solution),
        number_format,
    ) as program:
        run = simulate(program, drive_of(design), scenario, stride=stride, progress=progress)
    return replace(evaluate(design, run), format=number_format)


def recorded_stride(scenario: Scenario, t_s: float) -> int:
    """Samples of ``t_s`` in s per recorded row."""
    return 1 + int(scenario.duration / t_s) // _MOST_ROWS


def evaluate(design: Design, run: Simulation) -> DriveSimulation:
    """Read the figures off a run."""
    value, unit = controlled(run)
    deviation = value - run.reference
    tracking = (float(np.max(np.abs(deviation))), float(np.sqrt(np.mean(deviation**2))))
    copper = float(run.figures.e_copper[0]) / float(run.figures.t[0])
    return DriveSimulation(
        design=design,
        run=run,
        unit=unit,
        steps=step_figures(run.t, value, run.scenario.reference),
        tracking=tracking,
        copper=copper,
        speed_largest=float(np.max(np.abs(run.omega_m))),
        torque_largest=float(np.max(np.abs(run.torque))),
        observed=observed(run),
        phases=None if run.phases is None else phase_figures(run.figures, run.phases),
        turning=None if ripple_of_map(design.machine) is None else turning_figures(run),
        start=None if run.start is None else start_figures(run, run.start),
        estimation=None if run.estimation is None else estimation_figures(run.estimation),
    )


def turning_figures(run: Simulation) -> TurningFigures:
    """Figures of a machine whose torque depends on the rotor angle."""
    figures, last = run.figures, run.t >= 0.9 * float(run.t[-1])
    torque, ripple = float(figures.tail_torque[0]), float(figures.tail_ripple[0])
    return TurningFigures(
        torque=torque,
        ripple=ripple,
        relative=ripple / abs(torque) if abs(torque) > 0.1 * ripple else None,
        ripple_means=float(figures.tail_ripple_means[0]),
        speed=float(np.ptp(run.omega_m[last])),
        current=float(np.ptp(np.hypot(run.i_d, run.i_q)[last])),
    )


def estimation_figures(record: EstimationRecord) -> EstimationFigures:
    """Figures of parameters estimated on line."""
    status = record.estimation_status.astype(int)
    return EstimationFigures(
        r_s=float(record.r_s_estimated[-1]),
        r_s_plant=float(record.r_s[-1]),
        psi_pm=float(record.psi_pm_estimated[-1]),
        psi_pm_plant=float(record.psi_pm[-1]),
        r_s_share=float(np.mean((status & RESISTANCE) > 0)),
        psi_pm_share=float(np.mean((status & FLUX) > 0)),
    )


def phase_figures(figures: Summary, record: PhaseRecord) -> PhaseFigures:
    """Figures of a phase machine of one run."""
    split = bool(np.all(np.isfinite(record.v_midpoint)))
    return PhaseFigures(
        torque=float(figures.tail_torque[0]),
        ripple_means=float(figures.tail_ripple_means[0]),
        ripple=float(figures.tail_ripple[0]),
        neutral_rms=float(figures.tail_neutral_rms[0]),
        copper=(
            float(figures.tail_copper_a[0]),
            float(figures.tail_copper_b[0]),
            float(figures.tail_copper_c[0]),
        ),
        midpoint=float(figures.tail_midpoint[0]) if split else None,
    )


def controlled(run: Simulation) -> tuple[FloatArray, str]:
    """The value that follows the reference, shape (N,), and its SI unit."""
    if run.scenario.mode == "speed":
        return run.omega_m, "rad/s"
    return (run.torque, "N m") if run.scenario.mode == "torque" else (run.i_q, "A")


def step_figures(
    time: FloatArray, value: FloatArray, reference: Profile
) -> tuple[StepFigures, ...]:
    """Answers to the steps of a held reference; none for lines and sines.

    Args:
        time, value: Samples in s, and of the controlled value, shape (N,).
        reference: What it follows.
    """
    if reference.shape != "hold" or reference.amplitude != 0.0:
        return ()
    ends = [*reference.times[1:], np.inf]
    found: list[StepFigures] = []
    for begin, end, after in zip(reference.times, ends, reference.values, strict=True):
        inside = np.flatnonzero((time >= begin - 1e-9) & (time < end - 1e-9))
        if inside.size < 3 or len(found) == _MOST_STEPS:
            continue
        before = float(value[inside[0]])
        if abs(after - before) > 1e-3 * max(abs(after), abs(before)):
            found.append(_step(time[inside], value[inside], before, after))
    return tuple(found)


def _step(time: FloatArray, value: FloatArray, before: float, after: float) -> StepFigures:
    share = (value - before) / (after - before)
    rise = _crossing(time, share, 0.9) - _crossing(time, share, 0.1)
    outside = np.flatnonzero(np.abs(share - 1.0) > SETTLED)
    last = int(outside[-1]) + 1 if outside.size else 0
    settling = float(time[last] - time[0]) if last < time.size else np.nan
    tail = value[-max(1, int(_LAST * value.size)) :]
    overshoot = max(0.0, float(np.max(share)) - 1.0)
    return StepFigures(
        float(time[0]), before, after, rise, overshoot, settling, float(np.mean(tail)) - after
    )


def _crossing(time: FloatArray, share: FloatArray, level: float) -> float:
    """Time in s at which a level is first reached, between samples by a line; nan if never."""
    above = np.flatnonzero(share >= level)
    if not above.size:
        return float("nan")
    k = int(above[0])
    if k == 0:
        return float(time[0])
    part = (level - share[k - 1]) / (share[k] - share[k - 1])
    return float(time[k - 1] + part * (time[k] - time[k - 1]))


# What is read off a simulated start without encoder.

_NEAR = 0.1  # of the reference: it counts as reached


_SOON = 10  # samples after the hand-over


def _turned(run: Simulation) -> FloatArray:
    """Electrical angle since the start in rad, shape (N,)."""
    angle = np.unwrap(run.theta_e)
    return np.asarray(angle - angle[0])


def start_figures(run: Simulation, record: StartRecord) -> StartFigures:
    """Figures of a start.

    Args:
        run, record: What was recorded.
    """
    state, fault = record.start_state.astype(int), record.start_fault.astype(int)
    running = state == StartupState.RUN
    first = int(np.argmax(running)) if np.any(running) else -1
    last = float(run.reference[-1])
    near = np.abs(run.omega_m - last) <= _NEAR * abs(last)
    close = np.flatnonzero(near) if last else np.empty(0, dtype=np.intp)
    turned = _turned(run) * (-1.0 if last < 0.0 else 1.0)
    gap, step, speed, time = (float("nan"),) * 4
    if first >= 0:
        error = float(run.theta_e_observed[first] - run.theta_e[first])
        gap = float((error + np.pi) % (2.0 * np.pi) - np.pi)
        vector = run.i_d[first : first + _SOON] + 1j * run.i_q[first : first + _SOON]
        step = float(np.max(np.abs(vector - vector[0])))
        speed, time = float(run.omega_m[first]), float(run.t[first])
    return StartFigures(
        state=StartupState(state[-1]).name,
        fault=StartupFault(fault[-1]).name,
        failed=tuple(StartupFault(code).name for code in sorted(set(fault.tolist()) - {0})),
        hand_over=time,
        speed=speed,
        angle_error=gap,
        current_step=step,
        reached=float(run.t[close[0]]) if close.size else float("nan"),
        back=float(max(0.0, -np.min(turned))),
        crossings=int(np.count_nonzero(np.diff(running.astype(int)))),
    )


def spans(record: StartRecord) -> list[tuple[str, int, int]]:
    """States in turn: name, first sample, first sample of the next.

    Args:
        record: What was recorded.
    """
    state = record.start_state.astype(int)
    edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), state.size]
    return [(StartupState(state[start]).name, start, end) for start, end in pairwise(edges)]
