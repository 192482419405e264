"""What ``--table``, ``--where`` and ``--sort`` ask of a study: names of columns, conditions with
units, an order. Nothing in them is ever run.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray
from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_quantity
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, OUTPUT_COLUMN, STATES, ColumnSpec
from dqforge.reports.exploration.part_file import (
    INDEX,
    KEY,
    MESSAGE,
    OWN_COLUMNS,
    STATE,
    PartColumns,
)
from dqforge.reports.exploration.part_store import PartStore, StudyHeader, label, value_text
from dqforge.reports.pages.answer import Answer, Table, write_atomically
from dqforge.reports.plain_data import PlainData

Operator = Literal["=", "!=", "<", "<=", ">", ">="]

_CONDITION = re.compile(
    r"\s*(?P<name>[^\s<>=!]+)\s*(?P<operator><=|>=|!=|<>|==|=|<|>)\s*(?P<value>.*?)\s*", re.DOTALL
)
_AND = re.compile(r"\s+and\s+", re.IGNORECASE)
_SAME: dict[str, Operator] = {
    "==": "=",
    "<>": "!=",
    "=": "=",
    "!=": "!=",
    "<": "<",
    "<=": "<=",
    ">": ">",
    ">=": ">=",
}
_EXAMPLE = "write e.g. --where 'losses.total < 600 W'"
_ROUND = ("bandwidth", "crossover")
_USUAL_OUTPUTS = 4


@dataclass(frozen=True, slots=True)
class Condition:
    """What a row must have.

    Args:
        name: Whole name of a column.
        operator: Numbers know all of them, words and texts ``=`` and ``!=``.
        number: What numbers are compared with, in the SI unit of the column.
        words: What words are compared with: patterns with ``*``, any of them.
    """

    name: str
    operator: Operator
    number: float = 0.0
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TableQuery:
    """Rows of a study that are looked for.

    Args:
        columns: Whole names of the columns that are shown.
        conditions: All of them hold.
        order: Columns that the rows go by, and whether the largest come first; by index where they
            are the same.
        first: How many rows, None for all.
    """

    columns: tuple[str, ...]
    conditions: tuple[Condition, ...] = ()
    order: tuple[tuple[str, bool], ...] = ()
    first: int | None = None

    @property
    def needed(self) -> tuple[str, ...]:
        """Columns that are shown, compared or sorted by."""
        compared = [condition.name for condition in self.conditions]
        return tuple(dict.fromkeys([*self.columns, *compared, *(name for name, _ in self.order)]))


def read_query(
    header: StudyHeader,
    table: str = "",
    where: Sequence[str] = (),
    sort: str = "",
    first: int | None = None,
) -> TableQuery:
    """What the options of a command ask.

    Args:
        header: The study.
        table: Names with commas between them, without ``in.`` or ``out.`` where that leaves no
            doubt, ``*`` for anything; empty for what varies and what the study is after.
        where: Conditions ``name < number unit``; ``and`` stands between several.
        sort: Names with commas between them, ``-name`` for the largest first.
        first: How many rows.

    Raises:
        InputError: There is no such column, the value has another unit, or the syntax is not
            understood.
    """
    if first is not None and first < 1:
        raise InputError(f"--first {first}: write a number of rows from 1 on")
    columns = _columns(header, table) if table.strip() else usual_columns(header)
    conditions = [
        _condition(header, text) for option in where for text in _AND.split(option.strip())
    ]
    order = []
    for word in _listed(sort):
        name = word.removeprefix("-")
        order.append((_column(header, name, "--sort"), name != word))
    return TableQuery(columns, tuple(conditions), tuple(order), first)


def usual_columns(header: StudyHeader) -> tuple[str, ...]:
    """What a table shows where nothing is asked for: what varies, and the goals of the study or
    its first outputs.
    """
    names = [column.name for column in header.columns]
    inputs = [name for name in names if name.startswith(INPUT_COLUMN)]
    outputs = [name for name in names if name.startswith(OUTPUT_COLUMN)]
    goals = [OUTPUT_COLUMN + goal["output"] for goal in header.study.get("goals", ())]
    wanted = [name for name in goals if name in outputs] or outputs[:_USUAL_OUTPUTS]
    return (INDEX, STATE, *inputs, *wanted)


def short_name(header: StudyHeader, name: str) -> str:
    """Name of a column without what says that it is an input or output, where one has it."""
    short = label(name)
    return short if len(_named(header, short)) == 1 else name


def spec_of(header: StudyHeader, name: str) -> ColumnSpec:
    """Unit and words of a column by its whole name."""
    if name == STATE:
        return ColumnSpec(STATE, "", "choice", STATES)
    return next((one for one in header.columns if one.name == name), ColumnSpec(name))


def _listed(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _all_names(header: StudyHeader) -> tuple[str, ...]:
    return (*OWN_COLUMNS, *(column.name for column in header.columns))


def _named(header: StudyHeader, name: str) -> list[str]:
    """Whole names of the columns that a name may mean."""
    known = _all_names(header)
    if name in known:
        return [name]
    return [one for one in (INPUT_COLUMN + name, OUTPUT_COLUMN + name) if one in known]


def _column(header: StudyHeader, name: str, option: str) -> str:
    found = _named(header, name)
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(f"{option}: {name} may be {found[0]} or {found[1]}; write one of these")
    raise InputError(f"{option}: the study has no column {shown(name)}{_meant(header, name)}")


def _meant(header: StudyHeader, name: str) -> str:
    known = _all_names(header)
    short = [label(one) for one in known]
    close = close_matches(name, dict.fromkeys([*short, *known]), 1)
    return f"; did you mean {close[0]}?" if close else f"; write one of: {_some(short)}"


def _some(names: Iterable[str], most: int = 8) -> str:
    listed = list(dict.fromkeys(names))
    return ", ".join(listed[:most]) + (", ..." if len(listed) > most else "")


def _columns(header: StudyHeader, table: str) -> tuple[str, ...]:
    found: list[str] = []
    for word in _listed(table):
        if "*" in word:
            fitting = [
                name for name in _all_names(header) if _fits(name, word) or _fits(label(name), word)
            ]
            if not fitting:
                raise InputError(f"--table: the study has no column like {shown(word)}")
            found += fitting
        else:
            found.append(_column(header, word, "--table"))
    return tuple(dict.fromkeys(found))


def _fits(text: str, pattern: str) -> bool:
    """Whether a text is what a pattern says, in which ``*`` alone stands for something else."""
    return fnmatchcase(text, re.sub(r"([\[?])", r"[\1]", pattern))


def fitting(words: Sequence[str], condition: Condition) -> tuple[bool, ...]:
    """Which of some words or texts are among those of a condition, whatever its operator."""
    return tuple(any(_fits(word, pattern) for pattern in condition.words) for word in words)


def _condition(header: StudyHeader, text: str) -> Condition:
    match = _CONDITION.fullmatch(text)
    if match is None or not match["value"]:
        raise InputError(f"--where: {shown(text)} is not a condition; {_EXAMPLE}")
    name = _column(header, match["name"], "--where")
    operator, value = _SAME[match["operator"]], match["value"]
    spec = spec_of(header, name)
    if name in (MESSAGE, KEY) or spec.kind == "choice":
        if operator not in ("=", "!="):
            raise InputError(f"--where: {match['name']} holds words; write = or != before them")
        words = tuple(_listed(value))
        if not words:
            raise InputError(f"--where: {shown(text)} is not a condition; {_EXAMPLE}")
        if spec.kind == "choice":
            _require_words(match["name"], words, spec.choices)
        return Condition(name, operator, words=words)
    return Condition(name, operator, _number(spec, value, match["name"]))


def _require_words(name: str, words: Sequence[str], choices: Sequence[str]) -> None:
    for word in words:
        if not any(_fits(choice, word) for choice in choices):
            close = close_matches(word, choices, 1)
            advice = f"did you mean {close[0]}?" if close else f"write one of: {_some(choices)}"
            raise InputError(f"--where: {name} is never {shown(word)}; {advice}")


def _number(spec: ColumnSpec, value: str, name: str) -> float:
    """A number with its unit, in the SI unit of a column; without one it is in that unit."""
    fitting_dimensions = [key for key, one in DIMENSIONS.items() if one.unit == spec.unit]
    if "bandwidth" in fitting_dimensions and any(word in name for word in _ROUND):
        fitting_dimensions = ["bandwidth"]
    if not fitting_dimensions:
        # Units that no key of a design has: the number is in them.
        value, fitting_dimensions = value.removesuffix(spec.unit), ["number"]
    try:
        return parse_quantity(value, fitting_dimensions[0])
    except InputError as error:
        raise InputError(f"--where {name}: {error.message}") from None


# What is found in a study, for people and programs: a table, JSON, a CSV file of any length.

USUAL_ROWS = 20  # Rows that a terminal shows where no number is asked for.


@dataclass(frozen=True, slots=True)
class TableRequest:
    """What the options of the command say, as they were written.

    ``table``, ``where``, ``sort`` and ``first`` as of
    `dqforge.reports.exploration.table_query.read_query`; ``csv`` is a file that is written.
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
    counts: list[int] = []

    def contents() -> Iterator[bytes]:
        for rows, content in pieces:
            counts.append(rows)
            yield content

    write_atomically(path, contents(), "--csv")
    return sum(counts)


# Rows of a study that a query looks for, part by part: memory holds one part and what is shown.

MOST_SORTED = 100_000  # Rows that are kept for sorting.
# Relative difference of numbers that count as equal: those of a grid have rounded ends.
_NEAR = 1e-9
Cells = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class FoundRows:
    """Rows that were found.

    Args:
        cells: By whole name of the column, (n,): numbers in SI units, places of words, of keys
            their hexadecimal digits, texts.
        matched: How many rows have what was asked.
        there: How many rows are computed.
        count: How many rows the study has.
    """

    cells: Cells
    matched: int
    there: int
    count: int

    @property
    def shown(self) -> int:
        """How many rows are among the cells."""
        return len(self.cells[INDEX])


def matching_parts(
    store: PartStore, query: TableQuery, parts: Collection[int] | None = None
) -> Iterator[tuple[int, Cells]]:
    """Number of rows of each part, and the cells of those that match, in their order; with the
    index whether it is shown or not. ``parts`` as of `PartStore.read`.
    """
    own = (INDEX, STATE)
    names = [name for name in query.needed if name not in own]
    kept = dict.fromkeys([INDEX, *query.columns, *(name for name, _ in query.order)])
    for part in store.read(names, parts):
        mask = np.ones(part.count, dtype=np.bool_)
        for condition in query.conditions:
            mask &= _holds(_cells(part, condition.name), condition, store.header)
        yield part.count, {name: _cells(part, name)[mask] for name in kept}


def find_rows(
    store: PartStore, query: TableQuery, parts: Collection[int] | None = None
) -> FoundRows:
    """The first rows of a query in its order, and how many match.

    Args:
        store: The study.
        query: What is looked for.
        parts: In which parts, None for all.

    Raises:
        InputError: More rows than can be sorted are asked for.
    """
    most = query.first or MOST_SORTED
    if most > MOST_SORTED:
        raise InputError(
            f"--first {most}: a table has at most {MOST_SORTED} rows; write --csv FILE"
        )
    kept: Cells | None = None
    matched = there = 0
    for count, cells in matching_parts(store, query, parts):
        there += count
        matched += len(cells[INDEX])
        kept = cells if kept is None else _joined(kept, cells, query, most)
        kept = _first(kept, query, most)
    if kept is None:
        kept = {name: np.empty(0) for name in dict.fromkeys([INDEX, *query.columns])}
    if query.order and query.first is None and matched > MOST_SORTED:
        raise InputError(
            f"{matched} rows match, of which {MOST_SORTED} can be sorted; write --first N"
        )
    return FoundRows(kept, matched, there, store.header.count)


def _joined(kept: Cells, cells: Cells, query: TableQuery, most: int) -> Cells:
    if not len(cells[INDEX]) or (not query.order and len(kept[INDEX]) >= most):
        return kept
    return {name: np.concatenate([kept[name], cells[name]]) for name in kept}


def _first(cells: Cells, query: TableQuery, most: int) -> Cells:
    """The first rows in the order of a query; what does not exist comes last."""
    if query.order:
        keys = [cells[INDEX]]
        for name, largest in reversed(query.order):
            values = cells[name]
            if values.dtype.kind not in "if":
                keys.append(np.unique(values, return_inverse=True)[1] * (-1 if largest else 1))
                continue
            lost = np.isnan(values) if values.dtype.kind == "f" else values < 0
            keys += [-values if largest else values, lost]
        chosen = np.lexsort(keys)[:most]
        return {name: values[chosen] for name, values in cells.items()}
    return {name: values[:most] for name, values in cells.items()}


def _cells(part: PartColumns, name: str) -> NDArray[Any]:
    if name == INDEX:
        return np.arange(part.first, part.first + part.count)
    if name == STATE:
        return part.states
    if name == KEY:
        return np.array([bytes(key).hex() for key in part.keys], dtype=object)
    if name == MESSAGE:
        return np.array(part.messages, dtype=object)
    return part.columns[name]


def _holds(values: NDArray[Any], condition: Condition, header: StudyHeader) -> BoolArray:
    """Which rows have what a condition asks; what does not exist never has."""
    spec = spec_of(header, condition.name)
    if spec.kind == "choice":
        wanted = condition.operator == "="
        table = np.array([found == wanted for found in fitting(spec.choices, condition)] + [False])
        return np.asarray(table[values.astype(np.int64)])
    if condition.name in (KEY, MESSAGE):
        found = fitting([str(value) for value in values], condition)
        return np.array([fits == (condition.operator == "=") for fits in found], dtype=np.bool_)
    return _compared(values.astype(np.float64), condition)


def _compared(values: NDArray[np.float64], condition: Condition) -> BoolArray:
    number = condition.number
    near = np.abs(values - number) <= _NEAR * abs(number)
    there = ~np.isnan(values)
    found: dict[str, BoolArray] = {
        "=": near,
        "!=": there & ~near,
        "<": (values < number) & ~near,
        "<=": (values < number) | near,
        ">": (values > number) & ~near,
        ">=": (values > number) | near,
    }
    return found[condition.operator]
