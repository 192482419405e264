"""Which number format a simulation runs, and which emitted ones it does not."""

from __future__ import annotations

from dqforge.machines.names import NumberFormat
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.solution import Solution

SIMULATED: NumberFormat = "float32"


def not_simulated(solution: Solution) -> tuple[NumberFormat, ...]:
    """Fixed-point formats that the design emits, control functions or current reference.

    The simulation runs none.
    """
    emitted = list(solution.design.export.control)
    if isinstance(solution.fit.reference, FixedReference):
        emitted.append(solution.fit.reference.format)
    return tuple(sorted(set(emitted) - {SIMULATED}))


def format_text(formats: tuple[NumberFormat, ...]) -> str:
    """What runs and what does not, in words; empty where everything that is emitted runs."""
    if not formats:
        return ""
    names = " and ".join(formats)
    return (
        f"runs the {SIMULATED} control; the emitted {names} {'is' if len(formats) == 1 else 'are'} "
        "not simulated"
    )
