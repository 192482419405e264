"""The current reference that a design asks for."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.current_reference.cheapest import FitChoice, choose_fit
from dqforge.optimizer.current_reference.data_use import data_use
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.operating_points.solve import current_choice


@on_design("fit")
def solve_fit(design: Design) -> FitChoice:
    """Current reference of the design: as set, or the cheapest that keeps its budget."""
    choice, budget = current_choice(design), design.fit.budget
    if budget is None:
        found = FitChoice(fit_reference(choice, design.fit), ())
    else:
        found = choose_fit(choice, design.fit, budget)
    return replace(found, data=data_use(choice, found.fit.torque_max))
