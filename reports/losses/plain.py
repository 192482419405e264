"""Loss comparisons as plain data."""

from __future__ import annotations

from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.reports.losses.leg_texts import plain_legs
from dqforge.reports.pages.labels import obstacle
from dqforge.reports.plain_data import PlainData


def plain_losses(comparison: LossComparison | None) -> PlainData | None:
    """One row per point, strategy and modulator."""
    if comparison is None:
        return None
    budget = comparison.budget
    rows = [
        {
            "torque_Nm": point.torque,
            "omega_m_rad_per_s": point.omega_m,
            "strategy": strategy,
            "modulation": modulation,
            "copper_W": budget.copper[index],
            "conduction_W": budget.conduction[index],
            "switching_W": budget.switching[index],
            "ripple_copper_W": budget.ripple_copper[index],
            "iron_W": budget.iron[index],
            "ripple_iron_W": budget.ripple_iron[index],
            "magnet_W": budget.magnet[index],
            "dead_time_W": budget.dead_time[index],
            "capacitor_W": budget.capacitor[index],
            "total_W": budget.total[index],
            "junction_degC": budget.junction_temperature[index],
            "voltage_V": budget.voltage[index],
            "friction_W": budget.friction[index],
            "feasible": comparison.usable[index],
            "reached": comparison.reached[index],
            "torque_made_Nm": comparison.most[index],
            "obstacle": obstacle(comparison, index),
            "saving_percent": comparison.saving[index],
        }
        | ({} if comparison.legs is None else plain_legs(comparison.legs, index))
        for p, point in enumerate(comparison.points)
        for s, strategy in enumerate(comparison.strategies)
        for m, modulation in enumerate(comparison.modulations)
        for index in [(s, m, p)]
    ]
    best = [None if labels is None else list(labels) for labels in comparison.best_labels]
    return {"scope": comparison.scope, "rows": rows, "best": best}
