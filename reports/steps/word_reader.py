"""C of steps over words: whole numbers of a fixed number of bits, beside those of single
precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression, expression, joined


class WordReader(StepReader):
    """Writes what a step computes into ``block``."""

    def inside(self, function: Callable[..., Any], names: Sequence[str]) -> WordReader:  # noqa: ARG002
        """The reader of a function."""
        return WordReader(self.prefix, self.functions, Block("    ", set(names)))

    def constant(self, name: str, value: Any) -> Any:
        """A name in capitals: of words from 0 on, or of a number."""
        kind = "float" if isinstance(value, float) else "uint32_t"
        text = f"{self.prefix.upper()}_{name}"
        if isinstance(value, tuple):
            each = (f"{text}[{n}]" for n in range(len(value)))
            return tuple(Expression(one, whole=text, kind=kind) for one in each)
        return Expression(text, kind=kind)

    def masked(self, a: Any, bits: Any) -> Any:
        """The bits that both have."""
        parts = a, expression(bits, a.kind)
        return joined(" & ".join(part.operand() for part in parts), *parts, kind=a.kind)

    def converted(self, a: Any, kind: str) -> Any:
        """A conversion."""
        return joined(f"({kind}_t){a.operand()}", a, kind=f"{kind}_t")
