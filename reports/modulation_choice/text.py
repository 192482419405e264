"""The choice of modulator and switching frequency in words: its limits, its alternatives,
what binds it.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ChoiceSettings
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity, signed_hundredths
from dqforge.optimizer.modulation_choice.rule import Leaf, Rule
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, PricedRule
from dqforge.reports.modulation_choice.rule_model import as_emitted, plain_rule
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import letter
from dqforge.reports.plain_data import PlainData

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
    units = {"torque_Nm": ("torque", 1.0, "N m"), "speed_rad_per_s": ("speed", in_rpm(1.0), "rpm")}
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
                "  this design",
                f"{alternative_text(today.alternatives[0])}: {today.mean_loss:.4g} W{broken}",
            )
        )
    return rows


# Tables and plain data of the choice of modulator and switching frequency.

_GRID = (10, 12)  # Torques and speeds of the map in the terminal at most.


def _row(choice: ModulationChoice, label: str, what: str, rule: PricedRule) -> tuple[str, ...]:
    if not math.isfinite(rule.mean_loss):
        return (label, what, "-", "-", kept_text(rule))
    return (
        label,
        what,
        f"{rule.mean_loss:.4g}",
        signed_hundredths(100.0 * choice.price(rule)),
        kept_text(rule),
    )


def rule_rows(choice: ModulationChoice) -> list[tuple[str, ...]]:
    """What the best choice, the rules and the this design lose: label, alternatives, mean W,
    price in %, limits.
    """
    rows: list[tuple[str, ...]] = [
        (
            "best at every point",
            "every modulator, any frequency",
            f"{choice.best_mean:.4g}",
            "0",
            "kept",
        )
    ]
    for rule in reversed(choice.rules):
        mark = " (in the header)" if rule is choice.emitted else ""
        label = (
            f"rule with {question_text(rule.questions)}{mark}"
            if rule.questions
            else f"one everywhere{mark}"
        )
        rows.append(
            _row(
                choice, label, ", ".join(alternative_text(part) for part in rule.alternatives), rule
            )
        )
    rows.append(
        _row(choice, "this design", alternative_text(choice.today.alternatives[0]), choice.today)
    )
    return rows


def choice_notes(choice: ModulationChoice) -> list[str]:
    """Limits, what binds, and the points that are left out."""
    shares = binding_shares(choice)
    bound = (
        ", ".join(f"{name} at {100.0 * share:.0f} %" for name, share in shares.items()) or "none"
    )
    notes = [
        *limits_text(choice.settings),
        f"limits that bind the best choice: {bound} of the points",
    ]
    unreached, idle = 100.0 * choice.unreached_share, 100.0 * choice.idle_share
    if unreached > 0.0:
        notes.append(f"{unreached:.0f} % of the map lies beyond what current and voltage allow")
    if idle > 0.0:
        notes.append(
            f"at {idle:.1f} % of the map nothing keeps all limits; rule and means exclude these "
            "points"
        )
    return notes


def choice_tables(design: Design, choice: ModulationChoice) -> list[Table]:
    """Prices of the rules, the rule itself, and coarse maps of the best modulator and frequency."""
    columns = ("", "modulator and frequency", "mean loss W", "above best %", "limits")
    title = f"{design.name}: modulator and switching frequency over torque and speed"
    prices = Table(title, columns, tuple(rule_rows(choice)), tuple(choice_notes(choice)))
    lines = rule_lines(choice.emitted.rule, choice.emitted.alternatives)
    rule = Table(
        f"Rule in {design.export.prefix}_modulation.h",
        ("where", "modulator and frequency"),
        tuple(lines),
    )
    return [prices, rule, _map(choice)]


def _map(choice: ModulationChoice) -> Table:
    """Letter of the best modulator and its frequency in kHz, highest torque first."""
    shape = (choice.torque.size, choice.omega_m.size)
    best, f_sw = choice.best.modulation.reshape(shape), choice.best.f_sw.reshape(shape)
    places = [
        np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))
        for size, most in zip(shape, _GRID, strict=True)
    ]
    rows = []
    for i in places[0][::-1]:
        cells = [
            f"{letter(int(best[i, j]))} {f_sw[i, j] / 1e3:.3g}" if best[i, j] >= 0 else "."
            for j in places[1]
        ]
        rows.append((f"{choice.torque[i]:.4g}", *cells))
    seen = np.unique(best[best >= 0])
    notes = [f"{letter(int(k))} = {choice.best.modulations[int(k)]}" for k in seen]
    notes.append("of modulators with equal losses the first in the list is named")
    columns = ("N m \\ rpm", *(f"{in_rpm(choice.omega_m[j]):.0f}" for j in places[1]))
    return Table(
        "Best modulator with its frequency in kHz, over torque and speed",
        columns,
        tuple(rows),
        tuple(notes),
    )


def _plain_priced(choice: ModulationChoice, rule: PricedRule) -> PlainData:
    shape = (choice.torque.size, choice.omega_m.size)
    return {
        "questions": rule.questions,
        "alternatives": [{"modulation": name, "frequency_Hz": f} for name, f in rule.alternatives],
        "rule": plain_rule(as_emitted(rule.rule)),
        "mean_loss_W": rule.mean_loss,
        "price": choice.price(rule),
        "limits_kept": rule.kept,
        "taken": rule.taken.reshape(shape),
    }


def plain_choice(choice: ModulationChoice) -> PlainData:
    """Axes, best choice over torque by speed, rules with their prices, and where limits bind."""
    shape, best = (choice.torque.size, choice.omega_m.size), choice.best
    settings = choice.settings
    return {
        "torque_Nm": choice.torque,
        "omega_m_rad_per_s": choice.omega_m,
        "limits": {
            "frequency_Hz": [settings.f_min, settings.f_max],
            "avoid_Hz": [list(band) for band in settings.bands],
            "ripple_current_A": settings.ripple_max,
            "junction_degC": settings.junction_max,
            "carrier_ratio": settings.carrier_ratio,
        },
        "modulations": best.modulations,
        "best": {
            "modulation": best.modulation.reshape(shape),
            "frequency_Hz": best.f_sw.reshape(shape),
            "loss_W": best.loss.reshape(shape),
            "ripple_current_A": best.ripple_current.reshape(shape),
            "junction_degC": best.junction_temperature.reshape(shape),
        },
        "binding": {
            name.replace(" ", "_"): mark.reshape(shape) for name, mark in best.binding.items()
        },
        "binding_share": {
            name.replace(" ", "_"): share for name, share in choice.binding_shares.items()
        },
        "unreached_share": choice.unreached_share,
        "idle_share": choice.idle_share,
        "asked": choice.asked.reshape(shape),
        "best_mean_W": choice.best_mean,
        "rules": [_plain_priced(choice, rule) for rule in choice.rules],
        "emitted": settings.questions,
        "today": _plain_priced(choice, choice.today),
    }
