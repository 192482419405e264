"""Winners of a study: their design files, and their headers by the exact path, proven as in `run`;
and what ``explore --export`` answers.

What a study computes by batches is no header. The design of a row is written with the comments of
the design that the study starts from, read as a file, and solved, emitted and verified like any.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.exploration.row_designs import design_text_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    row_assignments,
    row_keys,
)
from dqforge.reports.exploration.part_file import FRONT, INDEX, KEY, WINNERS, StoreError, read_whole
from dqforge.reports.exploration.part_store import PartStore, input_names, study_from
from dqforge.reports.exploration.table_query import (
    Condition,
    TableQuery,
    find_rows,
    people_texts,
    short_name,
    usual_columns,
)
from dqforge.reports.output.folder import RUN, write_output
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run import RunOutput, export_design

_MOST = 1000
_ROWS = re.compile(r"row:(\d{1,12}(?:,\d{1,12})*)")


@dataclass(frozen=True, slots=True)
class Winner:
    """A row that was exported.

    Args:
        index: Of the row.
        folder: Where its files lie.
        output: What was made.
    """

    index: int
    folder: Path
    output: RunOutput


def chosen_rows(store: PartStore, which: str) -> tuple[int, ...]:
    """Indices of the rows that ``--export`` means.

    Args:
        store: The study.
        which: A number of the best ones, ``row:INDEX`` (several with commas), or ``front``.

    Raises:
        InputError: It is none of these, there are no such rows, or the study has no goal to be best
            in.
    """
    named = _ROWS.fullmatch(which.strip())
    if named is not None:
        rows = tuple(dict.fromkeys(int(row) for row in named[1].split(",")))
        _require_rows(store, rows)
        return rows
    if which.strip() == "front":
        return _few(store, _front(store))
    if re.fullmatch(r"[1-9]\d{0,8}", which.strip()):
        return _few(store, _best(store, int(which)))
    raise InputError(
        f"--export {which}: write a number of rows, row:INDEX (several with commas), or front"
    )


def _few(store: PartStore, rows: tuple[int, ...]) -> tuple[int, ...]:
    if not rows:
        raise InputError(f"{store.folder} has no row in state ok; there is nothing to export")
    if len(rows) > _MOST:
        raise InputError(f"--export: {len(rows)} rows, at most {_MOST} are written; name fewer")
    return rows


def _require_rows(store: PartStore, rows: Sequence[int]) -> None:
    header = store.header
    for row in rows:
        if row >= header.count:
            raise InputError(f"--export row:{row}: the study has {header.count} rows, from 0 on")
        if not list(store.read([], [row // header.batch])):
            raise InputError(f"--export row:{row}: it is not computed yet; continue the study")


def _goals(store: PartStore) -> tuple[tuple[str, bool], ...]:
    """Columns of the goals of a study, and whether the largest are the best."""
    goals = store.header.study["goals"]
    if not goals:
        raise InputError(
            "--export: the study requests no pareto, so no row is best; write row:INDEX"
        )
    return tuple((OUTPUT_COLUMN + goal["output"], not goal["minimise"]) for goal in goals)


def _best(store: PartStore, count: int) -> tuple[int, ...]:
    """The best rows by the only goal; of several goals those of the front, by the first one."""
    goals = _goals(store)
    if len(goals) > 1:
        return _front(store)[:count]
    name = goals[0][0]
    most = min(count, _MOST + 1)
    ok = Condition("state", "=", words=("ok",))
    found = find_rows(store, TableQuery((INDEX, name), (ok,), goals, most))
    there = ~np.isnan(found.cells[name])
    return tuple(int(row) for row in found.cells[INDEX][there])


def _front(store: PartStore) -> tuple[int, ...]:
    """Rows of the front in its file, by the first goal."""
    import pyarrow as pa
    from pyarrow import parquet

    (name, largest), *_ = _goals(store)
    path = store.folder / FRONT
    try:
        table = parquet.read_table(pa.BufferReader(read_whole(path)), columns=[INDEX, name])
        index, goal = table[INDEX].to_numpy(), table[name].to_numpy()
    except FileNotFoundError:
        raise InputError(f"{store.folder} has no {FRONT} yet; run the study to its end") from None
    except (pa.ArrowException, OSError, KeyError) as error:
        raise StoreError(f"{path}: it cannot be read; run the study again") from error
    order = np.lexsort([index, -goal if largest else goal])
    return tuple(int(row) for row in index[order])


def stored_study(store: PartStore) -> Study:
    """The study of a folder, from what lies in it.

    Raises:
        StoreError: A file is missing.
    """
    plain = store.header.study
    try:
        contents = {name: read_whole(store.folder / name) for name in input_names(plain)}
    except OSError as error:
        raise StoreError(
            f"{error.filename}: {error.strerror}; run the study again, which writes it again"
        ) from error
    return study_from(plain, contents)


def row_text(store: PartStore, study: Study, row: int) -> bytes:
    """The design file of a row.

    Raises:
        StoreError: What lies in the folder does not give the design that the row was computed for.
        InputError: A value of the row is none that a design may have.
    """
    header = store.header
    names = [column.name for column in header.columns]
    inputs = [name for name in names if name.startswith(INPUT_COLUMN)]
    (part,) = store.read([*inputs, KEY], [row // header.batch])
    place = row - part.first
    values = {
        name.removeprefix(INPUT_COLUMN): part.columns[name][place : place + 1] for name in inputs
    }
    outputs = [name.removeprefix(OUTPUT_COLUMN) for name in names if name not in inputs]
    key = row_keys(study, values, outputs)[0]
    if not np.array_equal(key, part.keys[place]):
        raise StoreError(
            f"row {row}: the design in {store.folder} is not the one that was computed; run the "
            "study again"
        )
    return design_text_of(study, row_assignments(study, values, 0))


def row_design(study: Study, text: bytes, source: str) -> Design:
    """A design file of a row, read like any file beside those that it names."""
    with scratch_folder() as copy:
        for name, content in study.named:
            path = copy / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return load_text(text, source, copy)


def export_row(store: PartStore, study: Study, row: int, *, verify: bool = True) -> Winner:
    """Write the design of a row and its headers into a folder of their own.

    Args:
        store, study: The folder and the study in it (`stored_study`).
        row: Index of the row.
        verify: Whether the compiled headers are compared with their models.

    Raises:
        DqforgeError: As `dqforge.reports.run.export_design`, with the row; as `row_text`.
    """
    stage(f"row {row}")
    folder = store.folder / WINNERS / f"row-{row:06d}"
    try:
        text = row_text(store, study, row)
        design = row_design(study, text, f"row {row}")
        output = export_design(design, verify=verify)
        write_output(folder, RUN, output.files, design)
    except DqforgeError as error:
        if f"row {row}" not in str(error):
            error.message = f"row {row}: {error.message}"
        raise
    return Winner(row, folder, output)


# What `dqforge explore OUT --export` answers: which rows were written where, and their proof.


def answer_export(folder: Path, which: str, *, verify: bool = True) -> Answer:
    """Write the designs and headers of rows of a study.

    Args:
        folder: Of the study.
        which: As of `dqforge.reports.exploration.winners.chosen_rows`.
        verify: Whether the compiled headers are compared with their models.

    Raises:
        DqforgeError: As `chosen_rows` and `dqforge.reports.exploration.winners.export_row`; what
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
