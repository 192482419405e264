"""Configuration files of other firmware as a capability: files, words, tables, and the report."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.solve import FirmwareFit
from dqforge.reports.capability import Capability, Outcome, ReportPart, Rows
from dqforge.reports.firmware_files.exported import firmware_files, read_files, target_named
from dqforge.reports.firmware_files.plain import plain_fit
from dqforge.reports.firmware_files.tables import fit_tables
from dqforge.reports.pages.chapters import Chapter
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.pages.table import Table
    from dqforge.reports.plain_data import PlainData

Fits = tuple[FirmwareFit, ...]

CHAPTER = Chapter("firmware", "Other firmware")


def _of(outcome: Outcome) -> Fits | None:
    return outcome.solution.firmware or None


def _emitted(solution: Solution, fits: Fits) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    for fit in fits:
        files |= firmware_files(solution.design, fit)
    return files


def _plain(solution: Solution, fits: Fits) -> PlainData:
    return {
        fit.name: plain_fit(fit) | {"files": list(firmware_files(solution.design, fit))}
        for fit in fits
    }


def _tables_of(solution: Solution, fit: FirmwareFit) -> list[Table]:
    files, target = firmware_files(solution.design, fit), target_named(fit)
    return fit_tables(fit, read_files(files, target), f"{target.title}: {', '.join(files)}")


def _tables(solution: Solution, fits: Fits) -> list[Table]:
    return [table for fit in fits for table in _tables_of(solution, fit)]


def _summary(solution: Solution, fits: Fits) -> Rows:
    rows: Rows = []
    for fit in fits:
        names = ", ".join(firmware_files(solution.design, fit))
        rows.append((f"for {fit.name}", f"{names}; {_margins(fit)}"))
        rows += [("  cannot hold", shortfall.words) for shortfall in fit.shortfalls]
    return rows


def _margins(fit: FirmwareFit) -> str:
    """Crossover and margin of the q current and of the speed, as that firmware runs them."""
    texts = []
    for name, loop in (("i_q", fit.judged.current_q), ("speed", fit.judged.speed)):
        if loop is not None and math.isfinite(loop.crossover):
            crossover = loop.crossover / (2.0 * math.pi)
            margin = math.degrees(loop.phase_margin)
            texts.append(f"{name} {crossover:.4g} Hz, phase margin {margin:.3g} deg")
    return "; ".join(texts) or "no loop judged"


def _html(table: Table, text_columns: int) -> HtmlTable:
    """A table for the report with its notes."""
    rows = tuple(Row(tuple(map(symbols, row))) for row in table.rows)
    columns, notes = tuple(map(symbols, table.columns)), tuple(map(symbols, table.notes))
    return HtmlTable(symbols(table.title), columns, rows, text_columns, notes)


def _part(solution: Solution, fit: FirmwareFit) -> PlainData:
    files, (values, loops, *lost) = firmware_files(solution.design, fit), _tables_of(solution, fit)
    return {
        "title": target_named(fit).title,
        "tables": [
            replace(
                _html(replace(values, title=", ".join(files)), len(values.columns)), folded=True
            ),
            _html(loops, 1),
            *(_html(table, len(table.columns)) for table in lost),
        ],
    }


def _parts(solution: Solution, fits: Fits) -> list[ReportPart]:
    made = [_part(solution, fit) for fit in fits]
    return [ReportPart(CHAPTER, "firmware_files/report.html.j2", {"fits": made})]


FIRMWARE = Capability(
    name="firmware",
    title="configuration files of other firmware",
    of=_of,
    plain=_plain,
    always=False,
    summary=_summary,
    tables=_tables,
    parts=_parts,
    emitted=_emitted,
)
