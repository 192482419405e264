"""The header of the rule that chooses modulator and switching frequency."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.design.design import Design
from dqforge.machines.names import ModulationName
from dqforge.optimizer.modulation_choice.rule import SimplifiedChoice
from dqforge.optimizer.modulation_choice.solve import ModulationChoice
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.modulation_choice.rule_model import (
    Alternative,
    EmittedRule,
    asked_thresholds,
    emitted_rule,
    plain_rule,
    rule_inputs,
    rule_results,
)
from dqforge.reports.modulation_choice.text import limits_text
from dqforge.reports.pages.templating import render

_SEED = 20_261_121


def _symbol(prefix: str, alternative: Alternative) -> str:
    name = alternative.modulation.upper().replace("-", "_")
    return f"{prefix.upper()}_{name}_{round(alternative.f_sw)}_HZ"


def _modulator(prefix: str, name: ModulationName) -> str:
    return f"{prefix.upper()}_MODULATOR_{name.upper().replace('-', '_')}"


def rule_header(
    design: Design,
    found: SimplifiedChoice,
    alternatives: Sequence[Alternative],
    *,
    reach: tuple[float, float] = (1.0, 1.0),
    limits: Sequence[str] = (),
) -> dict[str, bytes]:
    """Names and bytes of the header with the rule and of its test vectors.

    Only what the rule takes is in it.

    Args:
        design, found, alternatives: The rule with its price, and what its leaves number.
        reach: Largest torque in N m and mechanical speed in rad/s of the map that the rule was made
            for.
        limits: Lines on what was kept, for the comment.
    """
    prefix = design.export.prefix
    model = emitted_rule(found.rule, alternatives, reach)
    listed = [
        {
            "symbol": _symbol(prefix, part),
            "text": f"{part.modulation}, {part.f_sw:.6g} Hz",
            "f_sw": part.f_sw,
            "modulator": _modulator(prefix, part.modulation),
        }
        for part in model.alternatives
    ]
    context = {
        **title(design),
        "alternatives": listed,
        "modulators": [
            {"symbol": _modulator(prefix, name), "text": name} for name in model.modulators
        ],
        "rule": plain_rule(model.rule),
        "asked": sorted(asked_thresholds(model.rule)),
        "comment": [
            (
                "Least mean loss over the operating points of the design that so few questions can "
                "have:"
            ),
            (
                f"{found.mean_loss:.4g} W, {rounded_up(100.0 * found.price)} % above the best "
                "alternative at every point."
            ),
            *(
                []
                if found.permitted
                else ["No such rule keeps all limits at every point; this one breaks them least."]
            ),
            *limits,
        ],
    }
    inputs = rule_inputs(model, design.export.vectors, _SEED)
    results = rule_results(model, inputs)
    vectors = [
        (torque, speed, int(row[0]), row[2])
        for (torque, speed), row in zip(inputs, results, strict=True)
    ]
    texts = {
        f"{prefix}_modulation.h": render("modulation_choice/rule.h.j2", context),
        f"{prefix}_modulation_vectors.h": render(
            "modulation_choice/vectors.h.j2", context | {"vectors": vectors}
        ),
    }
    return {name: text.encode("ascii") for name, text in texts.items()}


def choice_model(choice: ModulationChoice) -> EmittedRule:
    """The model of the header of a design's choice."""
    rule = choice.emitted
    return emitted_rule(rule.rule, _alternatives(choice), _reach(choice))


def choice_files(design: Design, choice: ModulationChoice) -> dict[str, bytes]:
    """Names and bytes of the header with a design's rule and of its test vectors."""
    limits = [f"{line}." for line in limits_text(choice.settings)]
    return rule_header(
        design, choice.simplified(), _alternatives(choice), reach=_reach(choice), limits=limits
    )


def _alternatives(choice: ModulationChoice) -> list[Alternative]:
    return [Alternative(name, frequency) for name, frequency in choice.emitted.alternatives]


def _reach(choice: ModulationChoice) -> tuple[float, float]:
    return float(choice.torque[-1]), float(choice.omega_m[-1])


def rule_programme(rule: EmittedRule) -> Programme:
    """The harness of a rule for the modulator, with what its model answers."""
    half = SWEEP_POINTS // 2
    inputs = rule_inputs(rule, half, SWEEP_SEED, patterns=half)
    return Programme(
        "modulation_choice/harness.c.j2",
        inputs,
        rule_results(rule, inputs),
        name="choice of modulator",
    )
