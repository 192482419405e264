"""Copper loss of dqx over dqy with the emitted C in the loop, for the shapes of Table 3.1."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.frames import thesis_shapes
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass
from dqforge.reports.papers.paper002_definitions.bench_currents import bench_machine
from dqforge.reports.papers.paper002_definitions.compensation import TRAPEZOID_FLUX
from dqforge.reports.papers.paper002_loops.closed_loops import AVERAGED, TAIL
from dqforge.reports.papers.paper002_loops.loop_cases import LoopCase, case_design, controller_files
from dqforge.reports.simulation.compiled_plant import Simulator, simulate, simulator
from dqforge.reports.simulation.plant_input import Drive

_FRAMES: tuple[CurrentFrame, ...] = ("dqx", "dqy")


_NODES = 360  # as the shipped machine, with the trapezoid's corners among them


_ENOUGH = 50.0  # A


SHIPPED = "shipped drive"


@dataclass(frozen=True, slots=True)
class LoopRatio:
    """Copper loss of dqx over that of dqy of one shape on a circuit, in the loop, and the mean
    torques in N m (dqx, dqy) that were made.
    """

    shape: str
    circuit: Topology
    ratio: float
    torques: tuple[float, float]


def shaped_machines() -> dict[str, PhaseMachine]:
    """The shapes of the thesis that differ from a sine, and the shipped one, with the shipped
    windings.
    """
    # What the shapes make of the torque must not meet the current limit.
    shipped = replace(bench_machine(), i_max=_ENOUGH)
    shapes = thesis_shapes(_NODES)
    made = {
        name: replace(shipped, flux=TRAPEZOID_FLUX * shape)
        for name, shape in shapes.items()
        if name != "balanced sine"
    }
    return {**made, SHIPPED: shipped}


def _shape_bytes(flux: FloatArray) -> bytes:
    """The C structure of a back-EMF of three rows, filled up to whole doubles."""
    content = np.concatenate([flux, flux[:, :1]], axis=1).astype(np.float32).tobytes()
    return content + bytes(-len(content) % 8)


def _found(program: Simulator, scenario: Scenario, drive: Drive) -> tuple[float, float]:
    """Copper loss in W and mean torque in N m."""
    assert isinstance(drive.phases, PhaseMachine)
    run = simulate(
        program, drive, scenario, stride=1000, tail=TAIL, shape=_shape_bytes(drive.phases.flux)
    )
    figures = run.figures
    copper = figures.tail_copper_a + figures.tail_copper_b + figures.tail_copper_c
    return float(copper[0]), float(figures.tail_torque[0])


def _of_circuit(
    topology: Topology, scenario: Scenario, frame: CurrentFrame
) -> list[tuple[float, float]]:
    """Copper loss and torque of every machine with a frame on a circuit."""
    machines = shaped_machines()
    case = LoopCase("", "", "", topology, topology, frame, "references", harmonics=True)
    design = case_design(case)
    # Its phases differ: three rows, into which every other back-EMF fits.
    headers = controller_files(case, design, machines["one phase missing"])
    with simulator(headers, design.export.prefix, topology=topology) as program:
        return [
            _found(
                program,
                scenario,
                Drive(design.machine, design.inverter, design.control.t_s, 1, machine),
            )
            for machine in machines.values()
        ]


def loop_ratios(
    circuit: Topology = "four-leg", scenario: Scenario = AVERAGED
) -> tuple[LoopRatio, ...]:
    """All shapes on a circuit, by default an averaged inverter without dead time, 750 rpm, 1 N m.

    Raises:
        VerificationError: There is no compiler.
    """
    with ThreadPoolExecutor(len(_FRAMES)) as pool:
        of_x, of_y = pool.map(partial(_of_circuit, circuit, scenario), _FRAMES)
    return tuple(
        LoopRatio(name, circuit, x[0] / y[0], (x[1], y[1]))
        for name, x, y in zip(shaped_machines(), of_x, of_y, strict=True)
    )
