"""What `dqforge explore OUT --export` answers: which rows were written where, and their proof."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dqforge.reports.pages.answer import Answer, Table
from dqforge.reports.plain_data import PlainData
from dqforge.reports.study_store.part_file import INDEX
from dqforge.reports.study_store.part_store import PartStore
from dqforge.reports.study_store.table_query import (
    Condition,
    TableQuery,
    find_rows,
    people_texts,
    short_name,
    usual_columns,
)
from dqforge.reports.study_store.winners import Winner, chosen_rows, export_row, stored_study


def answer_export(folder: Path, which: str, *, verify: bool = True) -> Answer:
    """Write the designs and headers of rows of a study.

    Args:
        folder: Of the study.
        which: As of `dqforge.reports.study_store.winners.chosen_rows`.
        verify: Whether the compiled headers are compared with their models.

    Raises:
        DqforgeError: As `chosen_rows` and `dqforge.reports.study_store.winners.export_row`; what
            was written before stays.
    """
    store = PartStore.existing(folder)
    rows = chosen_rows(store, which)
    study = stored_study(store)
    winners = [export_row(store, study, row, verify=verify) for row in rows]
    one = len(winners) == 1
    what = "1 design, with its header" if one else f"{len(winners)} designs, with their headers"
    title = f"{store.header.name}: {what}"
    return Answer(
        store.header.name,
        (_table(store, winners, title),),
        {"winners": [_plain(winner) for winner in winners]},
        notes=tuple(f"written: {winner.folder}" for winner in winners),
    )


def _table(store: PartStore, winners: Sequence[Winner], title: str) -> Table:
    """What was exported as the study knows it."""
    header = store.header
    columns = usual_columns(header)
    texts: list[tuple[str, ...]] = []
    for winner in winners:
        one = Condition(INDEX, "=", winner.index)
        part = winner.index // header.batch
        cells = find_rows(store, TableQuery(columns, (one,)), [part]).cells
        texts += people_texts(header, columns, cells)
    return Table(title, tuple(short_name(header, name) for name in columns), tuple(texts))


def _plain(winner: Winner) -> PlainData:
    files = sorted(winner.output.files)
    return {
        "index": winner.index,
        "out": str(winner.folder),
        "verified": winner.output.verification is not None,
        "files": files,
    }
