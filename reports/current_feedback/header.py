"""The C header of a sampled regulator with its model, and that of settings for comparators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.names import SampledRuleName
from dqforge.machines.plants.current_regulators.sampled_rules import (
    FAR,
    RuleConstants,
    RuleInputs,
    SampledRule,
)
from dqforge.machines.plants.current_regulators.state_table import (
    ACTIVE,
    switching_table,
    unit_vectors,
)
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.c_code.read_back import single_from
from dqforge.reports.c_code.title import title
from dqforge.reports.current_feedback.regulator_words import emitted_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.current_feedback.patterns import DesignPattern
    from dqforge.optimizer.current_feedback.solve import CurrentFeedback

_FAULT = InputError("current_feedback_header is not what dqforge writes; run the design again")

_NUMBERS = ("r_s", "l_d", "l_q", "psi_pm", "t_s", "band", "outer_band")


def plain_rule(constants: RuleConstants) -> PlainData:
    """The rule as plain data, in double precision: the C rounds what is made of it."""
    return {"rule": constants.rule} | {name: getattr(constants, name) for name in _NUMBERS}


def rule_from(plain: Mapping[str, Any]) -> RuleConstants:
    """Read a rule back.

    Raises:
        InputError: The data are not what `plain_rule` makes.
    """
    try:
        numbers = {name: plain[name] for name in _NUMBERS}
        for value in numbers.values():
            single_from(value)
        if (
            plain["rule"] not in get_args(SampledRuleName)
            or min(numbers[name] for name in ("l_d", "l_q", "t_s")) <= 0.0
        ):
            raise _FAULT
        return RuleConstants(plain["rule"], **{name: float(numbers[name]) for name in numbers})
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error


def rule_inputs(constants: RuleConstants, count: int, seed: int) -> NDArray[np.float32]:
    """Rows (state, references, currents, cosine, sine, speed, link), shape (N, 9): errors far
    within and beyond the bands at all angles and speeds, some of them not finite.
    """
    generator = np.random.default_rng(seed)
    scale = max(constants.outer_band, 1e-3 * constants.psi_pm / constants.l_d, 1e-3)
    theta = generator.uniform(-math.pi, math.pi, count)
    place = generator.uniform(-math.pi, math.pi, count)
    size = scale * 10.0 ** generator.uniform(-2.0, 1.0, count)
    speed = generator.uniform(-0.2, 0.2, count) / constants.t_s
    rows = np.empty((count, 9))
    rows[:, 0] = generator.integers(0, 8, count)
    rows[:, 1:3] = generator.normal(0.0, 4.0 * scale, (count, 2))
    rows[:, 3] = rows[:, 1] + size * np.cos(place)
    rows[:, 4] = rows[:, 2] + size * np.sin(place)
    rows[:, 5], rows[:, 6] = np.cos(theta), np.sin(theta)
    rows[:, 7] = speed
    # A link that moves the error by some tenths to some multiples of the scale in a sample.
    steps = 10.0 ** generator.uniform(-1.0, 0.7, count)
    rows[:, 8] = steps * scale * constants.l_d / constants.t_s
    rows[::97, 3] = math.nan
    rows[50::97, 8] = math.inf
    rows[20::97, 1:8] = 0.0
    return rows.astype(np.float32)


def rule_outputs(constants: RuleConstants, rows: NDArray[np.float32]) -> NDArray[np.uint32]:
    """What the compiled rule must return for rows of `rule_inputs`, shape (N, 1)."""
    told = RuleInputs(*(rows[:, column] for column in range(1, 9)))
    with np.errstate(all="ignore"):
        codes = SampledRule(constants, np.float32).next_codes(rows[:, 0].astype(np.int64), told)
    return codes.astype(np.uint32)[:, None]


def rule_programme(constants: RuleConstants) -> Programme:
    """The harness of a sampled regulator, with what its model answers."""
    rows = rule_inputs(constants, SWEEP_POINTS, SWEEP_SEED)
    outputs = rule_outputs(constants, rows)
    name = f"{constants.rule} regulator"
    return Programme("current_feedback/harness.c.j2", rows, outputs, name=name)


def _speed_lines(design: Design, found: CurrentFeedback) -> list[str]:
    """Constants of the speed loop over the regulator."""
    if found.speed is None:
        return []
    macro = design.export.prefix.upper()
    speed, per_sample = found.speed, "/* per sample, N m s/rad */"
    return [
        "/* Speed loop over this regulator: torque = kp e + integral, parallel form. */",
        f"#define {macro}_FEEDBACK_SPEED_KP ({float_literal(speed.kp)}) /* N m s/rad */",
        f"#define {macro}_FEEDBACK_SPEED_KI_TS ({float_literal(speed.ki_ts)}) {per_sample}",
        f"#define {macro}_FEEDBACK_SPEED_T_S ({float_literal(speed.t_s)}) /* sampling period, s */",
    ]


def _common(design: Design, found: CurrentFeedback) -> PlainData:
    return {
        **title(design),
        "method": found.plan.method,
        "preamble": emitted_lines(design, found),
        "speed_lines": _speed_lines(design, found),
    }


def rule_files(design: Design, found: CurrentFeedback) -> dict[str, bytes]:
    """Name and bytes of the header of a sampled regulator; none of others."""
    constants = found.rule
    if constants is None:
        return {}
    rule = SampledRule(constants, np.float32)
    vectors = unit_vectors().astype(np.float32)
    context = _common(design, found) | {
        "rule": constants.rule,
        "t_s": constants.t_s,
        "band": rule.band,
        "outer_band": rule.outer,
        "square": rule.square,
        "alpha": list(vectors[:, 0]),
        "beta": list(vectors[:, 1]),
        "active": list(ACTIVE),
        "table": [list(row) for row in switching_table()],
        "gain_d": rule.gain_d,
        "gain_q": rule.gain_q,
        "r_s": rule.r_s,
        "l_d": rule.l_d,
        "l_q": rule.l_q,
        "psi_pm": rule.psi_pm,
        "half": rule.half,
        "sixth": np.float32(1.0 / 6.0),
        "third": np.float32(1.0 / 3.0),
        "root": np.float32(0.5 * math.sqrt(3.0)),
        "far": FAR,
    }
    text = render("current_feedback/rule.h.j2", context)
    return {f"{design.export.prefix}_current_feedback.h": text.encode("ascii")}


def settings_files(design: Design, found: CurrentFeedback) -> dict[str, bytes]:
    """Name and bytes of the settings of comparators or patterns; none of sampled rules."""
    plan, sensing = found.plan, design.inverter.current_sensing
    if found.rule is not None:
        return {}
    numbers: list[tuple[str, float, str]] = []
    if plan.method == "hysteresis":
        numbers.append(("FEEDBACK_BAND_A", plan.band, "comparators at reference -+ this, A"))
        if sensing is not None:
            counts = round(plan.band / sensing.step)
            meaning = f"the same in codes of {sensing.bits} bits, {sensing.step:.4g} A each"
            numbers.append(("FEEDBACK_BAND_COUNTS", counts, meaning))
    elif plan.method == "ramp-comparison":
        numbers += [
            ("FEEDBACK_KP", plan.kp, "both axes, V/A"),
            ("FEEDBACK_KI", plan.ki, "both axes, in rotor coordinates, V/(A s)"),
            ("FEEDBACK_CARRIER_HZ", plan.carrier, "triangle, Hz"),
            ("FEEDBACK_TRIANGLE_V", 0.5 * design.inverter.v_dc, "its amplitude: half of v_dc, V"),
            ("FEEDBACK_COMPARATOR_BAND_V", plan.comparator_band, "comparators, edge to edge, V"),
        ]
    else:
        numbers.append(("FEEDBACK_T_S", plan.t_s, "sampling period of the error, s"))
    most = max((len(pattern.angles) for pattern in found.patterns), default=0)
    patterns = [_pattern(pattern, most) for pattern in found.patterns]
    context = _common(design, found) | {"numbers": numbers, "patterns": patterns, "most": most}
    text = render("current_feedback/settings.h.j2", context)
    return {f"{design.export.prefix}_current_feedback.h": text.encode("ascii")}


def _pattern(pattern: DesignPattern, most: int) -> PlainData:
    padding = [0.0] * (most - len(pattern.angles))
    return {
        "index": shortest(np.float32(pattern.index)),
        "sign": float(pattern.sign),
        "angles": [*pattern.angles, *padding],
        "count": len(pattern.angles),
    }
