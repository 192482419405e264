"""The simulation of a drive with its emitted controller, as records."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from dqforge.machines.names import NumberFormat
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Draw, Outcome, ReportPart
from dqforge.reports.pages.chapters import SIMULATION as CHAPTER
from dqforge.reports.simulation.design_run import DriveSimulation
from dqforge.reports.simulation.number_format import format_text, not_simulated, simulated
from dqforge.reports.simulation.tables import (
    figure_name,
    plain_simulation,
    run_key,
    simulation_part,
    simulation_tables,
)


def _figures(_: Solution, found: DriveSimulation) -> Mapping[str, Draw]:
    from dqforge.reports.simulation.figures import plot_simulation

    return {
        figure_name(each.label, number): partial(plot_simulation, each)
        for number, each in enumerate(found.every)
    }


def _parts(_: Solution, found: DriveSimulation) -> list[ReportPart]:
    return [
        ReportPart(CHAPTER, "simulation/report.html.j2", simulation_part(found), run_key(found))
    ]


def _not_simulated(outcome: Outcome) -> tuple[NumberFormat, ...] | None:
    if outcome.design.simulation is None or not outcome.verified:
        return None
    return not_simulated(outcome.solution) or None


FORMATS_NOT_SIMULATED = Capability(
    name="not_simulated",
    title="number formats that no simulation runs",
    of=_not_simulated,
    summary=lambda solution, formats: [("simulation", format_text(simulated(solution), formats))],
)


def _simulation(outcome: Outcome) -> DriveSimulation | None:
    found: DriveSimulation | None = outcome.simulation
    return found


SIMULATION = Capability(
    name="simulation",
    title="simulation of the drive",
    of=_simulation,
    plain=lambda _, found: plain_simulation(found),
    always=False,
    tables=lambda _, found: simulation_tables(found),
    figures=_figures,
    parts=_parts,
    files=lambda _, found: found.files(),
)
