"""A changed study takes the rows that it has in common with an earlier one from there."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from dqforge.cli import main
from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.row_block import STATES, RowBlock
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.exploration.part_file import encode_part
from dqforge.reports.exploration.part_store import PartStore, study_header, study_inputs
from dqforge.reports.exploration.summary_files import ReusingRows

STUDY = """dqforge_study: 1
name: Loops
design: abb-syrm-6k7
vary:
  control.current_loop.bandwidth: {values: [%s]}
  machine.resistance: {values: [0.4 Ohm, 0.5 Ohm]}
outputs: [gains.i_d.phase_margin, gains.i_d.crossover, fit.path]
limits: {gains.i_d.crossover: {below: %s rad/s}}
"""
OLD = STUDY % ("100 Hz, 300 Hz, 90 kHz", "5000")
NEW = STUDY % ("100 Hz, 200 Hz, 300 Hz, 90 kHz", "1000")


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "old"
    study = study_of_text(OLD.encode(), "study.yaml")
    plan = StudyPlan(study)
    header = study_header(study, plan)
    with PartStore.open(folder, header, inputs=study_inputs(study)) as store:
        store.write(0, encode_part(plan.rows(0, 6), header.columns, header.digest))
    return folder


def same(one: RowBlock, other: RowBlock) -> None:
    assert [*one.columns] == [*other.columns]
    for name, values in one.columns.items():
        assert np.allclose(values, other.columns[name], rtol=1e-12, equal_nan=True), name
        assert values.dtype == other.columns[name].dtype
    assert np.array_equal(one.keys, other.keys)
    assert np.array_equal(one.states, other.states)
    assert one.messages == other.messages


def test_what_is_known_is_not_computed_again(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = StudyPlan(study_of_text(NEW.encode(), "study.yaml"))
    source = ReusingRows(plan, (old,))
    assert (source.count, source.batch, source.columns) == (8, plan.batch, plan.columns)
    whole = plan.rows(0, 8)
    asked = []
    compute = StudyPlan.rows_of

    def counted(self: StudyPlan, inputs: dict[str, np.ndarray], first: int, count: int) -> RowBlock:
        asked.append((first, count))
        return compute(self, inputs, first, count)

    monkeypatch.setattr(StudyPlan, "rows_of", counted)
    same(source.rows(0, 8), whole)
    assert asked == [(0, 2)]
    same(source.rows(4, 8), plan.rows(4, 8))
    ended = [STATES[state] for state in whole.states]
    assert ended[:2] == ["ok", "ok"]
    assert ended[4:6] == ["limit", "limit"]
    assert ended[6] in ("refused", "no-solution")


def test_it_travels_to_other_processes(old: Path) -> None:
    plan = StudyPlan(study_of_text(NEW.encode(), "study.yaml"))
    source = ReusingRows(plan, (old,))
    before = source.rows(0, 8)
    content = pickle.dumps(source)
    assert len(content) < 100_000
    same(pickle.loads(content).rows(0, 8), before)


def test_a_study_that_shares_nothing_is_computed(old: Path) -> None:
    other = NEW.replace("0.4 Ohm, 0.5 Ohm", "0.7 Ohm, 0.8 Ohm")
    plan = StudyPlan(study_of_text(other.encode(), "study.yaml"))
    same(ReusingRows(plan, (old,)).rows(0, 8), plan.rows(0, 8))


def test_the_option_of_the_command(
    old: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.yaml").write_text(NEW)
    command = ["explore", str(tmp_path / "study.yaml"), "--workers", "1", "-o"]
    for out, reuse in (("reused", ["--reuse", str(old)]), ("computed", [])):
        assert ended([*command, str(tmp_path / out), *reuse]) == 0
    reused, computed = (PartStore.existing(tmp_path / out) for out in ("reused", "computed"))
    assert reused.header.digest == computed.header.digest
    assert reused.finished() == computed.finished() == {0}
    name = "out.gains.i_d.crossover"
    (one,), (other,) = reused.read([name, "message"]), computed.read([name, "message"])
    assert np.allclose(one.columns[name], other.columns[name], rtol=1e-12, equal_nan=True)
    assert one.messages == other.messages
    capsys.readouterr()
    nowhere = tmp_path / "nowhere"
    assert ended([*command, str(tmp_path / "third"), "--reuse", str(nowhere)]) == 2
    assert capsys.readouterr().err == (
        f"dqforge: {nowhere} holds no study.json; name a folder that 'dqforge explore' wrote\n"
    )
    assert not (tmp_path / "third").exists()


def test_bytes_do_not_depend_on_where_the_study_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "study.yaml").write_text(OLD.replace("5000", "1000"))
    monkeypatch.chdir(tmp_path)
    for out, place in (("one", "study.yaml"), ("other", str(tmp_path / "study.yaml"))):
        assert ended(["explore", place, "--workers", "1", "-o", out]) == 0
    name = "parts/part-000000.parquet"
    assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()
    (part,) = PartStore.existing(tmp_path / "one").read(["message"])
    assert part.messages[2].startswith("study.yaml:")


def ended(arguments: list[str]) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    return int(caught.value.code or 0)
