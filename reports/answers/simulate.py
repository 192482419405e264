"""What `dqforge simulate` answers: a run of the drive in the time domain,
and the file of its samples.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.reports.answers.current_feedback import answer_regulator
from dqforge.reports.firmware.design_simulation import simulate_with_firmware
from dqforge.reports.output.folder import SIMULATION, SWITCHED, default_folder, refuse_other_design
from dqforge.reports.pages.answer import Answer, Files, shares, stage
from dqforge.reports.simulation.design_run import require_scenario, simulation_files
from dqforge.reports.simulation.tables import plain_simulation, simulation_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def answer_simulate(design: Design, out: Path | None, *, switched: bool) -> Answer:
    """Simulate a design.

    A current loop that switches the bridge itself is run at constant speed where the design asks
    for no simulation. Raises as `simulate_with_firmware`, and where ``out`` holds another design's
    headers.
    """
    if design.control.current_loop.switches and design.simulation is None:
        return answer_regulator(design)
    scenario = require_scenario(design)
    require_scenario(design, switched=switched)
    out = out or default_folder(design)
    refuse_other_design(out, design.digest, design.export.prefix)
    stage("simulating")
    found = simulate_with_firmware(design, switched=switched, progress=shares())

    def figure() -> Figure:
        from dqforge.reports.simulation.tables import plot_simulation

        return plot_simulation(found)

    plain = {"simulation": plain_simulation(found)}
    # The samples of the scenario as it stands are those of a run, under the same name.
    other = switched and scenario.inverter != "switched"
    files = Files(
        simulation_files(found, SWITCHED if other else ""),
        SIMULATION,
        design,
        options={SWITCHED: "yes"} if other else {},
    )
    return Answer(design.name, simulation_tables(found), plain, figure, files)
