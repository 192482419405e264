"""The rows of the comparison in time: each topology and controller emitted, compiled with the
switched plant, and run as it is and with every deviation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    PlantErrors,
    Scenario,
    constant,
)
from dqforge.optimizer.flashing_choice import (
    BACK_EMF,
    DEVIATIONS,
    INDUCTANCE,
    NOISE,
    OFFSET,
    FlashComparison,
    FlashRow,
    RippleFigures,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.flashing_choice.row_files import files_with_control
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Summary, simulate_many, simulator

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
