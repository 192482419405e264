"""A design simulated with its emitted controller, and beside it with the loops of the firmware
that it names.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.firmware.target import firmware_drive, simulate_profile
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.simulation.design_run import (
    DriveSimulation,
    evaluate,
    part_of,
    recorded_stride,
    require_scenario,
    simulate_design,
)
from dqforge.reports.simulation.feedback_run import simulate_feedback
from dqforge.reports.simulation.plant_input import Drive, fits_carrier
from dqforge.reports.six_step.drive_run import simulate_six_step

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.plants.scenario import Scenario
    from dqforge.optimizer.firmware.gain_search import FirmwareLoops
    from dqforge.reports.simulation.recorded_run import Progress, Simulator


@on_design("simulation")
def simulate_with_firmware(
    design: Design,
    *,
    switched: bool = False,
    solution: Solution | None = None,
    progress: Progress | None = None,
) -> DriveSimulation:
    """Run the scenario of a design with its emitted controller, and with the loops of
    ``control.firmware`` where it names one: the last of `DriveSimulation.others`. A six-step drive
    runs on its own.

    Args:
        design: With a section ``simulation``.
        switched: Whether every switching instant is simulated, whatever the section says.
        solution: That of the design, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: There is no such section, it does not fit the design, or the firmware has no
            such control.
        VerificationError: There is no C compiler, or the header does not compile.
    """
    if design.control.six_step is not None:
        found = None if solution is None else solution.six_step
        return simulate_six_step(design, found=found, progress=progress)
    if design.control.current_loop.switches:
        return simulate_feedback(design, solution=solution, progress=progress)
    if design.control.firmware is None:
        return simulate_design(design, switched=switched, solution=solution, progress=progress)
    scenario = require_scenario(design, switched=switched)
    require_compiler()
    whole = solve(design) if solution is None else solution
    loops = whole.gains.firmware
    mine = simulate_design(
        design, switched=switched, solution=whole, progress=part_of(progress, 0, 2)
    )
    if loops is None:
        return mine
    theirs = simulate_loops(design, loops, scenario, part_of(progress, 1, 2))
    return replace(mine, others=(*mine.others, theirs))


def simulate_loops(
    design: Design,
    loops: FirmwareLoops,
    scenario: Scenario,
    progress: Progress | None = None,
    *,
    program: Simulator | None = None,
) -> DriveSimulation:
    """Run a firmware's loops alone through a scenario.

    Args:
        design: Machine and inverter.
        loops: What the firmware makes of the design.
        scenario: What the drive goes through; what the loops have not is left out, and said in the
            remarks.
        progress: Called with the share that is done.
        program: That of `dqforge.reports.firmware.target.firmware_simulator`, where it is there
            already.

    Raises:
        InputError: The firmware has no such control.
        VerificationError: There is no C compiler.
    """
    drive = firmware_drive(loops.profile, design)
    possible, remarks = _as_it_can_run(loops, scenario, drive)
    try:
        run = simulate_profile(
            loops.profile,
            loops.configuration.drive,
            drive,
            possible,
            stride=recorded_stride(possible, drive.t_s),
            program=program,
            progress=progress,
        )
    except InputError as error:
        raise InputError(f"control.firmware: {error}") from error
    return replace(evaluate(design, run), firmware=loops.name, remarks=remarks)


def _as_it_can_run(
    loops: FirmwareLoops, scenario: Scenario, drive: Drive
) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario without what the simulation of a firmware has not, and what that was."""
    remarks = []
    if scenario.sensorless is not None:
        scenario = replace(scenario, sensorless=None)
        remarks.append(
            f"{loops.name} ran on the angle of the encoder: its observer is not modelled"
        )
    if scenario.encoder.speed in ("observer", "measured"):
        scenario = replace(scenario, encoder=replace(scenario.encoder, speed="exact"))
        remarks.append(
            f"{loops.name} derived the speed from the angle itself, without the observer of dqforge"
        )
    if scenario.inverter == "switched" and not fits_carrier(drive):
        scenario = replace(scenario, inverter="averaged")
        remarks.append(
            f"{loops.name} ran with an averaged inverter: its sampling or its delay does not fall "
            "on the peaks of the carrier"
        )
    return scenario, tuple(remarks)
