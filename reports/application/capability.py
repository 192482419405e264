"""The program around the emitted functions, as a record."""

from __future__ import annotations

from dqforge.optimizer.application.application_plan import ApplicationPlan
from dqforge.optimizer.solution import Solution
from dqforge.reports.application.header import application_files
from dqforge.reports.application.words import (
    application_html,
    application_rows,
    application_tables,
    plain_application,
)
from dqforge.reports.capability import Capability, ReportPart
from dqforge.reports.pages.chapters import LOOPS


def _parts(_: Solution, plan: ApplicationPlan) -> list[ReportPart]:
    data = {"tables": application_html(plan), "kind": "loops"}
    return [ReportPart(LOOPS, "pages/tables.html.j2", data)]


APPLICATION = Capability(
    name="application",
    title="program around the functions",
    of=lambda outcome: outcome.solution.application,
    plain=lambda _, plan: plain_application(plan),
    always=False,
    summary=lambda _, plan: application_rows(plan)[:1],
    tables=lambda _, plan: application_tables(plan),
    parts=_parts,
    emitted=application_files,
)
