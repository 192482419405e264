"""What ``check`` and ``run`` say of a design in a few lines."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.design.plausibility.figures import MARK
from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, Rows, asked_for
from dqforge.reports.pages.table import Table
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import verification_text


def check_tables(design: Design) -> list[Table]:
    """Every value with its origin, and what was assumed."""
    rows = tuple(
        (
            value.path,
            value.text,
            f"{value.si:.6g} {value.unit}".strip(),
            "inferred" if value.inferred else "",
            value.source,
        )
        for value in design.values
    )
    columns = ("key", "in the file", "in SI", "", "source")
    notes = tuple(
        sentence if sentence.startswith(MARK) else f"assumed: {sentence}"
        for sentence in design.assumptions
    )
    return [Table(f"{design.name}: valid", columns, rows, notes)]


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
