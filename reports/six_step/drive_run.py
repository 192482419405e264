"""A six-step drive in the time domain: the emitted control around a plant with every switching
instant and every diode.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.six_step.control import FAULTS, RUNNING, STAGES
from dqforge.optimizer.six_step.design import (
    STAR,
    SixStepDesign,
    commutation_errors,
    solve_six_step,
)
from dqforge.optimizer.six_step.sectors import SECTOR
from dqforge.reports.pages.templating import render
from dqforge.reports.simulation.design_run import (
    DriveSimulation,
    ObservedFigures,
    angle_error,
    evaluate,
    recorded_stride,
    require_scenario,
)
from dqforge.reports.simulation.plant_input import COLUMNS, Drive, run_input
from dqforge.reports.simulation.recorded_run import (
    BlockFigures,
    BlockRecord,
    Progress,
    Simulation,
    as_recorded,
    compiled,
    execute,
    records_of,
    simulation_sources,
)
from dqforge.reports.six_step.header import six_step_files

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.machines.plants.scenario import Scenario

_BLOCK_COLUMNS = ("stage", "fault", "sector", "i_reference")


_SETTLING = 20  # commutations after a hand-over that do not count


def drive_of_blocks(design: Design, found: SixStepDesign) -> Drive:
    """What is simulated: the machine in phase quantities, sampled once per carrier period.

    Args:
        design: Machine and inverter.
        found: Its six-step drive.
    """
    return Drive(design.machine, design.inverter, design.control.t_s, 1, found.phases)


def _voltmeter(design: Design, found: SixStepDesign) -> bytes:
    """Offset, noise, bits and full scale of the measured voltages."""
    settings = design.control.six_step
    bits = 0 if settings is None else settings.voltage_bits
    full_scale = 1.25 * design.inverter.v_dc
    if found.disturbed.by_diode:  # voltages serve the start alone
        return np.array([0.0, 0.0, float(bits), full_scale], dtype=np.float64).tobytes()
    offset = found.disturbed.offset - full_scale / 2.0 ** (bits + 1)
    # The noise of one phase against the mean of three is sqrt(2/3) of that of each.
    values = [offset, found.disturbed.noise * np.sqrt(1.5), float(bits + 1), full_scale]
    return np.array(values, dtype=np.float64).tobytes()


def _diode_voltage(design: Design, found: SixStepDesign) -> float:
    """Forward voltage of the diodes in V, with that of their threshold where they are observed."""
    device, known = design.inverter.device, found.disturbed
    threshold = 0.0 if device is None else device.diode_voltage
    return threshold + (STAR * known.offset if known.by_diode else 0.0)


def run_blocks(
    design: Design,
    found: SixStepDesign,
    scenario: Scenario,
    *,
    stride: int = 1,
    progress: Progress | None = None,
) -> Simulation:
    """Compile plant and emitted control, and run a scenario.

    Args:
        design: Machine and inverter.
        found: Its six-step drive.
        scenario: Of the modes ``speed`` or ``torque``; every switching instant is simulated.
        stride: Periods per recorded row.
        progress: Called with the share that is done.

    Raises:
        VerificationError: There is no compiler, or the program cannot be run.
    """
    prefix = design.export.prefix
    switched = replace(scenario, inverter="switched")
    run = run_input(drive_of_blocks(design, found), switched, stride=stride, topology="three-wire")
    if progress is not None:
        run.parameters["progress"] = 1.0
    run.parameters["diode_voltage"] = _diode_voltage(design, found)
    context = {
        "prefix": prefix,
        "macro": prefix.upper(),
        "diodes": found.disturbed.by_diode,
    }
    main = render("six_step/six_step_main.c.j2", context)
    sources = simulation_sources() | {"six_step_main.c": main}
    content = np.array([1.0]).tobytes() + run.content() + _voltmeter(design, found)
    with scratch_folder() as folder:
        program = compiled(folder, six_step_files(design, found), sources, "six_step_main.c")
        written = execute(program, content, progress)
    ((figures, rows),) = records_of(written, 1)
    recorded = as_recorded(switched, figures, rows, "three-wire")
    more = {
        name: np.ascontiguousarray(rows[:, len(COLUMNS) + k])
        for k, name in enumerate(_BLOCK_COLUMNS)
    }
    return replace(recorded, blocks=BlockRecord(**more))


def commutations(found: SixStepDesign, run: Simulation) -> tuple[NDArray[np.intp], FloatArray]:
    """Rows at which the estimator handed the current on, from the twentieth on after each
    hand-over, and by how much they are late in rad (electrical).

    Args:
        found: The six-step drive.
        run: Its run, every period recorded.
    """
    blocks = run.blocks
    assert blocks is not None
    running = blocks.stage == RUNNING
    both = running[1:] & running[:-1]
    changed = np.flatnonzero(both & (blocks.sector[1:] != blocks.sector[:-1])) + 1
    begun = np.flatnonzero(running & ~np.concatenate([[False], running[:-1]]))
    since = np.searchsorted(changed, begun[np.searchsorted(begun, changed, side="right") - 1])
    changed = changed[np.arange(changed.size) - since >= _SETTLING]
    before = blocks.sector[changed - 1].astype(np.intp)
    way = np.where((blocks.sector[changed] - before) % 6 == 1, 1, -1)
    angles = np.array(found.gains.observer.crossings)
    delay = SECTOR * np.array(found.gains.observer.delay)
    ideal = np.where(way > 0, angles[before] + delay[0], angles[(before + 3) % 6] - delay[1])
    late = way * (run.theta_e[changed] - ideal)
    return changed, np.asarray((late + np.pi) % (2.0 * np.pi) - np.pi)


def block_figures(found: SixStepDesign, run: Simulation) -> BlockFigures:
    """What is read off a run.

    Args:
        found: The six-step drive.
        run: Its run, every period recorded.
    """
    blocks = run.blocks
    assert blocks is not None
    running = np.flatnonzero(blocks.stage == RUNNING)
    changed, late = commutations(found, run)
    within = np.abs(run.omega_m[changed]) * found.phases.pole_pairs >= found.limits.low
    changed, late = changed[within], late[within]
    some = late.size > 0
    predicted = None
    if some:
        omega = np.abs(run.omega_m[changed]) * found.phases.pole_pairs
        errors = commutation_errors(
            found.shape, found.disturbed, omega, by_integral=found.by_integral
        )
        predicted = float(np.max(errors.largest))
    return BlockFigures(
        started=float(run.t[running[0]]) if running.size else None,
        stage=STAGES[int(blocks.stage[-1])],
        fault=FAULTS[int(blocks.fault[-1])],
        commutations=int(late.size),
        error_mean=float(np.mean(late)) if some else None,
        error_rms=float(np.sqrt(np.mean(late**2))) if some else None,
        error_largest=float(np.max(np.abs(late))) if some else None,
        predicted=predicted,
    )


def _observed(run: Simulation) -> ObservedFigures | None:
    """Errors of the estimates while the drive ran on them."""
    blocks = run.blocks
    assert blocks is not None
    running = blocks.stage == RUNNING
    if not np.any(running):
        return None
    error = angle_error(run)[running]
    speed = np.abs(run.omega_m_observed - run.omega_m)[running]
    return ObservedFigures(
        float(np.sqrt(np.mean(error**2))),
        float(np.max(np.abs(error))),
        float(np.max(speed)),
        float(np.mean(running)),
    )


def _remarks(figures: BlockFigures) -> tuple[str, ...]:
    if figures.started is None:
        return (f"it never ran on its estimator: {figures.stage}, fault: {figures.fault}",)
    text = (
        f"aligned and ramped up without an encoder, on its estimator from {figures.started:.4g} s"
    )
    if figures.fault != FAULTS[0]:
        text = f"{text}; it ended with the fault: {figures.fault}"
    return (text,)


@on_design("simulation")
def simulate_six_step(
    design: Design, *, found: SixStepDesign | None = None, progress: Progress | None = None
) -> DriveSimulation:
    """Run the scenario of a six-step drive with its emitted control.

    Args:
        design: With a section ``simulation``.
        found: Its six-step drive, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: The design asks for no simulation.
        NoSolutionError: It has no six-step drive.
        VerificationError: There is no compiler, or the header does not compile.
    """
    scenario = require_scenario(design)
    made = solve_six_step(design) if found is None else found
    if made is None:
        raise NoSolutionError("the design is no six-step drive")
    if recorded_stride(scenario, design.control.t_s) != 1:
        longest = format_quantity(2e6 * design.control.t_s, "s")
        raise NoSolutionError(
            f"simulation.duration: every period of a six-step drive is kept; write up to {longest}"
        )
    run = run_blocks(design, made, scenario, progress=progress)
    figures = block_figures(made, run)
    return replace(
        evaluate(design, run),
        observed=_observed(run),
        six_step=figures,
        remarks=_remarks(figures),
    )
