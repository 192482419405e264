"""The field-weakening reference that a design asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design

if TYPE_CHECKING:
    from dqforge.optimizer.field_weakening.fit import WeakeningFit


@on_design("field_weakening")
def solve_weakening(design: Design) -> WeakeningFit | None:
    """Two-dimensional reference of the design, None where it asks for none.

    Raises:
        NoSolutionError: As `fit_weakening`.
    """
    if design.weakening is None:
        return None
    from dqforge.optimizer.field_weakening.fit import fit_weakening

    return fit_weakening(design.machine, design.i_max, design.v_max, design.weakening)
