"""What is found in a study, for people and programs: a table, JSON, a CSV file of any length."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData
from dqforge.reports.study_store.column_texts import value_text
from dqforge.reports.study_store.part_file import INDEX
from dqforge.reports.study_store.part_store import PartStore
from dqforge.reports.study_store.study_header import StudyHeader
from dqforge.reports.study_store.table_query import (
    TableQuery,
    read_query,
    short_name,
    spec_of,
)
from dqforge.reports.study_store.table_rows import Cells, FoundRows, find_rows, matching_parts

USUAL_ROWS = 20  # Rows that a terminal shows where no number is asked for.


@dataclass(frozen=True, slots=True)
class TableRequest:
    """What the options of the command say, as they were written.

    ``table``, ``where``, ``sort`` and ``first`` as of
    `dqforge.reports.study_store.table_query.read_query`; ``csv`` is a file that is written.
    """

    table: str = ""
    where: tuple[str, ...] = ()
    sort: str = ""
    first: int | None = None
    csv: Path | None = None


def answer_table(folder: Path, asked: TableRequest) -> Answer:
    """Look into a folder that 'dqforge explore' wrote.

    A file takes all rows that match, the terminal the first ones.

    Args:
        folder: Of the study.
        asked: Which columns of which rows.

    Raises:
        InputError: The folder holds no study, the request is not understood, or the file cannot be
            written.
        StoreError: A part is damaged.
    """
    store = PartStore.existing(folder)
    query = read_query(store.header, asked.table, asked.where, asked.sort, asked.first)
    if asked.csv is not None:
        _require_place(asked.csv)
        written = write_pieces(asked.csv, csv_pieces(store, query))
        return Answer(
            store.header.name,
            (),
            {"csv": str(asked.csv), "written": written},
            notes=(f"written: {asked.csv} ({written} rows)",),
        )
    most = asked.first or USUAL_ROWS
    shown = TableQuery(query.columns, query.conditions, query.order, most)
    found = find_rows(store, shown)
    title, notes = _title(store.header, found), _notes(found)
    return Answer(
        store.header.name,
        (rows_table(store.header, query.columns, found.cells, title, notes),),
        plain_rows(store.header, query.columns, found),
    )


def _title(header: StudyHeader, found: FoundRows) -> str:
    return f"{header.name}: {found.shown} of {found.matched} rows"


def _notes(found: FoundRows) -> tuple[str, ...]:
    if found.there == found.count:
        return ()
    return (f"{found.there} of {found.count} rows are computed",)


def rows_table(
    header: StudyHeader,
    columns: Sequence[str],
    cells: Cells,
    title: str,
    notes: tuple[str, ...] = (),
) -> Table:
    """Rows for the terminal: quantities with their unit, nothing where there is none.

    Args:
        header: The study.
        columns: Whole names, in their order.
        cells: As of `FoundRows`.
        title, notes: As of `Table`.
    """
    heads = tuple(short_name(header, name) for name in columns)
    return Table(title, heads, people_texts(header, columns, cells), notes)


def people_texts(
    header: StudyHeader, columns: Sequence[str], cells: Cells
) -> tuple[tuple[str, ...], ...]:
    """Cells of `rows_table`, row by row."""
    texts = [[_people(header, name)(value) for value in cells[name].tolist()] for name in columns]
    return tuple(zip(*texts, strict=True))


def _people(header: StudyHeader, name: str) -> Callable[[Any], str]:
    """How the values of a column read."""
    spec = spec_of(header, name)

    def text(value: Any) -> str:
        number = isinstance(value, float)
        return value_text(spec, value) if number or spec.kind == "choice" else str(value)

    return text


def plain_rows(header: StudyHeader, columns: Sequence[str], found: FoundRows) -> PlainData:
    """Rows for programs, in SI units; null for what does not exist."""
    specs = [spec_of(header, name) for name in columns]
    values = [
        [_plain(spec.choices, value) if spec.kind == "choice" else value for value in cells]
        for spec, cells in zip(specs, (found.cells[name].tolist() for name in columns), strict=True)
    ]
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]
    return {
        "rows": found.count,
        "computed": found.there,
        "matched": found.matched,
        "columns": [{"name": spec.name, "unit": spec.unit} for spec in specs],
        "table": rows,
    }


def _plain(choices: Sequence[str], place: int) -> str | None:
    return choices[place] if place >= 0 else None


def csv_pieces(store: PartStore, query: TableQuery) -> Iterator[tuple[int, bytes]]:
    """Pieces of a CSV file with their number of rows, a part at a time where nothing is sorted;
    numbers in SI units with all their digits.
    """
    header, columns = store.header, query.columns
    heads = []
    for name in columns:
        unit = spec_of(header, name).unit
        heads.append(f"{name} [{unit}]" if unit else name)
    first_line = io.StringIO()
    csv.writer(first_line, lineterminator="\n").writerow(heads)
    yield 0, first_line.getvalue().encode()
    if query.order:
        found = find_rows(store, query)
        yield found.shown, _csv(header, columns, found.cells)
        return
    left = query.first
    for _, cells in matching_parts(store, query):
        some = cells if left is None else {name: cells[name][:left] for name in cells}
        count = len(some[INDEX])
        yield count, _csv(header, columns, some)
        left = None if left is None else left - count
        if left == 0:
            return


def _csv(header: StudyHeader, columns: Sequence[str], cells: Cells) -> bytes:
    """Rows as lines, without the one with the names."""
    import pyarrow as pa
    from pyarrow.csv import WriteOptions, write_csv

    arrays = []
    for name in columns:
        spec, values = spec_of(header, name), cells[name]
        if spec.kind == "choice":
            words = pa.array([*spec.choices, None], pa.string())
            # The place of no word is -1: that of the last entry.
            arrays.append(words.take(pa.array(values.astype(np.int64) % len(words))))
        elif values.dtype.kind in "if":
            arrays.append(pa.array(values, from_pandas=True))
        else:
            arrays.append(pa.array([value or None for value in values], pa.string()))
    sink = pa.BufferOutputStream()
    options = WriteOptions(include_header=False, quoting_style="needed")
    write_csv(pa.Table.from_arrays(arrays, list(columns)), sink, options)
    return bytes(sink.getvalue())


def _require_place(path: Path) -> None:
    if path.is_dir() or not path.parent.is_dir():
        reason = "it is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise InputError(f"cannot write {path}: {reason}; choose another file with --csv")


def write_pieces(path: Path, pieces: Iterator[tuple[int, bytes]]) -> int:
    """Write a file piece by piece beside its place, and rename it; returns the number of rows.

    Raises:
        InputError: It cannot be written; what stood there is there as it was.
    """
    temporary = path.parent / f".{path.name}.{os.getpid()}.new"
    count = 0
    try:
        with temporary.open("xb") as file:
            for rows, content in pieces:
                count += rows
                file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror}; choose another file with --csv"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    return count
