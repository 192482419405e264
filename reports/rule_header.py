"""The rule that chooses modulator and switching frequency, as a header of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dqforge import __version__
from dqforge.machines.design import Design
from dqforge.machines.settings import ModulationName
from dqforge.optimizer.choice_rule import Leaf, Question, Rule, SimplifiedChoice
from dqforge.reports.c_numbers import rounded_up
from dqforge.reports.reference_ir import PlainData, shortest
from dqforge.reports.templating import render

QUANTITIES = ("torque_Nm", "speed_rad_per_s")
"""What the emitted rule may ask about: magnitudes of torque and mechanical speed."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A modulator with its switching frequency in Hz."""

    modulation: ModulationName
    f_sw: float


def as_emitted(rule: Rule) -> Rule:
    """The rule with its thresholds as the floats that the header holds."""
    if isinstance(rule, Leaf):
        return rule
    threshold = float(np.float32(rule.threshold))
    return Question(rule.quantity, threshold, as_emitted(rule.below), as_emitted(rule.above))


def _taken(rule: Rule) -> set[int]:
    return {rule.choice} if isinstance(rule, Leaf) else _taken(rule.below) | _taken(rule.above)


def _asked(rule: Rule) -> set[str]:
    return set() if isinstance(rule, Leaf) else {rule.quantity} | _asked(rule.below) | _asked(rule.above)


def plain_rule(rule: Rule, numbers: dict[int, int] | None = None) -> PlainData:
    """A rule as plain data; ``numbers`` renumber its alternatives."""
    if isinstance(rule, Leaf):
        return {"choice": rule.choice if numbers is None else numbers[rule.choice]}
    return {
        "quantity": rule.quantity,
        "threshold": shortest(np.float32(rule.threshold)),
        "below": plain_rule(rule.below, numbers),
        "above": plain_rule(rule.above, numbers),
    }


def _symbol(prefix: str, alternative: Alternative) -> str:
    name = alternative.modulation.upper().replace("-", "_")
    return f"{prefix.upper()}_{name}_{round(alternative.f_sw)}_HZ"


def rule_header(design: Design, found: SimplifiedChoice, alternatives: Sequence[Alternative]) -> dict[str, bytes]:
    """Name and bytes of the header with the rule; only the alternatives that it takes are in it."""
    prefix = design.export.prefix
    numbers = {index: place for place, index in enumerate(sorted(_taken(found.rule)))}
    listed = [
        {
            "symbol": _symbol(prefix, alternatives[index]),
            "text": f"{alternatives[index].modulation}, {alternatives[index].f_sw:.6g} Hz",
            "f_sw": alternatives[index].f_sw,
        }
        for index in numbers
    ]
    context = {
        "prefix": prefix,
        "macro": prefix.upper(),
        "name": design.name,
        "version": __version__,
        "digest": design.digest,
        "alternatives": listed,
        "rule": plain_rule(found.rule, numbers),
        "asked": sorted(_asked(found.rule)),
        "comment": [
            "Least mean loss over the operating points of the design that so few questions can have:",
            f"{found.mean_loss:.4g} W, {rounded_up(100.0 * found.price)} % above the best alternative at every point.",
            *([] if found.permitted else ["No such rule keeps all limits at every point; this one breaks them least."]),
        ],
    }
    return {f"{prefix}_modulation.h": render("choice_rule.h.j2", context).encode("ascii")}
