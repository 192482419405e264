"""What is answered for a design whose current loop switches the bridge itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.current_feedback.regulator_runs import (
    load_points,
    regulator_plan,
    run_regulator,
    solve_current_feedback,
    solve_loads,
    speed_points,
)
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.simulation.feedback_run import closed_loads
from dqforge.reports.simulation.tables import closed_tables, plain_closed
from dqforge.reports.single_headers.current_feedback import (
    compared_table,
    load_tables,
    own_table,
    plain_feedback,
    plain_loads,
    plain_plan,
    plain_run,
    point_table,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.machines.design.design import Design
    from dqforge.optimizer.current_feedback.regulator_runs import RegulatorRun
    from dqforge.reports.plain_data import PlainData


@on_design("control.current_loop")
def answer_feedback(design: Design) -> Answer:
    """The regulator, all others beside it over speed, and the speed loop over it."""
    stage("running the current regulators")
    found = solve_current_feedback(design)
    if found is None:
        raise InputError("the current loops of this design are by gains")

    def figure() -> Figure:
        from dqforge.reports.single_headers.current_feedback import plot_regulators

        return plot_regulators(found.over_speed)

    plain = {"current_feedback": plain_feedback(found)}
    return Answer(design.name, [own_table(found), compared_table(found)], plain, figure)


@on_design("losses")
def with_regulators(design: Design, answered: Answer) -> Answer:
    """An answer on losses with those of the regulators at the same points."""
    stage("running the current regulators")
    loads = solve_loads(design)
    tables = [] if loads is None else load_tables(loads)
    said: list[PlainData] = []
    if loads is not None:
        closed, said = _closed(design, loads.runs[loads.own])
        tables += closed
    plain: PlainData = {"current_feedback": {"loads": plain_loads(loads), "closed": said}}
    return replace(answered, tables=[*answered.tables, *tables], plain=answered.plain | plain)


def _closed(design: Design, run: RegulatorRun) -> tuple[list[Table], list[PlainData]]:
    """The loads of a run in the closed drive; nothing without a speed loop, an inertia, or a C
    compiler.
    """
    if design.control.speed_loop is None or design.machine.inertia is None:
        return [], []
    stage("simulating the closed drives")
    try:
        found = closed_loads(design, run.points)
    except VerificationError:
        return [], []
    return closed_tables(found, run.points, run.plan.method), plain_closed(found)


@on_design("control.current_loop")
def answer_regulator(design: Design) -> Answer:
    """The regulator of the design at its loads, or over speed where it names none.

    Sampled regulators run in the numbers of the emitted C. Raises as `run_regulator`.
    """
    stage("running the current regulator")
    points = load_points(design)
    run = run_regulator(
        design, regulator_plan(design), speed_points(design) if points is None else points
    )

    def figure() -> Figure:
        from dqforge.reports.single_headers.current_feedback import plot_regulators

        return plot_regulators([run])

    plain = {"current_feedback": {"regulator": plain_plan(run.plan), "simulated": plain_run(run)}}
    return Answer(design.name, [point_table(run)], plain, figure)
