"""What `dqforge fit` answers: the current references, their errors and bounds,
beside the alternatives.
"""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.optimizer.certificates.current_reference import certify
from dqforge.optimizer.current_reference.fit import alternatives, signed_designs
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.field_weakening.fit import solve_weakening
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.solution import solve_negative
from dqforge.reports.current_reference.capability import fit_tables, negative_tables
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.session.drives import Fit
from dqforge.reports.single_headers.field_weakening import weakening_tables


def answer_fit(design: Design) -> Answer:
    """Fit the current references of a design; raises as `solve_fit`."""
    positive = signed_designs(design)[0]
    choice = current_choice(positive)
    stage("fitting")
    chosen = solve_fit(positive)
    found = chosen.fit
    stage("fitting the alternatives")
    rows = alternatives(choice, found)
    stage("proving the bounds")
    proof = certify(choice, found.reference, found.errors)
    stage("fitting the further references")
    negative, weakening = solve_negative(design), solve_weakening(design)

    tables = [
        *fit_tables(design, found, rows, chosen.trials, proof, chosen.data),
        *negative_tables(negative),
        *weakening_tables(weakening),
    ]
    answer = Fit(design, chosen, rows, negative, weakening, proof)
    return Answer(design.name, tables, answer.plain(), answer.figure)
