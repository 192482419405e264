"""What ``--table``, ``--where`` and ``--sort`` ask of a study: names of columns, conditions with
units, an order. Nothing in them is ever run.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Literal

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_quantity
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.machines.wording import close_matches, shown
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    STATES,
    ColumnSpec,
)
from dqforge.reports.study_store.column_texts import label
from dqforge.reports.study_store.part_file import INDEX, KEY, MESSAGE, OWN_COLUMNS, STATE
from dqforge.reports.study_store.study_header import StudyHeader

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
        raise InputError(f"--where: {shown(text)} is no condition; {_EXAMPLE}")
    name = _column(header, match["name"], "--where")
    operator, value = _SAME[match["operator"]], match["value"]
    spec = spec_of(header, name)
    if name in (MESSAGE, KEY) or spec.kind == "choice":
        if operator not in ("=", "!="):
            raise InputError(f"--where: {match['name']} holds words; write = or != before them")
        words = tuple(_listed(value))
        if not words:
            raise InputError(f"--where: {shown(text)} is no condition; {_EXAMPLE}")
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
