"""A simulated run as it was recorded, and the figures of many."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.names import FeedbackMethod, NumberFormat, SampledRuleName, Topology
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.estimators import TRACKERS
from dqforge.reports.observers.position_header import REDUCED_ORDER
from dqforge.reports.operating_system.host_compiler import compile_program, require_compiler
from dqforge.reports.pages.templating import render
from dqforge.reports.simulation.plant_input import (
    BRIDGE_COLUMNS,
    BRIDGE_PARAMETERS,
    BRIDGE_STATES,
    COLUMNS,
    HEARD,
    LONGEST_DELAY,
    PARAMETERS,
    PLANT,
    STATES,
    SUMMARY,
    Drive,
    RunInput,
    run_input,
    share_tables,
)


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """Figures of N runs, arrays of shape (N,).

    ``status`` is 0, or 1 where the currents left all bounds and the run ended early, at ``t`` in s.
    ``peak_current`` in A is the largest current vector of all integration steps; ``tail_error`` the
    largest deviation from the reference over the last part of the run (rad/s, N m or A),
    ``tail_current`` the largest current vector at the samples there. ``i_d``, ``i_q``, ``omega_m``
    and ``torque`` are those at the end. Integrals over the run: ``i_square`` of the mean square of
    the phase currents in A^2 s, and in J the energy from the inverter (``e_in``), into copper, from
    the air gap (``e_shaft``), into the load and into friction.

    Of phase machines alone, 0 for others: the energy at the end in the inductances (a choke in the
    neutral included) and in the midpoint of a split link off its half, in J; and over the last part
    of the run the mean torque in N m, the peak to peak of its means over control periods
    (``tail_ripple_means``) and of itself (``tail_ripple``), the neutral's current in A r.m.s., the
    mean copper loss of each phase in W, and the largest distance of the midpoint from half the
    link in V.
    """

    status: NDArray[np.intp]
    t: FloatArray
    peak_current: FloatArray
    tail_error: FloatArray
    tail_current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    omega_m: FloatArray
    torque: FloatArray
    i_square: FloatArray
    e_in: FloatArray
    e_copper: FloatArray
    e_shaft: FloatArray
    e_load: FloatArray
    e_friction: FloatArray
    e_magnetic: FloatArray
    e_midpoint: FloatArray
    tail_torque: FloatArray
    tail_ripple_means: FloatArray
    tail_ripple: FloatArray
    tail_neutral_rms: FloatArray
    tail_copper_a: FloatArray
    tail_copper_b: FloatArray
    tail_copper_c: FloatArray
    tail_midpoint: FloatArray

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Whether the run came to its end, shape (N,)."""
        return np.asarray(self.status == 0)

    @property
    def rms_current(self) -> FloatArray:
        """Root mean square of the phase currents in A, shape (N,)."""
        return np.sqrt(self.i_square / np.maximum(self.t, 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class PhaseRecord:
    """What is recorded of a phase machine besides, arrays of shape (N,) at the sampling instants.

    ``duty_legs`` has the shape (N, legs), in the order of `TOPOLOGIES`, and acts until the next
    sample; ``i_phases`` (N, 3) are the true currents of a, b and c in A, ``i_neutral`` is their sum
    where a neutral is connected. ``v_midpoint`` in V lies above the negative rail, nan where the
    link is not split. ``torque_mean`` in N m is the mean over the control period that ends.
    """

    duty_legs: FloatArray
    i_phases: FloatArray
    i_neutral: FloatArray
    v_midpoint: FloatArray
    torque_mean: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ApplicationRecord:
    """What the program around the functions records, arrays of shape (N,) at the sampling instants.

    The numbers of its emitted enumerations.
    """

    application_state: FloatArray
    application_fault: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EstimationRecord:
    """What an estimation of parameters records besides, arrays of shape (N,) at the sampling
    instants.

    ``r_s`` in Ohm and ``psi_pm`` in Wb are those of the plant, ``r_s_estimated`` and
    ``psi_pm_estimated`` the estimates, ``estimation_status`` that of the emitted structure.
    """

    r_s: FloatArray
    psi_pm: FloatArray
    r_s_estimated: FloatArray
    psi_pm_estimated: FloatArray
    estimation_status: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StartRecord:
    """What a start without encoder records besides, arrays of shape (N,) at the sampling instants.

    ``start_state`` and ``start_fault`` are the numbers of the emitted enumerations,
    ``start_reference`` in rad/s (mechanical) is the reference of the speed on its slope.
    """

    start_state: FloatArray
    start_fault: FloatArray
    start_reference: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BlockRecord:
    """What is recorded of a six-step drive besides, arrays of shape (N,) at the sampling instants.

    ``stage`` and ``fault`` are those of the emitted control, ``sector`` is fed until the next
    sample, nan where all legs rest; ``i_reference`` in A.
    """

    stage: FloatArray
    fault: FloatArray
    sector: FloatArray
    i_reference: FloatArray


@dataclass(frozen=True, slots=True)
class BlockFigures:
    """What a six-step drive did.

    ``started`` is the time in s at which it first ran on its estimator, None where it never did;
    ``fault`` names that at the end, ``stage`` the last one. ``commutations`` is the number of those
    by the estimator, ``error_mean``, ``error_rms`` and ``error_largest`` (rad, electrical) how far
    their instants lie behind those of the waveform, from the twentieth on after each hand-over
    and within the range; None without any. ``predicted`` is the largest error by the formula at the
    speeds of these.
    """

    started: float | None
    stage: str
    fault: str
    commutations: int
    error_mean: float | None
    error_rms: float | None
    error_largest: float | None
    predicted: float | None


@dataclass(frozen=True, slots=True, eq=False)
class BridgeUse:
    """What was counted of a bridge over a time.

    ``counted`` has the shape (2, 5, B): upper and lower position; times in s in which a transistor
    carries its own direction, a current returns, flows in a dead time, and numbers of commutations
    by which a transistor turns on and off; over `BINS` currents. ``edges`` (3,) are commutations of
    the legs, ``up`` (3,) the times in s that they were up; ``duration`` in s. ``states`` are the
    integrals of the plant over that time by name, in SI units.
    """

    counted: FloatArray
    edges: FloatArray
    up: FloatArray
    duration: float
    states: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class BridgeFigures:
    """Figures of a counted bridge.

    ``use`` is that of the run, ``tail`` that of its last tenth, to which all figures belong but
    ``frequency``; pairs are of the run and of its last tenth. Frequencies in Hz are means of the
    legs. ``distortion`` is that of the phase currents over their fundamental, no order left out,
    ``ripple_current`` in A r.m.s. what they have beside it; ``torque`` in N m with its ripple, peak
    to peak and r.m.s.; ``i_d`` and ``i_q`` are means in A; ``copper``, ``shaft`` and ``link`` mean
    powers in W. ``conduction`` (with ``blanked``, its part in dead times) and ``switching`` in W
    are by the tables of the device; ``junction_temperature`` in degC.
    """

    use: BridgeUse
    tail: BridgeUse
    frequency: float
    tail_frequency: float
    distortion: float
    ripple_current: float
    torque: float
    torque_ripple: float
    torque_rms: float
    i_d: float
    i_q: float
    copper: float
    shaft: float
    link: float
    conduction: tuple[float, float]
    switching: tuple[float, float]
    blanked: tuple[float, float]
    junction_temperature: float


@dataclass(frozen=True, slots=True, eq=False)
class BridgeRecord:
    """What is recorded where a bridge is counted besides: ``edges``, shape (N,), commutations of
    all legs up to the sampling instant. The duty cycles of such a run are the shares of the period
    in which the legs were up.
    """

    edges: FloatArray
    figures: BridgeFigures


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A run as it was recorded, arrays of shape (N,) at the sampling instants,
    and (N, 3) for phases a, b, c.

    ``t`` in s; ``i_d``, ``i_q``, ``i_zero`` in A; ``omega_m`` in rad/s, ``theta_e`` in rad;
    ``torque`` and ``torque_load`` in N m; ``duty`` acts until the next sample, shape (N, 3);
    ``v_dc`` in V. ``reference`` and ``reference_d`` are those that the controller saw
    (`Scenario.reference`), ``i_measured`` (N, 3), ``theta_e_measured`` and ``omega_m_measured``
    what its sensors gave, ``i_d_reference``, ``i_q_reference`` and ``torque_reference`` what its
    outer loops asked for. ``theta_e_observed`` and ``omega_m_observed`` are the estimates of the
    design's observers (nan where there is none) from the measured currents and ``v_alpha``,
    ``v_beta`` in V, which the controller made over the period that ends; ``sensorless`` is 1 where
    the controller ran on them, and then ``theta_e_measured`` and ``omega_m_measured`` are theirs.
    ``figures`` are those of the one run, ``phases`` what phase machines have besides, ``start``
    what a start without encoder has, ``blocks`` what six-step drives have,
    ``application`` what the program around the functions has, ``estimation`` what an estimation of
    parameters has.
    """

    scenario: Scenario
    t: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    i_zero: FloatArray
    omega_m: FloatArray
    theta_e: FloatArray
    torque: FloatArray
    torque_load: FloatArray
    duty: FloatArray
    v_dc: FloatArray
    reference: FloatArray
    reference_d: FloatArray
    i_measured: FloatArray
    theta_e_measured: FloatArray
    omega_m_measured: FloatArray
    i_d_reference: FloatArray
    i_q_reference: FloatArray
    torque_reference: FloatArray
    v_alpha: FloatArray
    v_beta: FloatArray
    theta_e_observed: FloatArray
    omega_m_observed: FloatArray
    sensorless: FloatArray
    figures: Summary
    phases: PhaseRecord | None = None
    start: StartRecord | None = None
    blocks: BlockRecord | None = None
    application: ApplicationRecord | None = None
    bridge: BridgeRecord | None = None
    estimation: EstimationRecord | None = None


# Simulation in the time domain: a compiled plant around the emitted controller,
# run as often as wanted.
#
# The program is compiled once; machines, gains and scenarios are data that it reads, so that
# thousands of drives take one process. docs/methods/simulation.md has the equations and the limits.

# Of every program with a plant in it, which more optimisation makes no faster.
PLANT_FLAGS = ("-std=c99", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")

_HEARD = {
    "sum-voltage": "heard[0] + heard[1] + heard[2]",
    "voltage-a": "heard[0]",
    "voltage-b": "heard[1]",
    "voltage-c": "heard[2]",
}

_EXITS = {
    2: "its input is too short",
    3: "the gains are not those of its header",
    4: "there is not enough memory",
    6: "the back-EMF given is not that of its header",
    7: "the gains of the observer are not those of its header",
}

Progress = Callable[[float], None]

# What switches a bridge whose commutations are counted.
Switching = Literal["carrier"] | FeedbackMethod

# Places of the grid of currents over which is counted.
BINS = 256

# Most angles in a quarter of a pulse pattern.
MOST_ANGLES = 12


@dataclass(frozen=True, slots=True)
class Simulator:
    """A compiled program; ``prefix`` is that of the controller, empty where there is none.

    ``observers`` are the names in C of those that run in it: at most one of the position,
    and ``reduced_order``. ``topology`` is that of a controller for phase machines, None for one
    that drives three legs, or none. ``format`` is the number format of its control functions.
    ``starts`` says whether it can start without an encoder, ``measures`` that it can measure the
    speed by the emitted functions, ``applies`` that it is led by the program around them,
    ``estimates`` that it estimates parameters on line.
    """

    program: Path
    prefix: str
    observers: tuple[str, ...] = ()
    topology: Topology | None = None
    format: NumberFormat = "float32"
    starts: bool = False
    measures: bool = False
    applies: bool = False
    estimates: bool = False


def measurement_of(files: Mapping[str, bytes], prefix: str) -> str:
    """How the emitted headers measure the speed: by ``edges`` or by ``counts``; empty if not."""
    content = files.get(f"{prefix}_speed_measurement.h")
    if content is None:
        return ""
    return "edges" if b"_speed_measurement_edge(" in content else "counts"


def compile_simulator(
    folder: Path,
    files: Mapping[str, bytes] | None = None,
    prefix: str = "",
    observers: tuple[str, ...] = (),
    topology: Topology | None = None,
    number_format: NumberFormat = "float32",
    bridge: Switching | None = None,
) -> Simulator:
    """Compile the plant around a controller.

    Args:
        folder: Where sources and program are written; it must exist, and programs must be allowed
            to run there.
        files: Emitted headers by name, that of the control functions in ``number_format`` among
            them; None for a plant without controller, which runs scenarios of the mode
            ``open-loop`` only.
        prefix: That of the headers.
        observers: Names in C of the observers to run: ``reduced_order`` of
            ``<prefix>_speed_observer.h``, any other of ``<prefix>_observer.h``.
        topology: That of the header where it controls a phase machine (duty cycles by the names of
            legs, a back-EMF to swap); None for the control of machines with a sinusoidal back-EMF.
        number_format: Whose control functions (and observers) run: those of ``<prefix>_control.h``,
            or those in integers of ``<prefix>_control_q15.h`` and the like.
        bridge: What switches the bridge where its commutations and losses are counted: the carrier,
            or a regulator of the phase currents in place of it; None for the carrier, uncounted.

    Raises:
        VerificationError: There is no compiler, or the header does not compile.
    """
    controller = prefix if files else ""
    sources = simulation_sources(files, prefix, observers, topology, number_format, bridge)
    program = compiled(folder, files or {}, sources)
    return Simulator(
        program,
        controller,
        observers,
        topology,
        number_format,
        starts=number_format == "float32" and f"{controller}_startup.h" in (files or {}),
        measures=bool(measurement_of(files or {}, controller)),
        applies=number_format == "float32" and f"{controller}_main.c" in (files or {}),
        estimates=number_format == "float32"
        and f"{controller}_online_estimation.h" in (files or {}),
    )


def simulation_sources(
    files: Mapping[str, bytes] | None = None,
    prefix: str = "",
    observers: tuple[str, ...] = (),
    topology: Topology | None = None,
    number_format: NumberFormat = "float32",
    bridge: Switching | None = None,
) -> dict[str, str]:
    """The C of the plant and of its main programme, by the names of the files.

    Parameters as `compile_simulator`.
    """
    controller = prefix if files else ""
    integers = number_format != "float32"
    position = next((name for name in observers if name != REDUCED_ORDER), "")
    tracker = next((each for each in TRACKERS.values() if each.code == position), None)
    hears = () if tracker is None else tracker.hears
    context = PLANT | {
        "prefix": controller,
        "macro": controller.upper(),
        "format": number_format,
        "width": FIXED_WIDTHS.get(number_format, 0),
        "position": position,
        "reduced": REDUCED_ORDER in observers,
        "topology": topology or "",
        "legs": TOPOLOGIES[topology or "three-wire"].legs,
        "neutral": topology is not None and TOPOLOGIES[topology].neutral,
        "midpoint": topology is not None and TOPOLOGIES[topology].midpoint,
        "low": _start_observer(prefix, files or {}),
        "start_up": not integers and f"{prefix}_startup.h" in (files or {}),
        "measurement": measurement_of(files or {}, controller),
        "estimation": not integers and f"{controller}_online_estimation.h" in (files or {}),
        "application": not integers and f"{prefix}_main.c" in (files or {}),
        "torque_limit": any(b"*torque_limit;" in content for content in (files or {}).values()),
        "torque_control": not integers
        or any(b"_torque_control_" in content for content in (files or {}).values()),
        "waiting": int(LONGEST_DELAY) + 2,
        "parameters": PARAMETERS + (BRIDGE_PARAMETERS if bridge else ()),
        "columns": COLUMNS + (BRIDGE_COLUMNS if bridge else ()),
        "summary": SUMMARY,
        "states": STATES + (HEARD if hears else ()) + (BRIDGE_STATES if bridge else ()),
        "bridge": bridge or "",
        "bins": BINS,
        "most_angles": MOST_ANGLES,
        "sampled_rules": get_args(SampledRuleName),
        "hears": hears,
        "further": "".join(
            f", ({'double' if integers else 'float'})({_HEARD[name]})" for name in hears
        ),
        "injects": tracker is not None and tracker.injects,
        "at_speed": tracker is not None and tracker.at_speed,
    }
    sources = {
        "plant.c": render("simulation/plant.c.j2", context),
        "phase_plant.c": render("simulation/phase_plant.c.j2", context),
        "main.c": render("simulation/simulate_main.c.j2", context),
    }
    if bridge:
        for name in ("bridge", "regulators"):
            sources[f"{name}.c"] = render(f"simulation/{name}.c.j2", context)
    if integers:
        sources["integer_border.h"] = render("simulation/integer_border.h.j2", context)
    return sources


def compiled(
    folder: Path, files: Mapping[str, bytes], sources: Mapping[str, str], main: str = "main.c"
) -> Path:
    """The program of sources and headers.

    Args:
        folder: Where they and the program are written.
        files, sources: Emitted headers, and C code, by name.
        main: The source that is compiled.

    Raises:
        VerificationError: There is no compiler, or the sources do not compile.
    """
    compiler = require_compiler()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    failed = "the simulation does not compile"
    return compile_program(compiler, PLANT_FLAGS, main, folder, "simulate", failed)


def _start_observer(prefix: str, files: Mapping[str, bytes]) -> str:
    """Name in C of the estimator from standstill on; empty without one."""
    content = files.get(f"{prefix}_start_observer.h", b"")
    codes = (tracker.code for tracker in TRACKERS.values())
    return next((code for code in codes if f" {prefix}_{code}_t;".encode() in content), "")


@contextmanager
def simulator(
    files: Mapping[str, bytes] | None = None,
    prefix: str = "",
    observers: tuple[str, ...] = (),
    topology: Topology | None = None,
    number_format: NumberFormat = "float32",
    bridge: Switching | None = None,
) -> Iterator[Simulator]:
    """A compiled program in a folder that goes with the block.

    Parameters and errors as `compile_simulator`.
    """
    with scratch_folder() as folder:
        yield compile_simulator(folder, files, prefix, observers, topology, number_format, bridge)


def execute(program: Path, content: bytes, progress: Progress | None) -> bytes:
    """Output of the program; its progress lines go to the callback as they come."""
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as made:
        given.write(content)
        given.seek(0)
        try:
            process = subprocess.Popen(
                [str(program)], stdin=given, stdout=made, stderr=subprocess.PIPE
            )
        except OSError as error:
            raise VerificationError(
                f"the compiled simulation cannot be started ({error.strerror}); "
                "TMPDIR must name a folder whose programs may run"
            ) from error
        with process:
            try:
                _follow(process.stderr, progress)
            except BaseException:
                process.kill()
                raise
            code = process.wait()
        if code != 0:
            reason = _EXITS.get(code, f"exit code {code}")
            raise VerificationError(f"the compiled simulation stopped: {reason}")
        made.seek(0)
        return made.read()


def _follow(stream: IO[bytes] | None, progress: Progress | None) -> None:
    for line in stream or ():
        if progress is not None:
            progress(float(line))


def _runs(
    simulator: Simulator, runs: Sequence[RunInput], progress: Progress | None
) -> list[tuple[FloatArray, FloatArray]]:
    """(figures, rows of shape (N, columns)) of each run."""
    if progress is not None:
        for run in runs:
            run.parameters["progress"] = 1.0
    content = np.array([float(len(runs))]).tobytes() + b"".join(
        run.content() for run in share_tables(list(runs))
    )
    return records_of(execute(simulator.program, content, progress), len(runs))


def records_of(written: bytes, runs: int) -> list[tuple[FloatArray, FloatArray]]:
    """(figures, rows of shape (N, columns)) of each run that a program wrote.

    Args:
        written: Its output.
        runs: How many it ran.
    """
    numbers = np.frombuffer(written, dtype=np.float64)
    found, place = [], 0
    for _ in range(runs):
        figures = numbers[place : place + len(SUMMARY)]
        count, width, _size = numbers[place + len(SUMMARY) : place + len(SUMMARY) + 3].astype(
            np.intp
        )
        place += len(SUMMARY) + 3
        found.append((figures, numbers[place : place + count * width].reshape(count, width)))
        place += count * width
    return found


def _summary(figures: Sequence[FloatArray]) -> Summary:
    columns = dict(zip(SUMMARY, np.stack(list(figures)).T, strict=True))
    status = columns.pop("status").astype(np.intp)
    return Summary(status=status, **columns)


def simulate(
    simulator: Simulator,
    drive: Drive,
    scenario: Scenario,
    *,
    stride: int = 1,
    tail: float = 0.9,
    gains: bytes = b"",
    shape: bytes = b"",
    progress: Progress | None = None,
    observer: bytes = b"",
) -> Simulation:
    """Run one drive through a scenario.

    Args:
        simulator: The compiled program.
        drive, scenario: What is simulated.
        stride: Samples per recorded row.
        tail: Share of the duration from which `Summary.tail_error` counts.
        gains: Bytes of the controller's C structure of gains; empty for those in its header. Where
            it ends with a pointer to the back-EMF, the program fills that in.
        shape: Bytes of its C structure of the back-EMF; empty for that in its header.
        progress: Called with the share that is done.
        observer: Bytes of the C structure of the position observer's gains, in float32; empty for
            those in its header.

    Raises:
        InputError: As `dqforge.reports.simulation.recorded_run.plant_input.run_input`.
        VerificationError: The program cannot be run.
    """
    _require_controller(simulator, scenario)
    topology = _topology(simulator, drive, scenario)
    run = run_input(
        drive,
        scenario,
        stride=stride,
        tail=tail,
        gains=gains,
        shape=shape,
        topology=topology,
        observer=observer,
    )
    ((figures, rows),) = _runs(simulator, [run], progress)
    applied = simulator.applies and scenario.mode == "speed"
    return as_recorded(
        scenario,
        figures,
        rows,
        None if drive.phases is None else topology,
        applied=applied,
        estimated=simulator.estimates and not (applied or scenario.encoder.absent),
    )


def as_recorded(
    scenario: Scenario,
    figures: FloatArray,
    rows: FloatArray,
    topology: Topology | None,
    *,
    applied: bool = False,
    estimated: bool = False,
) -> Simulation:
    """A run from the numbers that a program wrote.

    Args:
        scenario: What was simulated.
        figures: In the order of `SUMMARY`.
        rows: In the order of `COLUMNS`, shape (N, columns); further columns are left aside.
        topology: Of a phase machine, None for others.
        applied: Whether the program around the functions ran.
        estimated: Whether parameters were estimated.
    """
    columns = {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(COLUMNS)}
    duty = np.stack([columns.pop(f"duty_{phase}") for phase in "abc"], axis=1)
    measured = np.stack([columns.pop(f"i_{phase}_measured") for phase in "abc"], axis=1)
    phases = _phase_record(columns, duty, topology)
    start = _start_record(columns, scenario)
    program = _application_record(columns, applied=applied)
    known = EstimationRecord(*(columns.pop(name) for name in EstimationRecord.__slots__))
    return Simulation(
        scenario=scenario,
        duty=duty,
        i_measured=measured,
        figures=_summary([figures]),
        phases=phases,
        start=start,
        blocks=None,
        application=program,
        bridge=None,
        estimation=known if estimated else None,
        **columns,
    )


def _application_record(
    columns: dict[str, FloatArray], *, applied: bool
) -> ApplicationRecord | None:
    """Takes the columns of the program around the functions out; None where none ran."""
    state, fault = (columns.pop(f"application_{name}") for name in ("state", "fault"))
    return ApplicationRecord(state, fault) if applied else None


def _start_record(columns: dict[str, FloatArray], scenario: Scenario) -> StartRecord | None:
    """Takes the columns of a start without encoder out; None where there is one."""
    state, fault, reference = (
        columns.pop(f"start_{name}") for name in ("state", "fault", "reference")
    )
    return StartRecord(state, fault, reference) if scenario.encoder.absent else None


def _phase_record(
    columns: dict[str, FloatArray], duty: FloatArray, topology: Topology | None
) -> PhaseRecord | None:
    """Takes the columns of phase machines out; None where there is no topology."""
    more = {name: columns.pop(name) for name in COLUMNS[-10:]}
    if topology is None:
        return None
    rule = TOPOLOGIES[topology]
    return PhaseRecord(
        duty_legs=np.column_stack([duty, *(more[f"duty_{leg}"] for leg in rule.legs[3:])]),
        i_phases=np.stack([more[f"i_{phase}"] for phase in "abc"], axis=1),
        i_neutral=more["i_n"],
        v_midpoint=more["v_m"] if rule.midpoint else np.full_like(more["v_m"], np.nan),
        torque_mean=more["torque_mean"],
    )


def _topology(simulator: Simulator, drive: Drive, scenario: Scenario) -> Topology:
    """How the phases are fed: legs that the controller does not know of are not connected."""
    wanted = drive.inverter.topology
    if scenario.mode == "open-loop":
        return wanted
    if simulator.topology is not None:
        if wanted != simulator.topology:
            raise ValueError(f"a controller for {simulator.topology} cannot drive {wanted}")
        return wanted
    return wanted if len(TOPOLOGIES[wanted].legs) == 3 else "three-wire"


def simulate_many(
    simulator: Simulator,
    runs: Sequence[tuple[Drive, Scenario, bytes]],
    *,
    tail: float = 0.9,
    shapes: Sequence[bytes] | None = None,
    progress: Progress | None = None,
) -> Summary:
    """Figures of many runs (drive, scenario, bytes of the gains) in one process.

    Nothing is recorded. ``shapes`` are the bytes of `simulate` of each run; None for those in the
    header.

    Parameters and errors as `simulate`.
    """
    for _, scenario, _ in runs:
        _require_controller(simulator, scenario)
    inputs = [
        run_input(
            drive,
            scenario,
            stride=0,
            tail=tail,
            gains=gains,
            shape=shape,
            topology=_topology(simulator, drive, scenario),
        )
        for (drive, scenario, gains), shape in zip(runs, shapes or [b""] * len(runs), strict=True)
    ]
    return _summary([figures for figures, _ in _runs(simulator, inputs, progress)])


def _require_controller(simulator: Simulator, scenario: Scenario) -> None:
    if not simulator.prefix and scenario.mode != "open-loop":
        raise ValueError(
            f"a program without a controller cannot follow a {scenario.mode} reference"
        )
    if scenario.encoder.absent and not simulator.starts:
        raise InputError(
            "a drive without encoder starts by control.start_up; write it, or give it an encoder"
        )
    if scenario.encoder.speed == "measured" and not simulator.measures:
        raise InputError("simulation.encoder.speed: measured needs control.speed_loop.measurement")
    if scenario.encoder.speed == "observer" and not simulator.observers:
        raise InputError(
            "the speed is to come from an observer; give the drive one (control.observer)"
        )
    if scenario.sensorless is not None and not set(simulator.observers) - {REDUCED_ORDER}:
        raise InputError(
            "the angle is to come from an observer; give the drive one of the position "
            "(control.observer)"
        )
