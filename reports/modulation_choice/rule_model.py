"""The emitted rule that chooses modulator and switching frequency: as plain data,
and what its C finds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.modulation_choice.rule import (
    Leaf,
    Question,
    Rule,
    asked_thresholds,
    modulation_choice,
    of_choice,
)
from dqforge.optimizer.steps.step_arithmetic import Arithmetic
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import sentence
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

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
    def choices(self) -> list[IntEnum]:
        """What the alternatives are called in C, without the prefix."""
        names = (
            f"{part.modulation.upper().replace('-', '_')}_{round(part.f_sw)}_HZ"
            for part in self.alternatives
        )
        return _enumeration("Choice", names)

    @property
    def taken(self) -> list[IntEnum]:
        """What the modulator of each alternative is called in C, without the prefix."""
        names = (f"MODULATOR_{name.upper().replace('-', '_')}" for name in self.modulators)
        found = _enumeration("Modulator", names)
        return [found[self.modulators.index(part.modulation)] for part in self.alternatives]

    @property
    def modulators(self) -> tuple[ModulationName, ...]:
        """Modulators that it takes, in the order of the alternatives."""
        return tuple(dict.fromkeys(alternative.modulation for alternative in self.alternatives))


def _enumeration(kind: str, names: Iterable[str]) -> list[IntEnum]:
    found: Any = IntEnum
    return list(found(kind, list(names), start=0))


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
    torque, speed = np.ascontiguousarray(inputs.T)
    frequencies = [part.f_sw for part in model.alternatives]
    with np.errstate(invalid="ignore"):  # signalling not-a-numbers among raw bits
        choice = modulation_choice(SINGLE, model.rule, model.choices, torque, speed)
        columns = (
            choice,
            of_choice(SINGLE, "modulator", model.choices, model.taken, choice),
            of_choice(SINGLE, "frequency_Hz", model.choices, frequencies, choice),
        )
    shape = torque.shape
    return np.stack([np.broadcast_to(x, shape) for x in columns], axis=1).astype(np.float32)


# The rule in C.


def rule_text(model: EmittedRule, prefix: str) -> str:
    """Types and functions of the header."""
    reader = StepReader(prefix, Functions(), Block("", set()))
    choices, number = model.choices, Expression("number")
    choice = [Expression("choice", kind=f"{prefix}_choice_t")]

    def asked(o: Arithmetic, torque: Any, speed: Any) -> Any:
        return modulation_choice(o, model.rule, choices, torque, speed)

    def modulator(o: Arithmetic, choice: Any) -> Any:
        return of_choice(o, "modulator", choices, model.taken, choice)

    def frequency(o: Arithmetic, choice: Any) -> Any:
        numbers = [part.f_sw for part in model.alternatives]
        return of_choice(o, "frequency_Hz", choices, numbers, choice)

    reader.write("modulation_choice", asked, [number, number], sentence(modulation_choice))
    reader.write("modulator", modulator, choice, "Modulator of a choice.")
    hertz = "Switching frequency of a choice in Hz."
    reader.write("switching_frequency_Hz", frequency, choice, hertz)
    said = [f"{part.modulation}, {part.f_sw:.6g} Hz" for part in model.alternatives]
    modulators = dict(zip(model.taken, (p.modulation for p in model.alternatives), strict=True))
    parts = [
        "/* Modulators that the rule takes. */",
        _enum(f"{prefix}_modulator_t", modulators, prefix),
        "",
        "/* What the rule takes: a modulator with its switching frequency. */",
        _enum(f"{prefix}_choice_t", dict(zip(choices, said, strict=True)), prefix),
        *(f"\n{text}" for text in reader.functions.texts.values()),
    ]
    return "\n".join(parts)


def _enum(name: str, members: Mapping[IntEnum, str], prefix: str) -> str:
    found = [f"    {prefix.upper()}_{key.name}, /* {text} */" for key, text in members.items()]
    found[-1] = found[-1].replace(", /*", " /*", 1)
    return "\n".join(["typedef enum {", *found, f"}} {name};"])
