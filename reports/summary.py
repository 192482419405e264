"""What ``run`` says of a design: what to flash, what to look out for, the evidence."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Flashed, Outcome, Rows, asked_for
from dqforge.reports.pages.answer import Table
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import verification_text


def flashed(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> list[Flashed]:
    """The numbers to flash, in the order of the capabilities."""
    found = asked_for(capabilities, outcome)
    return [row for each, result in found for row in each.flashed(outcome.solution, result)]


def watched(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> list[str]:
    """What to look out for before anything is flashed, a sentence each."""
    found = asked_for(capabilities, outcome)
    texts = [text for each, result in found for text in each.watched(outcome.solution, result)]
    if not outcome.verified:
        texts.append("the emitted C was not compiled and not compared with its model")
    return [*texts, *_open_points(outcome.design)]


def _open_points(design: Design) -> list[str]:
    """How much of the design is inferred or left open."""
    inferred = [value.path for value in design.values if value.inferred]
    texts = []
    if inferred:
        listed = ", ".join(inferred[:3]) + (", ..." if len(inferred) > 3 else "")
        verb = "is" if len(inferred) == 1 else "are"
        texts.append(f"{listed} {verb} inferred, not measured: 'dqforge check' says from what")
    return texts


def run_tables(
    solution: Solution,
    verification: Verification | None,
    capabilities: Capabilities = CAPABILITIES,
) -> list[Table]:
    """The short summary of a run.

    Args:
        solution: What was solved.
        verification: Outcome of compiling and running the headers, None if that was skipped.
        capabilities: Those of the product, or these and some from outside.
    """
    outcome = Outcome(solution, verification is not None)
    rows: Rows = []
    for capability, found in asked_for(capabilities, outcome):
        rows += capability.summary(solution, found)
    rows += [
        ("flux map", f"{evidence.source}: {text}")
        for evidence in solution.design.flux_evidence
        for text in evidence.sentences()
    ]
    rows.append(("verification", verification_text(verification)))
    first = tuple((row.label, row.value, row.meaning) for row in flashed(outcome, capabilities))
    warnings = tuple(("", text) for text in watched(outcome, capabilities))
    return [
        Table(f"{solution.design.name}: what to flash", ("", "", ""), first),
        *([Table("What to look out for", ("", ""), warnings)] if warnings else []),
        Table("Evidence", ("", ""), tuple(rows)),
    ]
