"""Limits of a study held against the columns of a block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.exploration.study import Bound, Study
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.optimizer.exploration.verdicts import within
from dqforge.optimizer.variant_steps.outputs import bound_output, output_named

_DIGITS = 6


@dataclass(frozen=True, slots=True)
class NamedLimit:
    """A limit with the output that it looks at, in SI units, and its place in the study."""

    output: str
    unit: str
    place: str
    bound: Bound

    def broken(self, values: FloatArray) -> BoolArray:
        """Where values lie beyond the limit, or do not exist.

        Args:
            values: Values in SI units, any shape.
        """
        return ~within(values, self.bound.below, self.bound.above)

    def words(self, value: float) -> str:
        """What is wrong with a value that breaks the limit."""
        if np.isnan(value):
            return f"{self.place}: there is no value"
        low, high = self.bound.above, self.bound.below
        above = high is not None and value > high
        end, side = (high, "above") if above else (low, "below")
        assert end is not None
        found, bound = (format_quantity(each, self.unit, _DIGITS) for each in (value, end))
        return f"{self.place}: {found} is {side} {bound}"


def study_limits(study: Study, design: Design) -> tuple[NamedLimit, ...]:
    """The limits of a study whose names are checked.

    Args:
        study: The study.
        design: The design it starts from.
    """
    found = []
    for bound in study.limits:
        name = bound_output(bound, design)
        output = output_named(name)
        assert output is not None
        found.append(NamedLimit(name, output.unit, _place(study, bound.output), bound))
    return tuple(found)


def _place(study: Study, name: str) -> str:
    if study.places is None:
        return f"limits.{name}"
    line, column = study.places.of_key(("limits", name))
    return f"{study.places.source}:{line}:{column}: limits.{name}"


def hold_limits(block: BlockRows, limits: Sequence[NamedLimit]) -> None:
    """End rows whose numbers break a limit.

    Args:
        block: Rows with all their columns.
        limits: The limits.
    """
    ended = block.states > STATES.index("limit")
    for limit in limits:
        values = np.asarray(block.columns[limit.output], dtype=np.float64)
        for row in np.flatnonzero(limit.broken(values) & ~ended).tolist():
            block.end(row, "limit", limit.words(float(values[row])))
