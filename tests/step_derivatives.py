"""Steps of observers on CasADi's numbers: the derivative of the very text that is emitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import casadi
import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import ObserverMethod, ObserverState
from dqforge.optimizer.step_arithmetic import AlphaBeta, Arithmetic, Rotation


class Number:
    """An expression of CasADi that leaves arrays of numpy to numpy."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph

    def _with(self, work: Callable[[Any, Any], Any], other: Any, *, swapped: bool = False) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        pair = (graph(other), self.graph) if swapped else (self.graph, graph(other))
        return Number(work(*pair))

    def __add__(self, other: Any) -> Any:
        return self._with(lambda a, b: a + b, other)

    def __radd__(self, other: Any) -> Any:
        return self._with(lambda a, b: a + b, other, swapped=True)

    def __sub__(self, other: Any) -> Any:
        return self._with(lambda a, b: a - b, other)

    def __rsub__(self, other: Any) -> Any:
        return self._with(lambda a, b: a - b, other, swapped=True)

    def __mul__(self, other: Any) -> Any:
        return self._with(lambda a, b: a * b, other)

    def __rmul__(self, other: Any) -> Any:
        return self._with(lambda a, b: a * b, other, swapped=True)

    def __truediv__(self, other: Any) -> Any:
        return self._with(lambda a, b: a / b, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(lambda a, b: a / b, other, swapped=True)

    def __neg__(self) -> Any:
        return Number(-self.graph)

    def __lt__(self, other: Any) -> Any:
        return self._with(lambda a, b: a < b, other)

    def __le__(self, other: Any) -> Any:
        return self._with(lambda a, b: a <= b, other)

    def __gt__(self, other: Any) -> Any:
        return self._with(lambda a, b: a > b, other)

    def __ge__(self, other: Any) -> Any:
        return self._with(lambda a, b: a >= b, other)

    def __and__(self, other: Any) -> Any:
        return self._with(casadi.logic_and, other)


def graph(value: Any) -> Any:
    return value.graph if isinstance(value, Number) else float(value)


def _wrapped(theta: Any) -> Any:
    turns = casadi.floor((theta.graph + np.pi) / (2.0 * np.pi))
    return Number(theta.graph - 2.0 * np.pi * turns)


def _rotated(theta: Any) -> Any:
    cosine: Any = Number(casadi.cos(theta.graph))
    sine: Any = Number(casadi.sin(theta.graph))
    return Rotation(cosine, sine)


class Derivatives(Arithmetic):
    """Double precision, as expressions of CasADi."""

    def __init__(self) -> None:
        super().__init__(np.float64, _wrapped, _rotated)

    def product(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        return a * b

    def negative(self, a: Any) -> Any:
        return -a

    def total(self, name: str, *terms: Any) -> Any:  # noqa: ARG002
        first, *rest = terms
        for term in rest:
            first = first + term
        return first

    def choose(self, condition: Any, a: Any, b: Any) -> Any:
        return Number(casadi.if_else(condition.graph, graph(a), graph(b)))

    def magnitude(self, a: Any) -> Any:
        return Number(casadi.fabs(a.graph))

    def root(self, a: Any) -> Any:
        return Number(casadi.sqrt(a.graph))

    def full(self, value: Any, like: Reals) -> Any:  # noqa: ARG002
        return Number(casadi.SX(graph(value)))

    def either(self, condition: Any, then: Callable[[], Any], otherwise: Callable[[], Any]) -> Any:
        return self._both(condition, then(), otherwise())

    def _both(self, condition: Any, a: Any, b: Any) -> Any:
        if isinstance(a, Number):
            return self.choose(condition, a, b)
        if is_dataclass(a) and not isinstance(a, type):
            names = [member.name for member in fields(a)]
            parts = {n: self._both(condition, getattr(a, n), getattr(b, n)) for n in names}
            return replace(a, **parts)
        if isinstance(a, tuple):
            return tuple(self._both(condition, x, y) for x, y in zip(a, b, strict=True))
        return a


def derivative(method: ObserverMethod, gains: Any) -> casadi.Function:
    """(state (n,), turn, omega, drift, v (2,), i (2,)) -> state after a sample, and its derivatives
    by the state, by i and by v; states as those of `SteadyObserver`.
    """
    assert method.members is not None
    count = len(method.members.vectors)
    n = 2 * count + len(method.members.scalars) + 2
    state, v, i = (casadi.SX.sym(name, size) for name, size in (("x", n), ("v", 2), ("i", 2)))
    turn, omega, drift = (casadi.SX.sym(name) for name in ("turn", "omega", "drift"))
    c, s = casadi.cos(turn), casadi.sin(turn)

    def pair(x: Any, y: Any) -> AlphaBeta:
        first: Any = Number(x)
        second: Any = Number(y)
        return AlphaBeta(first, second)

    vectors = tuple(
        pair(
            state[2 * k] * c + state[2 * k + 1] * s,
            state[2 * k + 1] * c - state[2 * k] * s,
        )
        for k in range(count)
    )
    scalars: Any = tuple(Number(state[k]) for k in range(2 * count, n - 2))
    theta: Any = Number(state[n - 2] - turn)
    speed: Any = Number(state[n - 1] + omega - drift)
    before = ObserverState(vectors, theta, speed, True, scalars)
    after = method.step(gains, before, pair(v[0], v[1]), pair(i[0], i[1]), Derivatives())
    parts = [part for vector in after.vectors for part in vector] + [*after.scalars, after.theta_e]
    found = casadi.vertcat(*map(graph, parts), graph(after.omega_e) - omega)
    by = [casadi.jacobian(found, part) for part in (state, i, v)]
    return casadi.Function("step", [state, turn, omega, drift, v, i], [found, *by])


def evaluated(function: casadi.Function, *arguments: Any) -> list[FloatArray]:
    return [np.asarray(part, dtype=np.float64) for part in function(*arguments)]
