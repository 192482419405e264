"""What `dqforge tune` answers: gains and observers with their margins."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_phase_control.solve import solve_integers
from dqforge.optimizer.observers.proof import prove
from dqforge.reports.dynamic_references.tables import reference_tables
from dqforge.reports.loops.tables import gains_tables
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.console import stage
from dqforge.reports.phase_control.emitted_integers import integer_tables
from dqforge.reports.session.control import Tuning


def answer_tune(design: Design) -> Answer:
    """Tune the controllers and the observer of a design; raises as `solve_gains`."""
    stage("tuning")
    gains = solve_gains(design)
    stage("rounding to fixed point")
    fixed = solve_integers(design, gains)
    stage("proving the observer")
    proof = prove(gains.position)
    moving = [] if gains.references is None else reference_tables(gains.references)
    tables = [*gains_tables(design, gains, proof), *moving, *integer_tables(fixed)]
    found = Tuning(design, gains, fixed, proof)
    return Answer(design.name, tables, found.plain(), found.figure)
