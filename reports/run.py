"""The main job: solve a design, emit its header, prove the header, and
gather the files to be written.
"""

from __future__ import annotations

from dataclasses import dataclass

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.capabilities import programmes
from dqforge.reports.control.fixed_header import control_fixed_files
from dqforge.reports.control.header import control_files
from dqforge.reports.field_weakening.header import weakening_files
from dqforge.reports.loops.header import gains_files
from dqforge.reports.main_header.header import header_files
from dqforge.reports.modulation_choice.header import choice_files
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.observers.speed_header import speed_observer_files
from dqforge.reports.pages.console import shares, stage
from dqforge.reports.pages.envelope import to_text
from dqforge.reports.plain_data import PlainData
from dqforge.reports.report import render_report
from dqforge.reports.result import SIMULATION, plain_solution
from dqforge.reports.simulation.design_run import simulate_design, simulation_files
from dqforge.reports.simulation.tables import plain_simulation
from dqforge.reports.verification.host import Verification, verify_files
from dqforge.reports.waveforms.header import waveform_files


@dataclass(frozen=True, slots=True)
class RunOutput:
    """What a run made: the solution, the outcome of the verification (None if it was skipped),
    and the files.

    ``plain`` is what ``result.json`` holds.
    """

    solution: Solution
    verification: Verification | None
    files: dict[str, bytes]
    plain: PlainData


def _verified(solution: Solution, files: dict[str, bytes], plain: PlainData) -> Verification:
    """The headers against what the result says of them: what a later `dqforge verify` will read."""
    stage("compiling and comparing")
    export = solution.design.export
    _, further = programmes(plain)
    return verify_files(files, export.prefix, solution.reference, export.vectors, further)


def _loop_files(design: Design, gains: GainSet) -> dict[str, bytes]:
    """Headers of gain schedules and observers, where the design asks for them."""
    files: dict[str, bytes] = {}
    if gains.schedule is not None:
        files |= gains_files(design, gains.schedule)
    if gains.position is not None:
        files |= observer_files(design, gains.position)
    if gains.observer is not None:
        files |= speed_observer_files(design, gains.observer)
    return files


@on_design("export")
def export_design(design: Design, *, verify: bool) -> RunOutput:
    """Header, test vectors and ``result.json`` of a design; nothing else is computed for show.

    Raises
    ------
    VerificationError
        The compiled header differs from the model, or no compiler is there to try it.
    """
    stage("solving")
    solution = solve(design)
    stage("emitting the headers")
    files = header_files(solution)
    if solution.phases is not None:
        files |= waveform_files(design, solution.phases)
    if solution.weakening is not None:
        files |= weakening_files(design, solution.weakening)
    if solution.choice is not None:
        files |= choice_files(design, solution.choice)
    if solution.loops is not None:
        files |= _loop_files(design, solution.loops)
    if "float32" in design.export.control:
        files |= control_files(solution)
    for fit in solution.fixed:
        files |= control_fixed_files(design, fit)
    plain = plain_solution(solution)
    verification = _verified(solution, files, plain) if verify else None
    files["result.json"] = to_text("run", design.name, plain).encode("ascii")
    return RunOutput(solution, verification, files, plain)


@on_design("machine")
def run_design(design: Design, *, verify: bool) -> RunOutput:
    """Everything that the design asks for, the report included.

    Raises
    ------
    VerificationError
        As `export_design`.
    """
    output = export_design(design, verify=verify)
    simulation = None
    if verify and design.simulation is not None:
        stage("simulating")
        simulation = simulate_design(design, solution=output.solution, progress=shares())
        plain = output.plain | {SIMULATION: plain_simulation(simulation)}
        output.files["result.json"] = to_text("run", design.name, plain).encode("ascii")
        output.files.update(simulation_files(simulation))
    stage("writing the report")
    output.files["report.html"] = render_report(
        output.solution, output.verification, simulation
    ).encode("utf-8")
    return output
