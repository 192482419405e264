"""The C header of field-weakening references and its test vectors, as plain data and as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.single_precision import SingleArray, SinglePolynomial
from dqforge.optimizer.surface_fit import WeakeningFit
from dqforge.optimizer.surface_reference import SingleSurface, WeakeningReference
from dqforge.reports.header_title import title
from dqforge.reports.plain_singles import single_from, singles_from
from dqforge.reports.reference_ir import PlainData, shortest
from dqforge.reports.templating import render
from dqforge.reports.weakening_text import error_lines

_SEED = 20_260_611
_MOST_SEGMENTS, _MOST_TERMS = 8, 16
_NUMBERS = "flux_min", "flux_max", "torque_mid", "excess_mid"
_CURVES = "limit", "d", "q", "flux"
_SURFACES = "surface_d", "surface_q"
_FAULT = InputError("weakening_header is not what dqforge writes; run the design again")


def plain_weakening(reference: WeakeningReference) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    plain: PlainData = {name: shortest(getattr(reference, name)) for name in _NUMBERS}
    for name in _CURVES:
        curve: SinglePolynomial = getattr(reference, name)
        plain[name] = [
            {"start": shortest(start), "coefficients": [shortest(value) for value in row]}
            for start, row in zip(curve.starts, curve.coefficients, strict=True)
        ]
    for name in _SURFACES:
        surface: SingleSurface = getattr(reference, name)
        plain[name] = [[shortest(value) for value in row] for row in surface.rows]
    return plain


def weakening_from(plain: Mapping[str, Any]) -> WeakeningReference:
    """Read an evaluator back.

    Raises
    ------
    InputError
        The data are not what `plain_weakening` makes.
    """
    try:
        found = WeakeningReference(
            flux_min=single_from(plain["flux_min"]),
            flux_max=single_from(plain["flux_max"]),
            limit=_curve(plain["limit"]),
            d=_curve(plain["d"]),
            q=_curve(plain["q"]),
            flux=_curve(plain["flux"]),
            torque_mid=single_from(plain["torque_mid"]),
            excess_mid=single_from(plain["excess_mid"]),
            surface_d=_surface(plain["surface_d"]),
            surface_q=_surface(plain["surface_q"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    alike = all(np.array_equal(curve.starts, found.d.starts) for curve in (found.q, found.flux))
    if not alike or len(found.surface_d.rows) != len(found.surface_q.rows):
        raise _FAULT
    return found


def _curve(rows: Any) -> SinglePolynomial:
    starts = singles_from([row["start"] for row in rows], _MOST_TERMS)
    coefficients = np.stack([singles_from(row["coefficients"], _MOST_TERMS) for row in rows])
    ascending = starts[0] == 0.0 and bool(np.all(np.diff(starts) > 0.0)) and starts.size <= _MOST_SEGMENTS
    if coefficients.shape[1] < 2 or not ascending:
        raise ValueError
    return SinglePolynomial(starts, coefficients)


def _surface(rows: Any) -> SingleSurface:
    if not 1 <= len(rows) <= _MOST_TERMS:
        raise ValueError
    return SingleSurface(tuple(singles_from(row, _MOST_TERMS) for row in rows))


def weakening_inputs(reference: WeakeningReference, count: int, seed: int, patterns: int = 0) -> SingleArray:
    """Inputs of the evaluator, shape (count + patterns + 100, 2): torque in N m and flux linkage in Wb.

    All over the domain and beyond it, ``patterns`` of any bits, and every pair of ten special values.
    """
    generator = np.random.default_rng(seed)
    low, high = float(reference.flux_min), float(reference.flux_max)
    flux = generator.uniform(0.9 * low, high + 0.1 * low, count).astype(np.float32)
    _, clamped = reference.limited(np.zeros_like(flux), flux)
    most, _ = reference.limited(np.full_like(flux, np.inf), clamped)
    torque = (generator.uniform(-1.1, 1.1, count) * most).astype(np.float32)
    edges = [np.float32(value) for value in (0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, low, high, float(np.max(most)))]
    edges.append(-edges[-1])
    special = np.stack(np.meshgrid(edges, edges), axis=-1).reshape(-1, 2).astype(np.float32)
    bits = generator.integers(0, 2**32, (patterns, 2), dtype=np.uint32).view(np.float32)
    return np.ascontiguousarray(np.concatenate([np.stack([torque, flux], axis=1), special, bits]))


def weakening_currents(reference: WeakeningReference, inputs: SingleArray) -> SingleArray:
    """What the compiled evaluator must return for inputs, shape (M, 2)."""
    return np.stack(reference.currents(inputs[:, 0].copy(), inputs[:, 1].copy()), axis=1)


def _ladder(variable: str, plain: PlainData, targets: Mapping[str, str]) -> PlainData:
    """Segments of curves on the same edges as the template prints them; ``targets`` maps C names to curves."""
    first = plain[next(iter(targets.values()))]
    ends = [row["start"] for row in first[1:]] + [None]
    return {
        "variable": variable,
        "segments": [
            {
                "start": row["start"],
                "end": end,
                "polynomials": [(target, plain[name][place]["coefficients"]) for target, name in targets.items()],
            }
            for place, (row, end) in enumerate(zip(first, ends, strict=True))
        ],
    }


def _comment(fit: WeakeningFit) -> list[str]:
    return [
        "torque_Nm: torque in N m, either sign, held to what the flux linkage and the current limit allow.",
        "flux_Wb: available flux linkage in Wb, largest phase-voltage amplitude over |electrical speed| in rad/s;",
        "the drop over the phase resistance is neglected: take r_s times the current off the voltage (always safe).",
        "It is clamped to FLUX_MIN and FLUX_MAX; infinity, at standstill, is as good as FLUX_MAX.",
        "i_d_A, i_q_A: current references in A (peak). Not-a-number as torque gives no torque; as flux linkage",
        "no torque at FLUX_MIN, which keeps the voltage limit at every speed up to the largest.",
        "",
        *error_lines(fit),
        f"{fit.reference.coefficients} coefficients; on a Cortex-M4F below {fit.reference.flash} bytes (estimate).",
    ]


def _context(design: Design, fit: WeakeningFit) -> PlainData:
    plain = plain_weakening(fit.reference)
    rpm = fit.settings.omega_m * 30.0 / np.pi
    return {
        **title(design),
        "form": plain,
        "ladders": [
            _ladder("f", plain, {"limit": "limit"}),
            _ladder("t", plain, {"i_d": "d", "i_q": "q", "delta": "flux"}),
        ],
        "preamble": [
            f"{design.machine.pole_pairs} pole pairs, {design.i_max:.6g} A (peak), up to {rpm:.6g} rpm.",
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated errors hold either way.",
        ],
        "comment": _comment(fit),
    }


def weakening_files(design: Design, fit: WeakeningFit) -> dict[str, bytes]:
    """Names and bytes of the header of field-weakening references and of its test vectors."""
    context, prefix = _context(design, fit), design.export.prefix
    inputs = weakening_inputs(fit.reference, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, weakening_currents(fit.reference, inputs)], axis=1)
    texts = {
        f"{prefix}_weakening.h": render("surface.h.j2", context),
        f"{prefix}_weakening_vectors.h": render(
            "surface_vectors.h.j2", context | {"vectors": [list(v) for v in vectors]}
        ),
    }
    return {name: text.encode("ascii") for name, text in texts.items()}
