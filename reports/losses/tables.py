"""Loss comparisons as tables of the terminal."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.reports.losses.leg_texts import leg_notes
from dqforge.reports.pages.labels import (
    WITHOUT_BRIDGE,
    friction_text,
    obstacle,
    part_label,
    shown_parts,
    three_decimals,
)
from dqforge.reports.pages.table import Table


def losses_tables(design: Design, comparison: LossComparison) -> list[Table]:
    """One table per operating point: strategy and modulator against losses
    and junction temperature.
    """
    kinds = shown_parts(comparison.budget)
    headings = [f"{part_label(kind)} W" for kind in kinds]
    columns = ("strategy", "modulator", *headings, "total W", "junction degC", "saving %", "")
    tables = []
    budget = comparison.budget
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                mark = "best" if best == (strategy, modulation) else obstacle(comparison, index)
                cells = [
                    *(getattr(budget, kind) for kind in kinds),
                    budget.total,
                    budget.junction_temperature,
                ]
                texts = [three_decimals(float(cell[index])) for cell in cells]
                # Strategies with the same currents differ by rounding, which nobody saves.
                saving = three_decimals(round(float(comparison.saving[index]), 6))
                rows.append((strategy, modulation, *texts, saving, mark))
        title = (
            f"{design.name}: losses at {point.torque:.4g} N m, "
            f"{point.omega_m * 30.0 / math.pi:.5g} rpm"
        )
        notes = [
            friction_text(comparison, p),
            WITHOUT_BRIDGE if comparison.scope != "drive" else "",
            *leg_notes(comparison, p),
        ]
        tables.append(Table(title, columns, tuple(rows), tuple(note for note in notes if note)))
    return tables
