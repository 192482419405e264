"""A study in this process."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest
from study_rows import StudyRows
from study_runs import opened, parts_hash, rows_there, run_in

from dqforge.optimizer.exploration.row_block import RowBlock
from dqforge.reports.exploration.contained_rows import EngineSettings
from dqforge.reports.exploration.local_cluster import StudyInterruptedError
from dqforge.reports.exploration.run_study import local_processes, run_study


def test_all_parts_are_written_and_counted(tmp_path: Path) -> None:
    rows = StudyRows(count=47, batch=10, refused=(3, 12), raising=(20,))
    outcome = run_in(tmp_path, rows, workers=1)
    assert rows_there(tmp_path) == list(range(47))
    assert outcome.counts == {"ok": 44, "limit": 0, "no-solution": 0, "refused": 2, "crashed": 1}
    assert [(each.state, each.count, each.first) for each in outcome.failures] == [
        ("refused", 2, 3),
        ("crashed", 1, 20),
    ]
    assert outcome.failures[0].message == "500 V is above 80 V"
    assert (outcome.rows, outcome.done, outcome.computed, outcome.workers) == (47, 47, 47, 0)
    assert outcome.succeeded
    assert outcome.audited == {"losses.total": pytest.approx(4.1e-14)}


def test_only_missing_parts_are_computed(tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    seen.mkdir()
    rows = StudyRows(count=50, batch=10, seen=seen)
    run_in(tmp_path / "a", rows, workers=1)
    before = parts_hash(tmp_path / "a")
    names = sorted((tmp_path / "a" / "parts").iterdir())
    names[1].unlink()
    names[3].write_bytes(names[3].read_bytes()[:-100])
    for mark in seen.iterdir():
        mark.unlink()
    outcome = run_in(tmp_path / "a", rows, workers=1)
    assert sorted(mark.name.split("-")[0] for mark in seen.iterdir()) == ["10", "30"]
    assert (outcome.computed, outcome.done) == (20, 50)
    assert parts_hash(tmp_path / "a") == before


def test_parts_that_are_asked_for_alone(tmp_path: Path) -> None:
    rows = StudyRows(count=50, batch=10)
    with opened(tmp_path, rows) as store:
        outcome = run_study(rows, store, EngineSettings(workers=1), only=range(2))
    assert rows_there(tmp_path) == list(range(20))
    assert (outcome.rows, outcome.done) == (50, 20)


@dataclass(frozen=True)
class PressedInRow(StudyRows):
    """Somebody presses Ctrl-C while row 25 is computed."""

    def rows(self, first: int, end: int) -> RowBlock:
        if first <= 25 < end:
            os.kill(os.getpid(), signal.SIGINT)
        return super().rows(first, end)


def test_ctrl_c_leaves_what_is_done(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(StudyInterruptedError) as stopped:
        run_in(tmp_path, PressedInRow(count=50, batch=10), workers=1)
    assert stopped.value.exit_code == 130
    assert str(stopped.value) == (
        "explore: interrupted after 20 of 50 rows; they are kept, run the same command again"
    )
    assert rows_there(tmp_path) == list(range(20))
    assert signal.getsignal(signal.SIGINT) is before


def test_processes_that_a_study_is_worth() -> None:
    assert local_processes(batch=1000, parts=2, asked=None) == 1
    assert local_processes(batch=20, parts=2, asked=None) == 1
    assert local_processes(batch=1000, parts=100, asked=1) == 1
    assert local_processes(batch=1000, parts=1, asked=8) == 8
    assert local_processes(batch=20, parts=100, asked=None) == len(os.sched_getaffinity(0))
