"""The C header of field-weakening references and its test vectors, as plain data and as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.curves.single_precision import SingleArray, SinglePolynomial
from dqforge.optimizer.field_weakening.drop_reference import STEPS, DropReference
from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.optimizer.field_weakening.form import SingleSurface, WeakeningReference
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.read_back import single_from, singles_from
from dqforge.reports.c_code.title import title
from dqforge.reports.field_weakening.text import error_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

_SEED = 20_260_611


_MOST_SEGMENTS, _MOST_TERMS = 8, 16


_NUMBERS = "flux_min", "flux_max", "torque_mid", "excess_mid"


_CURVES = "limit", "d", "q", "flux"


_SURFACES = "surface_d", "surface_q"


_DROPS = "torque_max", "per_torque", "square", "reserve"


_FAULT = InputError("weakening_header is not what dqforge writes; run the design again")


def plain_weakening(step: DropReference) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    reference = step.surface
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
    plain["drop"] = {
        **{name: shortest(getattr(step, name)) for name in _DROPS},
        "near": None if step.near is None else [shortest(value) for value in step.near],
        "passes": step.passes,
    }
    return plain


def weakening_from(plain: Mapping[str, Any]) -> DropReference:
    """Read an evaluator back.

    Raises:
        InputError: The data are not what `plain_weakening` makes.
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
        step = _drop(found, plain["drop"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    alike = all(np.array_equal(curve.starts, found.d.starts) for curve in (found.q, found.flux))
    if not alike or len(found.surface_d.rows) != len(found.surface_q.rows):
        raise _FAULT
    return step


def _drop(surface: WeakeningReference, plain: Any) -> DropReference:
    near, passes = plain["near"], plain["passes"]
    if isinstance(passes, bool) or passes not in (1, 2) or (near is not None and len(near) != 2):
        raise ValueError
    torque_max, per_torque, square, reserve = (single_from(plain[name]) for name in _DROPS)
    line = None if near is None else (single_from(near[0]), single_from(near[1]))
    return DropReference(surface, torque_max, per_torque, square, reserve, line, passes)


def _curve(rows: Any) -> SinglePolynomial:
    starts = singles_from([row["start"] for row in rows], _MOST_TERMS)
    coefficients = np.stack([singles_from(row["coefficients"], _MOST_TERMS) for row in rows])
    ascending = (
        starts[0] == 0.0 and bool(np.all(np.diff(starts) > 0.0)) and starts.size <= _MOST_SEGMENTS
    )
    if coefficients.shape[1] < 2 or not ascending:
        raise ValueError
    return SinglePolynomial(starts, coefficients)


def _surface(rows: Any) -> SingleSurface:
    if not 1 <= len(rows) <= _MOST_TERMS:
        raise ValueError
    return SingleSurface(tuple(singles_from(row, _MOST_TERMS) for row in rows))


def weakening_inputs(step: DropReference, count: int, seed: int, patterns: int = 0) -> SingleArray:
    """Inputs of the evaluator, shape (count + patterns + 1000, 3): torque in N m, voltage in V,
    speed in rad/s.

    All over the domain and beyond it, ``patterns`` of any bits, and every
    triple of ten special values.
    """
    generator = np.random.default_rng(seed)
    reference, most = step.surface, float(step.torque_max)
    low, high = float(reference.flux_min), float(reference.flux_max)
    volts = max(4.0 * float(np.sqrt(step.reserve)), 1.0) * generator.uniform(0.5, 4.0, count)
    whole = generator.uniform(
        0.9 * low, high + 1.5 * np.sqrt(float(step.reserve)) * low / np.min(volts), count
    )
    omega = volts / whole * generator.choice([-1.0, 1.0], count)
    torque = generator.uniform(-1.1, 1.1, count) * most
    inside = np.stack([torque, volts, omega], axis=1).astype(np.float32)
    edges = [
        np.float32(value)
        for value in (0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, 1e30, most, -most, 1e3)
    ]
    special = np.stack(np.meshgrid(edges, edges, edges), axis=-1).reshape(-1, 3).astype(np.float32)
    bits = generator.integers(0, 2**32, (patterns, 3), dtype=np.uint32).view(np.float32)
    return np.ascontiguousarray(np.concatenate([inside, special, bits]))


def weakening_currents(step: DropReference, inputs: SingleArray) -> SingleArray:
    """What the compiled evaluator must return for inputs, shape (M, 2)."""
    return np.stack(step.currents(*(inputs[:, column].copy() for column in range(3))), axis=1)


def _ladder(variable: str, plain: PlainData, targets: Mapping[str, str]) -> PlainData:
    """Segments of curves on the same edges as the template prints them.

    ``targets`` maps C names to curves.
    """
    first = plain[next(iter(targets.values()))]
    ends = [row["start"] for row in first[1:]] + [None]
    return {
        "variable": variable,
        "segments": [
            {
                "start": row["start"],
                "end": end,
                "polynomials": [
                    (target, plain[name][place]["coefficients"]) for target, name in targets.items()
                ],
            }
            for place, (row, end) in enumerate(zip(first, ends, strict=True))
        ],
    }


def _comment(fit: WeakeningFit) -> list[str]:
    domain = fit.domain
    return [
        (
            "torque_Nm: torque in N m, either sign, held to what voltage, speed and current limit "
            "allow."
        ),
        (
            "v_max_V: largest phase-voltage amplitude in V, as the dc link gives it now; negative "
            "counts as 0."
        ),
        (
            "omega_e_rad_per_s: electrical speed in rad/s, either sign; motoring where its sign is "
            "that of the torque."
        ),
        (
            f"Made for {domain.v_max:.6g} V up to {domain.omega_e:.6g} rad/s, and from "
            f"{domain.voltages[0]:.6g} V up for speeds up to the largest"
        ),
        (
            "in proportion to the voltage; below that the resistance takes more of it, and the "
            "largest speed falls faster."
        ),
        (
            "Beyond it torque is given up first; then the field is weakened to FLUX_MIN and no "
            "further, which may break"
        ),
        "the voltage limit.",
        (
            "i_d_A, i_q_A: current references in A (peak). Not-a-number as torque gives no torque; "
            "as voltage or speed"
        ),
        "no torque at FLUX_MIN, which keeps the voltage limit up to the largest speed.",
        (
            f"The phase resistance is {domain.machine.r_s:.6g} Ohm in what follows: take its "
            "largest value, warm."
        ),
        "",
        *error_lines(fit),
        (
            f"{fit.step.coefficients} constants; on a Cortex-M4F below {fit.step.flash} bytes "
            "(estimate)."
        ),
    ]


def _context(design: Design, fit: WeakeningFit) -> PlainData:
    plain = plain_weakening(fit.step)
    rpm = fit.settings.omega_m * 30.0 / np.pi
    return {
        **title(design),
        "form": plain,
        "drop": plain["drop"],
        "trials": STEPS,
        "ladders": [
            _ladder("f", plain, {"limit": "limit"}),
            _ladder("t", plain, {"i_d": "d", "i_q": "q", "taken": "flux"}),
        ],
        "preamble": [
            (
                f"{design.machine.pole_pairs} pole pairs, {design.i_max:.6g} A (peak), up to "
                f"{rpm:.6g} rpm."
            ),
            (
                "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
                "errors hold either way."
            ),
        ],
        "comment": _comment(fit),
    }


def weakening_files(design: Design, fit: WeakeningFit) -> dict[str, bytes]:
    """Names and bytes of the header of field-weakening references and of its test vectors."""
    context, prefix = _context(design, fit), design.export.prefix
    inputs = weakening_inputs(fit.step, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs, weakening_currents(fit.step, inputs)], axis=1)
    texts = {
        f"{prefix}_weakening.h": render("field_weakening/surface.h.j2", context),
        f"{prefix}_weakening_vectors.h": render(
            "field_weakening/vectors.h.j2", context | {"vectors": [list(v) for v in vectors]}
        ),
    }
    return {name: text.encode("ascii") for name, text in texts.items()}


def weakening_programme(reference: DropReference) -> Programme:
    """The harness of a field-weakening header, with what its model answers."""
    half = SWEEP_POINTS // 2
    inputs = weakening_inputs(reference, half, SWEEP_SEED, patterns=half)
    results = weakening_currents(reference, inputs)
    return Programme(
        "field_weakening/harness.c.j2",
        inputs,
        results,
        name="current reference with field weakening",
    )
