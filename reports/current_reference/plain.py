"""The current reference as plain data: what the header template prints and
what `result.json` keeps.

Every number of a float form is a float32 value written as a Python float, so that the shortest
decimal of either reads back the same; fixed point has integers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.names import Strategy
from dqforge.machines.units.quantities import to_digits
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.fit import Alternative, ReferenceFit
from dqforge.optimizer.current_reference.forms import (
    FIXED_WIDTHS,
    ClosedForm,
    CurrentReference,
    Emitted,
    FixedReference,
    FloatReference,
    Form,
    Polynomials,
    Proportional,
    Reference,
    ReluctanceClosedForm,
    SignedReference,
    TorqueExact,
)
from dqforge.optimizer.current_reference.solve import COVERED, DataUse, Trial
from dqforge.optimizer.current_reference.torque_band import TorqueBand
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.curves.single_precision import (
    PiecewisePolynomial,
    SingleArray,
    SinglePolynomial,
)
from dqforge.optimizer.solution import NegativeHalf, Solution
from dqforge.optimizer.steps.integer_arithmetic import CodeArray
from dqforge.reports.c_code.harness import SWEEP_POINTS, SWEEP_SEED, Harness, Programme
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.operating_points.map_tables import plain_curves, plain_speed
from dqforge.reports.pages.html_text import operation_text
from dqforge.reports.pages.templating import header_lines, plain_certificate
from dqforge.reports.plain_data import PlainData, shortest


def _segments(polynomial: SinglePolynomial) -> list[PlainData]:
    return [
        {"start": shortest(start), "coefficients": [shortest(c) for c in row]}
        for start, row in zip(polynomial.starts, polynomial.coefficients, strict=True)
    ]


def _fixed_segments(polynomial: FixedPolynomial | None) -> list[PlainData] | None:
    if polynomial is None:
        return None
    return [
        {
            "start": segment.start,
            "leading": segment.leading,
            "steps": [list(step) for step in zip(segment.constants, segment.shifts, strict=True)],
        }
        for segment in polynomial.segments
    ]


def _fixed_plain(reference: FixedReference) -> PlainData:
    """Integers as they are, the full scales as doubles."""
    return {
        "format": reference.format,
        "form": "polynomial" if reference.d is not None else "proportional",
        "torque_max": reference.end,
        "torque_base": reference.torque_base,
        "current_base": reference.current_base,
        "d": _fixed_segments(reference.d),
        "q": _fixed_segments(reference.q),
    }


def to_plain(reference: Emitted) -> PlainData:
    """Describe a reference by its number format, its form's name and its constants.

    That of negative torques, where there is one, stands beside those of the
    positive ones under ``negative``.
    """
    if isinstance(reference, SignedReference):
        return to_plain(reference.positive) | {"negative": to_plain(reference.negative)}
    if isinstance(reference, FixedReference):
        return _fixed_plain(reference)
    plain: PlainData = {"format": "float32", "torque_max": shortest(reference.torque_max)}
    match reference.form:
        case Proportional(gain):
            plain |= {"form": "proportional", "gain": shortest(gain)}
        case Polynomials(d, q):
            plain |= {"form": "polynomial", "d": _segments(d), "q": _segments(q)}
        case TorqueExact(d, magnet, slope):
            plain |= {
                "form": "torque-exact",
                "d": _segments(d),
                "magnet": shortest(magnet),
                "slope": shortest(slope),
            }
        case ClosedForm(q, base, sign):
            plain |= {
                "form": "closed-form",
                "q": _segments(q),
                "base": shortest(base),
                "sign": sign,
            }
        case ReluctanceClosedForm(gain, sign):
            plain |= {"form": "reluctance", "gain": shortest(gain), "sign": sign}
    return plain


def _number(plain: Mapping[str, Any], key: str) -> np.float32:
    value = plain.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(
            f"reference.{key} must be a finite number, got {value!r}; run the design again"
        )
    return np.float32(value)


def _is_polynomial(starts: SingleArray, coefficients: SingleArray) -> bool:
    """Whether arrays read from a file are a piecewise polynomial: finite, ascending from 0,
    at least degree 1.
    """
    shaped = starts.ndim == 1 and coefficients.ndim == 2 and coefficients.shape[1] >= 2
    finite = shaped and bool(np.all(np.isfinite(starts)) and np.all(np.isfinite(coefficients)))
    return finite and starts[0] == 0.0 and bool(np.all(np.diff(starts) > 0.0))


def _polynomial(plain: Mapping[str, Any], key: str) -> SinglePolynomial:
    fault = f"reference.{key} is not a list of segments with coefficients; run the design again"
    try:
        starts = np.array([row["start"] for row in plain[key]], dtype=np.float32)
        coefficients = np.array([row["coefficients"] for row in plain[key]], dtype=np.float32)
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise InputError(fault) from error
    if not _is_polynomial(starts, coefficients):
        raise InputError(fault)
    return SinglePolynomial(starts, coefficients)


def _integer(plain: Any) -> int:
    if isinstance(plain, bool) or not isinstance(plain, int):
        raise TypeError(plain)
    return plain


def _fixed_polynomial(plain: Mapping[str, Any], key: str, width: int, end: int) -> FixedPolynomial:
    fault = (
        f"reference.{key} is not a list of segments in integers that cannot overflow; run the "
        "design again"
    )
    try:
        segments = tuple(
            FixedSegment(
                _integer(row["start"]),
                _integer(row["leading"]),
                tuple(_integer(constant) for constant, _ in row["steps"]),
                tuple(_integer(shift) for _, shift in row["steps"]),
            )
            for row in plain[key]
        )
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(fault) from error
    starts = [segment.start for segment in segments]
    ascends = starts[:1] == [0] and all(
        a < b for a, b in zip(starts, [*starts[1:], end + 1], strict=True)
    )
    shifts = [shift for segment in segments for shift in segment.shifts]
    polynomial = FixedPolynomial(segments, width, end)
    if (
        not ascends
        or not shifts
        or not 0 <= min(shifts) <= max(shifts) < 2 * width
        or polynomial.overflows()
    ):
        raise InputError(fault)
    return polynomial


def _fixed_reference(plain: Mapping[str, Any], width: int) -> FixedReference:
    bases = [float(_number(plain, key)) for key in ("torque_base", "current_base")]
    end = plain.get("torque_max")
    if (
        min(bases) <= 0.0
        or isinstance(end, bool)
        or not isinstance(end, int)
        or not 0 < end < 2 ** (width - 1)
    ):
        raise InputError(
            "reference.torque_max, torque_base or current_base is out of range; run the design "
            "again"
        )
    d = None if plain.get("d") is None else _fixed_polynomial(plain, "d", width, end)
    # The bases are kept in double: they scale what is shown, not what the firmware computes.
    return FixedReference(
        d, _fixed_polynomial(plain, "q", width, end), plain["torque_base"], plain["current_base"]
    )


def from_plain(plain: Mapping[str, Any]) -> Emitted:
    """Read a reference back.

    Raises:
        InputError: The data are not what `to_plain` makes; it names the entry.
    """
    positive = _one_from_plain(plain)
    if "negative" not in plain:
        return positive
    negative = (
        _one_from_plain(plain["negative"]) if isinstance(plain["negative"], Mapping) else None
    )
    if not isinstance(positive, CurrentReference) or not isinstance(negative, CurrentReference):
        raise InputError("reference.negative is not a reference in float32; run the design again")
    return SignedReference(positive, negative)


def _one_from_plain(plain: Mapping[str, Any]) -> Reference:
    number_format = plain.get("format", "float32")
    if number_format in FIXED_WIDTHS:
        return _fixed_reference(plain, FIXED_WIDTHS[number_format])
    sign = 1 if plain.get("sign", 1) == 1 else -1
    form: Form
    match plain.get("form"):
        case "proportional":
            form = Proportional(_number(plain, "gain"))
        case "polynomial":
            form = Polynomials(_polynomial(plain, "d"), _polynomial(plain, "q"))
        case "torque-exact":
            form = TorqueExact(
                _polynomial(plain, "d"), _number(plain, "magnet"), _number(plain, "slope")
            )
        case "closed-form":
            form = ClosedForm(_polynomial(plain, "q"), _number(plain, "base"), sign)
        case "reluctance":
            form = ReluctanceClosedForm(_number(plain, "gain"), sign)
        case other:
            raise InputError(f"reference.form {other!r} is unknown; run the design again")
    return CurrentReference(form, _number(plain, "torque_max"))


def _plain_polynomial(polynomial: PiecewisePolynomial | None) -> PlainData | None:
    if polynomial is None:
        return None
    return {"edges_Nm": polynomial.edges, "coefficients_local": polynomial.coefficients}


def plain_fit(
    fit: ReferenceFit,
    rows: tuple[Alternative, ...],
    trials: tuple[Trial, ...] = (),
    certificate: Certificate | None = None,
    data: DataUse = COVERED,
) -> PlainData:
    """The fit in double, its emitted constants, its errors found and proven,
    and the alternatives with theirs.
    """
    return {
        "form": fit.form,
        "method": fit.settings.method,
        "degree": fit.settings.degree,
        "segments": fit.settings.segments,
        "breakpoints": "searched" if fit.settings.breakpoints is None else "given",
        "exact_at_zero": fit.settings.exact_at_zero,
        "continuous": fit.settings.continuous,
        "core": fit.settings.core,
        "holds_at": plain_speed(fit.speed),
        "torque_max_Nm": fit.torque_max,
        "d": _plain_polynomial(fit.d),
        "q": _plain_polynomial(fit.q),
        "reference": to_plain(fit.reference),
        "errors": asdict(fit.errors),
        "certificate": plain_certificate(certificate),
        **plain_data_use(data),
        "trials": [asdict(trial) for trial in trials],
        "alternatives": [{"label": row.label, "errors": asdict(row.errors)} for row in rows],
    }


def plain_negative(half: NegativeHalf | None) -> PlainData:
    """Currents and fit of negative torques, mirrored.

    Nothing where one reference serves both signs.
    """
    if half is None:
        return {}
    return {
        "mtpa_negative": plain_curves(half.curves),
        "fit_negative": plain_fit(half.fit, (), (), half.certificate),
    }


# What the header says of the current reference, and the test vectors beside it,
# as plain data for the templates.

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


def _arithmetic(reference: Reference) -> str:
    if isinstance(reference, FixedReference):
        return f"integers as emitted{', all codes of the torque' if reference.width <= 16 else ''}"
    return "single precision, with and without fused multiply-add"


def error_text(solution: Solution) -> list[str]:
    """What the current reference errs by, and the torque of a drive within its tolerances, as lines
    of at most 110 characters.
    """
    lines = _error_lines(solution.fit, solution.certificate, solution.design.strategy)
    band = solution.torque_band
    if band is None:
        return lines
    return [
        *lines,
        *wrap(f"On a machine within {within_text(band)}: torque {band_text(band)}.", 110),
    ]


def within_text(band: TorqueBand) -> str:
    """What the machine is within where the torque is within the band."""
    names = {part.name for part in band.parts}
    of_map = ["the 95 % interval of its flux map"] if "flux_map" in names else []
    others = ["control.tolerances"] if names - {"flux_map", "reference"} else []
    return " and ".join(others + of_map)


def band_text(band: TorqueBand) -> str:
    """The torque of a drive within its tolerances, in words."""
    low, high, together = (_percent(value) for value in (-band.low, band.high, band.independent))
    parts = ", ".join(f"{part.name} {_percent(part.size)} %" for part in band.parts)
    least = f"{low} % less to {high} % more than requested"
    if len(band.parts) == 1:
        return f"{least} ({parts})"
    return f"{least} ({parts}; {together} % together if independent)"


def _percent(share: float) -> str:
    """Two digits, rounded up."""
    return f"{to_digits(100.0 * share, 2, up=True):g}" if share > 0.0 else "0"


def plain_band(band: TorqueBand | None) -> PlainData | None:
    """The same as shares of the requested torque."""
    if band is None:
        return None
    return {
        "low": band.low,
        "high": band.high,
        "independent": band.independent,
        "parts": {part.name: [part.low, part.high] for part in band.parts},
    }


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
    """Comment and constants of the evaluator, for the template."""
    fit, where = solution.fit, operation_text(solution.fit.speed)
    shape = (
        f"{fit.settings.method}, degree {fit.settings.degree}, {fit.settings.segments} segment(s) "
        f"over 0 to {fit.torque_max:.6g} N m;"
    )
    has_polynomials = fit.d is not None or fit.q is not None
    return plain | {
        "uses_sqrt": plain["form"] in ("closed-form", "reluctance"),
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


def reference_harness(reference: Emitted) -> Harness:
    """What the main header does with a torque."""
    function, number, told = "current_reference", "float", "torque in N m; i_d and i_q in A"
    if isinstance(reference, FixedReference):
        function += f"_{reference.format}"
        number, told = f"int{reference.width}_t", "code of the torque; codes of i_d and i_q"
    return Harness("", told, (1, 2), (f"@_{function}(in[0], &out[0], &out[1]);",), number)


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


def vectors_of(solution: Solution) -> NDArray[Any]:
    """Inputs and results of the test vectors, shape (N, 3)."""
    design, reference = solution.design, solution.reference
    if isinstance(reference, FixedReference):
        inputs, results = fixed_vectors(reference, design.export.vectors)
        return np.concatenate([inputs[:, np.newaxis], results], axis=1)
    torque = vector_torques(reference, design.export.vectors)
    return np.stack([torque, *reference.currents(torque)], axis=1)


def fixed_vectors(reference: FixedReference, count: int) -> tuple[CodeArray, CodeArray]:
    """Codes of the torque, shape (N,), and what the model makes of them, shape (N, 2)."""
    codes = vector_codes(reference, count)
    return codes, np.stack(reference.codes(codes), axis=1)


# The harness of the current reference: inputs, and results of the model.


def sweep_torques(reference: FloatReference, count: int = SWEEP_POINTS) -> SingleArray:
    """Float32 torques beyond the test vectors: across the domain of both signs,
    and raw bit patterns of any kind.
    """
    generator = np.random.default_rng(SWEEP_SEED)
    across = (generator.uniform(-1.1, 1.1, count // 2) * float(reference.torque_max)).astype(
        np.float32
    )
    patterns = generator.integers(0, 2**32, count - across.size, dtype=np.uint32).view(np.float32)
    return np.concatenate([across, patterns])


def sweep_codes(reference: FixedReference, count: int = SWEEP_POINTS) -> CodeArray:
    """All codes of 16 bits, or so many random ones of 32 bits, half of them inside the domain."""
    most = 2 ** (reference.width - 1)
    if reference.width <= 16:
        return np.arange(-most, most)
    generator = np.random.default_rng(SWEEP_SEED)
    inside = generator.integers(-reference.end, reference.end + 1, count // 2)
    return np.concatenate([inside, generator.integers(-most, most, count - inside.size)])


def reference_programme(reference: Emitted, vectors: int) -> tuple[Programme, int]:
    """The harness of the current reference with its inputs, and how many
    of these are test vectors.
    """
    if isinstance(reference, FixedReference):
        chosen = vector_codes(reference, vectors)
        codes = np.concatenate([chosen, sweep_codes(reference)])
        number = np.dtype(f"i{reference.width // 8}")
        results = np.stack(reference.codes(codes), axis=1).astype(number)
        return Programme(reference_harness(reference), codes.astype(number), results), chosen.size
    special = vector_torques(reference, vectors)
    torque = np.concatenate([special, sweep_torques(reference)])
    results = np.stack(reference.currents(torque), axis=1)
    return Programme(reference_harness(reference), torque, results), special.size


# What a current reference owes to the ends of a flux map, in sentences.


def data_lines(data: DataUse, end: float) -> list[str]:
    """Sentences of at most 110 characters, none where the data cover a reference up to ``end`` N
    m.
    """
    lines = []
    if data.held is not None:
        lines.append(
            f"{_where(data.held, end)} the currents are held by the data: the flux map ends there,"
        )
        lines.append("currents of less loss may lie beyond it.")
    if data.extrapolated is not None:
        lines.append(
            f"{_where(data.extrapolated, end)} the currents lie beyond the flux map, which is "
            "extrapolated"
        )
        lines.append("along its tangents (flux_map.extrapolate: true): no data support them.")
    return lines


def _where(torques: tuple[float, float], end: float) -> str:
    low, high = torques
    start = "From zero torque" if low == 0.0 else f"From {low:.4g} N m"
    return f"{start} on" if high >= end * (1.0 - 1e-9) else f"{start} to {high:.4g} N m"


def plain_data_use(data: DataUse) -> PlainData:
    """Ranges of the torque as plain data."""
    return {"held_by_data_Nm": data.held, "extrapolated_Nm": data.extrapolated}
