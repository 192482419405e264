"""The field-weakening reference that a design asks for."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening
from dqforge.optimizer.operating_points.characteristics import voltage_limit


@on_design("field_weakening")
def solve_weakening(design: Design) -> WeakeningFit | None:
    """Two-dimensional reference of the design, None where it asks for none.

    Raises
    ------
    NoSolutionError
        As `fit_weakening`.
    """
    if design.weakening is None:
        return None
    operation = design.operation
    limit = voltage_limit(design.inverter, operation.modulation, operation.voltage_margin)
    return fit_weakening(design.machine, design.i_max, limit.v_max, design.weakening)
