"""What is asked of the rows of a study together, from what its file says."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.design.design import Design
from dqforge.machines.exploration.study import Study
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, OUTPUT_COLUMN, ColumnSpec
from dqforge.optimizer.study_results.acceptance import StudyQuestion, bound_column, goal_columns

MOST_SPREAD = 12  # Histograms of a study that names no outputs that matter more than others.


def study_question(study: Study, design: Design, columns: Sequence[ColumnSpec]) -> StudyQuestion:
    """The question of a study.

    Args:
        study: What its file says.
        design: The design that it starts from.
        columns: Columns of its rows.
    """
    there = {column.name: column for column in columns}
    accept = tuple(bound_column(bound, design) for bound in study.accept)
    goals = goal_columns(study)
    sensitivity = tuple(OUTPUT_COLUMN + name for name in study.sensitivity)
    asked = [each.column for each in accept] + [*sensitivity] + [goal.column for goal in goals]
    numbers = [
        name
        for name, column in there.items()
        if name.startswith(OUTPUT_COLUMN) and column.kind == "number"
    ]
    drawn = tuple(
        name
        for name in (INPUT_COLUMN + each.key for each in study.tolerances)
        if name in there and there[name].kind == "number"
    )
    return StudyQuestion(
        accept=accept,
        goals=goals,
        inputs=tuple(name for name in there if name.startswith(INPUT_COLUMN)),
        drawn=drawn,
        sensitivity=sensitivity,
        spread=tuple(dict.fromkeys(asked or numbers[:MOST_SPREAD])),
        saltelli=study.saltelli,
    )
