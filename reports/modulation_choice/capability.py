"""The choice of modulator and switching frequency, as one record."""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.optimizer.modulation_choice.solve import ModulationChoice
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Draw, ReportPart
from dqforge.reports.modulation_choice.header import (
    choice_files,
    choice_model,
    rule_programme,
)
from dqforge.reports.modulation_choice.html import choice_part
from dqforge.reports.modulation_choice.rule_model import emitted_from, plain_emitted
from dqforge.reports.modulation_choice.tables import choice_tables, plain_choice
from dqforge.reports.modulation_choice.text import choice_rows
from dqforge.reports.pages.chapters import MODULATION
from dqforge.reports.pages.html_text import quantity


def _figures(_: Solution, choice: ModulationChoice) -> Mapping[str, Draw]:
    from dqforge.reports.modulation_choice.figures import plot_choice

    return {"choice": lambda: plot_choice(choice)}


def _parts(solution: Solution, choice: ModulationChoice) -> list[ReportPart]:
    data = choice_part(choice, solution.design.export.prefix)
    key = f"mean loss {quantity(choice.emitted.mean_loss, 'W')}"
    return [ReportPart(MODULATION, "modulation_choice/report.html.j2", data, key)]


MODULATION_CHOICE = Capability(
    name="modulation_choice",
    title="modulator and switching frequency",
    of=lambda outcome: outcome.solution.choice,
    plain=lambda _, choice: plain_choice(choice),
    summary=lambda _, choice: choice_rows(choice),
    tables=lambda solution, choice: choice_tables(solution.design, choice),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="modulation",
            files=lambda solution, choice: choice_files(solution.design, choice),
            plain=lambda _, choice: plain_emitted(choice_model(choice)),
            read=lambda own, _: emitted_from(own),
            programme=rule_programme,
        ),
    ),
)
