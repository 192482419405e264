"""Current-feedback PWM in tables for the terminal and the report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.reports.current_feedback.regulator_words import (
    ASSUMED,
    BESIDE,
    SPEED_LOOP,
    run_rows,
    setting_rows,
    speed_rows,
)
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.current_feedback.regulator_numbers import RegulatorPlan
    from dqforge.optimizer.current_feedback.regulator_runs import RegulatorRun
    from dqforge.optimizer.current_feedback.solve import CurrentFeedback, LoadRuns
    from dqforge.optimizer.losses.drive_budget import DriveBudget

_RPM = 30.0 / math.pi

_RUN_COLUMNS = (
    "regulator", "rpm", "kHz", "from", "to", "error A", "peak A", "THD %", "N m", "total W", "",
)  # fmt: skip

_LOSS_COLUMNS = (
    "regulator", "kHz", "THD %", "N m", "copper W", "ripple W", "conduction W", "switching W",
    "total W", "",
)  # fmt: skip

_COLUMNS_SAID = (
    "kHz: switching frequency of a leg, its mean and from the longest to the shortest time between "
    "turn-ons; error and peak: of a phase current; THD: of the phase currents; N m: torque made."
)


def _text(value: float, digits: int = 3) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _loss_cells(budget: DriveBudget, index: int | tuple[int, int]) -> tuple[str, ...]:
    parts = (
        budget.torque, budget.copper, budget.ripple_copper, budget.conduction, budget.switching,
        budget.total,
    )  # fmt: skip
    return tuple(_text(float(part[index])) for part in parts)


def _mark(run: RegulatorRun, point: int, chosen: str) -> str:
    return run.obstacles[point] or ("chosen" if run.plan.method == chosen else "")


def run_cells(run: RegulatorRun, chosen: str = "") -> list[tuple[str, ...]]:
    """One row per point of a regulator; ``chosen`` is the design's method."""
    rows = []
    for p, omega_m in enumerate(run.points.omega_m):
        frequencies = (run.frequency, run.lowest, run.highest)
        rows.append(
            (
                run.plan.method,
                f"{omega_m * _RPM:.0f}",
                *(_text(1e-3 * float(part[p]), 2) for part in frequencies),
                _text(float(run.rms_error[p])),
                _text(float(run.largest_error[p])),
                _text(100.0 * float(run.distortion[p]), 1),
                _text(float(run.budget.torque[p])),
                _text(float(run.budget.total[p]), 2),
                _mark(run, p, chosen),
            )
        )
    return rows


def settings_table(plan: RegulatorPlan) -> Table:
    """What a regulator has instead of gains."""
    return Table("Current-feedback PWM", ("", ""), tuple(setting_rows(plan)))


def own_table(found: CurrentFeedback) -> Table:
    """Settings of the regulator, what it does over speed, and the speed loop over it."""
    rows = (*setting_rows(found.plan), *run_rows(found.run), *speed_rows(found))
    notes = (ASSUMED, *((SPEED_LOOP,) if found.speed is not None else ()))
    return Table("Current-feedback PWM instead of current loops", ("", ""), rows, notes)


def compared_table(found: CurrentFeedback) -> Table:
    """All regulators over speed with half of the largest torque."""
    rows = [row for run in found.over_speed for row in run_cells(run, found.plan.method)]
    torque = float(found.run.points.torque[0])
    title = f"All regulators over speed, asked for {torque:.4g} N m"
    return Table(title, _RUN_COLUMNS, tuple(rows), (_COLUMNS_SAID, ASSUMED))


def point_table(run: RegulatorRun) -> Table:
    """One regulator at its points."""
    return Table(
        f"{run.plan.method} at constant speed", _RUN_COLUMNS, tuple(run_cells(run)), (ASSUMED,)
    )


def load_tables(loads: LoadRuns) -> list[Table]:
    """One table per load: every regulator, and the modulators at the chosen one's frequency."""
    tables, chosen = [], loads.runs[loads.own]
    for p, (torque, omega_m) in enumerate(
        zip(chosen.points.torque, chosen.points.omega_m, strict=True)
    ):
        rows = [
            (
                run.plan.method,
                _text(1e-3 * float(run.frequency[p]), 2),
                _text(100.0 * float(run.distortion[p]), 1),
                *_loss_cells(run.budget, p),
                _mark(run, p, chosen.plan.method),
            )
            for run in loads.runs
        ]
        for m, name in enumerate(loads.modulations):
            rows.append(
                (
                    name,
                    _text(1e-3 * float(chosen.frequency[p]), 2),
                    _text(100.0 * float(loads.distortion[m, p]), 1),
                    *_loss_cells(loads.budget, (m, p)),
                    "",
                )
            )
        title = f"Losses by current feedback at {torque:.4g} N m, {omega_m * _RPM:.5g} rpm"
        tables.append(Table(title, _LOSS_COLUMNS, tuple(rows), (BESIDE, ASSUMED)))
    return tables


def html_tables(found: CurrentFeedback) -> list[HtmlTable]:
    """The same for the report."""
    loads = [] if found.loads is None else load_tables(found.loads)
    return [_as_html(table) for table in (own_table(found), compared_table(found), *loads)]


def _as_html(table: Table) -> HtmlTable:
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in table.rows)
    narrow = len(table.columns) == 2
    columns = ("", "value") if narrow else table.columns
    notes = tuple(symbols(note) for note in table.notes)
    heads = tuple(symbols(text) for text in columns)
    return HtmlTable(symbols(table.title), heads, rows, 2 if narrow else 1, notes)
