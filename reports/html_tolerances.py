"""Tables of the report on tolerances and on gains over the current."""

from __future__ import annotations

from dqforge.optimizer.solution import GainSet
from dqforge.reports.html_tables import HtmlTable, Row
from dqforge.reports.html_text import symbols
from dqforge.reports.robustness_text import ROBUST_COLUMNS, robust_notes, robust_rows
from dqforge.reports.schedule_text import SCHEDULE_COLUMNS, schedule_notes, schedule_rows


def _table(caption: str, columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...], text_columns: int) -> HtmlTable:
    cells = tuple(Row(tuple(symbols(cell) for cell in row)) for row in rows)
    return HtmlTable(symbols(caption), tuple(symbols(column) for column in columns), cells, text_columns)


def tolerance_tables(gains: GainSet) -> list[HtmlTable]:
    """Worst margins within the tolerances, and scheduled beside constant gains; none where none are asked for."""
    tables = []
    if gains.robust is not None:
        caption = f"Worst within control.tolerances; {'; '.join(robust_notes(gains.robust))}"
        tables.append(_table(caption, ROBUST_COLUMNS, robust_rows(gains.robust), len(ROBUST_COLUMNS)))
    if gains.schedule is not None:
        caption = f"Scheduled gains along the current reference. {'; '.join(schedule_notes(gains.schedule))}"
        tables.append(_table(caption, SCHEDULE_COLUMNS, schedule_rows(gains.schedule), 1))
    return tables
