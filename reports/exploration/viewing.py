"""A study's folder read for what is shown of it, in two passes over its parts, and the files that
say it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.optimizer.exploration.acceptance import (
    StudyQuestion,
    bound_column,
    goal_columns,
    summarise,
)
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, OUTPUT_COLUMN, ColumnSpec
from dqforge.reports.exploration.html import render_study
from dqforge.reports.exploration.study_view import StudyView, pictured_rows
from dqforge.reports.pages.html_text import counted
from dqforge.reports.run_folder import ListedFile

if TYPE_CHECKING:
    from dqforge.reports.study_store.part_store import PartStore


def view_study(
    store: PartStore, question: StudyQuestion, audited: Mapping[str, float], about: str = ""
) -> StudyView:
    """Everything that is shown of a study.

    Args:
        store: Its folder.
        question: What is asked of its rows together.
        audited: Largest deviation of the batch path, as `PartStore.survey` found it.
        about: What its file says of it.

    Raises:
        StoreError: A part is damaged.
    """
    header = store.header
    summary = summarise(question, store.read([*question.columns, "message"]))
    front = () if summary.front is None else summary.front.index.tolist()
    names = [column.name for column in header.columns]
    return StudyView(
        name=header.name,
        about=about,
        columns=header.columns,
        rows=header.count,
        batch=header.batch,
        summary=summary,
        pictured=pictured_rows(store, names, front),
        audited=audited,
        computed_with=header.computed_with,
    )


def view_of(store: PartStore, study: Study, audited: Mapping[str, float]) -> StudyView:
    """Everything that is shown of a study that a folder holds; arguments and errors as of
    `view_study`.
    """
    question = study_question(study, design_of(study, {}), store.header.columns)
    return view_study(store, question, audited, study.about)


def write_pages(store: PartStore, view: StudyView, inputs: Mapping[str, bytes]) -> tuple[str, ...]:
    """Write the report, the front and the sensitivities beside the parts; returns their names.

    Args:
        store: The study's folder.
        view: What is shown of it.
        inputs: What the study was read from, by name in the folder.

    Raises:
        StoreError: The disk is full, or the folder cannot be written.
    """
    from dqforge.reports.study_store.part_file import FRONT, REPORT, SENSITIVITY
    from dqforge.reports.study_store.summary_files import front_file, sensitivity_file

    made: dict[str, bytes] = {}
    front, found = view.summary.front, view.summary.sensitivities
    if front is not None:
        made[FRONT] = front_file(store, front.index)
    if found:
        made[SENSITIVITY] = sensitivity_file(store.header.name, store.header.digest, found)
    page = render_study(view, _listed(store, made, inputs))
    files = {REPORT: page.encode("utf-8"), **made}
    for name, content in files.items():
        store.write_beside(name, content)
    return tuple(files)


def _listed(
    store: PartStore, made: Mapping[str, bytes], inputs: Mapping[str, bytes]
) -> list[ListedFile]:
    """What lies beside the page. ``study.json`` is finished after it, so that its bytes are not
    known here.
    """
    from dqforge.reports.study_store.part_file import FRONT, PARTS, SENSITIVITY, part_files
    from dqforge.reports.study_store.part_store import STUDY_JSON

    parts = [path.stat().st_size for path in part_files(store.folder).values()]
    words = {
        FRONT: "the rows of the front, whole",
        SENSITIVITY: "on which inputs the outputs depend",
    }
    return [
        ListedFile(STUDY_JSON, "what the study asks, its columns with units, and its outcome"),
        ListedFile(
            f"{PARTS}/",
            f"the rows in {counted(len(parts), 'file')}; each carries its SHA-256",
            sum(parts),
        ),
        *(ListedFile.of(name, words[name], content) for name, content in made.items()),
        *(
            ListedFile.of(name, "what the study was read from", content)
            for name, content in inputs.items()
        ),
    ]


# What is asked of the rows of a study together, from what its file says.

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
