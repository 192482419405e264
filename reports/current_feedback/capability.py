"""Current-feedback PWM, as a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Draw, ReportPart, Rows
from dqforge.reports.current_feedback.header import (
    plain_rule,
    rule_files,
    rule_from,
    rule_programme,
    settings_files,
)
from dqforge.reports.current_feedback.plain import plain_feedback
from dqforge.reports.current_feedback.regulator_words import run_rows, setting_rows
from dqforge.reports.current_feedback.tables import (
    compared_table,
    html_tables,
    load_tables,
    own_table,
)
from dqforge.reports.pages.chapters import CURRENT_FEEDBACK as CHAPTER

if TYPE_CHECKING:
    from dqforge.optimizer.current_feedback.solve import CurrentFeedback
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.pages.table import Table
    from dqforge.reports.plain_data import PlainData


def _summary(_: Solution, found: CurrentFeedback) -> Rows:
    return [*setting_rows(found.plan), *run_rows(found.run)]


def _tables(_: Solution, found: CurrentFeedback) -> list[Table]:
    loads = [] if found.loads is None else load_tables(found.loads)
    return [own_table(found), compared_table(found), *loads]


def _parts(_: Solution, found: CurrentFeedback) -> list[ReportPart]:
    data = {"tables": html_tables(found), "kind": "modulation"}
    return [ReportPart(CHAPTER, "current_feedback/report.html.j2", data)]


def _figures(_: Solution, found: CurrentFeedback) -> Mapping[str, Draw]:
    from dqforge.reports.current_feedback.figures import plot_regulators

    return {"current_feedback": lambda: plot_regulators(found.over_speed)}


def _plain_rule(_: Solution, found: CurrentFeedback) -> PlainData | None:
    return None if found.rule is None else plain_rule(found.rule)


CURRENT_FEEDBACK = Capability(
    name="current_feedback",
    title="current-feedback PWM",
    of=lambda outcome: outcome.solution.current_feedback,
    plain=lambda _, found: plain_feedback(found),
    always=False,
    summary=_summary,
    tables=_tables,
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="current_feedback",
            files=lambda solution, found: rule_files(solution.design, found),
            plain=_plain_rule,
            read=lambda own, _: rule_from(own),
            programme=rule_programme,
            vectors=False,
        ),
    ),
    emitted=lambda solution, found: settings_files(solution.design, found),
)
