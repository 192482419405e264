"""The current reference as plain data: what the header template prints and what `result.json` keeps.

Every number is a float32 value written as a Python float, so that the shortest decimal of either reads back the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.current_reference import (
    ClosedForm,
    CurrentReference,
    Form,
    Polynomials,
    Proportional,
    ReluctanceClosedForm,
    TorqueExact,
)
from dqforge.optimizer.single_precision import SingleArray, SinglePolynomial, multiply_add

PlainData = dict[str, Any]


def shortest(value: np.float32) -> float:
    """The double whose shortest decimal is that of the float: 0.1 for float32(0.1)."""
    return float(str(value))


def _segments(polynomial: SinglePolynomial) -> list[PlainData]:
    return [
        {"start": shortest(start), "coefficients": [shortest(c) for c in row]}
        for start, row in zip(polynomial.starts, polynomial.coefficients, strict=True)
    ]


def to_plain(reference: CurrentReference) -> PlainData:
    """Describe a reference by its form's name and its constants."""
    plain: PlainData = {"torque_max": shortest(reference.torque_max)}
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
            plain |= {"form": "closed-form", "q": _segments(q), "base": shortest(base), "sign": sign}
        case ReluctanceClosedForm(gain, sign):
            plain |= {"form": "reluctance", "gain": shortest(gain), "sign": sign}
    return plain


def _number(plain: Mapping[str, Any], key: str) -> np.float32:
    value = plain.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"reference.{key} must be a finite number, got {value!r}; run the design again")
    return np.float32(value)


def _is_polynomial(starts: SingleArray, coefficients: SingleArray) -> bool:
    """Whether arrays read from a file are a piecewise polynomial: finite, ascending from 0, at least degree 1."""
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


def from_plain(plain: Mapping[str, Any]) -> CurrentReference:
    """Read a reference back.

    Raises
    ------
    InputError
        The data are not what `to_plain` makes; it names the entry.
    """
    sign = 1 if plain.get("sign", 1) == 1 else -1
    form: Form
    match plain.get("form"):
        case "proportional":
            form = Proportional(_number(plain, "gain"))
        case "polynomial":
            form = Polynomials(_polynomial(plain, "d"), _polynomial(plain, "q"))
        case "torque-exact":
            form = TorqueExact(_polynomial(plain, "d"), _number(plain, "magnet"), _number(plain, "slope"))
        case "closed-form":
            form = ClosedForm(_polynomial(plain, "q"), _number(plain, "base"), sign)
        case "reluctance":
            form = ReluctanceClosedForm(_number(plain, "gain"), sign)
        case other:
            raise InputError(f"reference.form {other!r} is unknown; run the design again")
    return CurrentReference(form, _number(plain, "torque_max"))


def ladders(plain: PlainData) -> list[PlainData]:
    """Branch ladders of the evaluator: one for both axes where they share their breakpoints, else one per axis.

    Each holds its segments, and what they give at the end of the domain and without torque.
    """
    axes = [axis for axis in ("d", "q") if axis in plain]
    starts = {axis: tuple(segment["start"] for segment in plain[axis]) for axis in axes}
    groups = [axes] if len(set(starts.values())) == 1 else [[axis] for axis in axes]
    return [_ladder(plain, group) for group in groups] if axes else []


def _ladder(plain: PlainData, axes: Sequence[str]) -> PlainData:
    form = from_plain(plain).form
    ends = np.array([plain["torque_max"], 0.0], dtype=np.float32)
    values = {f"i_{axis}": getattr(form, axis).evaluate(ends, multiply_add) for axis in axes}
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
