"""Losses at the operating points of a design and over its mission, as records."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.losses.mission_budget import MissionComparison
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Draw, ReportPart, Rows, Tile
from dqforge.reports.losses.html import best_loss, loss_part, mission_part
from dqforge.reports.losses.map_tables import mission_tables, plain_mission
from dqforge.reports.losses.plain import plain_losses
from dqforge.reports.losses.tables import losses_tables
from dqforge.reports.pages.chapters import LOSSES as CHAPTER
from dqforge.reports.pages.html_text import symbols


def _watts(value: float) -> str:
    return f"{value:.0f} W" if value >= 99.95 else format_quantity(value, "W", 3)


def _summary(_: Solution, comparison: LossComparison) -> Rows:
    rows = []
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        label = f"losses at {point.torque:.4g} N m, {point.omega_m * 30.0 / math.pi:.4g} rpm"
        if best is None:
            rows.append((label, "no alternative is feasible"))
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        budget = comparison.budget
        known = comparison.scope == "drive"
        heat = (
            f", {budget.junction_temperature[index]:.0f} degC" if known else " without the bridge"
        )
        chosen = f"{_watts(float(budget.total[index]))}{heat}"
        first_loss = (
            _watts(float(budget.total[0, 0, p])) if comparison.usable[0, 0, p] else "not feasible"
        )
        first = f"{comparison.strategies[0]} with {comparison.modulations[0]}: {first_loss}"
        rows.append((label, f"{best[0]} with {best[1]}: {chosen} ({first})"))
    return rows


def _sentences(_: Solution, comparison: LossComparison) -> list[str]:
    best = best_loss(comparison)
    if best is None:
        return []
    return [f"The alternative that loses least is {best[1]}: {best[0]} {best[2]}."]


def _tiles(_: Solution, comparison: LossComparison) -> list[Tile]:
    best = best_loss(comparison)
    return (
        [] if best is None else [Tile("Least total loss", best[0], symbols(f"{best[1]} {best[2]}"))]
    )


def _figures(solution: Solution, comparison: LossComparison) -> Mapping[str, Draw]:
    from dqforge.reports.losses.figures import plot_losses

    return {"losses": lambda: plot_losses(solution.design, comparison)}


def _parts(_: Solution, comparison: LossComparison) -> list[ReportPart]:
    best = best_loss(comparison)
    key = "" if best is None else f"{best[0]} with {best[1]}"
    return [ReportPart(CHAPTER, "losses/comparison.html.j2", loss_part(comparison), symbols(key))]


def _mission_figures(_: Solution, found: MissionComparison) -> Mapping[str, Draw]:
    from dqforge.reports.losses.map_figures import plot_mission

    return {"mission": lambda: plot_mission(found)}


def _mission_parts(solution: Solution, found: MissionComparison) -> list[ReportPart]:
    data = mission_part(solution.design, found)
    return [ReportPart(CHAPTER, "losses/mission.html.j2", data)]


LOSSES = Capability(
    name="losses",
    title="losses by strategy and modulator",
    of=lambda outcome: outcome.solution.losses,
    plain=lambda _, comparison: plain_losses(comparison),
    summary=_summary,
    tables=lambda solution, comparison: losses_tables(solution.design, comparison),
    sentences=_sentences,
    tiles=_tiles,
    figures=_figures,
    parts=_parts,
)

MISSION = Capability(
    name="mission",
    title="losses over the mission",
    of=lambda outcome: outcome.solution.mission,
    plain=lambda _, found: plain_mission(found),
    tables=lambda solution, found: mission_tables(solution.design, found),
    figures=_mission_figures,
    parts=_mission_parts,
)
