"""Which number formats a simulation runs, and which emitted ones it does not."""

from __future__ import annotations

from typing import get_args

from dqforge.machines.names import NumberFormat
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.solution import Solution

_DEFAULT: NumberFormat = "float32"


def simulated(solution: Solution) -> tuple[NumberFormat, ...]:
    """Formats whose control functions a simulation runs: all that the design emits, float32 where
    it emits none.
    """
    emitted = solution.design.export.control
    return tuple(name for name in get_args(NumberFormat) if name in emitted) or (_DEFAULT,)


def not_simulated(solution: Solution) -> tuple[NumberFormat, ...]:
    """Formats of an emitted current reference that no simulated control functions have.

    Control functions call references in their own arithmetic.
    """
    reference = solution.fit.reference
    if not isinstance(reference, FixedReference) or reference.format in simulated(solution):
        return ()
    return (reference.format,)


def format_text(run: tuple[NumberFormat, ...], left: tuple[NumberFormat, ...]) -> str:
    """What runs and what does not, in words; empty where all that is emitted is float32."""
    if run == (_DEFAULT,) and not left:
        return ""
    text = f"runs the {' and the '.join(run)} control"
    return f"{text}; the emitted {' and '.join(left)} is not simulated" if left else text
