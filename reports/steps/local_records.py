"""Records that a function of the C keeps for itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Concatenate, ParamSpec, TypeVar

from dqforge.optimizer.steps.step_arithmetic import Arithmetic
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.record_text import c_name, whole_of
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Condition, Expression

_P = ParamSpec("_P")
_T = TypeVar("_T")


class RecordReader(StepReader):
    """A reader whose functions declare records by `let`, in their outermost block; they change
    them, hand them on by their address and return them.
    """

    def inside(self, function: Callable[..., Any], names: Sequence[str]) -> StepReader:  # noqa: ARG002
        """The reader of a function with parameters of these names."""
        return RecordReader(self.prefix, self.functions, Block("    ", set(names)))

    def _named(self, name: str, value: Any, meaning: str) -> Any:
        if not is_dataclass(value) or isinstance(value, Condition):
            return self._local(name, value, meaning)
        self.block.take(name)
        self.block.variable(self.type_name(c_name(type(value))), name)
        found = self._record(value, f"&{name}", f"{name}.", frozenset())
        for member in fields(value):
            setattr(found, member.name, getattr(value, member.name))
        self.write_state()
        return found

    def _local(self, name: str, value: Any, meaning: str) -> Any:
        """A constant where declarations still stand, behind statements a variable that is set."""
        vector = isinstance(value, tuple) and hasattr(value, "_fields")
        if self.block.declared is None or not (vector or isinstance(value, Expression | Condition)):
            found = super()._named(name, value, meaning)
            _written(value)
            return found
        kind = self._kind(value)
        self.block.take(name)
        self.block.variable(kind, name)
        self._assign(name, value)
        return self.vector(type(value), name) if vector else self.number_of(name, kind)

    def _assign(self, name: str, value: Any) -> None:
        super()._assign(name, value)
        _written(value)

    def call(
        self,
        function: Callable[Concatenate[Arithmetic, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """A call, whose result may be a condition."""
        found = super().call(function, *args, **kwargs)
        if isinstance(found, Condition) and self._open is not None:
            (self._open,) = found.terms
            self._open.uses[0] = 0
        return found

    def write_state(self) -> None:
        """Write what the step has made of its state, vectors of calls as a whole."""
        for kept in self._kept:
            if kept.set_to is not kept.value:
                _written(kept.set_to)
        super().write_state()

    def returned(self, result: Any, into: Sequence[str] = ()) -> tuple[str, list[str]]:
        """Type of what a function returns, and the statements that return it."""
        place = self._place(result)
        if place is None:
            return super().returned(result, into)
        name = place[0].removeprefix("&")
        return self.type_name(c_name(type(result))), [f"{self.block.indent}return {name};"]


def _written(value: Any) -> None:
    """Count that a vector of a call has been written as a whole."""
    if isinstance(value, tuple) and whole_of(value):
        value[0].uses[0] += 1
