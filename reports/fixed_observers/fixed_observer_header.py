"""The C header of a position observer in fixed point, as plain data and as text."""

from __future__ import annotations

import math
from dataclasses import asdict
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FixedObserverFit,
    FixedPositionObserver,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    integer_kinds,
    title,
)
from dqforge.reports.capability import Capability
from dqforge.reports.control.fixed_header import error_words
from dqforge.reports.fixed_observers.fixed_observer_model import (
    fixed_observer_from,
    input_names,
    output_names,
    row_inputs,
    row_results,
)
from dqforge.reports.pages.templating import render
from dqforge.reports.steps.code_text import code_basics, code_types
from dqforge.reports.steps.integer_text import integer_observer_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


_SEED = 20_261_122


def plain_fixed_observer(observer: FixedPositionObserver) -> PlainData:
    """Method, format, full scales and integers as plain data."""
    return {
        "method": observer.method.name,
        "width": observer.width,
        "bases": list(observer.bases),
        "turn": observer.turn,
        "gains": asdict(observer.gains),
    }


def plain_observer_evidence(fit: FixedObserverFit) -> PlainData:
    """The proven range of every product and sum, and what one code is, as plain data."""
    ranges = [
        {"name": reach.name, "low": reach.range.low, "high": reach.range.high, "bits": reach.bits}
        for reach in fit.reaches
    ]
    return {
        "ranges": ranges,
        "fullest": {"name": fit.fullest.name, "share": fit.fullest.share},
        "sine_error_codes": fit.sine_error,
        "angle_step_rad": fit.angle_step,
        "speed_step_rad_per_s": fit.speed_step,
    }


def _preamble(fit: FixedObserverFit, design: Design) -> list[str]:
    observer, fullest = fit.observer, fit.fullest
    bits, code, prefix = observer.width, observer.method.code, design.export.prefix
    current, voltage, speed = observer.bases
    return [
        f"Method: {METHODS[observer.method.name].title}, every {design.control.t_s * 1e6:.6g} us.",
        *wrap(
            f"Full scales, 2^{bits - 1} codes of int{bits}_t: {current:.6g} A, {voltage:.6g} V "
            f"(peak of phase), {speed:.6g} rad/s (mechanical); 2^{bits} codes of uint{bits}_t are "
            "a turn (electrical).",
            110,
        ),
        *wrap(
            "Inside all codes have 32 bits, products 64: filters and loop would come to rest in "
            f"dead bands of 16. What is shown is rounded to {math.degrees(fit.angle_step):.3g} deg "
            f"and {in_rpm(fit.speed_step):.3g} rpm; an estimated speed beyond full scale "
            "saturates.",
            110,
        ),
        *wrap(
            f"No overflow for any inputs and any past: {len(fit.reaches)} products and sums proven "
            f"by interval analysis; the fullest, '{fullest.name}', reaches {fullest.share:.4%} of "
            f"int{fullest.bits}_t.",
            110,
        ),
        "",
        *wrap(
            f"Call {prefix}_{code}_start_{observer.format}() once and "
            f"{prefix}_{code}_step_{observer.format}() at every sample with the voltage that acted "
            "over the period that ends there; both vectors in codes of the control.",
            110,
        ),
    ]


def fit_in_words(fit: FixedObserverFit) -> str:
    """What is proven of an observer and what one code of its estimates is, in words."""
    return (
        f"{fit.observer.format}: {len(fit.reaches)} products and sums never overflow, codes of "
        f"{math.degrees(fit.angle_step):.3g} deg and {in_rpm(fit.speed_step):.3g} rpm"
    )


def fixed_observer_files(design: Design, fit: FixedObserverFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    observer = fit.observer
    context = {
        **title(design),
        "format": observer.format,
        "width": observer.width,
        "code": observer.method.code,
        "gains": asdict(observer.gains),
        "preamble": _preamble(fit, design),
    }
    prefix, macro, core = context["prefix"], context["macro"], fit.sine.width
    context["types"] = code_types(prefix, macro, observer.width)
    context["core_types"] = code_types(prefix, macro, core, "core")
    error = error_words(core, fit.sine_error)
    context["core_basics"] = code_basics(prefix, macro, core, error, "core")
    context["text"] = integer_observer_text(
        observer.method, observer.gains, observer.width, context["prefix"], context["macro"]
    )
    inputs = row_inputs(observer, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, row_results(observer, inputs)], axis=1)
    text = render("fixed_observers/observer.h.j2", context)
    return fixed_observer_harness(observer).files(design, text, vectors)


def fixed_observer_harness(observer: FixedPositionObserver) -> Harness:
    """One sample from a given state; where it has not started, the start and the first sample."""
    f, code, words, width = (
        observer.format,
        observer.method.code,
        observer.method.words,
        observer.width,
    )
    number, rest, first = f"int{width}_t", 32 - width, 3 + len(words)
    v, i = (", ".join(f"({number})in[{first + k}]" for k in (begin, begin + 1)) for begin in (0, 2))
    ends = ("(int64_t)observer.theta_e", "observer.omega_m")
    results = [
        "(int64_t)observer.theta",
        "observer.omega",
        *(f"observer.{w.name}" for w in words),
        *ends,
    ]
    body = (
        f"const @_alphabeta_{f}_t v = {{ {v} }};",
        f"const @_alphabeta_{f}_t i = {{ {i} }};",
        f"@_{code}_{f}_t observer;",
        "",
        f"@_{code}_start_{f}(&observer, (u{number})(in[1] >> {rest}),",
        f"        ({number})(in[2] >> {rest}));",
        "if (in[0] != 0) {",
        "    observer.theta = (uint32_t)in[1];",
        "    observer.omega = (int32_t)in[2];",
        *(f"    observer.{w.name} = ({w.type})in[{k}];" for k, w in enumerate(words, 3)),
        "    observer.started = 1U;",
        "}",
        f"@_{code}_step_{f}(&@@_{code.upper()}_GAINS_{f.upper()}, &observer, v, i);",
        *(f"out[{k}] = {result};" for k, result in enumerate(results)),
    )
    told = f"{', '.join(input_names(observer))}; {', '.join(output_names(observer))}"
    return Harness(f"observer_{f}", told, (first + 4, len(results)), body, "int64_t")


def fixed_observer_programme(observer: FixedPositionObserver) -> Programme:
    """The harness of an observer in fixed point, with what its model answers."""
    inputs = row_inputs(observer, SWEEP_POINTS, SWEEP_SEED)
    results = row_results(observer, inputs).astype("i8")
    harness = fixed_observer_harness(observer)
    return Programme(harness, inputs.astype("i8"), results, "fixed-point position observer")


# The position observer in fixed point, as a record.

Fits = tuple[FixedObserverFit, ...]


_KINDS: tuple[HeaderKind[Fits, FixedPositionObserver], ...] = integer_kinds(
    "observer",
    width_of=lambda fit: fit.observer.width,
    files=lambda solution, fit: fixed_observer_files(solution.design, fit),
    plain=lambda fit: plain_fixed_observer(fit.observer),
    read=lambda own, width, _: fixed_observer_from(own, width),
    programme=fixed_observer_programme,
)


def _summary(_: Solution, fits: Fits) -> list[tuple[str, str]]:
    return [("observer in integers", "; ".join(fit_in_words(fit) for fit in fits))]


FIXED_OBSERVER = Capability(
    name="observer_fixed",
    title="position observer in fixed point",
    of=lambda outcome: outcome.solution.fixed_observers or None,
    plain=lambda _, fits: {fit.observer.format: plain_observer_evidence(fit) for fit in fits},
    always=False,
    summary=_summary,
    headers=_KINDS,
)
