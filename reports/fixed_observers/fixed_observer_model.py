"""Rows of integers through an observer in fixed point: states and inputs that reach the ends, and
what must come out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

import numpy as np

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_control.arithmetic import CodeArray, Integers
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FIXED_METHODS,
    FixedPositionObserver,
    observer_reaches,
)
from dqforge.optimizer.fixed_observers.kit import TOP, WIDTH, TrackedState, shown, widened
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.reports.control.fixed_model import gain_from, one_of, positive, whole

_LENGTH = 50


def input_names(observer: FixedPositionObserver) -> tuple[str, ...]:
    """Columns of the inputs: whether it has started, the state before, voltage and current."""
    words = tuple(word.name for word in observer.method.words)
    return ("started", "theta", "omega", *words, "v_alpha", "v_beta", "i_alpha", "i_beta")


def output_names(observer: FixedPositionObserver) -> tuple[str, ...]:
    """Columns of the results: the state after, and what is shown of it."""
    words = tuple(word.name for word in observer.method.words)
    return ("theta", "omega", *words, "theta_e", "omega_m")


def _limits(observer: FixedPositionObserver) -> list[tuple[int, int]]:
    code = 2 ** (observer.width - 1)
    words = [(limit.low, limit.high) for limit in observer.method.limits(observer.gains)]
    state = [(0, 1), (0, 2**WIDTH - 1), (-TOP - 1, TOP), *words]
    return [*state, *((-code, code - 1),) * 4]


def row_inputs(observer: FixedPositionObserver, count: int, seed: int) -> CodeArray:
    """Inputs of shape (count, columns).

    A half of the rows are the samples of drives that turn, at any speed and with rough noise; the
    others are spread over all that the words hold, some of them at the ends and near zero. One in
    sixteen is a first sample.
    """
    generator = np.random.default_rng(seed)
    columns = []
    for low, high in _limits(observer):
        even = generator.integers(low, high, count, endpoint=True)
        special = generator.choice(np.array([low, low + 1, -1, 0, 1, high - 1, high]), count)
        some = generator.random(count) < 1.0 / 4.0
        columns.append(np.where(some, np.clip(special, low, high), even))
    rows = np.stack(columns, axis=1)
    rows[:, 0] = generator.random(count) >= 1.0 / 16.0
    turning = _turning(observer, count // 2, generator)
    rows[: len(turning)] = turning
    return rows


def _turning(
    observer: FixedPositionObserver, count: int, generator: np.random.Generator
) -> CodeArray:
    """Rows along sequences of samples, each with the state that the one before has left."""
    top = 2 ** (observer.width - 1) - 1
    drives = count // _LENGTH
    if drives == 0:
        return np.empty((0, len(input_names(observer))), dtype=np.int64)
    o, method = Integers(), observer.method
    speed = generator.uniform(-1.0, 1.0, drives)
    turn = speed * observer.turn
    theta = generator.uniform(-np.pi, np.pi, drives)
    sizes = 10.0 ** generator.uniform(-3.0, 0.0, (2, drives))
    shift = np.array([1.6, 0.03, 1.5, -0.1])[:, None]
    angle = np.asarray(theta / np.pi * 2.0**31, dtype=np.int64) % 2**WIDTH
    right = generator.choice([0.0, 0.5, 1.0, -1.0], drives)
    omega = np.asarray(speed * right * TOP, dtype=np.int64)
    words = (np.zeros(drives, np.int64),) * len(method.words)
    state: TrackedState[Any] = TrackedState(angle, omega, words)
    rows = []
    for k in range(_LENGTH):
        noise = 0.02 * generator.standard_normal((4, drives))
        wave = np.cos(theta + k * turn + shift) + noise
        seen = np.rint(np.repeat(sizes, 2, axis=0) * wave * top)
        codes = np.clip(seen, -top - 1, top).astype(np.int64)
        started = np.full(drives, min(k, 1))
        rows.append(_columns(started, state.theta, state.omega, *state.words, *codes))
        state = _after(o, observer, rows[-1])
    return np.concatenate(rows)


def _columns(*parts: CodeArray) -> CodeArray:
    """Columns side by side, constants repeated."""
    return np.stack(np.broadcast_arrays(*parts), axis=1)


def _after(o: Integers, observer: FixedPositionObserver, rows: CodeArray) -> TrackedState[Any]:
    """States after the samples of rows, all of which have started, or none."""
    width, method = observer.width, observer.method
    bits = WIDTH - width
    columns = [rows[:, k] for k in range(rows.shape[1])]
    started, theta, omega, *words = columns[:-4]
    v_alpha, v_beta, i_alpha, i_beta = (
        widened(o, "voltage or current", part, width) for part in columns[-4:]
    )
    v, i = Pair(v_alpha, v_beta), Pair(i_alpha, i_beta)
    if np.all(started != 0):
        return method.step(o, observer.gains, TrackedState(theta, omega, tuple(words)), v, i)
    empty = np.zeros_like(theta)
    begun = TrackedState(
        widened(o, "angle or speed of the start", theta >> bits, width),
        widened(o, "angle or speed of the start", omega >> bits, width),
        (empty,) * len(words),
    )
    return method.begin(o, observer.gains, begun, v, i)


def row_results(
    observer: FixedPositionObserver, inputs: CodeArray, arithmetic: Integers | None = None
) -> CodeArray:
    """Results for rows of inputs, shape (rows, results), columns as `output_names`."""
    o = Integers() if arithmetic is None else arithmetic
    results = np.empty((len(inputs), len(output_names(observer))), dtype=np.int64)
    for started in (False, True):
        chosen = (inputs[:, 0] != 0) == started
        if np.any(chosen):
            state = _after(o, observer, inputs[chosen])
            seen = shown(o, state, observer.width)
            results[chosen] = _columns(state.theta, state.omega, *state.words, *seen)
    return results


# A position observer in fixed point read back from ``result.json``, and proven again not to
# overflow.

NOT_OURS = InputError(
    "observer_q15_header or observer_q31_header is not what dqforge writes; run the design again"
)

_SHIFTS = ("shift", "bits")


def fixed_observer_from(plain: Mapping[str, Any], width: int) -> FixedPositionObserver:
    """Read an observer back behind a control of ``width`` bits, and prove again that nothing
    overflows.

    Raises:
        InputError: The data are not what `plain_fixed_observer` makes.
    """
    try:
        method = FIXED_METHODS[plain["method"]]
        current, voltage, speed = positive(plain["bases"], 3)
        (turn,) = positive((plain["turn"],), 1)
        found = FixedPositionObserver(
            method,
            _record_from(method.gains, plain["gains"]),
            one_of(plain["width"], (width,)),
            (current, voltage, speed),
            turn,
        )
        observer_reaches(method, found.gains, width)
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, NoSolutionError):
        raise NOT_OURS from None
    return found


def _record_from(kind: type[Any], plain: Mapping[str, Any]) -> Any:
    if kind is FixedGain:
        return gain_from(plain, WIDTH)
    hints = get_type_hints(kind)
    return kind(**{f.name: _value_from(f.name, hints[f.name], plain[f.name]) for f in fields(kind)})


def _value_from(name: str, hint: Any, value: Any) -> Any:
    if hint is int:
        return whole(value, 0, 2 * WIDTH - 2) if name in _SHIFTS else whole(value, -(2**63), 2**63)
    if is_dataclass(hint):
        return _record_from(hint, value)  # type: ignore[arg-type]
    inner = get_args(hint)[0]
    if not isinstance(value, list | tuple):
        raise TypeError(name)
    return tuple(_value_from(name, inner, item) for item in value)
