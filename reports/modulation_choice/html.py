"""The choice of modulator and switching frequency in the report."""

from __future__ import annotations

import math

from dqforge.optimizer.modulation_choice.solve import ModulationChoice, PricedRule
from dqforge.reports.modulation_choice.text import (
    alternative_text,
    binding_shares,
    kept_text,
    limits_text,
    question_text,
    rule_lines,
)
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import share
from dqforge.reports.pages.labels import watts
from dqforge.reports.plain_data import PlainData


def choice_part(choice: ModulationChoice, prefix: str) -> PlainData:
    """What the report prints of a choice."""
    return {
        "text": _text(choice),
        "prices": _prices(choice),
        "rule": _rule(choice),
        "prefix": prefix,
        "left_out": _left_out(choice),
    }


def _text(choice: ModulationChoice) -> str:
    first, *others = limits_text(choice.settings)
    limits = "; ".join([first, *(line[0].lower() + line[1:] for line in others)])
    shares = binding_shares(choice)
    bound = ", ".join(f"{name} at {share(part)}" for name, part in shares.items())
    bound = (
        f"What binds the best choice, by share of the points: {bound}."
        if bound
        else "No limit binds."
    )
    return f"{limits}. {bound}"


def _left_out(choice: ModulationChoice) -> str:
    idle = choice.idle_share
    return (
        f"At {share(idle)} of the map nothing keeps all limits; rule and means leave that out."
        if idle > 0.0
        else ""
    )


def _cells(choice: ModulationChoice, label: str, rule: PricedRule) -> tuple[str, ...]:
    taken = ", ".join(alternative_text(part) for part in rule.alternatives)
    if not math.isfinite(rule.mean_loss):
        return (label, taken, "\u2013", "\u2013", kept_text(rule))
    price = choice.price(rule)
    sign = "+" if price >= 0.0 else "\u2212"
    return (label, taken, watts(rule.mean_loss), f"{sign}{share(abs(price), 3)}", kept_text(rule))


def _prices(choice: ModulationChoice) -> HtmlTable:
    rows = [Row(("best at every point", "any", watts(choice.best_mean), "", "kept"), "best")]
    for rule in reversed(choice.rules):
        label = f"rule of {question_text(rule.questions)}" if rule.questions else "one everywhere"
        rows.append(Row(_cells(choice, label, rule), "chosen" if rule is choice.emitted else ""))
    rows.append(Row(_cells(choice, "design of today", choice.today), "muted"))
    columns = ("", "takes", "mean loss", "above the best", "limits")
    return HtmlTable("Mean losses over the map, all points alike", columns, tuple(rows), 2)


def _rule(choice: ModulationChoice) -> HtmlTable:
    lines = rule_lines(choice.emitted.rule, choice.emitted.alternatives)
    return HtmlTable(
        "The rule in the header", ("where", "takes"), tuple(Row(line) for line in lines), 2
    )
