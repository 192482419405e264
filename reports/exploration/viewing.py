"""A study's folder read for what is shown of it, in two passes over its parts, and the files that
say it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.optimizer.study_results.acceptance import StudyQuestion, summarise
from dqforge.reports.exploration.html import render_study
from dqforge.reports.exploration.question import study_question
from dqforge.reports.exploration.study_view import StudyView, pictured_rows
from dqforge.reports.page_frame import ListedFile
from dqforge.reports.pages.html_text import counted

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
