"""The loops of another firmware in the time domain: its structure, compiled, around a machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.loop_code import (
    PREFIX,
    loop_bytes,
    loop_files,
    sampling_period,
    speed_ratio,
)
from dqforge.reports.simulation.compiled_plant import Simulator, simulate, simulator
from dqforge.reports.simulation.plant_input import LONGEST_DELAY, Drive

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.plants.scenario import Scenario
    from dqforge.optimizer.firmware.configuration import DriveValues
    from dqforge.optimizer.firmware.profile import LoopProfile
    from dqforge.reports.simulation.recorded_run import Simulation


def firmware_drive(profile: LoopProfile, design: Design) -> Drive:
    """The design's machine and inverter with the sampling and the delay of a firmware.

    Raises:
        InputError: The design has a machine that no firmware of others drives, or the delay cannot
            be simulated.
    """
    if design.phase_machine is not None:
        raise InputError(
            f"{profile.firmware} is for machines with a sinusoidal back-EMF; the design has "
            "model: waveform"
        )
    return drive_with(
        profile,
        Drive(design.machine, design.inverter, design.control.t_s),
    )


def drive_with(profile: LoopProfile, drive: Drive) -> Drive:
    """A drive with the sampling and the delay of a firmware."""
    if not 0.0 <= profile.current.delay <= LONGEST_DELAY:
        raise InputError(
            f"the delay of {profile.firmware}, {profile.current.delay:g} periods, cannot be "
            f"simulated; from 0 to {LONGEST_DELAY:g} can"
        )
    return replace(
        drive,
        t_s=sampling_period(profile),
        ratio=speed_ratio(profile),
        delay=profile.current.delay,
    )


@contextmanager
def firmware_simulator(profile: LoopProfile, values: DriveValues) -> Iterator[Simulator]:
    """A compiled program for all profiles that modulate as this one does.

    Raises:
        InputError: As `dqforge.reports.firmware.loop_code.loop_files`.
        VerificationError: There is no C compiler, or the code does not compile.
    """
    with simulator(loop_files(profile, values), PREFIX) as program:
        yield program


def simulate_profile(
    profile: LoopProfile,
    values: DriveValues,
    drive: Drive,
    scenario: Scenario,
    *,
    stride: int = 1,
    program: Simulator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Run a drive with the loops of a firmware through a scenario.

    Args:
        profile: Structure and numbers of the loops; its sampling and its delay hold.
        values: What the firmware is told of machine and limits.
        drive: Machine and inverter that are there.
        scenario: What it goes through; angle and phase currents come from its sensors.
        stride: Samples per recorded row.
        program: That of `firmware_simulator`, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: The firmware has no such control, or the profile does not fit the simulation.
        VerificationError: There is no C compiler, or the program cannot be run.
    """
    _require_control(profile, values, scenario)
    gains = loop_bytes(profile, values)
    mine = drive_with(profile, drive)
    if program is not None:
        return simulate(program, mine, scenario, stride=stride, gains=gains, progress=progress)
    with firmware_simulator(profile, values) as made:
        return simulate(made, mine, scenario, stride=stride, gains=gains, progress=progress)


def _require_control(profile: LoopProfile, values: DriveValues, scenario: Scenario) -> None:
    if scenario.mode == "speed" and profile.speed is None:
        raise InputError(
            f"{profile.firmware} has no speed controller in this configuration; simulate torque "
            "or current"
        )
    if scenario.mode == "torque" and not (values.psi_pm or 0.0) > 0.0:
        raise InputError(
            f"{profile.firmware} makes amperes of a torque by the flux linkage of the magnets, "
            "which is 0 here; simulate current"
        )
    if scenario.sensorless is not None:
        raise InputError(
            f"the observer of {profile.firmware} is not simulated; leave simulation.sensorless out"
        )
