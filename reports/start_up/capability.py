"""The start-up, as a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Outcome, ReportPart
from dqforge.reports.observers.tracker_header import tracker_from
from dqforge.reports.pages.chapters import LOOPS
from dqforge.reports.start_up.header import (
    plain_start_observer,
    plain_start_up,
    start_observer_files,
    start_up_files,
)
from dqforge.reports.start_up.tables import (
    plain_start,
    start_html,
    start_summary,
    start_tables,
)
from dqforge.reports.start_up.tried import (
    start_observer_programme,
    start_up_from,
    start_up_programme,
)

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.start_up.solve import StartUp


def _of(outcome: Outcome) -> StartUp | None:
    return outcome.solution.start_up


def _parts(_: Solution, found: StartUp) -> list[ReportPart]:
    return [
        ReportPart(LOOPS, "pages/tables.html.j2", {"tables": start_html(found), "kind": "loops"})
    ]


START_UP = Capability(
    name="start_up",
    title="from standstill to speed without an encoder",
    of=_of,
    plain=lambda _, found: plain_start(found),
    always=False,
    summary=lambda _, found: start_summary(found),
    tables=lambda _, found: start_tables(found),
    parts=_parts,
    headers=(
        HeaderKind(
            name="startup",
            files=start_up_files,
            plain=plain_start_up,
            read=start_up_from,
            programme=start_up_programme,
            vectors=False,
        ),
        HeaderKind(
            name="start_observer",
            files=start_observer_files,
            plain=lambda _, found: plain_start_observer(found),
            read=lambda own, _: tracker_from(own),
            programme=start_observer_programme,
            vectors=False,
        ),
    ),
)
