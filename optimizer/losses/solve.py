"""The loss comparisons that a design asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import Mission

if TYPE_CHECKING:
    from dqforge.optimizer.losses.drive_comparison import Alternatives, MissionComparison
    from dqforge.optimizer.losses.phase_comparison import LossComparison


@on_design("losses")
def solve_losses(design: Design) -> LossComparison | None:
    """Loss comparison of the design, or None where it asks for none.

    What a strategy cannot make within the limits is marked in the comparison,
    and so are junctions that run away.
    """
    losses = design.losses
    if losses is None or not losses.points:
        return None
    from dqforge.optimizer.losses.drive_budget import BudgetOptions
    from dqforge.optimizer.losses.phase_comparison import compare_points

    return compare_points(
        design.machine,
        design.inverter,
        losses,
        i_max=design.i_max,
        options=BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr),
        margin=design.operation.voltage_margin,
        phases=design.phase_machine,
    )


@on_design("losses")
def require_losses(design: Design) -> LossComparison:
    """Loss comparison of the design; raises `InputError` where it asks for none."""
    found = solve_losses(design)
    if found is None:
        raise InputError(
            "the design requests no comparison; add a section 'losses' with 'points', or use "
            "--map or --mission"
        )
    return found


@on_design("losses.mission")
def solve_mission(design: Design) -> MissionComparison | None:
    """Energies over the mission of the design, None where it names none.

    Raises:
        InputError, NoSolutionError: As `compare_mission`.
    """
    losses = design.losses
    if losses is None or losses.mission is None:
        return None
    from dqforge.optimizer.losses.drive_comparison import Alternatives

    alternatives = Alternatives(losses.strategies, losses.modulations, (design.inverter.f_sw,))
    return mission_comparison(design, losses.mission, alternatives, design.operation.voltage_margin)


def mission_comparison(
    design: Design, mission: Mission, alternatives: Alternatives, margin: float
) -> MissionComparison:
    """A mission with every alternative; with any back-EMF by the rules of its phase currents.

    Args:
        design: Machine, inverter and losses.
        mission: Torque and speed over time.
        alternatives: Strategies, modulators and frequencies.
        margin: Share of the voltage that is kept free for control.

    Raises:
        InputError, NoSolutionError: As `compare_mission`.
    """
    from dqforge.optimizer.losses.drive_comparison import compare_mission
    from dqforge.optimizer.losses.loss_map import budget_options

    machine, inverter, options = design.machine, design.inverter, budget_options(design)
    if design.phase_machine is not None:
        from dqforge.optimizer.losses.loss_map import compare_phase_mission
        from dqforge.optimizer.losses.phase_comparison import PhaseDrive

        drive = PhaseDrive(design.phase_machine, machine, inverter, design.i_max, options, margin)
        return compare_phase_mission(drive, mission, alternatives)
    return compare_mission(
        machine,
        inverter,
        mission,
        alternatives,
        i_max=design.i_max,
        options=options,
        margin=margin,
    )
