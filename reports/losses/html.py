"""Loss comparisons in the report."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.optimizer.losses.mission_budget import MissionComparison, MissionRun
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.reports.losses.figures import POINTS_SHOWN
from dqforge.reports.losses.leg_texts import leg_notes
from dqforge.reports.losses.map_tables import mission_mark, mission_tables
from dqforge.reports.pages.html_table import HtmlTable, Row, heading_cells
from dqforge.reports.pages.html_text import (
    NARROW,
    known_texts,
    number,
    share,
    symbols,
)
from dqforge.reports.pages.labels import (
    STRATEGY_TEXT,
    WITHOUT_BRIDGE,
    friction_text,
    modulation_label,
    obstacle,
    part_label,
    point_text,
    shown_parts,
    watts,
)
from dqforge.reports.plain_data import PlainData

_WATT_HOUR = 3600.0


_VISIBLE = 1e-4


_MOST_ROWS = 40


def mission_part(design: Design, found: MissionComparison) -> PlainData:
    """What the report prints of a mission."""
    (table,) = mission_tables(design, found)
    return {"source": found.mission.source, "notes": table.notes, "table": _table(found)}


def _table(found: MissionComparison) -> HtmlTable:
    """Energies in Wh by kind; what is less than 0.01 % everywhere is in the total alone."""
    kinds = [
        part for part in PARTS if any(run.energy[part] > _VISIBLE * run.total for run in found.runs)
    ]
    rows = []
    for index, run in enumerate(found.runs[:_MOST_ROWS]):
        mark = mission_mark(run, best=index == found.best)
        rows.append(
            Row(_cells(run, kinds, mark), "best" if mark == "best" else "muted" if mark else "")
        )
    columns = ("", *(part_label(kind) for kind in kinds), "total", "hottest junction", "its swing")
    return HtmlTable("Energy lost over the mission by kind, in Wh", columns, tuple(rows))


def _cells(run: MissionRun, kinds: list[str], mark: str) -> tuple[str, ...]:
    label = f"{STRATEGY_TEXT[run.strategy]}, {modulation_label(run.modulation)}"
    name = symbols(f"{label}: {mark}" if mark not in {"", "best"} else label)
    if not (run.steady and math.isfinite(run.total)):
        return (name, *("\u2013" for _ in range(len(kinds) + 3)))
    energies = (*(run.energy[kind] for kind in kinds), run.total)
    warm = f"{run.junction_max:.1f}{NARROW}\u00b0C", f"{run.swing:.1f}{NARROW}K"
    if not math.isfinite(run.junction_max):
        warm = "\u2013", "\u2013"
    return (name, *(number(energy / _WATT_HOUR) for energy in energies), *warm)


def best_loss(comparison: LossComparison) -> tuple[str, str, str] | None:
    """(total, alternative, comparison) at the first operating point that
    has a feasible alternative; None where no point has one.
    """
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        if best is None:
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        alternative = f"{STRATEGY_TEXT[best[0]]} with {modulation_label(best[1])}"
        first = (
            f"{STRATEGY_TEXT[comparison.strategies[0]]} with "
            f"{modulation_label(comparison.modulations[0])}"
        )
        saving = float(comparison.saving[index]) / 100.0
        against = (
            f", {share(saving, 3)} below {first}" if math.isfinite(saving) and saving > 0.0 else ""
        )
        return (
            watts(float(comparison.budget.total[index])),
            alternative,
            f"at {point_text(point)}{against}",
        )
    return None


def loss_part(comparison: LossComparison) -> PlainData:
    """What the report prints of a comparison."""
    left_out = max(0, len(comparison.points) - POINTS_SHOWN)
    return {"tables": loss_tables(comparison), "points_left_out": left_out}


def loss_tables(comparison: LossComparison) -> list[HtmlTable]:
    """One table per operating point."""
    budget = comparison.budget
    kinds = shown_parts(budget)
    columns = (
        "",
        *(part_label(kind) for kind in kinds),
        "total",
        "saved",
        "junction",
        "phase voltage",
    )
    tables = []
    for p, point in enumerate(comparison.points):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                best = (comparison.best_strategy[p], comparison.best_modulation[p]) == (s, m)
                label = f"{STRATEGY_TEXT[strategy]}, {modulation_label(modulation)}"
                reason = obstacle(comparison, index)
                parts = (*(getattr(budget, kind) for kind in kinds), budget.total)
                cells = (
                    symbols(f"{label}: {reason}" if reason else label),
                    *(
                        watts(float(part[index])) if math.isfinite(part[index]) else "\u2013"
                        for part in parts
                    ),
                    f"{comparison.saving[index] + 0.0:.1f}{NARROW}%"
                    if math.isfinite(comparison.saving[index])
                    else "\u2013",
                    *known_texts(
                        (float(budget.junction_temperature[index]), "\u00b0C"),
                        (float(budget.voltage[index]), "V"),
                    ),
                )
                rows.append(Row(cells, "muted" if reason else "best" if best else ""))
        notes = [
            point_text(point),
            friction_text(comparison, p),
            "" if comparison.scope == "drive" else WITHOUT_BRIDGE,
            *leg_notes(comparison, p),
        ]
        title = ". ".join(note for note in notes if note)
        least = [row.cells[0] for row in rows if row.mark == "best"]
        tables.append(
            HtmlTable(
                title,
                heading_cells(*columns),
                tuple(rows),
                folded=p > 0,
                key="least: " + least[0] if least else "",
            )
        )
    return tables
