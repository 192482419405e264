"""What `dqforge explore --dry-run` answers: how many rows, which ones, how long, how many bytes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.console import stage
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.machines.exploration.study import Study
    from dqforge.optimizer.exploration.row_block import RowBlock, RowSource
    from dqforge.reports.plain_data import PlainData

_TRIED_ROWS = 200
_TRIED_S = 10.0
_QUICK_S = 0.5


def estimated_study(study: Study, plan: RowSource) -> Answer:
    """What a study would be, from its first rows.

    Args:
        study: The study.
        plan: Its rows; of a search those of the first generation, since others follow from them.
    """
    search = study.search
    known = plan.count if search is None else search.population
    tried, seconds, size = _tried(study, plan, known)
    factor = plan.count / max(tried, 1)
    parts = -(-plan.count // plan.batch)
    places = {"first": 0} if search is not None else {"first": 0, "last": plan.count - 1}
    ends = {name: _inputs(plan, plan.rows(row, row + 1)) for name, row in places.items()}
    names = sorted({name for end in ends.values() for name in end})
    shown = list(ends.values())[: plan.count]
    rows = tuple((name, *(end.get(name, "") for end in shown)) for name in names)
    heads = ("input", "first row", "last row")[: 1 + len(shown)]
    price = f"{_span(seconds * factor)} on one core, {size * factor / 1e6:,.3g} MB"
    notes = [
        f"{plan.count:,} rows in {parts:,} parts of {plan.batch:,}",
        f"about {price} (from {tried:,} rows)",
    ]
    plain: PlainData = {"rows": plan.count, "rows_per_part": plan.batch, **ends}
    if search is not None:
        notes[0] += f", {search.generations:,} generations of {search.population:,} rows"
        plain |= {"generations": search.generations, "population": search.population}
    return Answer(
        study.name, [Table(study.name, heads, rows)], {"study": plain}, notes=tuple(notes)
    )


def _tried(study: Study, plan: RowSource, known: int) -> tuple[int, float, int]:
    """Rows that were tried, what they took in s, and their bytes; of ``known`` ones.

    What is done once in a process, such as imports and tables of breakpoints, is left out: a row
    comes first. Where some rows take no time, a whole part tells more.
    """
    from dqforge.reports.study_engine.contained_rows import contained_rows
    from dqforge.reports.study_store.part_file import encode_part

    def timed(first: int, end: int) -> tuple[float, int]:
        began = time.perf_counter()
        block = contained_rows(plan, first, end)
        size = len(encode_part(block, plan.columns, study.digest))
        return time.perf_counter() - began, size

    stage("trying rows")
    timed(0, 1)
    first, seconds, size = 0, 0.0, 0
    step = min(plan.batch, _TRIED_ROWS)
    while first < min(_TRIED_ROWS, known) and seconds < _TRIED_S:
        end = min(first + step, known)
        took, added = timed(first, end)
        first, seconds, size = end, seconds + took, size + added
    if plan.batch > first and seconds < _QUICK_S:
        first = min(plan.batch, known)
        seconds, size = timed(0, first)
    return first, seconds, size


def _inputs(plan: RowSource, block: RowBlock) -> Mapping[str, str]:
    """What goes into the one row of a block, as it is printed."""
    from dqforge.optimizer.exploration.row_block import INPUT_COLUMN
    from dqforge.reports.study_store.column_texts import label, value_text

    found = {}
    for column in plan.columns:
        if column.name.startswith(INPUT_COLUMN):
            value = float(block.columns[column.name][0])
            found[label(column.name)] = value_text(column, value)
    return found


def _span(seconds: float) -> str:
    """A time as people say it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"
