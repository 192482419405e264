"""Tables and plain data of the choice of modulator and switching frequency."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, PricedRule
from dqforge.reports.modulation_choice.rule_model import as_emitted, plain_rule
from dqforge.reports.modulation_choice.text import (
    alternative_text,
    binding_shares,
    kept_text,
    limits_text,
    question_text,
    rule_lines,
)
from dqforge.reports.pages.labels import letter
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

_RPM = 30.0 / math.pi
_GRID = (10, 12)  # Torques and speeds of the map in the terminal at most.


def _row(choice: ModulationChoice, label: str, what: str, rule: PricedRule) -> tuple[str, ...]:
    if not math.isfinite(rule.mean_loss):
        return (label, what, "-", "-", kept_text(rule))
    return (
        label,
        what,
        f"{rule.mean_loss:.4g}",
        f"{100.0 * choice.price(rule) + 0.0:+.2f}",
        kept_text(rule),
    )


def rule_rows(choice: ModulationChoice) -> list[tuple[str, ...]]:
    """What the best choice, the rules and the design of today lose: label, alternatives, mean W,
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
            f"rule of {question_text(rule.questions)}{mark}"
            if rule.questions
            else f"one everywhere{mark}"
        )
        rows.append(
            _row(
                choice, label, ", ".join(alternative_text(part) for part in rule.alternatives), rule
            )
        )
    rows.append(
        _row(
            choice, "design of today", alternative_text(choice.today.alternatives[0]), choice.today
        )
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
            f"at {idle:.1f} % of the map nothing keeps all limits; rule and means leave it out"
        )
    return notes


def choice_tables(design: Design, choice: ModulationChoice) -> list[Table]:
    """Prices of the rules, the rule itself, and coarse maps of the best modulator and frequency."""
    columns = ("", "takes", "mean loss W", "above best %", "limits")
    title = f"{design.name}: modulator and switching frequency over torque and speed"
    prices = Table(title, columns, tuple(rule_rows(choice)), tuple(choice_notes(choice)))
    lines = rule_lines(choice.emitted.rule, choice.emitted.alternatives)
    rule = Table(f"Rule in {design.export.prefix}_modulation.h", ("where", "takes"), tuple(lines))
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
    notes.append("of modulators that lose the same the first in the list is named")
    columns = ("N m \\ rpm", *(f"{choice.omega_m[j] * _RPM:.0f}" for j in places[1]))
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
