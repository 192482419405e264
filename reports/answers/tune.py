"""What `dqforge tune` answers: gains and observers with their margins."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.solve import solve_fixed
from dqforge.optimizer.observers.proof import prove
from dqforge.reports.control.fixed_header import plain_fixed_evidence
from dqforge.reports.control.fixed_tables import control_fixed_tables
from dqforge.reports.loops.plain import plain_gains
from dqforge.reports.loops.tables import gains_tables
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.console import stage
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def answer_tune(design: Design) -> Answer:
    """Tune the controllers and the observer of a design; raises as `solve_gains`."""
    stage("tuning")
    gains = solve_gains(design)
    stage("rounding to fixed point")
    fixed = solve_fixed(design, gains)
    stage("proving the observer")
    proof = prove(gains.position)

    def figure() -> Figure:
        from dqforge.reports.loops.figures import plot_gains

        return plot_gains(gains)

    plain: PlainData = {"gains": plain_gains(design, gains)}
    if proof is not None:
        plain["observer_proof"] = asdict(proof)
    if fixed:
        evidence = {fit.control.format: plain_fixed_evidence(fit) for fit in fixed}
        plain["control_fixed"] = evidence
    tables = [*gains_tables(design, gains, proof), *control_fixed_tables(fixed)]
    return Answer(design.name, tables, plain, figure)
