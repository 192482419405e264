"""A small study with a search, run in a folder, and plans that note or do something beside."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, SupportsIndex

from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.row_block import Inputs, RowBlock
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.optimizer.exploration.study_search import SearchedStudy
from dqforge.reports.exploration.contained_rows import EngineSettings, StudyOutcome
from dqforge.reports.exploration.part_store import PartStore, StudyHeader, study_header
from dqforge.reports.exploration.run_study import run_search

_LOOPS = """\
dqforge_study: 1
name: Loops searched
design: paper001-pmsm-bench
vary:
  machine.resistance: {range: {from: 2 Ohm, to: 3 Ohm, count: 2}}
  machine.inductance_q: {range: {from: 2 mH, to: 8 mH, count: 2, spacing: log}}
  control.sampling_frequency: WHICH
outputs: [gains.i_q.phase_margin, gains.i_q.crossover]
"""
FRONT = (
    _LOOPS.replace("WHICH", "[5 kHz, 8 kHz, 10 kHz]")
    + """\
limits: {gains.i_q.crossover: {above: 100 Hz}}
pareto: {maximise: [gains.i_q.phase_margin, gains.i_q.crossover]}
search: {population: 8, generations: 4, seed: 3}
"""
)
ONE_GOAL = (
    _LOOPS.replace("WHICH", "{range: {from: 5 kHz, to: 10 kHz, count: 2}}")
    + """\
limits: {gains.i_q.phase_margin: {above: 60 deg}}
pareto: {maximise: [gains.i_q.crossover]}
search: {method: nlopt, population: 4, generations: 6, seed: 3}
"""
)


def study_of(text: str) -> Study:
    """A study from its text."""
    return study_of_text(text.encode(), "study.yaml")


def searched(plan: StudyPlan) -> SearchedStudy:
    """The rows of a plan whose study has a search."""
    assert plan.study.search is not None
    return SearchedStudy(plan, plan.study.search)


def header_of(study: SearchedStudy) -> StudyHeader:
    """What stands in ``study.json``."""
    return study_header(study.plan.study, study.generation(0, study.begun().ask()))


def run_into(
    folder: Path, plan: StudyPlan, parts: int | None = None, workers: int = 1
) -> StudyOutcome:
    """Run a search into a folder, or the first parts of it."""
    study = searched(plan)
    with PartStore.open(folder, header_of(study)) as store:
        only = None if parts is None else range(parts)
        return run_search(study, store, EngineSettings(workers=workers), only)


@dataclass(frozen=True, slots=True, eq=False)
class NotingPlan(StudyPlan):
    """Notes the first rows and sizes of the blocks that it is asked for."""

    asked: list[tuple[int, int]] = field(default_factory=list)

    def rows_of(self, inputs: Inputs, first: int, count: int) -> RowBlock:
        """Rows, noted."""
        self.asked.append((first, count))
        return StudyPlan.rows_of(self, inputs, first, count)


@dataclass(frozen=True, slots=True, eq=False)
class StruckPlan(StudyPlan):
    """Sends a signal to its own process when it comes to a row, for as long as there is no mark."""

    row: int = 0
    number: int = signal.SIGKILL
    mark: Path = Path()

    def __reduce_ex__(self, protocol: SupportsIndex) -> tuple[Any, ...]:
        """Travel with all of it."""
        return StruckPlan, (self.study, self.header, self.row, self.number, self.mark)

    def rows_of(self, inputs: Inputs, first: int, count: int) -> RowBlock:
        """Rows, unless it is time for the signal."""
        if first <= self.row < first + count and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), self.number)
        return StudyPlan.rows_of(self, inputs, first, count)
