"""Figures of a design that are held against what drives usually have,
and the sentences on those that are not.
"""

from __future__ import annotations

import math

from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

MARK = "implausible: "  # How every sentence on an implausible figure begins.


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that follows from the design, and the range in which it usually lies.

    ``key`` is the entry of the design file that most likely is wrong where it does not, ``what``
    says what the figure is, ``value``, ``low`` and ``high`` are in SI units, printed in ``unit``
    (empty: a plain number; ``%``: a share).
    """

    key: str
    what: str
    value: float
    unit: str
    low: float
    high: float

    @property
    def is_usual(self) -> bool:
        """Whether the figure lies in its range; ends included."""
        return self.low <= self.value <= self.high

    def sentence(self) -> str:
        """What to say of a figure outside its range."""
        low, high, value = (
            format_quantity(part, self.unit, 3) for part in (self.low, self.high, self.value)
        )
        if self.low == -math.inf or (self.low == 0.0 and self.value > self.high):
            usual = f"at most {high}"
        elif self.high == math.inf:
            usual = f"at least {low}"
        else:
            usual = f"{low} to {high}"
        return (
            f"{MARK}{self.key}: {self.what} is {value}, usual is {usual}; check the value and its "
            "unit"
        )


def sentences(figures: list[Figure]) -> list[str]:
    """One sentence for each figure outside its range, in order."""
    return [figure.sentence() for figure in figures if not figure.is_usual]
