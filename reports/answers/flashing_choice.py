"""What to flash: the question of a design, with everything that this computer can find out."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.plants.scenario import CurrentSensor, Encoder, PlantErrors, Scenario, constant
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.flashing_choice import (
    BACK_EMF,
    DEVIATIONS,
    INDUCTANCE,
    NOISE,
    OFFSET,
    Advice,
    FlashComparison,
    FlashRow,
    RippleFigures,
    advise,
    compare_flashing,
    variant,
    with_rows,
)
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.main_header import header_files
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Summary, simulate_many, simulator
from dqforge.reports.verification.measured_cost import cost_on_target
from dqforge.reports.waveforms.tables import waveform_files

Progress = Callable[[float], None]


@on_design("waveform")
def what_to_flash(
    design: Design, settings: WaveformSettings, progress: Progress | None = None
) -> tuple[FlashComparison, Advice]:
    """The comparison with the ripple of the emitted C and its cycles, and what follows from it.

    What cannot be had here, for want of a compiler or because a control cannot be emitted, is left
    out, and the comparison says why.

    Args:
        design: The design.
        settings: The operating point.
        progress: Called with the share of the simulation that is done.

    Raises:
        InputError, NoSolutionError: As `compare_flashing`.
    """
    found = compare_flashing(design, settings)
    try:
        solution = _references(design, settings, found)
    except (NoSolutionError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message, uncounted=error.message)
        return found, advise(found)
    try:
        found = with_rows(found, simulated_rows(solution, found, progress), unsimulated="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message)
    try:
        found = with_rows(found, counted_rows(solution, found), uncounted="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, uncounted=error.message)
    return found, advise(found)


def _references(design: Design, settings: WaveformSettings, found: FlashComparison) -> Solution:
    """The solution that the emitted control takes its current references from, on the design's own
    topology and without what else the design asks for.
    """
    plain = variant(design, design.inverter.topology, "dq", found.capacitance)
    return solve(
        replace(
            plain,
            waveform=settings,
            losses=None,
            simulation=None,
            modulation_choice=None,
            weakening=None,
        )
    )


# The rows of the comparison in time: each topology and controller emitted, compiled with the
# switched plant, and run as it is and with every deviation.

# Duration in s of a run with and without harmonic integrators, of which the last part counts.
LEARNING, SETTLING = 0.4, 0.2
_TAIL = 0.75  # Share of a run after which ripple counts.
_PERIODS = 2.0  # Electrical periods that the rest of the run holds at least.

# Relative error of the mean torque above which a row does not do what it is asked for.
_MISSED = 0.05


def simulated_rows(
    solution: Solution,
    found: FlashComparison,
    progress: Callable[[float], None] | None = None,
) -> tuple[FlashRow, ...]:
    """Rows with the torque ripple of the emitted C; those with an obstacle stay as they are.

    Args:
        solution: Of the design; current references and speed loop are taken from it.
        found: The comparison, with the control of each row.
        progress: Called with the share that is done.

    Raises:
        VerificationError: There is no compiler, or a header does not compile.
        InputError: The sampling does not fit the carrier, or a control cannot be emitted.
    """
    done = 0

    def run(row: FlashRow) -> FlashRow:
        nonlocal done
        made = row if row.obstacle else replace(row, simulated=_row(solution, found, row))
        done += 1
        if progress is not None:
            progress(done / len(found.rows))
        return made

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(run, found.rows))


def _row(solution: Solution, found: FlashComparison, row: FlashRow) -> RippleFigures:
    """Ripple of one row."""
    control = row.control
    assert control is not None  # only a row with an obstacle has none
    design = solution.design
    inverter = replace(
        design.inverter, topology=row.topology, midpoint_capacitance=found.capacitance
    )
    drive = Drive(design.machine, inverter, design.control.t_s, 10, design.phase_machine)
    files = files_with_control(solution, control)
    runs = [
        (drive, scenario, b"") for scenario in _scenarios(found, row, design.machine.pole_pairs)
    ]
    with simulator(files, design.export.prefix, (), row.topology) as program:
        ripples = _ripples(simulate_many(program, runs, tail=_TAIL), found.torque)
    return RippleFigures(ripples[0], dict(zip(DEVIATIONS, ripples[1:], strict=True)))


def _scenarios(found: FlashComparison, row: FlashRow, pole_pairs: int) -> list[Scenario]:
    """The run as it is, and one for each deviation."""
    period = 2.0 * math.pi / (pole_pairs * abs(found.omega_m))
    least = LEARNING if row.frame == "table" else SETTLING
    plain = Scenario(
        duration=max(least, _PERIODS * period / (1.0 - _TAIL)),
        mode="torque",
        reference=constant(found.torque),
        shaft=constant(found.omega_m),
        inverter="switched",
        encoder=Encoder(speed="exact"),
        omega_m=found.omega_m,
    )
    sensors = {
        "offset": CurrentSensor(offset=(OFFSET, 0.0, 0.0)),
        "noise": CurrentSensor(noise=NOISE),
    }
    errors = {
        "inductance": PlantErrors(l_d=INDUCTANCE, l_q=INDUCTANCE),
        "back_emf": PlantErrors(psi_pm=BACK_EMF),
    }
    deviating = [
        replace(plain, sensor=sensors[name])
        if name in sensors
        else replace(plain, errors=errors[name])
        for name in DEVIATIONS
    ]
    return [plain, *deviating]


def _ripples(summary: Summary, torque: float) -> list[float]:
    """Ripple over the mean torque of each run; NaN where the mean is not the torque asked for."""
    found = []
    for bounded, mean, ripple in zip(
        summary.bounded, summary.tail_torque, summary.tail_ripple_means, strict=True
    ):
        reached = bounded and abs(mean / torque - 1.0) <= _MISSED + BACK_EMF
        found.append(float(ripple / abs(mean)) if reached else math.nan)
    return found


# What a sample of each row costs on the design's core: the emitted control compiled for it and run
# on the emulation.

_SAMPLES = 40


def counted_rows(solution: Solution, found: FlashComparison) -> tuple[FlashRow, ...]:
    """Rows with the cycles of a sample; those without a control stay as they are.

    Args:
        solution: Of the design; its fit names the core.
        found: The comparison, with the control of each row.

    Raises:
        VerificationError: A tool is missing, or the emulation failed.
    """

    def count(row: FlashRow) -> FlashRow:
        if row.control is None:
            return row
        return replace(row, cycles=_cycles(solution, found, row))

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(count, found.rows))


def _cycles(solution: Solution, found: FlashComparison, row: FlashRow) -> tuple[float, float]:
    """Mean cycles (low, high) of a sample."""
    assert row.control is not None  # asked for before
    prefix = solution.design.export.prefix
    omega_e = found.omega_m * row.control.pole_pairs
    sample = render(
        "c_code/control_sample.h.j2",
        {
            "prefix": prefix,
            "omega_m": float_literal(found.omega_m),
            "v_dc": float_literal(found.v_dc),
            "step": float_literal(omega_e * row.control.t_s),
            "midpoint": TOPOLOGIES[row.topology].midpoint,
        },
    )
    files = files_with_control(solution, row.control)
    sources = files | {"control_sample.h": sample.encode("ascii")}
    torques = np.full(_SAMPLES, found.torque, dtype=np.float32)
    core = solution.design.fit.core
    return cost_on_target(sources, "control_sample.h", "control_sample", core, torques).cycles


# The headers that a row of the comparison would flash.


def files_with_control(solution: Solution, control: PhaseControl) -> dict[str, bytes]:
    """Headers of another control than that of a solution, on another topology maybe, complete.

    Args:
        solution: Of a design with a phase machine.
        control: The control; its references are solved for its own topology where it reads them
            from the header of phase currents.
    """
    design = solution.design
    files = header_files(solution) | phase_control_files(solution, control)
    if control.frame != "table" or not isinstance(design.phase_machine, SalientPhaseMachine):
        return files
    other = replace(design, inverter=replace(design.inverter, topology=control.topology))
    return files | waveform_files(other, solve_phases(other))
