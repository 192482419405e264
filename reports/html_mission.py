"""The mission in the report: energies of every alternative."""

from __future__ import annotations

import math

from dqforge.optimizer.drive_budget import PARTS
from dqforge.optimizer.mission_budget import MissionComparison, MissionRun
from dqforge.optimizer.solution import Solution
from dqforge.reports.drive_losses_tables import mission_mark, mission_tables
from dqforge.reports.html_tables import STRATEGY_TEXT, HtmlTable, Row
from dqforge.reports.html_text import NARROW, number, symbols
from dqforge.reports.labels import MODULATION_LABELS, part_label
from dqforge.reports.reference_ir import PlainData

_WATT_HOUR = 3600.0
_VISIBLE = 1e-4
_MOST_ROWS = 40


def mission_part(solution: Solution) -> PlainData | None:
    """What the report prints of a mission, None where there is none."""
    found = solution.mission
    if found is None:
        return None
    (table,) = mission_tables(solution.design, found)
    return {"source": found.mission.source, "notes": table.notes, "table": _table(found)}


def _table(found: MissionComparison) -> HtmlTable:
    """Energies in Wh by kind; what is less than 0.01 % everywhere is in the total alone."""
    kinds = [part for part in PARTS if any(run.energy[part] > _VISIBLE * run.total for run in found.runs)]
    rows = []
    for index, run in enumerate(found.runs[:_MOST_ROWS]):
        mark = mission_mark(run, best=index == found.best)
        rows.append(Row(_cells(run, kinds, mark), "best" if mark == "best" else "muted" if mark else ""))
    columns = ("", *(part_label(kind) for kind in kinds), "total", "hottest junction", "its swing")
    return HtmlTable("Energy lost over the mission by kind, in Wh", columns, tuple(rows))


def _cells(run: MissionRun, kinds: list[str], mark: str) -> tuple[str, ...]:
    label = f"{STRATEGY_TEXT[run.strategy]}, {MODULATION_LABELS[run.modulation]}"
    name = symbols(f"{label}: {mark}" if mark not in {"", "best"} else label)
    if not (run.steady and math.isfinite(run.total)):
        return (name, *("\u2013" for _ in range(len(kinds) + 3)))
    energies = (*(run.energy[kind] for kind in kinds), run.total)
    warm = f"{run.junction_max:.1f}{NARROW}\u00b0C", f"{run.swing:.1f}{NARROW}K"
    if not math.isfinite(run.junction_max):
        warm = "\u2013", "\u2013"
    return (name, *(number(energy / _WATT_HOUR) for energy in energies), *warm)
