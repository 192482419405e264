"""What a study asks of its rows, by the names of their columns."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.exploration.study import Bound, Study
from dqforge.optimizer.exploration.row_block import OUTPUT_COLUMN
from dqforge.optimizer.study_results.acceptance import AcceptedRange
from dqforge.optimizer.study_results.summary import GoalColumn
from dqforge.optimizer.variant_steps.outputs import bound_output


def goal_columns(study: Study) -> tuple[GoalColumn, ...]:
    """Goals of a study.

    Args:
        study: The study.
    """
    return tuple(GoalColumn(OUTPUT_COLUMN + goal.output, goal.minimise) for goal in study.goals)


def bound_column(bound: Bound, design: Design) -> AcceptedRange:
    """A limit of a study, or what it accepts.

    Args:
        bound: As the study says it.
        design: The design that it starts from.
    """
    name = bound_output(bound, design)
    return AcceptedRange(OUTPUT_COLUMN + name, bound.output, bound.below, bound.above)
