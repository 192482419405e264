"""Float32 models of the emitted observers and sequences to try them: same steps,
in the numbers of the C code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.observers.parts import ObserverMethod
from dqforge.optimizer.step_arithmetic import cast
from dqforge.reports.c_code.harness import SINGLE, wrap
from dqforge.reports.plain_data import shortest

_LENGTH = 100


def observer_inputs(method: ObserverMethod, gains: Any, count: int, seed: int) -> SingleArray:
    """Rows (start flag, angle, speed, v_alpha, v_beta, i_alpha, i_beta), shape (rows, 7), in
    sequences of 100 samples.

    Voltages and currents turn at any speed up to beyond the range, with any amplitude and rough
    noise; the first estimates are right, wrong, or without any speed.
    """
    generator = np.random.default_rng(seed)
    sequences = max(1, count // _LENGTH)
    t_s, flux = method.scale(gains)
    speed = (
        generator.uniform(-0.9, 0.9, sequences)
        / t_s
        * np.where(np.arange(sequences) % 3 == 0, 0.05, 1.0)
    )
    theta = generator.uniform(-np.pi, np.pi, sequences)
    angles = theta[:, None] + speed[:, None] * t_s * np.arange(_LENGTH)
    scale = 10.0 ** generator.uniform(-2.0, 2.0, sequences)[:, None]
    rows = np.zeros((sequences, _LENGTH, 7))
    rows[:, 0, 0] = 1.0
    rows[:, 0, 1] = theta + np.where(
        np.arange(sequences) % 2 == 0, 0.0, generator.uniform(-4.0, 4.0, sequences)
    )
    rows[:, 0, 2] = speed * generator.choice([0.0, 0.5, 1.0, 1.2, -1.0], sequences)
    voltage = np.abs(speed)[:, None] * flux + 0.1 * scale
    for column, size, shift in (
        (3, voltage, 1.6),
        (4, voltage, 0.03),
        (5, scale, 1.5),
        (6, scale, -0.1),
    ):
        noise = 0.05 * size * generator.standard_normal(angles.shape)
        rows[:, :, column] = size * np.cos(angles + shift) + noise
    return np.ascontiguousarray(rows.reshape(-1, 7).astype(np.float32))


def observer_outputs(method: ObserverMethod, gains: Any, inputs: SingleArray) -> SingleArray:
    """What the compiled observer must return for the rows of `observer_inputs`: angle and speed,
    shape (rows, 2).
    """
    own = cast(gains, SINGLE)
    rows = inputs.reshape(-1, _LENGTH, 7)
    state = method.start(wrap(rows[:, 0, 1].copy()), rows[:, 0, 2].copy())
    found = np.empty((*rows.shape[:2], 2), dtype=np.float32)
    with np.errstate(
        all="ignore"
    ):  # rough sequences may leave the range of single precision, as in C
        for k in range(_LENGTH):
            v_alpha, v_beta, i_alpha, i_beta = (
                rows[:, k, column].copy() for column in (3, 4, 5, 6)
            )
            state = method.step(own, state, (v_alpha, v_beta), (i_alpha, i_beta), SINGLE)
            found[:, k, 0], found[:, k, 1] = state.theta_e, state.omega_e
    return found.reshape(-1, 2)


def plain_gains_of(gains: Any) -> dict[str, Any]:
    """Gains as plain data of float32 values, which `gains_from` reads back."""
    plain: dict[str, Any] = {}
    for field in fields(gains):
        value = getattr(gains, field.name)
        if is_dataclass(value):
            plain[field.name] = plain_gains_of(value)
        elif isinstance(value, tuple):
            plain[field.name] = [shortest(np.float32(item)) for item in value]
        else:
            plain[field.name] = shortest(np.float32(value))
    return plain


def gains_from(kind: type[Any], plain: Mapping[str, Any]) -> Any:
    """Read gains of a dataclass back.

    Raises:
        InputError: The data are not what `plain_gains_of` makes.
    """
    try:
        return _gains_from(kind, plain)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            "observer_header is not what dqforge writes; run the design again"
        ) from error


def _gains_from(kind: type[Any], plain: Mapping[str, Any]) -> Any:
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for field in fields(kind):
        value, hint = plain[field.name], hints[field.name]
        if is_dataclass(hint):
            values[field.name] = _gains_from(hint, value)  # type: ignore[arg-type]
        elif hint is float:
            values[field.name] = _finite(value)
        else:
            if Ellipsis not in hint.__args__ and len(value) != len(hint.__args__):
                raise ValueError
            values[field.name] = tuple(_finite(item) for item in value)
    return kind(**values)


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError
    return float(value)
