"""What `dqforge tune` answers: gains and observers with their margins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.files.library_files import design_names
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.reports.loops.proven_text import gains_tables
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.session.result import Tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.estimator_comparison.candidate import ObserverEvidence
    from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
    from dqforge.optimizer.observers.tuning import ObserverProof
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.reports.pages.answer import Table
    from dqforge.reports.plain_data import PlainData


def answer_tune(design: Design) -> Answer:
    """Tune the controllers and the observer of a design; raises as `solve_gains`.

    A current loop that switches the bridge itself has no gains: the answer is what it does.
    """
    if design.control.current_loop.switches:
        from dqforge.reports.answers.current_feedback import answer_feedback

        return answer_feedback(design)
    stage("tuning")
    if design.control.six_step is not None:
        from dqforge.optimizer.six_step.design import solve_six_step

        blocks = solve_six_step(design)
        if blocks is not None:
            return _blocks(design, blocks)
    gains = solve_gains(design)
    require_observed(design, gains)
    stage("rounding to fixed point")
    fixed, rounded = _integers(design, gains)
    stage("proving the observer")
    proof, evidence, own = _observer(design, gains)
    starting, start = _start(design)
    estimating, online = _online(design)
    tables = [
        *gains_tables(design, gains, proof),
        *own,
        *starting,
        *estimating,
        *_moving(gains),
        *rounded,
    ]
    found = Tuning(design, gains, fixed, proof, evidence)
    plain = found.plain() | start | online
    return Answer(design.name, tables, plain, found.figure, notes=_next(design))


def _next(design: Design) -> tuple[str, ...]:
    """What to do with the gains; nothing of a design that stands in no file."""
    if design.places is None:
        return ()
    source = design.places.source
    stem = source.removesuffix(".yaml")
    name = stem if stem in design_names() else source
    return (f"next: dqforge run {name}, or dqforge export {name} --for vesc, simplefoc, ...",)


# What not every design asks for is loaded where one does.


def _blocks(design: Design, blocks: SixStepDesign) -> Answer:
    from dqforge.reports.six_step.header import block_tables, plain_blocks

    def figure() -> Figure:
        from dqforge.reports.six_step.figures import plot_blocks

        return plot_blocks(blocks)

    return Answer(design.name, block_tables(blocks), {"six_step": plain_blocks(blocks)}, figure)


def _integers(design: Design, gains: GainSet) -> tuple[tuple[IntegerFit, ...], list[Table]]:
    if all(form == "float32" for form in design.export.control):
        return (), []
    from dqforge.optimizer.fixed_phase_control.solve import solve_integers
    from dqforge.reports.phase_control.emitted_integers import integer_tables

    fixed = solve_integers(design, gains)
    return fixed, integer_tables(fixed)


def _observer(
    design: Design, gains: GainSet
) -> tuple[ObserverProof | None, ObserverEvidence | None, list[Table]]:
    """Proof and evidence of a position observer, and what is shown of the latter."""
    if gains.position is None:
        return None, None, []
    from dqforge.optimizer.estimator_comparison.candidate import observer_evidence
    from dqforge.optimizer.observers.tuning import prove
    from dqforge.reports.estimator_comparison.observer_errors import capture_table, warm_table

    proof = prove(gains.position)
    stage("trying starts of the observer")
    evidence = observer_evidence(design, gains.position)
    if evidence is None:
        return proof, None, []
    return proof, evidence, [warm_table(evidence.warm), capture_table(evidence.capture)]


def _moving(gains: GainSet) -> list[Table]:
    if gains.references is None:
        return []
    from dqforge.reports.dynamic_references import reference_tables

    return reference_tables(gains.references)


def _start(design: Design) -> tuple[list[Table], PlainData]:
    if design.control.start_up is None:
        return [], {}
    from dqforge.optimizer.start_up.solve import solve_start_up
    from dqforge.reports.start_up.tables import plain_start, start_tables

    start = solve_start_up(design)
    return ([], {}) if start is None else (start_tables(start), {"start_up": plain_start(start)})


def _online(design: Design) -> tuple[list[Table], PlainData]:
    if design.control.online_estimation is None:
        return [], {}
    from dqforge.optimizer.online_estimation import solve_online_estimation
    from dqforge.reports.observers.online_estimation import (
        estimation_tables,
        plain_estimation,
    )

    found = solve_online_estimation(design)
    if found is None:
        return [], {}
    return estimation_tables(found), {"online_estimation": plain_estimation(found)}
