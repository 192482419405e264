"""Steps of observers as graphs of CasADi: the very text that is emitted, to be derived or run for
many samples at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import casadi
import numpy as np

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Rotation


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
    """The expression of a number, or the number."""
    return value.graph if isinstance(value, Number) else float(value)


def _wrapped(theta: Any) -> Any:
    turns = casadi.floor((theta.graph + np.pi) / (2.0 * np.pi))
    return Number(theta.graph - 2.0 * np.pi * turns)


def _rotated(theta: Any) -> Any:
    cosine: Any = Number(casadi.cos(theta.graph))
    sine: Any = Number(casadi.sin(theta.graph))
    return Rotation(cosine, sine)


class Graphs(Arithmetic):
    """Double precision, as expressions of CasADi."""

    def __init__(self) -> None:
        super().__init__(np.float64, _wrapped, _rotated)

    def product(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        """A product."""
        return a * b

    def negative(self, a: Any) -> Any:
        """A number with the other sign."""
        return -a

    def total(self, name: str, *terms: Any) -> Any:  # noqa: ARG002
        """A sum, from the left."""
        first, *rest = terms
        for term in rest:
            first = first + term
        return first

    def at(self, table: Sequence[Any], place: Any, column: int | None = None) -> Any:
        """The number at a place, of rows in a column."""
        if column is not None:
            table = [row[column] for row in table]
        if isinstance(place, int):
            return table[place]
        found = graph(table[-1])
        for number in reversed(range(len(table) - 1)):
            found = casadi.if_else(place.graph <= number, graph(table[number]), found)
        return Number(found)

    def each(self, name: str, count: int, of: Callable[[Any], Any]) -> tuple[Any, ...]:  # noqa: ARG002
        """One number after the other."""
        return tuple(map(of, range(count)))

    def summed(self, name: str, first: Any, count: int, of: Callable[[Any], Any]) -> Any:  # noqa: ARG002
        """One number after the other."""
        for place in range(count):
            first = first + of(place)
        return first

    def reached(self, name: str, conditions: Sequence[Any]) -> Any:  # noqa: ARG002
        """How many conditions hold."""
        return Number(sum(condition.graph for condition in conditions))

    def choose(self, condition: Any, a: Any, b: Any) -> Any:
        """``a`` where the condition holds, else ``b``."""
        return Number(casadi.if_else(condition.graph, graph(a), graph(b)))

    def magnitude(self, a: Any) -> Any:
        """The absolute value."""
        return Number(casadi.fabs(a.graph))

    def root(self, a: Any) -> Any:
        """The square root."""
        return Number(casadi.sqrt(a.graph))

    def full(self, value: Any, like: Reals) -> Any:  # noqa: ARG002
        """A constant."""
        return Number(casadi.SX(graph(value)))

    def either(self, condition: Any, then: Callable[[], Any], otherwise: Callable[[], Any]) -> Any:
        """Both, and member by member the one that holds."""
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
