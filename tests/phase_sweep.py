"""The emitted control of many phase machines: few programs, machines, gains and shapes as data."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from emitted_decay import EmittedLoop, compiled_loop
from random_phase_drives import RandomMachine, random_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.machines.names import Topology
from dqforge.machines.plants.scenario import InverterModel, Scenario, constant
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.loops.gains import tune_current_loop
from dqforge.optimizer.loops.tolerance_box import drive_box
from dqforge.optimizer.phase_control.design import (
    PhaseLoops,
    judged,
    phase_control,
    voltage_margin,
)
from dqforge.optimizer.phase_control.floquet import radius
from dqforge.optimizer.phase_control.periodic_step import PhasePlants
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, PhaseShape
from dqforge.optimizer.phase_control.shape_table import resampled
from dqforge.optimizer.phase_control.torque_limit import largest_torques
from dqforge.optimizer.solution import Solution
from dqforge.reports.main_header.header import header_files
from dqforge.reports.phase_control.header import phase_control_files, plain_solution_control
from dqforge.reports.phase_control.plain import (
    HARMONIC_NUMBERS,
    MIDPOINT_NUMBERS,
    NUMBERS,
    PIS,
    structure_of,
)
from dqforge.reports.simulation.compiled_plant import Summary, simulate_many, simulator
from dqforge.reports.simulation.plant_input import Drive

NODES = (720, 1536)
"""Sizes of the table that programs are made for: the next one above what the design chose."""

ORDERS = {
    "odd": ((-5, 7, -11, 13), (3, 9)),
    "any": ((-1, -2, 3, 4, -5, 7, -11, 13), (1, 3, 6, 9)),
}
"""Harmonic integrators that programs are made for. Equal phases with mirrored half waves have just
those of their design; of the others, who have any of some forty, as many as a design has at most.
"""

TAIL = 0.75
"""Share of a run after which its figures count."""


@dataclass(frozen=True, eq=False)
class SweptDrive:
    """A design that was accepted, its control as it is emitted, and its point.

    ``torque`` in N m; ``periods`` electrical periods of ``samples`` samples in all, at the
    electrical speed ``omega_e`` in rad/s, are the last part of a run.
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
    """Why a drive was refused, and the control that was, None where none was found."""

    reason: str
    drive: SweptDrive | None


def swept(drawn: RandomMachine, topology: Topology) -> SweptDrive | Refusal:
    """Design and judge a machine on a topology, and see whether the link permits its torque."""
    design, drive = random_design(drawn, topology), None
    machine, control = design.machine, design.control
    try:
        i_q = tune_current_loop(
            machine.r_s, machine.l_q, control.t_s, control.current_loop, "i_q"
        )
        found = phase_control(design, replace(i_q, loop="i_d"), i_q)
        drive = _at_its_point(drawn, design, found)
        nominal = (machine.l_d, machine.l_q)
        judged(design, drive_box(design, nominal, nominal), replace(found, control=drive.control))
    except DqforgeError as error:
        return Refusal(str(error), drive)
    if abs(drive.torque) > permitted(drive):
        return Refusal("torque beyond what the link permits", drive)
    return drive


def permitted(drive: SweptDrive) -> float:
    """Largest torque in N m at the drive's speed and link."""
    omega, margin = np.array([abs(drive.omega_e)]), voltage_margin(drive.design)
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
    periods = math.ceil(0.08 / (turn * drawn.t_s))
    samples = round(periods * turn)
    omega_e = math.copysign(2.0 * math.pi * periods / (samples * drawn.t_s), drawn.omega_e)
    torque = drawn.share * control.torque_max
    return SweptDrive(drawn, design, control, torque, omega_e, samples)


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
        dead_time=drawn.dead_time if inverter == "switched" else 0.0,
    )
    return Drive(design.machine, design.inverter, drawn.t_s, 1, drawn.machine), scenario


def run(
    solution: Solution,
    drives: Sequence[SweptDrive],
    inverter: InverterModel = "averaged",
    lengths: int = 4,
) -> Summary:
    """Figures of drives that have the same program; their last one of ``lengths`` parts counts."""
    export, topology = solution.design.export, drives[0].control.topology
    files = header_files(solution) | phase_control_files(solution, drives[0].control)
    runs = [
        (*_run(drive, inverter, lengths), gain_bytes(solution, drive.control)) for drive in drives
    ]
    shapes = [shape_bytes(drive.control) for drive in drives]
    with simulator(files, export.prefix, (), topology) as program:
        return simulate_many(program, runs, tail=1.0 - 1.0 / lengths, shapes=shapes)


def decays(
    folder: Path, solution: Solution, drives: Sequence[SweptDrive]
) -> tuple[FloatArray, FloatArray]:
    """Radius per sample, and what is left of a disturbance in time, of drives that have the same
    program.
    """
    program = compiled_loop(folder, solution, drives[0].control)
    found = [_decay(solution, program, drive) for drive in drives]
    return np.array([pair[0] for pair in found]), np.array([pair[1] for pair in found])


def _decay(solution: Solution, program: EmittedLoop, drive: SweptDrive) -> tuple[float, float]:
    """Both at the whole number of samples per period that is next to the drive's speed."""
    control, t_s = drive.control, drive.drawn.t_s
    samples = max(12, round(2.0 * math.pi / (abs(drive.omega_e) * t_s)))
    omega = 2.0 * math.pi / (samples * t_s)
    capacitance = drive.design.inverter.midpoint_capacitance or 1.0
    held = np.array([capacitance]) if control.midpoint is not None else None
    sizes = tuple(np.array([size]) for size in (control.r_s, *control.inductances))
    expected = float(radius(control, PhasePlants(*sizes, np.ones(1), held), omega)[0])
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
    few = samples < 40 and control.frame in ("dqx", "dqy")
    starts = (0.382, 1.382, 2.382) if few else (0.382,)
    plant = (control.r_s, *control.inductances, capacitance)
    left = (
        loop.decay(omega, plant, 1.0, 4000, length, start / len(starts) * omega * t_s)
        for start in starts
    )
    return expected, max(left)
