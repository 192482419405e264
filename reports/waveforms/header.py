"""The C header of phase currents and its test vectors, as text."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.waveforms.firmware_fit import PhaseFit
from dqforge.optimizer.waveforms.firmware_form import HALF_ROOT_3, PhasePolynomials, PhaseReference
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.waveforms.float32_model import (
    model_currents,
    plain_phase_reference,
    waveform_inputs,
)

_SEED = 20_260_502


def _error_lines(fit: PhaseFit) -> list[str]:
    chosen = fit.chosen
    current, torque = (
        rounded_up(100.0 * value) for value in (chosen.errors.current, chosen.errors.torque)
    )
    lines = [
        (
            f"Form {chosen.name}: {chosen.flash} bytes of constants, some {chosen.operations} "
            "operations;"
        ),
        (
            f"currents err by at most {current} % of the peak, the torque by {torque} % of the "
            "torque asked for"
        ),
        (
            f"({chosen.errors.samples} evaluations, with and without fused multiply-add; sampled, "
            "not proven)."
        ),
    ]
    for other in fit.candidates[1:]:
        worst = rounded_up(100.0 * other.errors.current)
        lines.append(
            f"Not chosen: {other.name}, {other.flash} bytes, {other.operations} operations, "
            f"{worst} %."
        )
    return lines


def _terms(plain: PlainData) -> list[list[PlainData]]:
    """Products of each phase in the order in which they are added; none of a table."""
    if plain["form"] != "harmonics":
        return []
    rows = []
    for cosine, sine in zip(plain["cosine"], plain["sine"], strict=True):
        pairs = [
            (harmonic, weight, factor)
            for harmonic, weights in enumerate(zip(cosine, sine, strict=True))
            for weight, factor in zip(weights, ("c", "s"), strict=True)
            if weight != 0.0
        ]
        rows.append(
            [
                {"harmonic": harmonic, "weight": weight, "factor": factor, "first": place == 0}
                for place, (harmonic, weight, factor) in enumerate(pairs)
            ]
        )
    return rows


def _weight_steps(form: PhasePolynomials, weight: tuple[float, ...]) -> PlainData | None:
    """How the C evaluates one weight: Horner's rule in x or its square."""
    if not weight:
        return None
    coefficients, variable, odd = form.steps(weight)
    return {
        "last": coefficients[-1],
        "others": coefficients[-2::-1],
        "variable": variable,
        "odd": odd,
    }


def _polynomial_context(form: PhasePolynomials) -> PlainData:
    """Harmonics in the order in which the C adds them, each with the weights of its rows."""
    equal, started = len(form.cosine) == 1, set()
    harmonics = []
    for harmonic in range(form.size):
        order = 1 + form.stride * harmonic
        rows = []
        for row, (cosine, sine) in enumerate(zip(form.cosine, form.sine, strict=True)):
            a, b = _weight_steps(form, cosine[harmonic]), _weight_steps(form, sine[harmonic])
            if a is None and b is None:
                continue
            along = ("along" if order % 3 else "common") if equal else f"i_{'abc'[row]}"
            turns = equal and order % 3 != 0
            rows.append(
                {
                    "cosine": a,
                    "sine": b,
                    "along": along,
                    "first_along": along not in started,
                    "across": turns,
                    "first_across": turns and "across" not in started,
                    "sign": "" if order % 3 == 1 else "-",
                }
            )
            started |= {along, "across"} if turns else {along}
        harmonics.append({"order": order, "rows": rows})
    weights = [
        weight
        for part in (form.cosine, form.sine)
        for row in part
        for weight in row
        if len(weight) > 1
    ]
    names = ("common", "along", "across") if equal else ("i_a", "i_b", "i_c")
    return {
        "equal": equal,
        "stride": form.stride,
        "harmonics": harmonics,
        "sums": [{"name": name, "used": name in started} for name in names],
        "uses": {
            "x": bool(weights),
            "square": any(form.steps(weight)[1] == "square" for weight in weights),
            "a": any(any(row) for row in form.cosine),
            "b": any(any(row) for row in form.sine),
        },
        "inverse": shortest(form.inverse),
        "half_root_3": shortest(HALF_ROOT_3),
    }


def _span(design: Design) -> str:
    """The turn that a table spans."""
    turns = 1 if design.phase_machine is None else design.phase_machine.turns
    return "electrical" if turns == 1 else "mechanical"


def _angle_lines(design: Design, form: str) -> list[str]:
    """What the C takes as its angle."""
    if form != "table":
        return ["sine, cosine: of the electrical angle of the d axis from phase a."]
    span = _span(design)
    text = (
        f"turn: {span} angle of the d axis from phase a over 2 pi, 0 to below 1; others count as 0."
    )
    if span == "electrical":
        return [text]
    pairs = design.machine.pole_pairs
    return [text, f"The {pairs} pole pairs differ: at 0 the first one of the back-EMF begins."]


def _context(design: Design, fit: PhaseFit) -> PlainData:
    plain = plain_phase_reference(fit.reference)
    rule = "with" if TOPOLOGIES[design.inverter.topology].neutral else "without"
    angle = _angle_lines(design, plain["form"])
    form = fit.reference.form
    proportional = (
        "not in proportion to" if isinstance(form, PhasePolynomials) else "proportional to"
    )
    return {
        **title(design),
        "polynomials": _polynomial_context(form) if isinstance(form, PhasePolynomials) else None,
        "torque_max": plain["torque_max"],
        "span": _span(design),
        "form": {"table": None, "size": 0}
        | plain
        | ({"size": len(plain["table"][0]) - 1} if "table" in plain else {}),
        "terms": _terms(plain),
        "preamble": [
            (
                f"{design.machine.pole_pairs} pole pairs, {design.i_max:.6g} A (peak), "
                f"{design.inverter.topology}."
            ),
            (
                "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
                "errors hold either way."
            ),
        ],
        "comment": [
            (
                f"Constant torque at least copper loss, {rule} zero-sequence current; "
                f"{proportional} the torque."
            ),
            (
                "torque_Nm: torque in N m, clamped to +-TORQUE_MAX; i_a_A, i_b_A, i_c_A: phase "
                "currents in A."
            ),
            *angle,
            *_error_lines(fit),
        ],
    }


def waveform_files(design: Design, fit: PhaseFit) -> dict[str, bytes]:
    """Names and bytes of the header of phase currents and of its test vectors."""
    context, prefix = _context(design, fit), design.export.prefix
    inputs = waveform_inputs(fit.reference, max(design.export.vectors, 64), _SEED)
    currents = model_currents(fit.reference, inputs)
    vectors = np.concatenate([inputs, currents], axis=1)
    more = {"vectors": [list(row) for row in vectors], "inputs": inputs.shape[1]}
    template = (
        "waveforms/waveform.h.j2" if context["polynomials"] is None else "waveforms/salient.h.j2"
    )
    texts = {
        f"{prefix}_waveform.h": render(template, context),
        f"{prefix}_waveform_vectors.h": render("waveforms/vectors.h.j2", context | more),
    }
    return {name: text.encode("ascii") for name, text in texts.items()}


def waveform_programme(reference: PhaseReference) -> Programme:
    """The harness of phase currents, with what their model answers."""
    inputs = waveform_inputs(reference, SWEEP_POINTS, SWEEP_SEED)
    return Programme(
        "waveforms/harness.c.j2", inputs, model_currents(reference, inputs), name="phase currents"
    )
