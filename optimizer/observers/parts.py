"""What all position observers are made of: their state, the arithmetic they run in,
and noise-proof normalisation.

An observer is a module of three functions (docs/methods/position-observers.md): ``design`` makes
its gains,
``start`` its first state, ``step`` the next one. Each is written once, in the order of operations
of the emitted C, and runs on numpy arrays in double precision for analysis and in single precision
as the model of the C.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Floats, Reals

Pair = tuple[Reals, Reals]

"""The alpha and beta (or d and q) components of a vector."""


_Gains = TypeVar("_Gains")


@dataclass(frozen=True, slots=True)
class Arithmetic(Floats):
    """How angles are wrapped to -pi to pi and how (cosine, sine) is found.

    ``number`` is the type of all values.
    """

    wrap: Callable[[Reals], Reals]
    rotation: Callable[[Reals], Pair]


def _wrap(theta: Reals) -> Reals:
    return np.asarray((theta + np.pi) % (2.0 * np.pi) - np.pi)


def _rotation(theta: Reals) -> Pair:
    return np.cos(theta), np.sin(theta)


EXACT = Arithmetic(np.float64, _wrap, _rotation)

"""Double precision."""


@dataclass(frozen=True, slots=True, eq=False)
class ObserverState:
    """State of N observers: vectors in stationary coordinates, angle in rad and
    speed in rad/s (electrical).

    ``started`` is false until the first step, which takes the currents of the instant for which the
    angle was given. ``scalars`` are what else it remembers, none of which turns with the rotor;
    ``added`` is the voltage in V that an estimator asks for, None where it asks for none; ``seen``
    is the current in A without what that voltage makes of it, for the controllers.
    """

    vectors: tuple[Pair, ...]
    theta_e: Reals
    omega_e: Reals
    started: bool = True
    scalars: tuple[Reals, ...] = ()
    added: Pair | None = None
    seen: Pair | None = None


def cast(gains: _Gains, maths: Arithmetic) -> _Gains:
    """Gains (a dataclass of floats and tuples of floats) as numbers of an arithmetic."""
    assert is_dataclass(gains)
    values: dict[str, Any] = {}
    for field in fields(gains):
        value = getattr(gains, field.name)
        if is_dataclass(value):
            values[field.name] = cast(value, maths)
        elif isinstance(value, tuple):
            values[field.name] = tuple(maths.number(item) for item in value)
        else:
            values[field.name] = maths.number(value)
    return replace(gains, **values)  # type: ignore[type-var]


def at_least(value: Reals, floor: Any) -> Reals:
    """The larger of both, as ``(value > floor) ? value : floor`` (the floor for not-a-number)."""
    return np.where(value > floor, value, floor)
