"""The speed loop over an observer, both judged as one: as `tune` would in a design that asks for
this observer.
"""

from __future__ import annotations

import math
from dataclasses import replace

from dqforge.machines.design.sections.chosen_together import SPREAD
from dqforge.machines.design.settings import ControlSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.estimator_comparison.candidate import Question
from dqforge.optimizer.estimator_comparison.observer_candidates import settings_of
from dqforge.optimizer.observers.methods.registry import METHODS


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """The loop.

    Args:
        margin, crossover: Phase margin in rad and crossover in rad/s at the worst speed.
        holds: Whether it is stable with the margin that the design asks for.
        low: Least electrical speed in rad/s from which every corner of the tolerances is stable,
            dead time apart; nan where there is none.
    """

    margin: float
    crossover: float
    holds: bool
    low: float

    @property
    def robust(self) -> bool:
        """Whether it has its margin, and there is a speed at which every corner is stable."""
        return self.holds and math.isfinite(self.low)


def control_over(asked: Question, name: str) -> ControlSettings:
    """Control of the design with another observer, as in a design that leaves open what is chosen
    together: a speed loop by the symmetrical optimum counts the lag of the observer.

    Args:
        asked: The question.
        name: Of the observer.
    """
    control = asked.design.control
    loop, own = control.speed_loop, control.observer
    other = own is None or own.method != name
    if other and loop is not None and loop.method == "symmetrical-optimum":
        loop = replace(loop, spread=SPREAD, counts_observer=True)
    return replace(control, observer=settings_of(asked, name), speed_loop=loop)


def closed_loop(asked: Question, name: str) -> ClosedLoop | None:
    """The speed loop over an observer; None without a speed loop, or where it has none.

    Args:
        asked: The question.
        name: Of the observer.
    """
    design = asked.design
    if design.control.speed_loop is None or asked.loops is None or name not in METHODS:
        return None
    chosen = replace(control_over(asked, name), start_up=None, six_step=None)
    try:
        speed = solve_gains(replace(design, control=chosen)).speed
    except (InputError, NoSolutionError):
        return None
    found = None if speed is None else speed.observed
    if speed is None or found is None:
        return None
    low = float("nan") if found.corners is None else found.corners.binding.low
    return ClosedLoop(speed.phase_margin, speed.crossover, found.holds, low)
