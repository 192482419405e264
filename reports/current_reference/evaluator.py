"""What the header says of the current reference, and the test vectors beside it,
as plain data for the templates.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.names import Strategy
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import (
    Emitted,
    FloatReference,
    Reference,
    SignedReference,
)
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.curves.integer_polynomial import CodeArray
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.current_reference.data_text import data_lines
from dqforge.reports.current_reference.plain import ladders
from dqforge.reports.pages.certificate_text import header_lines
from dqforge.reports.pages.labels import operation_text
from dqforge.reports.plain_data import PlainData, shortest

_VECTOR_SEED = 20_260_501  # Seed of the random test vectors; any fixed number does.

_FORM_TEXT = {
    "proportional": ("i_d = 0 and i_q proportional to the torque (exact)",),
    "polynomial": ("i_d and i_q are polynomials of the torque",),
    "even-odd": (
        (
            "i_d and i_q are polynomials of the torque; i_d has no linear term, i_q no square and "
            "one degree more;"
        ),
        "i_q is fitted to the torque that it makes together with this i_d",
    ),
    "torque-exact": (
        "i_d is a polynomial of the torque; i_q is the torque over (magnet + slope i_d),",
        "so the torque has no error but rounding",
    ),
    "closed-form": (
        "i_q is a polynomial of the torque; i_d follows from it by the MTPA locus,",
        "so the current lies on the optimum locus",
    ),
    "reluctance": ("i_q is a square root of the torque and |i_d| = |i_q| (exact)",),
}


def _fixed_ladders(plain: PlainData, saturates: dict[str, bool]) -> list[list[PlainData]]:
    """Branch ladders in fixed point: one for both axes where they share their breakpoints,
    else one per axis.
    """
    axes = [axis for axis in ("d", "q") if plain.get(axis) is not None]
    starts = {axis: tuple(segment["start"] for segment in plain[axis]) for axis in axes}
    groups = [axes] if len(set(starts.values())) == 1 else [[axis] for axis in axes]
    found = []
    for group in groups:
        edges = starts[group[0]]
        found.append(
            [
                {
                    "start": start,
                    "end": edges[index + 1] if index + 1 < len(edges) else plain["torque_max"],
                    "polynomials": [(axis, plain[axis][index], saturates[axis]) for axis in group],
                }
                for index, start in enumerate(edges)
            ]
        )
    return found


def _arithmetic(reference: Reference) -> str:
    if isinstance(reference, FixedReference):
        return f"integers as emitted{', all codes of the torque' if reference.width <= 16 else ''}"
    return "single precision, with and without fused multiply-add"


def error_text(solution: Solution) -> list[str]:
    """What the current reference errs by, as lines of at most 110 characters."""
    return _error_lines(solution.fit, solution.certificate, solution.design.strategy)


def _error_lines(
    fit: ReferenceFit, certificate: Certificate | None, strategy: Strategy
) -> list[str]:
    errors = fit.errors
    i_d, i_q, torque, loss = (
        rounded_up(value) for value in (errors.i_d, errors.i_q, errors.torque, errors.loss)
    )
    voltage = errors.voltage_excess
    over = (
        []
        if voltage is None
        else [f"phase voltage at most {rounded_up(100.0 * voltage)} % above its limit."]
    )
    torque_percent, loss_percent = (
        rounded_up(100.0 * v) for v in (errors.torque_relative, errors.loss_relative)
    )
    if certificate is not None:
        return [
            *header_lines(certificate, strategy),
            f"Largest errors found in {errors.samples} evaluations ({_arithmetic(fit.reference)}):",
            f"i_d {i_d} A, i_q {i_q} A, torque {torque} N m, copper loss {loss} W.",
        ]
    return [
        f"Largest errors found in {errors.samples} evaluations ({_arithmetic(fit.reference)};",
        "sampled, not proven):",
        f"i_d {i_d} A, i_q {i_q} A against the exact {strategy} currents;",
        f"torque {torque} N m ({torque_percent} % of the largest torque);",
        f"copper loss {loss} W above the least ({loss_percent} % from 5 % torque up).",
        *over,
    ]


def _saturates(reference: Reference) -> dict[str, bool]:
    """Which polynomials of a fixed-point reference need saturation."""
    if not isinstance(reference, FixedReference):
        return {}
    return {
        axis: p.saturates() for axis, p in (("d", reference.d), ("q", reference.q)) if p is not None
    }


def _argument_text(reference: Emitted) -> list[str]:
    """What goes in and comes out, in its units."""
    if isinstance(reference, SignedReference):
        return [
            (
                "torque_Nm: torque in N m, clamped to -TORQUE_MAX_NEGATIVE_NM to TORQUE_MAX; "
                "i_d_A, i_q_A: currents in A"
            ),
            (
                "(peak). The halves of the flux map are kept: each sign of the torque has its own "
                "polynomials, and what"
            ),
            "follows holds for positive torques. Not-a-number gives the reference of zero torque.",
        ]
    if not isinstance(reference, FixedReference):
        return [
            (
                "torque_Nm: torque in N m, clamped to +-TORQUE_MAX; i_d_A, i_q_A: currents in A "
                "(peak)."
            ),
            (
                "i_d is even and i_q odd in the torque; not-a-number gives the reference of zero "
                "torque."
            ),
        ]
    name, one = reference.format.upper(), f"2^{reference.width - 1}"
    saturated = any(_saturates(reference).values())
    return [
        f"torque: {one} codes are BASE_TORQUE_NM, clamped to +-TORQUE_MAX_{name};",
        (
            f"i_d, i_q: {one} codes are BASE_CURRENT_A "
            f"(peak){', saturated to the largest code' if saturated else ''}."
        ),
        (
            "i_d is even and i_q odd in the torque. Each step of Horner's rule has its own scale; "
            "its constant holds"
        ),
        "half of the last place that the shift leaves, so that every step rounds to nearest.",
    ]


def reference_context(solution: Solution, plain: PlainData) -> PlainData:
    """Ladders, comment and constants of the evaluator for the header's template."""
    fit, where = solution.fit, operation_text(solution.fit.speed)
    below = plain.get("negative")
    shape = (
        f"{fit.settings.method}, degree {fit.settings.degree}, {fit.settings.segments} segment(s) "
        f"over 0 to {fit.torque_max:.6g} N m;"
    )
    is_float = plain["format"] == "float32"
    has_polynomials = fit.d is not None or fit.q is not None
    base_squared = (
        {"base_squared": shortest(np.float32(plain["base"]) * np.float32(plain["base"]))}
        if "base" in plain
        else {}
    )
    return (
        plain
        | base_squared
        | {
            **_fixed_context(fit.reference),
            "uses_sqrt": plain["form"] in ("closed-form", "reluctance"),
            "ladders": ladders(plain)
            if is_float
            else _fixed_ladders(plain, _saturates(fit.reference)),
            "below": None
            if below is None
            else below | {"ladders": ladders(below), "uses_sqrt": False},
            "comment": [
                *_argument_text(solution.reference),
                (
                    f"Strategy {solution.design.strategy}{f' at {where}' if where else ''}; form "
                    f"{fit.form}:"
                ),
                *_FORM_TEXT[fit.form],
                *([shape] if has_polynomials else []),
                *error_text(solution),
                *data_lines(solution.data, fit.torque_max),
                *_negative_text(solution),
            ],
        }
    )


def _negative_text(solution: Solution) -> list[str]:
    """What holds for negative torques where they have a reference of their own."""
    half = solution.negative
    if half is None:
        return []
    return [
        (
            f"Negative torques, 0 to -{half.fit.torque_max:.6g} N m, by the other half of the flux "
            "map:"
        ),
        *_error_lines(half.fit, half.certificate, solution.design.strategy),
    ]


def _fixed_context(reference: Reference) -> PlainData:
    """What only the templates of fixed point ask for."""
    if not isinstance(reference, FixedReference):
        return {}
    return {
        "width": reference.width,
        "largest": reference.q.largest,
        "has_d": reference.d is not None,
    }


def vectors_template(reference: Emitted) -> str:
    """Template of the test vectors."""
    return (
        "current_reference/fixed_vectors.h.j2"
        if isinstance(reference, FixedReference)
        else "current_reference/vectors.h.j2"
    )


def vector_codes(reference: FixedReference, count: int) -> CodeArray:
    """Codes of the test vectors: the ends of the type and of the domain, breakpoints, both signs,
    random ones.
    """
    most = 2 ** (reference.width - 1)
    edges = [
        start + offset for start in (*reference.starts, reference.end) for offset in (-1, 0, 1)
    ]
    even = np.linspace(0, reference.end, 33).astype(np.int64)
    special = np.unique(np.clip(np.concatenate([[0, 1, most - 1, most], edges, even]), 0, most))
    generator = np.random.default_rng(_VECTOR_SEED)
    random = generator.integers(-most, most, max(count - 2 * special.size, 0))
    return np.concatenate([np.minimum(special, most - 1), -special, random]).astype(np.int64)


def vector_torques(reference: FloatReference, count: int) -> SingleArray:
    """Float32 torques of the test vectors: special values, breakpoints and neighbours, both signs,
    random ones.
    """
    end = np.float32(reference.torque_max)
    above = np.nextafter(end, np.float32(np.inf))
    tiny = np.float32(1e-45)
    special = np.array(
        [0.0, -0.0, np.nan, np.inf, -np.inf, tiny, -tiny, 1e-38, end, -end, above, 1e30],
        dtype=np.float32,
    )
    edges = reference.samples(9)
    generator = np.random.default_rng(_VECTOR_SEED)
    rest = max(count - special.size - 2 * edges.size, 0)
    random = (generator.uniform(-1.05, 1.05, rest) * float(end)).astype(np.float32)
    return np.concatenate([special, edges, -edges, random])


def vectors_context(solution: Solution) -> PlainData:
    """Test vectors beside the names that their header needs."""
    design, reference = solution.design, solution.reference
    context: PlainData = {}
    if isinstance(reference, FixedReference):
        inputs, results = fixed_vectors(reference, design.export.vectors)
        rows = np.concatenate([inputs[:, np.newaxis], results], axis=1).tolist()
        context = {"reference": {"width": reference.width, "format": reference.format}}
    else:
        torque = vector_torques(reference, design.export.vectors)
        rows = list(zip(torque, *reference.currents(torque), strict=True))
    return context | {
        **title(design),
        "vectors": rows,
    }


def fixed_vectors(reference: FixedReference, count: int) -> tuple[CodeArray, CodeArray]:
    """Codes of the torque, shape (N,), and what the model makes of them, shape (N, 2)."""
    codes = vector_codes(reference, count)
    return codes, np.stack(reference.codes(codes), axis=1)
