"""Six-step drives, as a record."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Draw, Outcome, ReportPart
from dqforge.reports.pages.chapters import Chapter
from dqforge.reports.six_step.header import (
    plain_six_step,
    six_step_files,
    six_step_from,
    six_step_programme,
)
from dqforge.reports.six_step.tables import (
    block_html,
    block_summary,
    block_tables,
    plain_blocks,
    range_words,
)

if TYPE_CHECKING:
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.optimizer.solution import Solution

CHAPTER = Chapter("six_step", "Six-step drive")


def _of(outcome: Outcome) -> SixStepDesign | None:
    return outcome.solution.six_step


def _figures(_: Solution, found: SixStepDesign) -> Mapping[str, Draw]:
    from dqforge.reports.six_step.figures import plot_blocks

    return {"six_step": partial(plot_blocks, found)}


def _parts(_: Solution, found: SixStepDesign) -> list[ReportPart]:
    data = {"tables": block_html(found)}
    return [ReportPart(CHAPTER, "six_step/report.html.j2", data, range_words(found))]


SIX_STEP = Capability(
    name="six_step",
    title="six-step drive",
    of=_of,
    plain=lambda _, found: plain_blocks(found),
    always=False,
    summary=lambda _, found: block_summary(found),
    tables=lambda _, found: block_tables(found),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="six_step",
            files=lambda solution, found: six_step_files(solution.design, found),
            plain=lambda _, found: plain_six_step(found),
            read=lambda own, _: six_step_from(own),
            programme=six_step_programme,
            vectors=False,
        ),
    ),
)
