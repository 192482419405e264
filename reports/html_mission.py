"""The mission in the report: energies of every alternative."""

from __future__ import annotations

from dqforge.optimizer.solution import Solution
from dqforge.reports.drive_losses_tables import mission_tables
from dqforge.reports.html_tables import HtmlTable, Row
from dqforge.reports.reference_ir import PlainData

_TEXT_COLUMNS = 3


def mission_part(solution: Solution) -> PlainData | None:
    """What the report prints of a mission, None where there is none."""
    found = solution.mission
    if found is None:
        return None
    (table,) = mission_tables(solution.design, found)
    marks = {"best": "best", "": ""}
    rows = tuple(Row(cells, marks.get(cells[-1], "muted")) for cells in table.rows)
    return {
        "source": found.mission.source,
        "notes": table.notes,
        "table": HtmlTable("Energy lost over the mission by kind", table.columns, rows, _TEXT_COLUMNS),
    }
