"""What is shown of a study: its columns in the units of people, what its rows say together, and
some of its rows for pictures.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, ColumnSpec
from dqforge.optimizer.study_results.summary import StudyQuestion, StudySummary
from dqforge.reports.study_store.column_texts import people_unit

if TYPE_CHECKING:
    from dqforge.reports.study_store.part_store import PartStore

MOST_PICTURED = 1500  # Rows of a picture besides those of the front: every n-th of the study.
MOST_OF_FRONT = 500


@dataclass(frozen=True, slots=True, eq=False)
class PicturedRows:
    """Some rows of a study.

    Args:
        index: Their indices, ascending, int64 (n,).
        states: Places in `dqforge.optimizer.exploration.row_block.STATES`, int8 (n,).
        columns: Numbers in SI units, of choices the places in their words, -1 for none, (n,).
        step: Every how manyth row is here, besides those of the front.
    """

    index: NDArray[np.int64]
    states: NDArray[np.int8]
    columns: Mapping[str, NDArray[np.float64]]
    step: int


@dataclass(frozen=True, slots=True, eq=False)
class StudyView:
    """Everything that a page or a table says of a study.

    Args:
        name, about: Words of its file.
        columns: All columns of its rows.
        rows: Rows of the study; ``summary.rows`` of them are computed.
        batch: Rows per part.
        summary: What the rows say together.
        pictured: Rows for pictures.
        audited: Largest relative deviation of the batch path from the single path, by output.
        computed_with: Versions of what computed it.
    """

    name: str
    about: str
    columns: tuple[ColumnSpec, ...]
    rows: int
    batch: int
    summary: StudySummary
    pictured: PicturedRows
    audited: Mapping[str, float]
    computed_with: Mapping[str, str]

    @property
    def question(self) -> StudyQuestion:
        """What was asked of the rows together."""
        return self.summary.question

    def spec(self, name: str) -> ColumnSpec:
        """The column of a whole name."""
        return next(column for column in self.columns if column.name == name)

    @property
    def varied(self) -> tuple[ColumnSpec, ...]:
        """Columns of inputs that are not the same in all pictured rows."""
        return tuple(
            column
            for column in self.columns
            if column.name.startswith(INPUT_COLUMN) and _changes(self.pictured.columns[column.name])
        )


def _changes(values: NDArray[np.float64]) -> bool:
    known = values[~np.isnan(values)]
    return bool(known.size and np.any(known != known[0]))


def shown_unit(spec: ColumnSpec, values: NDArray[np.float64]) -> tuple[str, float]:
    """Unit in which values of a column are drawn, and the factor from SI to it.

    Args:
        spec: A column of numbers.
        values: What is drawn, shape (n,); the largest one chooses the prefix.
    """
    finite = np.abs(values[np.isfinite(values)])
    plain = people_unit(spec)
    if plain == "" or not finite.size or not np.max(finite) > 0.0:
        return plain, 1.0
    largest = float(np.max(finite))
    figure, _, unit = format_quantity(largest, people_unit(spec), 15).partition(" ")
    factor = float(figure) / largest
    # Of a decimal prefix the factor is known exactly; the printed figure has 15 digits of it.
    power = 10.0 ** round(float(np.log10(factor)))
    return unit, power if abs(factor / power - 1.0) < 1e-9 else factor


def pictured_rows(
    store: PartStore, names: Sequence[str], front: Collection[int] = ()
) -> PicturedRows:
    """Rows for pictures: every n-th row of the study that is computed, and those of a front.

    Args:
        store: The study's folder; one part is in memory at a time.
        names: Whole names of the columns that are wanted.
        front: Indices of rows that are wanted in any case.
    """
    step = max(-(-store.header.count // MOST_PICTURED), 1)
    wanted = np.array(sorted(front)[:MOST_OF_FRONT], dtype=np.int64)
    index: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
    states: list[NDArray[np.int8]] = [np.empty(0, dtype=np.int8)]
    columns: dict[str, list[NDArray[np.float64] | NDArray[np.int32]]] = {name: [] for name in names}
    for part in store.read(names):
        own = part.first + np.arange(part.count, dtype=np.int64)
        kept = (own % step == 0) | np.isin(own, wanted)
        index.append(own[kept])
        states.append(part.states[kept])
        for name in names:
            columns[name].append(part.columns[name][kept])
    return PicturedRows(
        np.concatenate(index),
        np.concatenate(states),
        {name: _joined(found) for name, found in columns.items()},
        step,
    )


def _joined(pieces: list[NDArray[np.float64] | NDArray[np.int32]]) -> NDArray[np.float64]:
    """Pieces of one column, words' places as numbers."""
    return np.concatenate([np.empty(0), *pieces])
