"""The choice of modulator and switching frequency in words: its limits, its alternatives,
what binds it.
"""

from __future__ import annotations

import math

from dqforge.machines.design.settings import ChoiceSettings
from dqforge.machines.names import ModulationName
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.modulation_choice.rule import Leaf, Rule
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, PricedRule

_RPM = 30.0 / math.pi


BINDING_TEXT = {
    "ripple": "current ripple",
    "junction": "junction temperature",
    "carrier ratio": "carrier ratio",
    "avoided band": "avoided band",
    "voltage": "linear range",
    "least frequency": "least frequency",
    "largest frequency": "largest frequency",
}


def hertz(frequency: float) -> str:
    """A frequency with its unit."""
    return format_quantity(frequency, "Hz", 4)


def alternative_text(alternative: tuple[ModulationName, float]) -> str:
    """A modulator with its switching frequency."""
    return f"{alternative[0]} at {hertz(alternative[1])}"


def limits_text(settings: ChoiceSettings) -> list[str]:
    """What is kept, one phrase each."""
    if settings.f_min == settings.f_max:
        lines = [f"Switching frequency {hertz(settings.f_min)}"]
    else:
        lines = [f"Switching frequency {hertz(settings.f_min)} to {hertz(settings.f_max)}"]
    if settings.bands:
        lines[0] += " without " + ", ".join(
            f"{hertz(low)} to {hertz(high)}" for low, high in settings.bands
        )
    lines[0] += f", at least {settings.carrier_ratio:.4g} carrier periods per electrical period"
    if settings.ripple_max is not None:
        lines.append(
            f"Ripple of a phase current at most {format_quantity(settings.ripple_max, 'A', 4)} "
            "(r.m.s.)"
        )
    if settings.junction_max is not None:
        lines.append(f"Junctions at most {settings.junction_max:.4g} degC")
    return lines


def rule_lines(
    rule: Rule, alternatives: tuple[tuple[ModulationName, float], ...]
) -> list[tuple[str, str]]:
    """A rule as pairs, one for each answer: where it is given, and what is taken there."""
    return [
        (_where(ranges), alternative_text(alternatives[choice]))
        for ranges, choice in _answers(rule, {})
    ]


_Ranges = dict[str, tuple[float, float]]


def _answers(rule: Rule, ranges: _Ranges) -> list[tuple[_Ranges, int]]:
    if isinstance(rule, Leaf):
        return [(ranges, rule.choice)]
    low, high = ranges.get(rule.quantity, (0.0, math.inf))
    below = ranges | {rule.quantity: (low, min(high, rule.threshold))}
    above = ranges | {rule.quantity: (max(low, rule.threshold), high)}
    return [*_answers(rule.below, below), *_answers(rule.above, above)]


def _where(ranges: _Ranges) -> str:
    units = {"torque_Nm": ("torque", 1.0, "N m"), "speed_rad_per_s": ("speed", _RPM, "rpm")}
    texts = []
    for quantity, (low, high) in sorted(ranges.items()):
        name, factor, unit = units[quantity]
        if high == math.inf:
            texts.append(f"{name} from {low * factor:.4g} {unit}")
        elif low == 0.0:
            texts.append(f"{name} below {high * factor:.4g} {unit}")
        else:
            texts.append(f"{name} {low * factor:.4g} to {high * factor:.4g} {unit}")
    return ", ".join(texts) or "everywhere"


def kept_text(rule: PricedRule) -> str:
    """Whether a rule keeps the limits."""
    if rule.permitted:
        return "kept"
    return f"broken at {100.0 * (1.0 - rule.kept):.3g} % of the points"


def binding_shares(choice: ModulationChoice) -> dict[str, float]:
    """Share of the points at which each limit binds the best choice.

    Those that bind nowhere are left out.
    """
    return {
        BINDING_TEXT[name]: share for name, share in choice.binding_shares.items() if share > 0.0
    }


def question_text(count: int) -> str:
    """Number of questions in words."""
    return ("no question", "one question", "two questions")[count]


def choice_rows(choice: ModulationChoice) -> list[tuple[str, str]]:
    """Two rows for the summary of a run: what the rule loses, and against what."""
    rule, today = choice.emitted, choice.today
    taken = ", ".join(alternative_text(part) for part in rule.alternatives)
    loss = (
        f"{rule.mean_loss:.4g} W in the mean, {100.0 * choice.price(rule):.3g} % above the best at "
        "every point"
    )
    rows = [("modulator by rule", taken), ("  loss over the map", loss)]
    if math.isfinite(today.mean_loss):
        broken = "" if today.permitted else f", limits {kept_text(today)}"
        rows.append(
            (
                "  design of today",
                f"{alternative_text(today.alternatives[0])}: {today.mean_loss:.4g} W{broken}",
            )
        )
    return rows
