"""Studies for the tests of their rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.row_block import STATES, RowBlock
from dqforge.optimizer.exploration.study_plan import StudyPlan

POINTS = """  losses.points:
    - {torque: 40 N m, speed: 450 rad/s, weight: 60 %}
    - {torque: 130 N m, speed: 300 rad/s, weight: 30 %}
    - {torque: 150 N m, speed: 200 rad/s, weight: 10 %}
"""

MACHINES = """tolerances:
  machine.resistance: {normal: 5 %}
  machine.inductance_d: {normal: 5 %}
  machine.inductance_q: {normal: 5 %}
  machine.magnet_flux: {normal: 2 %}
  machine.max_current: {uniform: 5 %}
"""

MARGINS = ("phase_margin", "gain_margin", "delay_margin", "crossover", "max_sensitivity", "stable")


def loop_names(*loops: str) -> list[str]:
    """Outputs of some loops."""
    return [f"gains.{loop}.{name}" for loop in loops for name in MARGINS]


def plan_of(body: str, design: str = "paper000-ipmsm-100kw") -> StudyPlan:
    """The plan of a study with these sections."""
    text = f"dqforge_study: 1\nname: a trial\ndesign: {design}\n{body}"
    return StudyPlan(study_of_text(text.encode(), "study.yaml"))


def outputs(*names: str) -> str:
    """The section that asks for outputs."""
    return f"outputs: [{', '.join(names)}]\n"


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """All rows of a plan, block by block."""

    plan: StudyPlan
    blocks: tuple[RowBlock, ...]

    @classmethod
    def of(cls, plan: StudyPlan, most: int | None = None) -> Rows:
        """Computed in parts."""
        end = plan.count if most is None else min(most, plan.count)
        firsts = range(0, end, plan.batch)
        return cls(plan, tuple(plan.rows(k, min(k + plan.batch, end)) for k in firsts))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column by its name."""
        found: NDArray[Any] = np.concatenate([block.columns[name] for block in self.blocks])
        return found

    @property
    def states(self) -> list[str]:
        """How each row ended."""
        return [STATES[place] for block in self.blocks for place in block.states]

    @property
    def messages(self) -> list[str]:
        """What is said of each."""
        return [message for block in self.blocks for message in block.messages]

    def word(self, name: str) -> NDArray[Any]:
        """A choice as words."""
        spec = next(column for column in self.plan.columns if column.name == name)
        words: NDArray[Any] = np.array(spec.choices)[self[name]]
        return words
