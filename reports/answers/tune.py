"""What `dqforge tune` answers: gains and observers with their margins."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.observed_refusal import require_observed
from dqforge.optimizer.estimator_comparison.own_observer import observer_evidence
from dqforge.optimizer.fixed_phase_control.solve import solve_integers
from dqforge.optimizer.observers.proof import prove
from dqforge.optimizer.six_step.design import SixStepDesign, solve_six_step
from dqforge.optimizer.start_up.solve import solve_start_up
from dqforge.reports.current_feedback.question import answer_feedback
from dqforge.reports.dynamic_references.tables import reference_tables
from dqforge.reports.estimator_comparison.observer_errors import capture_table, warm_table
from dqforge.reports.loops.tables import gains_tables
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.console import stage
from dqforge.reports.phase_control.emitted_integers import integer_tables
from dqforge.reports.session.control import Tuning
from dqforge.reports.six_step.tables import block_tables, plain_blocks
from dqforge.reports.start_up.tables import plain_start, start_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _figure(blocks: SixStepDesign) -> Figure:
    from dqforge.reports.six_step.figures import plot_blocks

    return plot_blocks(blocks)


def answer_tune(design: Design) -> Answer:
    """Tune the controllers and the observer of a design; raises as `solve_gains`.

    A current loop that switches the bridge itself has no gains: the answer is what it does.
    """
    if design.control.current_loop.switches:
        return answer_feedback(design)
    stage("tuning")
    blocks = solve_six_step(design)
    if blocks is not None:
        return Answer(
            design.name,
            block_tables(blocks),
            {"six_step": plain_blocks(blocks)},
            partial(_figure, blocks),
        )
    gains = solve_gains(design)
    require_observed(design, gains)
    stage("rounding to fixed point")
    fixed = solve_integers(design, gains)
    stage("proving the observer")
    proof = prove(gains.position)
    stage("trying starts of the observer")
    evidence = observer_evidence(design, gains.position)
    own = [] if evidence is None else [warm_table(evidence.warm), capture_table(evidence.capture)]
    moving = [] if gains.references is None else reference_tables(gains.references)
    start = solve_start_up(design)
    starting = [] if start is None else start_tables(start)
    tables = [*gains_tables(design, gains, proof), *own, *starting, *moving, *integer_tables(fixed)]
    found = Tuning(design, gains, fixed, proof, evidence)
    plain = found.plain() | ({} if start is None else {"start_up": plain_start(start)})
    return Answer(design.name, tables, plain, found.figure)
