"""The emitted control of many phase machines: few programs, machines, gains and shapes as data."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from emitted_decay import EmittedLoop, compiled_loop
from random_phase_drives import RandomMachine, random_design

from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.machines.names import Topology
from dqforge.machines.plants.scenario import InverterModel, Scenario, constant
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.loops.loop_gains import tune_current_loop
from dqforge.optimizer.loops.robustness import drive_box
from dqforge.optimizer.phase_control.design import (
    PhaseLoops,
    judged,
    phase_control,
    resampled,
    voltage_margin,
)
from dqforge.optimizer.phase_control.judged_box import SHARES, PhasePlants, radius, weight_of
from dqforge.optimizer.phase_control.phase_controller import (
    PhaseControl,
    PhaseShape,
    largest_torques,
    reference_currents,
    torque_of,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.header import (
    HARMONIC_NUMBERS,
    MIDPOINT_NUMBERS,
    NUMBERS,
    PIS,
    phase_control_files,
    plain_solution_control,
    structure_of,
)
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulator, Summary, simulate_many, simulator

# Sizes of the table that programs are made for: the next one above what the design chose.
NODES = (720, 1536)

# Harmonic integrators that programs are made for. Equal phases with mirrored half waves have just
# those of their design; of the others, who have any of some forty, as many as a design has at most.
ORDERS = {
    "odd": ((-5, 7, -11, 13), (3, 9)),
    "any": ((-1, -2, 3, 4, -5, 7, -11, 13), (1, 3, 6, 9)),
}

# Reasons of refusals in short, and words of their messages.
KINDS = {
    "torque": "beyond what the link permits",
    "unstable": "the currents are unstable at",
    "neutral mean": "have a mean in the neutral",
    "frame": "the current for constant torque would grow without bound",
    "zero loop": "i_0 loop",
    "table": "no table of up to",
}

PART = 0.06  # Least length in s of the last part of a run, of which its figures are; whole periods.

# Weight of a harmonic integrator below which it learns so slowly that it may hide in time.
FADING = 0.3


@dataclass(frozen=True, eq=False)
class SweptDrive:
    """A design that was accepted, its control as it is emitted, and its point.

    ``torque`` in N m; ``samples`` make whole periods at the electrical speed ``omega_e`` in rad/s.
    """

    drawn: RandomMachine
    design: Design
    control: PhaseControl
    torque: float
    omega_e: float
    samples: int

    @property
    def key(self) -> tuple[Any, ...]:
        """What the program depends on."""
        control = self.control
        assert control.harmonics is not None
        orders = (control.harmonics.plane, control.harmonics.zero)
        return (control.frame, control.feedforward, control.shape.flux.shape, orders)


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why a drive was refused, and what was: None where no control was found."""

    reason: str
    drive: SweptDrive | None

    @property
    def kind(self) -> str:
        """The reason in short."""
        return next(kind for kind, words in KINDS.items() if words in self.reason)


def swept(drawn: RandomMachine, topology: Topology) -> SweptDrive | Refusal:
    """Design and judge a machine on a topology, and see whether the link permits its torque."""
    design, drive = random_design(drawn, topology), None
    machine, control = design.machine, design.control
    try:
        i_q = tune_current_loop(machine.r_s, machine.l_q, control.t_s, control.current_loop, "i_q")
        found = phase_control(design, replace(i_q, loop="i_d"), i_q)
        drive = _at_its_point(drawn, design, found)
        nominal = (machine.l_d, machine.l_q)
        judged(design, drive_box(design, nominal, nominal), replace(found, control=drive.control))
    except DqforgeError as error:
        return Refusal(str(error), drive)
    if abs(drive.torque) > permitted(drive):
        return Refusal("torque beyond what the link permits", drive)
    return drive


def permitted(drive: SweptDrive, margin: float | None = None) -> float:
    """Largest torque in N m at the drive's speed and link, with the margin of its design."""
    omega = np.array([abs(drive.omega_e)])
    margin = voltage_margin(drive.design) if margin is None else margin
    return float(largest_torques(drive.control, omega, drive.design.inverter.v_dc, margin)[0])


def _at_its_point(drawn: RandomMachine, design: Design, found: PhaseLoops) -> SweptDrive:
    """The control in one of the forms that there are programs for, and the point."""
    control, machine = found.control, drawn.machine
    harmonics, rows = control.harmonics, machine.flux[: 1 if drawn.winding == "odd" else 3]
    size = next(nodes for nodes in NODES if nodes >= control.shape.flux.shape[1])
    if harmonics is not None:
        plane, zero = ORDERS["odd" if drawn.winding == "odd" else "any"]
        neutral = TOPOLOGIES[control.topology].neutral
        harmonics = replace(harmonics, plane=plane, zero=zero if neutral else ())
    control = replace(
        control, shape=PhaseShape(resampled(rows, size)), harmonics=harmonics, torque_limit=None
    )
    turn = 2.0 * math.pi / (abs(drawn.omega_e) * drawn.t_s)
    periods = math.ceil(PART / (turn * drawn.t_s))
    samples = round(periods * turn)
    omega_e = math.copysign(2.0 * math.pi * periods / (samples * drawn.t_s), drawn.omega_e)
    torque = drawn.share * control.torque_max
    return SweptDrive(drawn, design, control, torque, omega_e, samples)


def sampled_torque(drive: SweptDrive) -> float:
    """Mean torque in N m of currents that meet their references at the samples.

    Between them they run along chords, which leaves sinc^2 of every order: of the fundamental
    0.5 % less with 25 samples per period.
    """
    control, omega = drive.control, np.array(drive.omega_e)
    turns = np.arange(NODES[0]) / NODES[0]
    wanted = drive.torque * reference_currents(control, 2.0 * math.pi * turns, omega)
    orders = np.fft.fftfreq(NODES[0], 1.0 / NODES[0])
    left = np.sinc(orders * drive.omega_e * drive.drawn.t_s / (2.0 * math.pi)) ** 2
    made = np.fft.ifft(left * np.fft.fft(wanted, axis=1), axis=1).real
    flux = clarke_matrix() @ resampled(drive.drawn.machine.flux, NODES[0])
    return float(np.mean(torque_of(flux, made, control.pole_pairs)))


def gain_bytes(solution: Solution, control: PhaseControl) -> bytes:
    """The C structure of the gains, its pointers empty."""
    plain = plain_solution_control(solution, control)
    made = structure_of(plain)
    names = [
        *NUMBERS,
        *(HARMONIC_NUMBERS if made.multiples else ()),
        *(MIDPOINT_NUMBERS if made.midpoint else ()),
    ]
    numbers = [x for name in PIS for x in plain[name]] + [plain[name] for name in names]
    content = struct.pack(f"<{len(numbers)}fI", *numbers, plain["ratio"])
    return content + bytes(-len(content) % 8) + bytes(8)


def shape_bytes(control: PhaseControl) -> bytes:
    """The C structure of the back-EMF."""
    flux = control.shape.flux
    return np.hstack([flux, flux[:, :1]]).astype("<f4").tobytes()


def _run(drive: SweptDrive, inverter: InverterModel, lengths: int) -> tuple[Drive, Scenario]:
    design, drawn = drive.design, drive.drawn
    omega_m = drive.omega_e / drawn.machine.pole_pairs
    by_current = drive.control.frame == "dq"
    wanted = drive.torque / (1.5 * drawn.machine.pole_pairs * drive.control.psi_pm)
    scenario = Scenario(
        lengths * drive.samples * drawn.t_s,
        "current" if by_current else "torque",
        constant(wanted if by_current else drive.torque),
        shaft=constant(omega_m),
        omega_m=omega_m,
        inverter=inverter,
        dead_time=0.0,
    )
    return Drive(design.machine, design.inverter, drawn.t_s, 1, drawn.machine), scenario


@contextmanager
def program(solution: Solution, drive: SweptDrive) -> Iterator[Simulator]:
    """The compiled plant around the control of a drive, and of all that have its key."""
    files = header_files(solution) | phase_control_files(solution, drive.control)
    with simulator(files, solution.design.export.prefix, (), drive.control.topology) as compiled:
        yield compiled


def run(
    solution: Solution,
    compiled: Simulator,
    drives: Sequence[SweptDrive],
    inverter: InverterModel = "averaged",
    lengths: int = 4,
) -> Summary:
    """Figures of drives; those of the last one of ``lengths`` parts count."""
    runs = [
        (*_run(drive, inverter, lengths), gain_bytes(solution, drive.control)) for drive in drives
    ]
    shapes = [shape_bytes(drive.control) for drive in drives]
    return simulate_many(compiled, runs, tail=1.0 - 1.0 / lengths, shapes=shapes)


@dataclass(frozen=True, eq=False)
class Decay:
    """What is left of a disturbance per sample: as the loop is judged, with and without the orders
    that fade, which may hide, and in time.
    """

    radius: float
    unfaded: float
    in_time: float

    @property
    def agrees(self) -> bool:
        """Whether time and judgement are the same within 1e-3."""
        return self.unfaded - 1e-3 < self.in_time < self.radius + 1e-3


def slowest_speed(drive: SweptDrive) -> float:
    """Electrical speed in rad/s, of those that are judged, where the radius is the largest."""
    top = drive.drawn.omega_e_max
    speeds = [share * top for share in SHARES[1:]]
    return max(speeds, key=lambda speed: expected_radius(drive, whole(drive, speed)[1]))


def whole(drive: SweptDrive, omega_e: float) -> tuple[int, float]:
    """Whole number of samples per period next to a speed in rad/s, and the speed that has it."""
    t_s = drive.drawn.t_s
    samples = min(max(10, round(2.0 * math.pi / (abs(omega_e) * t_s))), 2000)
    return samples, 2.0 * math.pi / (samples * t_s)


def expected_radius(drive: SweptDrive, omega_e: float, least: float = 0.0) -> float:
    """Radius per sample with the orders that run with more than a weight."""
    control, capacitance = drive.control, drive.design.inverter.midpoint_capacitance
    harmonics = control.harmonics
    if harmonics is not None:
        plane, zero = (
            tuple(m for m in part if weight_of(harmonics, m * omega_e / (2.0 * math.pi)) > least)
            for part in (harmonics.plane, harmonics.zero)
        )
        control = replace(control, harmonics=replace(harmonics, plane=plane, zero=zero))
    held = None if capacitance is None else np.array([capacitance])
    r_s, l_d, l_q, l_0 = (np.array([size]) for size in (control.r_s, *control.inductances))
    return float(radius(control, PhasePlants(r_s, l_d, l_q, l_0, np.ones(1), held), omega_e)[0])


def decays(
    folder: Path, solution: Solution, drives: Sequence[SweptDrive], *, slowest: bool = False
) -> list[Decay]:
    """Decays of drives that have the same program, at their points or where they are slowest."""
    program = compiled_loop(folder, solution, drives[0].control)
    speeds = [slowest_speed(drive) if slowest else drive.omega_e for drive in drives]
    return [
        _decay(solution, program, drive, speed) for drive, speed in zip(drives, speeds, strict=True)
    ]


def _decay(solution: Solution, program: EmittedLoop, drive: SweptDrive, speed: float) -> Decay:
    """Both at the whole number of samples per period that is next to a speed in rad/s."""
    control, t_s = drive.control, drive.drawn.t_s
    samples, omega = whole(drive, speed)
    level = 0.05 * drive.design.i_max
    voltage = omega * control.psi_pm * 3.0 + 10.0 * level * max(g.kp for g in control.gains)
    loop = replace(
        program,
        control=control,
        data=gain_bytes(solution, control) + shape_bytes(control),
        level=level,
        v_dc=20.0 * voltage,
    )
    length = samples * max(1, round(12000 / samples))
    starts = 3 if samples < 40 and control.frame in ("dqx", "dqy") else 1
    plant = (
        control.r_s, *control.inductances, drive.design.inverter.midpoint_capacitance or 1.0
    )  # fmt: skip
    left = [
        loop.decay(omega, plant, 1.0, 4000, length, (0.382 + start) / starts * omega * t_s)
        for start in range(starts)
    ]
    unfaded, found = (expected_radius(drive, omega, least) for least in (FADING, 0.0))
    # Where an order lies on the limit its weight is rounding: the order keeps what it has.
    harmonics = control.harmonics
    orders = () if harmonics is None else (*harmonics.plane, *harmonics.zero)
    faded = any(6 * abs(order) == samples for order in orders)
    return Decay(1.0 if faded else found, unfaded, max(left))
