"""Overmodulation, as one record."""

from __future__ import annotations

from dqforge.optimizer.overmodulation import Overmodulation
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Quantity, ReportPart, Rows
from dqforge.reports.overmodulation.tables import (
    gain_text,
    overmodulation_part,
    overmodulation_tables,
    plain_overmodulation,
    reach_text,
)
from dqforge.reports.pages.templating import MODULATION


def _summary(_: Solution, found: Overmodulation) -> Rows:
    rows = [("overmodulation", reach_text(found))]
    return rows if found.largest is None else [*rows, ("  gives", gain_text(found.largest))]


def _parts(_: Solution, found: Overmodulation) -> list[ReportPart]:
    return [ReportPart(MODULATION, "overmodulation/report.html.j2", overmodulation_part(found))]


OVERMODULATION = Capability(
    name="overmodulation",
    title="overmodulation",
    of=lambda outcome: outcome.solution.overmodulation,
    plain=lambda _, found: plain_overmodulation(found),
    summary=_summary,
    tables=lambda _, found: overmodulation_tables(found),
    parts=_parts,
    quantities=(
        Quantity("overmodulation", "largest fundamental", "V", ("overmodulation", "v_max_V")),
    ),
)
