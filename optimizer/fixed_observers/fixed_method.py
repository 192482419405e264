"""What a position observer in integers is: its record, its state, and a run over samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Literal

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    CodeArray,
    Integers,
    Range,
    rounded,
)
from dqforge.optimizer.fixed_control.transforms import full_scale
from dqforge.optimizer.fixed_observers.kit import TOP, WIDTH
from dqforge.optimizer.fixed_observers.scales import Scales

WordType = Literal["int32_t", "int64_t", "uint32_t"]


@dataclass(frozen=True, slots=True)
class Word:
    """A word of the state: its member in C and its type."""

    name: str
    type: WordType = "int32_t"


@dataclass(frozen=True, slots=True)
class TrackedState(Generic[N]):
    """Angle, 2^32 codes of a turn, speed, 2^31 codes of full scale, and what else is kept."""

    theta: N
    omega: N
    words: tuple[N, ...]


Step = Callable[[Any, Any, TrackedState[Any], Pair[Any], Pair[Any]], TrackedState[Any]]


@dataclass(frozen=True, slots=True)
class FixedMethod:
    """One method of observing the position, in integers.

    Args:
        name, code: As those of the `ObserverMethod` of the same name.
        gains: The dataclass that ``design`` returns: integers, `FixedGain` and records of them.
        design: (gains of the method in double precision, scales) -> gains in integers.
        words: What the state holds besides angle and speed.
        limits: gains -> what each word can be; ``step`` leaves none of these ranges.
        begin, step: (arithmetic, gains, state, voltage, current) -> state after the first and after
            any other sample; both vectors (alpha, beta) in codes of 32 bits.
    """

    name: str
    code: str
    gains: type[Any]
    design: Callable[[Any, Scales], Any]
    words: tuple[Word, ...]
    limits: Callable[[Any], tuple[Range, ...]]
    begin: Step
    step: Step


def code_limits(count: int) -> Callable[[Any], tuple[Range, ...]]:
    """``limits`` of a state of so many codes."""

    def limits(_: Any) -> tuple[Range, ...]:
        return (Range(-TOP - 1, TOP),) * count

    return limits


def vector_words(*names: str) -> tuple[Word, ...]:
    """Words of vectors in stationary coordinates."""
    return tuple(Word(f"{name}.{part}") for name in names for part in ("alpha", "beta"))


def widened(o: Arithmetic[N, Any], name: str, a: N, width: int) -> N:
    """A code of ``width`` bits as one of 32 bits."""
    return o.product(name, a, o.const(1 << (WIDTH - width)))


def shown(o: Arithmetic[N, Any], state: TrackedState[N], width: int) -> tuple[N, N]:
    """Angle and speed in codes of ``width`` bits."""
    bits = WIDTH - width
    theta = o.wrapped(rounded(o, "angle shown", state.theta, bits), width)
    top = full_scale(width)
    return theta, o.clamp(rounded(o, "speed shown", state.omega, bits), -top, top)


def observe_codes(
    method: FixedMethod,
    gains: Any,
    width: int,
    start: tuple[CodeArray, CodeArray],
    samples: tuple[CodeArray, CodeArray, CodeArray, CodeArray],
) -> tuple[CodeArray, CodeArray]:
    """Estimated angle and speed in codes of ``width`` bits, shape (K, S).

    Args:
        method, gains, width: The observer and the format of the control.
        start: Angle and speed before the first sample in codes of ``width`` bits, shape (S,).
        samples: v_alpha, v_beta, i_alpha and i_beta in codes of ``width`` bits, shape (K, S).
    """
    o = Integers()
    theta, omega = (
        widened(o, "angle or speed of the start", np.asarray(part), width) for part in start
    )
    empty = np.zeros_like(theta)
    state = TrackedState(theta, omega, (empty,) * len(method.words))
    wide = [widened(o, "voltage or current", part, width) for part in samples]
    angles, speeds = np.empty_like(wide[0]), np.empty_like(wide[0])
    for k in range(len(angles)):
        v, i = Pair(wide[0][k], wide[1][k]), Pair(wide[2][k], wide[3][k])
        state = (method.step if k else method.begin)(o, gains, state, v, i)
        angles[k], speeds[k] = shown(o, state, width)
    return angles, speeds
