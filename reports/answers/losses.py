"""What `dqforge losses` answers: the losses of alternatives at points, over a map or a mission,
and the choice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.losses.solve import require_losses
from dqforge.reports.answers.current_feedback import with_regulators
from dqforge.reports.losses.map_tables import losses_tables, plain_losses
from dqforge.reports.losses.question import LossRequest, answer
from dqforge.reports.modulation_choice.question import answer_choice
from dqforge.reports.pages.answer import Answer, stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = ["LossRequest", "answer_losses"]


def answer_losses(design: Design, request: LossRequest, *, choice: bool) -> Answer:
    """Losses at the points of the design, over a map or a mission, or the choice of the design.

    Raises:
        InputError: As `answer` and `answer_choice`, and where options do not go together.
    """
    if design.control.six_step is not None:
        raise InputError(
            "losses: the loss budget is that of sinusoidal currents, and control.observer makes "
            "this a six-step drive; simulate it, or write another observer"
        )
    if choice:
        if request != LossRequest():
            raise InputError(
                "--choice takes what the section 'modulation_choice' says; leave the other options "
                "out"
            )
        stage("choosing modulator and frequency")
        return answer_choice(design)
    stage("comparing the losses")
    if request.chart is not None or request.mission is not None:
        return answer(design, request)
    _refuse_alternatives(request)
    return _points(design)


def _refuse_alternatives(request: LossRequest) -> None:
    """Refuse what goes with a map or a mission, and say how the points of the design have it."""
    for name, text, instead in (
        ("--strategies", request.strategies, "write --set losses.strategies='[mtpa, id0]'"),
        ("--modulations", request.modulations, "write --set losses.modulations='[spwm, svpwm]'"),
        (
            "--frequencies",
            request.frequencies,
            "write --set inverter.switching_frequency='8 kHz', a command for each",
        ),
        (
            "--margin",
            None if request.margin == LossRequest().margin else request.margin,
            "write operation.voltage_margin in the design",
        ),
    ):
        if text is not None:
            raise InputError(
                f"{name} goes with --map or --mission; add one of them, or for the points of the "
                f"design {instead}"
            )


def _points(design: Design) -> Answer:
    found = require_losses(design)

    def figure() -> Figure:
        from dqforge.reports.losses.map_figures import plot_losses

        return plot_losses(design, found)

    plain = {"losses": plain_losses(found)}
    answered = Answer(design.name, losses_tables(design, found), plain, figure)
    return with_regulators(design, answered) if design.control.current_loop.switches else answered
