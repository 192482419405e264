"""The emitted phase currents: as plain data, and what their C finds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.waveforms.firmware_fit import (
    PhaseHarmonics,
    PhasePolynomials,
    PhaseReference,
    PhaseTable,
    Weights,
    sample_angles,
)
from dqforge.reports.plain_data import PlainData, shortest

_LONGEST = 1 << 17


_MOST_HARMONICS = 200


_MOST_TERMS = 32


def plain_phase_reference(reference: PhaseReference) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    form = reference.form
    plain: PlainData = {"torque_max": shortest(reference.torque_max)}
    if isinstance(form, PhaseTable):
        return plain | {"form": "table", "table": _rows(form.entries)}
    if isinstance(form, PhasePolynomials):
        return plain | {
            "form": "polynomials",
            "stride": form.stride,
            "inverse": shortest(form.inverse),
            "cosine": _weights(form.cosine),
            "sine": _weights(form.sine),
        }
    return plain | {
        "form": "harmonics",
        "stride": form.stride,
        "cosine": _rows(form.cosine),
        "sine": _rows(form.sine),
    }


def _rows(values: SingleArray) -> list[list[float]]:
    return [[shortest(value) for value in row] for row in values]


def _weights(weights: Weights) -> list[list[list[float]]]:
    return [
        [[shortest(np.float32(value)) for value in weight] for weight in row] for row in weights
    ]


def _weights_from(rows: Any) -> Weights:
    """Weights as `_weights` writes them; ValueError where they are not float32 values or not
    finite.
    """
    found = tuple(
        tuple(tuple(float(np.float32(value)) for value in weight) for weight in row) for row in rows
    )
    values = np.array([value for row in found for weight in row for value in weight])
    if (
        not np.all(np.isfinite(values))
        or max(len(weight) for row in found for weight in row) > _MOST_TERMS
    ):
        raise ValueError
    return found


def _polynomials_from(plain: Mapping[str, Any]) -> PhasePolynomials:
    cosine, sine = _weights_from(plain["cosine"]), _weights_from(plain["sine"])
    stride, inverse = int(plain["stride"]), np.float32(plain["inverse"])
    sizes = {len(row) for row in (*cosine, *sine)}
    if (
        len(cosine) != len(sine)
        or len(cosine) not in (1, 3)
        or len(sizes) != 1
        or not np.isfinite(inverse)
    ):
        raise ValueError
    if stride not in (1, 2) or not 0 < sizes.pop() < _MOST_HARMONICS:
        raise ValueError
    return PhasePolynomials(cosine, sine, stride, inverse)


def phase_reference_from(plain: Mapping[str, Any]) -> PhaseReference:
    """Read an evaluator back.

    Raises:
        InputError: The data are not what `plain_phase_reference` makes.
    """
    fault = InputError("waveform.reference is not what dqforge writes; run the design again")
    try:
        torque_max = np.float32(plain["torque_max"])
        if plain["form"] == "table":
            entries = _array(plain["table"])
            if entries.shape[0] not in (1, 3) or not 24 < entries.shape[1] <= _LONGEST:
                raise fault
            return PhaseReference(PhaseTable(entries), torque_max)
        if plain["form"] == "polynomials":
            return PhaseReference(_polynomials_from(plain), torque_max)
        cosine, sine = _array(plain["cosine"]), _array(plain["sine"])
        stride = int(plain["stride"])
        count = cosine.shape[1]
        if (
            cosine.shape != sine.shape
            or cosine.shape[0] != 3
            or stride not in (1, 2)
            or not 0 < count < _MOST_HARMONICS
        ):
            raise fault
        return PhaseReference(PhaseHarmonics(cosine, sine, stride), torque_max)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise fault from error


def _array(rows: Any) -> SingleArray:
    values = np.array(rows, dtype=np.float32)
    if values.ndim != 2 or not np.all(np.isfinite(values)):
        raise ValueError
    return values


def waveform_inputs(reference: PhaseReference, count: int, seed: int) -> SingleArray:
    """Inputs of the evaluator, shape (count, 2 or 3): torques of both signs and beyond,
    special values, any angles.
    """
    generator = np.random.default_rng(seed)
    end = reference.torque_max
    torque = (generator.uniform(-1.1, 1.1, count) * float(end)).astype(np.float32)
    special = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, end, -end], dtype=np.float32)
    # Special torques meet ordinary angles behind the special angles.
    torque[16 : 16 + special.size] = special
    return np.ascontiguousarray(
        np.stack([torque, *sample_angles(reference.form, count, seed + 1)], axis=1)
    )


def model_currents(reference: PhaseReference, inputs: SingleArray) -> SingleArray:
    """What the compiled evaluator must return for inputs, shape (M, 3)."""
    columns = tuple(np.ascontiguousarray(column) for column in inputs.T)
    return np.ascontiguousarray(reference.currents(columns[0], columns[1:]).T)
