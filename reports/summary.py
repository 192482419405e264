"""What ``run`` says of a design in a few lines."""

from __future__ import annotations

from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, Rows, asked_for
from dqforge.reports.pages.table import Table
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import verification_text


def run_tables(
    solution: Solution,
    verification: Verification | None,
    capabilities: Capabilities = CAPABILITIES,
) -> list[Table]:
    """The short summary of a run.

    Parameters
    ----------
    solution:
        What was solved.
    verification:
        Outcome of compiling and running the headers, None if that was skipped.
    capabilities:
        Those of the product, or these and some from outside.
    """
    rows: Rows = []
    for capability, found in asked_for(capabilities, Outcome(solution, verification is not None)):
        rows += capability.summary(solution, found)
    rows += [
        ("flux map", f"{evidence.source}: {text}")
        for evidence in solution.design.flux_evidence
        for text in evidence.sentences()
    ]
    rows.append(("verification", verification_text(verification)))
    return [Table(solution.design.name, ("", ""), tuple(rows))]
