"""References that move, as a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.capability import Capability, Outcome, ReportPart
from dqforge.reports.dynamic_references.tables import (
    plain_references,
    reference_html,
    reference_rows,
    reference_tables,
)
from dqforge.reports.pages.chapters import LOOPS

if TYPE_CHECKING:
    from dqforge.optimizer.dynamic_references.solve import DynamicReferences
    from dqforge.optimizer.solution import Solution


def _of(outcome: Outcome) -> DynamicReferences | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.references


def _parts(_: Solution, found: DynamicReferences) -> list[ReportPart]:
    data = {"tables": reference_html(found), "kind": "loops"}
    return [ReportPart(LOOPS, "pages/tables.html.j2", data)]


DYNAMIC_REFERENCES = Capability(
    name="dynamic_references",
    title="slopes of the references and voltage feedback",
    of=_of,
    plain=lambda _, found: plain_references(found),
    always=False,
    summary=lambda _, found: reference_rows(found),
    tables=lambda _, found: reference_tables(found),
    parts=_parts,
)
