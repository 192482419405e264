"""What a run of a study leads to, counted over the parts that are there."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.reports.study_store.part_store import PartStore

FAILED = ("no-solution", "refused", "crashed")


@dataclass(frozen=True, slots=True)
class FailedRows:
    """Rows that ended in the same state: how many, and the first of them with its message."""

    state: str
    count: int
    first: int
    message: str


@dataclass(frozen=True, slots=True)
class StudyOutcome:
    """A study after a run.

    Args:
        rows: Rows of the study.
        counts: Rows by state, in the order of `STATES`; rows that are not computed are in none.
        failures: By state, those that gave no numbers.
        audited: Largest relative deviation of the batch path from the single path, by output.
        computed: Rows that this run computed; the others were there.
        seconds: What it took; it stands in no file.
        workers: Processes that computed, 0 for the command's own.
    """

    rows: int
    counts: Mapping[str, int]
    failures: tuple[FailedRows, ...]
    audited: Mapping[str, float]
    computed: int
    seconds: float
    workers: int

    @property
    def done(self) -> int:
        """Rows that are there."""
        return sum(self.counts.values())

    @property
    def succeeded(self) -> bool:
        """Whether any row has its numbers."""
        return self.counts["ok"] + self.counts["limit"] > 0


def study_outcome(store: PartStore, *, computed: int, seconds: float, workers: int) -> StudyOutcome:
    """Look through the parts of a store; ``computed``, ``seconds`` and ``workers`` of the run."""
    counts = np.zeros(len(STATES), dtype=np.int64)
    first: dict[str, tuple[int, str]] = {}
    for part in store.read(["message"]):
        counts += np.bincount(part.states, minlength=len(STATES))
        for state in FAILED:
            own = np.flatnonzero(part.states == STATES.index(state))
            if own.size:
                first.setdefault(state, (part.first + int(own[0]), part.messages[own[0]]))
    by_state: dict[str, int] = dict(zip(STATES, counts.tolist(), strict=True))
    failures = [
        FailedRows(state, by_state[state], *first[state]) for state in FAILED if state in first
    ]
    return StudyOutcome(
        rows=store.header.count,
        counts=by_state,
        failures=tuple(failures),
        audited=store.survey().audited,
        computed=computed,
        seconds=seconds,
        workers=workers,
    )
