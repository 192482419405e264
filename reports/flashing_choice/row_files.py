"""The headers that a row of the comparison would flash."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.main_header.header import header_files
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.waveforms.tables import waveform_files


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
