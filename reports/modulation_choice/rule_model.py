"""The emitted rule that chooses modulator and switching frequency: as plain data,
and what its C finds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.modulation_choice.rule import Leaf, Question, Rule, decide
from dqforge.reports.plain_data import PlainData, shortest

# What the emitted rule may ask about: magnitudes of torque and mechanical speed.
QUANTITIES = ("torque_Nm", "speed_rad_per_s")
_DEEPEST = 8
_FAULT = InputError("modulation_header is not what dqforge writes; run the design again")


@dataclass(frozen=True, slots=True)
class Alternative:
    """A modulator with its switching frequency in Hz."""

    modulation: ModulationName
    f_sw: float


@dataclass(frozen=True, slots=True)
class EmittedRule:
    """The rule as the header holds it: thresholds and frequencies are floats,
    only what it takes is numbered.

    ``reach`` is the largest torque in N m and mechanical speed in rad/s of the
    map that it was made for.
    """

    rule: Rule
    alternatives: tuple[Alternative, ...]
    reach: tuple[float, float]

    @property
    def modulators(self) -> tuple[ModulationName, ...]:
        """Modulators that it takes, in the order of the alternatives."""
        return tuple(dict.fromkeys(alternative.modulation for alternative in self.alternatives))


def as_emitted(rule: Rule, numbers: Mapping[int, int] | None = None) -> Rule:
    """The rule with its thresholds as the floats that the header holds.

    ``numbers`` renumber its alternatives.
    """
    if isinstance(rule, Leaf):
        return rule if numbers is None else Leaf(numbers[rule.choice])
    threshold = float(np.float32(rule.threshold))
    return Question(
        rule.quantity, threshold, as_emitted(rule.below, numbers), as_emitted(rule.above, numbers)
    )


def emitted_rule(
    rule: Rule, alternatives: Sequence[Alternative], reach: tuple[float, float] = (1.0, 1.0)
) -> EmittedRule:
    """The model of the header for a rule over alternatives."""
    numbers = {index: place for place, index in enumerate(sorted(_taken(rule)))}
    return EmittedRule(
        as_emitted(rule, numbers), tuple(alternatives[index] for index in numbers), reach
    )


def _taken(rule: Rule) -> set[int]:
    return {rule.choice} if isinstance(rule, Leaf) else _taken(rule.below) | _taken(rule.above)


def asked_thresholds(rule: Rule) -> dict[str, set[float]]:
    """Thresholds by quantity."""
    if isinstance(rule, Leaf):
        return {}
    found = {rule.quantity: {rule.threshold}}
    for part in (asked_thresholds(rule.below), asked_thresholds(rule.above)):
        for name, thresholds in part.items():
            found[name] = found.get(name, set()) | thresholds
    return found


def plain_rule(rule: Rule) -> PlainData:
    """A rule as plain data."""
    if isinstance(rule, Leaf):
        return {"choice": rule.choice}
    return {
        "quantity": rule.quantity,
        "threshold": shortest(np.float32(rule.threshold)),
        "below": plain_rule(rule.below),
        "above": plain_rule(rule.above),
    }


def plain_emitted(model: EmittedRule) -> PlainData:
    """The model of the header as plain data; every number is a float32 value."""
    return {
        "alternatives": [
            {"modulation": part.modulation, "frequency_Hz": shortest(np.float32(part.f_sw))}
            for part in model.alternatives
        ],
        "rule": plain_rule(model.rule),
        "torque_max_Nm": shortest(np.float32(model.reach[0])),
        "omega_m_max_rad_per_s": shortest(np.float32(model.reach[1])),
    }


def emitted_from(plain: Mapping[str, Any]) -> EmittedRule:
    """Read a model back.

    Raises:
        InputError: The data are not what `plain_emitted` makes.
    """
    try:
        alternatives = tuple(
            Alternative(_name(entry["modulation"]), _positive(entry["frequency_Hz"]))
            for entry in plain["alternatives"]
        )
        rule = _rule(plain["rule"], len(alternatives), _DEEPEST)
        reach = _positive(plain["torque_max_Nm"]), _positive(plain["omega_m_max_rad_per_s"])
    except (KeyError, TypeError, ValueError) as error:
        raise _FAULT from error
    if _taken(rule) != set(range(len(alternatives))):
        raise _FAULT
    return EmittedRule(rule, alternatives, reach)


def _name(value: Any) -> ModulationName:
    for name in MODULATORS:
        if name == value:
            return name
    raise ValueError


def _positive(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e30:
        raise ValueError
    single = float(np.float32(value))
    if not (math.isfinite(single) and single > 0.0):
        raise ValueError
    return single


def _rule(plain: Any, count: int, depth: int) -> Rule:
    if "choice" in plain:
        choice = plain["choice"]
        if isinstance(choice, bool) or not isinstance(choice, int) or not 0 <= choice < count:
            raise ValueError
        return Leaf(choice)
    if depth == 0 or plain["quantity"] not in QUANTITIES:
        raise ValueError
    below, above = (_rule(plain[side], count, depth - 1) for side in ("below", "above"))
    return Question(plain["quantity"], _positive(plain["threshold"]), below, above)


def rule_inputs(model: EmittedRule, count: int, seed: int, patterns: int = 0) -> SingleArray:
    """Torques in N m and speeds in rad/s, shape (N, 2), on which the rule is tried.

    ``count`` all over the map and beyond it, in all four quadrants; every threshold with its two
    neighbouring floats of either sign against the same of the other quantity, zero, the end of the
    map, infinity and not-a-number; ``patterns`` of any bits.
    """
    generator = np.random.default_rng(seed)
    across = (generator.uniform(-1.1, 1.1, (count, 2)) * np.array(model.reach)).astype(np.float32)
    asked = asked_thresholds(model.rule)
    edges = [
        _edges(asked.get(name, set()), end)
        for name, end in zip(QUANTITIES, model.reach, strict=True)
    ]
    special = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 2)
    bits = generator.integers(0, 2**32, (patterns, 2), dtype=np.uint32).view(np.float32)
    return np.ascontiguousarray(np.concatenate([special, across, bits]))


def _edges(thresholds: set[float], end: float) -> SingleArray:
    exact = np.array(sorted(thresholds), dtype=np.float32)
    near = np.concatenate([exact, *(np.nextafter(exact, np.float32(to)) for to in (0.0, np.inf))])
    plain = np.array([0.0, 1e-45, end, np.inf, np.nan], dtype=np.float32)
    values = np.concatenate([near, plain])
    return np.concatenate([values, -values]).astype(np.float32)


def rule_results(model: EmittedRule, inputs: SingleArray) -> SingleArray:
    """What the compiled rule must return: number of the choice, of its modulator,
    and frequency in Hz, shape (N, 3).
    """
    with np.errstate(invalid="ignore"):  # signalling not-a-numbers among raw bits
        size = np.abs(inputs).astype(np.float64)
        chosen = decide(model.rule, dict(zip(QUANTITIES, size.T, strict=True)))
    columns: list[FloatArray] = [
        np.arange(len(model.alternatives), dtype=np.float64),
        np.array(
            [model.modulators.index(part.modulation) for part in model.alternatives],
            dtype=np.float64,
        ),
        np.array([part.f_sw for part in model.alternatives]),
    ]
    return np.stack(columns, axis=1)[chosen].astype(np.float32)
