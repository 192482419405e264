"""The measured speed, as a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Outcome, ReportPart
from dqforge.reports.pages.chapters import LOOPS
from dqforge.reports.speed_measurement.float32_model import (
    EdgeNumbers,
    numbers_from,
    plain_numbers,
)
from dqforge.reports.speed_measurement.header import (
    measurement_files,
    measurement_programme,
    numbers_of,
)
from dqforge.reports.speed_measurement.tables import (
    measured_html,
    measured_rows,
    measured_tables,
    plain_measured,
)

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.optimizer.solution import Solution


def _of(outcome: Outcome) -> MeasuredSpeed | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.measured_speed


def _parts(_: Solution, found: MeasuredSpeed) -> list[ReportPart]:
    data = {"tables": measured_html(found), "kind": "loops"}
    return [ReportPart(LOOPS, "pages/tables.html.j2", data)]


_HEADER: HeaderKind[MeasuredSpeed, EdgeNumbers] = HeaderKind(
    name="speed_measurement",
    files=lambda solution, found: measurement_files(solution.design, found),
    plain=lambda solution, found: plain_numbers(numbers_of(solution.design, found)),
    read=lambda own, _: numbers_from(own),
    programme=measurement_programme,
    vectors=False,
)

SPEED_MEASUREMENT = Capability(
    name="speed_measurement",
    title="speed from the edges of an encoder",
    of=_of,
    plain=lambda _, found: plain_measured(found),
    always=False,
    summary=lambda _, found: measured_rows(found),
    tables=lambda _, found: measured_tables(found),
    parts=_parts,
    headers=(_HEADER,),
)
