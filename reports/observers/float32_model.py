"""Float32 models of the emitted observers and sequences to try them: same steps,
in the numbers of the C code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.observers.parts import ObserverMethod
from dqforge.optimizer.observers.reduced_order_step import (
    ReducedOrderGains,
    start,
    step,
)
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.c_code.harness import wrap
from dqforge.reports.plain_data import shortest

if TYPE_CHECKING:
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.optimizer.estimators import Tracker
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.reports.plain_data import PlainData


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
    """Gains as plain data of float32 values and whole numbers, which `gains_from` reads back."""
    plain: dict[str, Any] = {}
    hints = get_type_hints(type(gains))
    for field in fields(gains):
        value = getattr(gains, field.name)
        if is_dataclass(value):
            plain[field.name] = plain_gains_of(value)
        elif hints[field.name] is int:
            plain[field.name] = value
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
        elif hint is int:
            values[field.name] = _whole(value)
        else:
            if Ellipsis not in hint.__args__ and len(value) != len(hint.__args__):
                raise ValueError
            values[field.name] = tuple(_finite(item) for item in value)
    return kind(**values)


def _whole(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 1 << 32:
        raise ValueError
    return value


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError
    return float(value)


# The emitted speed observer: its gains as plain data, its model, and sequences to try it.


def plain_speed_observer(
    machine: Machine, observer: ReducedOrderObserver | None
) -> PlainData | None:
    """Gains as plain data of float32 values; None where there is no observer."""
    return (
        None
        if observer is None
        else {"gains": plain_gains_of(ReducedOrderGains.of(machine, observer))}
    )


def speed_observer_from(plain: Mapping[str, Any]) -> ReducedOrderGains:
    """Read gains back.

    Raises:
        InputError: The data are not what `plain_speed_observer` makes.
    """
    message = "speed_observer_header is not what dqforge writes; run the design again"
    if not isinstance(plain.get("gains"), dict):
        raise InputError(message)
    try:
        found = gains_from(ReducedOrderGains, plain["gains"])
    except InputError as error:
        raise InputError(message) from error
    assert isinstance(found, ReducedOrderGains)
    return found


def observed_speeds(
    gains: ReducedOrderGains,
    v: tuple[SingleArray, SingleArray], i: tuple[SingleArray, SingleArray],
    theta_e: SingleArray, first: tuple[SingleArray, SingleArray],
) -> SingleArray:  # fmt: skip
    """What the C functions find over N sequences.

    Args:
        gains: Those of the header.
        v, i: Voltages in V over the periods that end at the samples, and currents in A, alpha and
            beta, shape (N, steps).
        theta_e: Electrical angle at the samples in rad, shape (N, steps).
        first: Angle in rad and electrical speed in rad/s at the start, shape (N,).

    Returns:
        Mechanical and electrical speed in rad/s, float32, shape (N, steps, 2).
    """
    own = cast(gains, SINGLE)
    found = np.empty((*theta_e.shape, 2), dtype=np.float32)
    state = start(wrap(first[0]), first[1])
    for k in range(theta_e.shape[1]):
        v_k, i_k = ((pair[0][:, k].copy(), pair[1][:, k].copy()) for pair in (v, i))
        state = step(own, state, v_k, i_k, SINGLE, theta_e[:, k].copy())
        found[:, k, 0], found[:, k, 1] = state.scalars[1], state.omega_e
    return found


def speed_observer_inputs(gains: ReducedOrderGains, count: int, seed: int) -> SingleArray:
    """Rows (start flag, angle, speed, v_alpha, v_beta, i_alpha, i_beta, angle), shape (rows, 8),
    100 to a sequence.

    Voltages, currents and angles turn at any speed to beyond half a turn per sample,
    with any amplitude and noise.
    """
    generator = np.random.default_rng(seed)
    sequences = max(1, count // _LENGTH)
    speed = (
        generator.uniform(-2.0, 2.0, sequences)
        / gains.half_t_s
        * 10.0 ** generator.uniform(-3.0, 0.0, sequences)
    )
    theta = generator.uniform(-np.pi, np.pi, sequences)
    angles = theta[:, None] + 2.0 * speed[:, None] * gains.half_t_s * np.arange(_LENGTH)
    rows = np.zeros((sequences, _LENGTH, 8))
    rows[:, 0, 0] = 1.0
    rows[:, 0, 1] = theta * generator.choice([1.0, 3.0], sequences)
    rows[:, 0, 2] = speed * generator.choice([0.0, 0.5, 1.0, -1.0], sequences)
    size = 10.0 ** generator.uniform(-2.0, 3.0, (2, sequences, 1))
    for column, shift in ((3, 1.6), (4, 0.03), (5, 1.5), (6, -0.1)):
        noise = 0.05 * generator.standard_normal(angles.shape)
        rows[:, :, column] = size[(column - 3) // 2] * (np.cos(angles + shift) + noise)
    wrapped = np.angle(np.exp(1j * angles))
    rows[:, :, 7] = np.where(np.arange(sequences)[:, None] % 2 == 0, wrapped, angles)
    return np.ascontiguousarray(rows.reshape(-1, 8).astype(np.float32))


def speed_observer_outputs(gains: ReducedOrderGains, inputs: SingleArray) -> SingleArray:
    """What the compiled observer must return for the rows of `speed_observer_inputs`, shape (rows,
    2).
    """
    rows = inputs.reshape(-1, _LENGTH, 8)
    v, i = (rows[:, :, 3], rows[:, :, 4]), (rows[:, :, 5], rows[:, :, 6])
    with np.errstate(
        all="ignore"
    ):  # rough sequences may leave the range of single precision, as in C
        found = observed_speeds(
            gains, v, i, rows[:, :, 7], (rows[:, 0, 1].copy(), rows[:, 0, 2].copy())
        )
    return found.reshape(-1, 2)


# Trackers of the position in single precision, and sequences to try them: same steps, in the
# numbers of the C code.


@dataclass(frozen=True, slots=True)
class EmittedTracker:
    """What verification needs: the tracker and its gains (of the type ``tracker.gains``)."""

    tracker: Tracker
    gains: Any


def tracker_inputs(found: EmittedTracker, count: int, seed: int) -> SingleArray:
    """Rows (start flag, angle, speed, v_alpha, v_beta, i_alpha, i_beta, further signals), in
    sequences of 100 samples.

    Signals turn at any speed, with any amplitude and rough noise; some samples are no numbers.
    """
    generator = np.random.default_rng(seed)
    sequences, further = max(1, count // _LENGTH), len(found.tracker.hears)
    t_s = float(found.gains.t_s)
    turning = generator.choice([0.0, 0.01, 0.9], (sequences, 1))
    speed = generator.uniform(-1.0, 1.0, (sequences, 1)) * turning / t_s
    theta = generator.uniform(-np.pi, np.pi, (sequences, 1))
    angles = theta + speed * t_s * np.arange(_LENGTH)
    rows = np.zeros((sequences, _LENGTH, 7 + further))
    rows[:, 0, 0] = 1.0
    rows[:, 0, 1] = theta[:, 0] + generator.choice([0.0, 1.0, 4.0], sequences)
    rows[:, 0, 2] = speed[:, 0] * generator.choice([0.0, 0.5, 1.0, -1.0], sequences)
    size = 10.0 ** generator.uniform(-2.0, 3.0, (sequences, 1))
    for column in range(3, 7 + further):
        shift = 1.6 * (column % 2)
        noise = 0.05 * generator.standard_normal(angles.shape)
        rows[:, :, column] = size * (np.cos(angles + shift) + noise)
    bad = generator.random((sequences, _LENGTH, 4 + further)) < 0.002
    rows[:, :, 3:] = np.where(bad, generator.choice([np.nan, np.inf], bad.shape), rows[:, :, 3:])
    return np.ascontiguousarray(rows.reshape(-1, 7 + further).astype(np.float32))


def tracker_outputs(found: EmittedTracker, inputs: SingleArray) -> SingleArray:
    """What the compiled tracker must return for the rows of `tracker_inputs`: angle, speed, and of
    one that injects the voltage that it asks for and the current that it hands on.
    """
    tracker, own = found.tracker, cast(found.gains, SINGLE)
    rows = inputs.reshape(-1, _LENGTH, inputs.shape[1])
    state: Any = tracker.start(own, wrap(rows[:, 0, 1].copy()), rows[:, 0, 2].copy())
    answers = np.empty((*rows.shape[:2], 6 if tracker.injects else 2), dtype=np.float32)
    with np.errstate(all="ignore"):  # rough sequences may leave the range of single precision
        for k in range(_LENGTH):
            v_alpha, v_beta, i_alpha, i_beta, *heard = (
                np.ascontiguousarray(rows[:, k, column]) for column in range(3, rows.shape[2])
            )
            state = tracker.step(
                own, state, (v_alpha, v_beta), (i_alpha, i_beta), tuple(heard), SINGLE
            )
            answers[:, k, 0], answers[:, k, 1] = state.theta_e, state.omega_e
            if tracker.injects:
                for n, value in enumerate((*state.added, *state.current)):
                    answers[:, k, 2 + n] = value
    return answers.reshape(-1, answers.shape[2])
