"""Runs the parts of a study with a search: all parts of one generation are in before the next one
is asked for.

Which generations are finished is told by the stored parts alone. A run that goes on tells the
search their outcomes again, and computes what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, STATES
from dqforge.reports.pages.answer import stage
from dqforge.reports.study_engine.engine_settings import EngineSettings, StudyOutcome
from dqforge.reports.study_engine.run_study import computing, opened_run
from dqforge.reports.study_store.part_file import PartColumns
from dqforge.reports.study_store.part_store import PartStore

if TYPE_CHECKING:
    from dqforge.optimizer.exploration.study_search import GenerationRows, SearchedStudy, SearchRows

_CRASHED = STATES.index("crashed")


def run_search(
    searched: SearchedStudy,
    store: PartStore,
    settings: EngineSettings,
    only: Sequence[int] | None = None,
) -> StudyOutcome:
    """Compute what a store lacks of a study with a search.

    Args:
        searched: The study.
        store: Where parts go; those that it has stay.
        settings: On what they are computed.
        only: Numbers of the parts that are wanted, from 0 on; None for all.

    Raises:
        InputError: What is stored is not what this search comes to.
        EngineStoppedError: The run could not go on; what is done is kept.
    """
    run, missing = opened_run(store, settings, only)
    if not missing:
        return run.outcome()
    each = searched.parts_of_generation
    way = SearchedWay(searched, store, searched.begun())
    stage("finding the way of the search so far")
    way.go_to(min(missing) // each)
    with computing(run, searched.batch, len(missing), at_once=each) as compute:
        for number in range(way.number, max(missing) // each + 1):
            way.go_to(number)
            lacking = [part for part in way.parts if part in missing]
            if lacking:
                compute(way.rows, lacking)
    return run.outcome()


@dataclass(slots=True, eq=False)
class SearchedWay:
    """How far a search is along the generations that a store holds.

    Args:
        searched: The study.
        store: Its parts.
        search: Told all generations before that of ``number``.
    """

    searched: SearchedStudy
    store: PartStore
    search: SearchRows

    @property
    def number(self) -> int:
        """Of the generation that is asked for now."""
        return self.search.generation

    @property
    def parts(self) -> range:
        """Numbers of its parts."""
        each = self.searched.parts_of_generation
        return range(self.number * each, (self.number + 1) * each)

    @property
    def rows(self) -> GenerationRows:
        """Its rows."""
        return self.searched.generation(self.number, self.search.ask())

    def go_to(self, number: int) -> None:
        """Tell the search what the store holds of the generations before ``number``.

        Raises:
            InputError: Their rows are others than this search asks for.
        """
        while self.number < number:
            rows, judged = self.rows, self.searched.judged_columns
            inputs = [spec.name for spec in rows.columns if spec.name.startswith(INPUT_COLUMN)]
            stored = list(self.store.read([*judged, *inputs], self.parts))
            if sum(part.count for part in stored) != rows.size:
                raise ValueError(f"generation {self.number} is not finished")
            self._require(rows, stored)
            columns = {
                name: np.concatenate([part.columns[name] for part in stored]) for name in judged
            }
            states = np.concatenate([part.states for part in stored])
            self.search.tell(self.searched.outcomes(columns, states))

    def _require(self, rows: GenerationRows, stored: Sequence[PartColumns]) -> None:
        """Raise where rows were computed from other inputs; those of crashed rows are not known."""
        for part in stored:
            known = part.states != _CRASHED
            for name, values in rows.inputs(part.first, part.first + part.count).items():
                if not np.array_equal(part.columns[INPUT_COLUMN + name][known], values[known]):
                    raise InputError(
                        f"{self.store.folder}: {name} of generation {self.number} is not what the "
                        "search asks for here; take another -o, or --restart"
                    )
