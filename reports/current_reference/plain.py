"""The current reference as plain data: what the header template prints and
what `result.json` keeps.

Every number of a float form is a float32 value written as a Python float, so that the shortest
decimal of either reads back the same; fixed point has integers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.alternatives import Alternative
from dqforge.optimizer.current_reference.cheapest import Trial
from dqforge.optimizer.current_reference.data_use import COVERED, DataUse
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    CurrentReference,
    Emitted,
    Form,
    Polynomials,
    Proportional,
    Reference,
    ReluctanceClosedForm,
    SignedReference,
    TorqueExact,
)
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS, FixedReference
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.curves.single_precision import SingleArray, SinglePolynomial
from dqforge.optimizer.negative_torques import NegativeHalf
from dqforge.reports.current_reference.data_text import plain_data_use
from dqforge.reports.operating_points.plain import plain_curves, plain_speed
from dqforge.reports.pages.certificate_text import plain_certificate
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


def ladders(plain: PlainData) -> list[PlainData]:
    """Branch ladders of the evaluator: one for both axes where they share their breakpoints,
    else one per axis.

    Each holds its segments, and what they give at the end of the domain and without torque.
    """
    axes = [axis for axis in ("d", "q") if axis in plain]
    starts = {axis: tuple(segment["start"] for segment in plain[axis]) for axis in axes}
    groups = [axes] if len(set(starts.values())) == 1 else [[axis] for axis in axes]
    return [_ladder(plain, group) for group in groups] if axes else []


def _ladder(plain: PlainData, axes: Sequence[str]) -> PlainData:
    reference = _one_from_plain(plain)
    assert isinstance(reference, CurrentReference)
    form = reference.form
    ends = np.array([plain["torque_max"], 0.0], dtype=np.float32)
    values = {f"i_{axis}": getattr(form, axis).evaluate(ends) for axis in axes}
    edges = [segment["start"] for segment in plain[axes[0]]]
    return {
        "segments": [
            {
                "start": start,
                "end": edges[index + 1] if index + 1 < len(edges) else plain["torque_max"],
                "polynomials": [(f"i_{axis}", plain[axis][index]["coefficients"]) for axis in axes],
            }
            for index, start in enumerate(edges)
        ],
        "at_end": [(name, shortest(value[0])) for name, value in values.items()],
        "at_rest": [(name, shortest(value[1])) for name, value in values.items()],
    }


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
