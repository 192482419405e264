"""A study with a search: generation after generation, with the same bytes however it is run."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from searched_rows import (
    FRONT,
    ONE_GOAL,
    NotingPlan,
    StruckPlan,
    header_of,
    run_into,
    searched,
    study_of,
)
from study_runs import parts_hash, rows_there

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_block import KnownRows
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.exploration.local_cluster import StudyInterruptedError
from dqforge.reports.exploration.part_file import encode_part
from dqforge.reports.exploration.part_store import PartStore

INPUTS = ("in.machine.resistance", "in.machine.inductance_q", "in.control.sampling_frequency")


def plan_of(text: str = FRONT) -> StudyPlan:
    return StudyPlan(study_of(text))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study, run at once in this process."""
    folder = tmp_path_factory.mktemp("whole")
    assert run_into(folder, plan_of()).computed == 32
    return folder


def test_rows_are_what_the_search_asks_for(whole: Path) -> None:
    assert rows_there(whole) == list(range(32))
    store = PartStore.existing(whole)
    assert (store.header.batch, store.header.parts) == (2, 16)
    parts = list(store.read(INPUTS))
    found = [np.concatenate([part.columns[name] for part in parts]) for name in INPUTS]
    assert np.all((found[0] >= 2.0) & (found[0] <= 3.0))
    assert np.all((found[1] >= 2e-3) & (found[1] <= 8e-3))
    assert set(found[2]) <= {5e3, 8e3, 10e3}
    assert len(np.unique(found[0])) > 8  # anywhere in the range, not at its two steps
    first = searched(plan_of()).begun().ask()
    assert np.array_equal(first[:, :2], np.column_stack(found)[:8, :2])
    assert np.array_equal(np.array([5e3, 8e3, 10e3])[first[:, 2].astype(int)], found[2][:8])


@pytest.mark.parametrize("text", [FRONT, ONE_GOAL])
def test_after_a_stop_at_any_part_the_rest_follows(text: str, tmp_path: Path) -> None:
    outcome = run_into(tmp_path / "whole", plan_of(text))
    parts = len([*(tmp_path / "whole" / "parts").iterdir()])
    each = outcome.rows // parts
    for stop in (1, parts // 2 + 1, parts - 1):
        folder = tmp_path / str(stop)
        assert run_into(folder, plan_of(text), stop).computed == stop * each
        rest = run_into(folder, plan_of(text))
        assert (rest.computed, rest.done) == (outcome.rows - stop * each, outcome.rows)
        assert parts_hash(folder) == parts_hash(tmp_path / "whole")


def test_parts_that_are_gone_are_computed_anew_and_no_others(whole: Path, tmp_path: Path) -> None:
    run_into(tmp_path, plan_of())
    for part in (2, 9):
        (tmp_path / "parts" / f"part-{part:06d}.parquet").unlink()
    plan = NotingPlan(study_of(FRONT))
    assert run_into(tmp_path, plan).computed == 4
    assert plan.asked == [(4, 2), (18, 2)]
    assert parts_hash(tmp_path) == parts_hash(whole)
    again = NotingPlan(study_of(FRONT))
    assert run_into(tmp_path, again).computed == 0
    assert again.asked == []


def test_more_generations_begin_with_the_parts_of_fewer(whole: Path, tmp_path: Path) -> None:
    run_into(tmp_path, plan_of(FRONT.replace("generations: 4", "generations: 2")))
    assert run_into(tmp_path, plan_of()).computed == 16
    assert parts_hash(tmp_path) == parts_hash(whole)


def test_two_workers_write_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    outcome = run_into(tmp_path, plan_of(), workers=2)
    assert (outcome.workers, outcome.computed) == (2, 32)
    assert parts_hash(tmp_path) == parts_hash(whole)


@pytest.mark.slow
def test_a_worker_that_is_killed_changes_no_byte(whole: Path, tmp_path: Path) -> None:
    plan = StruckPlan(study_of(FRONT), row=19, mark=tmp_path / "struck")
    outcome = run_into(tmp_path / "out", plan, workers=2)
    assert plan.mark.exists()
    assert (outcome.workers, outcome.computed, outcome.counts["crashed"]) == (2, 32, 0)
    assert parts_hash(tmp_path / "out") == parts_hash(whole)


def test_ctrl_c_leaves_what_is_done_and_the_next_run_goes_on(whole: Path, tmp_path: Path) -> None:
    plan = StruckPlan(study_of(FRONT), None, 13, signal.SIGINT, tmp_path / "struck")
    with pytest.raises(StudyInterruptedError, match="12 of 32 rows") as stopped:
        run_into(tmp_path / "out", plan)
    assert stopped.value.exit_code == 130
    assert rows_there(tmp_path / "out") == list(range(12))
    assert run_into(tmp_path / "out", plan_of()).computed == 20
    assert parts_hash(tmp_path / "out") == parts_hash(whole)


def test_rows_that_the_search_would_not_ask_for_are_not_built_upon(tmp_path: Path) -> None:
    plan = plan_of()
    study = searched(plan)
    run_into(tmp_path, plan, 4)
    with PartStore.open(tmp_path, header_of(study)) as store:
        rows = study.generation(0, study.begun().ask() * 1.0001)
        rows = replace(rows, points=np.where(rows.points < 3.0, rows.points, 2.5))
        store.write(1, encode_part(rows.rows(2, 4), rows.columns, store.header.digest))
    with pytest.raises(InputError, match=r"machine\.resistance of generation 0 is not what the se"):
        run_into(tmp_path, plan_of())


def test_rows_of_a_generation_are_known_before_they_are_computed() -> None:
    study = searched(plan_of())
    rows = study.generation(0, study.begun().ask())
    block = rows.rows(2, 4)
    assert isinstance(rows, KnownRows)
    assert np.array_equal(rows.keys(2, 4), block.keys)
    for name, values in rows.inputs(2, 4).items():
        assert np.array_equal(values, block.columns[f"in.{name}"])


def test_a_range_that_is_spaced_otherwise_is_another_study(whole: Path) -> None:
    other = FRONT.replace(", spacing: log", "")
    with pytest.raises(InputError, match=r"another study \(1 of .*: vary\.machine\.inductance_q\)"):
        run_into(whole, plan_of(other))


def test_the_plan_of_a_search_has_no_rows_of_a_grid() -> None:
    with pytest.raises(ValueError, match="their own inputs"):
        plan_of().rows(0, 2)
