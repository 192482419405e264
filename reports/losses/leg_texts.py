"""What loss comparisons say of half bridges and neutral, for machines with any back-EMF."""

from __future__ import annotations

import math

from dqforge.optimizer.losses.leg_budgets import PhaseBudget
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.reports.pages.labels import three_decimals
from dqforge.reports.plain_data import PlainData

Index = tuple[int, ...]
_SAME = 5e-4  # Legs whose losses differ by less, relative, are named together.


def legs_text(found: PhaseBudget, index: Index) -> str:
    """Losses of the legs such as ``a, b, c 6.56 W each, n 2.08 W``; empty where unknown."""
    losses = [float(value) for value in found.leg_loss[index]]
    if not all(math.isfinite(value) for value in losses):
        return ""
    groups: list[tuple[float, list[str]]] = []
    for name, value in zip(found.legs, losses, strict=True):
        if groups and abs(value - groups[-1][0]) <= _SAME * max(groups[-1][0], value):
            groups[-1][1].append(name)
        else:
            groups.append((value, [name]))
    return ", ".join(
        f"{', '.join(names)} {three_decimals(value)} W{' each' if len(names) > 1 else ''}"
        for value, names in groups
    )


def leg_notes(comparison: LossComparison, point: int) -> list[str]:
    """What is said below the table of an operating point: legs, neutral and dead time by rule."""
    found = comparison.legs
    if found is None:
        return []
    rules: dict[str, list[str]] = {}
    for s, strategy in enumerate(comparison.strategies):
        text = _rule_text(found, (s, 0, point))
        if text:
            rules.setdefault(text, []).append(strategy)
    return [f"legs with {', '.join(names)}: {text}" for text, names in rules.items()]


def _rule_text(found: PhaseBudget, index: Index) -> str:
    """Legs, neutral and dead time of one rule; empty where the legs are unknown."""
    text = legs_text(found, index)
    if not text:
        return ""
    neutral, ripple = float(found.neutral_current[index]), float(found.neutral_ripple[index])
    if ripple > 0.0:
        through = f"{three_decimals(neutral)} A r.m.s. and " if neutral > 0.0 else ""
        text += f"; neutral {through}{three_decimals(ripple)} A r.m.s. of the switching"
    volts = float(found.budget.voltage_error[index])
    if volts > 0.0:
        text += f"; dead time takes {three_decimals(volts)} V where nothing compensates it"
    return text


def plain_legs(found: PhaseBudget, index: Index) -> dict[str, PlainData]:
    """Keys of a row of the JSON document."""
    losses = zip(found.legs, found.leg_loss[index].tolist(), strict=True)
    warm = zip(found.legs, found.leg_temperature[index].tolist(), strict=True)
    return {
        "legs_W": dict(losses),
        "legs_degC": dict(warm),
        "neutral_A": found.neutral_current[index],
        "neutral_ripple_A": found.neutral_ripple[index],
        "link_needed_V": found.link_demand[index],
        "dead_time_V": found.budget.voltage_error[index],
    }
