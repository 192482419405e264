"""What `dqforge losses --choice` answers."""

from __future__ import annotations

from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.optimizer.modulation_choice.solve import solve_choice
from dqforge.reports.modulation_choice.text import choice_tables, plain_choice
from dqforge.reports.pages.answer import Answer


@on_design("modulation_choice")
def answer_choice(design: Design) -> Answer:
    """Choose modulator and switching frequency as the design asks.

    Raises:
        InputError: The design has no section ``modulation_choice``.
        NoSolutionError: Nothing keeps the limits anywhere.
    """
    found = solve_choice(design)
    if found is None:
        message = (
            "the design requests no choice; add a section 'modulation_choice' with min_frequency, "
            "max_frequency"
        )
        raise InputError(message)

    def figure() -> Any:
        from dqforge.reports.modulation_choice.figures import plot_choice

        return plot_choice(found)

    return Answer(
        design.name,
        choice_tables(design, found),
        {"modulation_choice": plain_choice(found)},
        figure,
    )
