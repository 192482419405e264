"""Rows of a study become designs with headers: the design that was computed, and no other."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from study_blocks import Rows, filled

from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.exploration.part_file import FRONT, StoreError, encode_part
from dqforge.reports.exploration.part_store import PartStore, study_header, study_inputs
from dqforge.reports.exploration.summary_files import front_file
from dqforge.reports.exploration.winners import (
    answer_export,
    chosen_rows,
    export_row,
    row_design,
    row_text,
    stored_study,
)
from dqforge.reports.output.recomputation import recompute

STUDY = b"""dqforge_study: 1
name: Loops of a reluctance drive
design: abb-syrm-6k7
vary:
  control.current_loop.bandwidth: {values: [100 Hz, 200 Hz, 300 Hz]}
  inverter.switching_frequency: {values: [8 kHz, 10 kHz]}
outputs: [gains.i_d.phase_margin, gains.i_d.crossover, fit.error.torque]
pareto: {maximise: [gains.i_d.crossover]}
"""
PHASE, CROSSOVER = "out.gains.i_d.phase_margin", "out.gains.i_d.crossover"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study, computed."""
    folder = tmp_path_factory.mktemp("study") / "out"
    study = study_of_text(STUDY, "study.yaml")
    plan = StudyPlan(study)
    header = study_header(study, plan)
    with PartStore.open(folder, header, inputs=study_inputs(study)) as store:
        store.write(0, encode_part(plan.rows(0, 6), header.columns, header.digest))
        store.write_beside(FRONT, front_file(store, np.array([1, 4])))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_the_best_row_is_written_proven_and_computed_again(folder: Path) -> None:
    answer = answer_export(folder, "1")
    (winner,) = answer.plain["winners"]
    assert (winner["index"], winner["verified"]) == (4, True)
    place = folder / "winners" / "row-000004"
    assert winner["out"] == str(place)
    result = json.loads((place / "result.json").read_bytes())
    (part,) = PartStore.existing(folder).read([PHASE, CROSSOVER])
    loop = result["gains"]["i_d"]
    assert loop["phase_margin_rad"] == pytest.approx(part.columns[PHASE][4], rel=1e-8)
    assert loop["crossover_rad_per_s"] == pytest.approx(part.columns[CROSSOVER][4], rel=1e-8)
    text = (place / "dqforge-input" / "design.yaml").read_text()
    assert text.startswith("# Reluctance machine of 6.7 kW without magnets")
    assert "bandwidth: {value: 1884.95559" in text or "bandwidth: 1884.95559" in text
    assert recompute(place).listed == ()
    assert answer.tables[0].rows[0][0] == "4"
    assert answer.notes == (f"written: {place}",)


def test_rows_by_number_front_and_goal(folder: Path) -> None:
    store = PartStore.existing(folder)
    (part,) = store.read([CROSSOVER])
    order = np.argsort(-part.columns[CROSSOVER], kind="stable")
    assert chosen_rows(store, "3") == tuple(order[:3])
    assert chosen_rows(store, "100") == tuple(order)
    assert chosen_rows(store, "row:5") == (5,)
    assert chosen_rows(store, "row:5,0,5") == (5, 0)
    assert chosen_rows(store, "front") == (4, 1)


@pytest.mark.parametrize(
    ("which", "message"),
    [
        ("0", "--export 0: write a number of rows, row:INDEX (several with commas), or front"),
        ("-1", "--export -1: write a number"),
        ("best", "--export best: write a number"),
        ("row:", "--export row:: write a number"),
        ("row:1-3", "--export row:1-3: write a number"),
        ("row:6", "--export row:6: the study has 6 rows, from 0 on"),
        ("row:../../x", "--export row:../../x: write a number"),
        ("", "--export : write a number"),
    ],
)
def test_what_is_not_understood(folder: Path, which: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        chosen_rows(PartStore.existing(folder), which)
    assert str(caught.value).startswith(message)


def test_rows_that_are_not_there(folder: Path) -> None:
    (folder / FRONT).unlink()
    with pytest.raises(InputError, match=r"has no front\.parquet yet"):
        chosen_rows(PartStore.existing(folder), "front")
    (folder / FRONT).write_bytes(b"PAR1")
    with pytest.raises(StoreError, match=r"front\.parquet: it cannot be read"):
        chosen_rows(PartStore.existing(folder), "front")
    (folder / "parts" / "part-000000.parquet").unlink()
    store = PartStore.existing(folder)
    with pytest.raises(InputError, match="row:1: it is not computed yet"):
        chosen_rows(store, "row:1")
    with pytest.raises(InputError, match="has no row in state ok"):
        chosen_rows(store, "3")
    none = replace(store.header, study=store.header.study | {"goals": []})
    with pytest.raises(InputError, match="requests no pareto, so no row is best"):
        chosen_rows(replace(store, header=none), "3")
    (folder / "study-input" / "design.yaml").unlink()
    with pytest.raises(StoreError, match=r"design\.yaml: No such file or directory; run"):
        stored_study(store)


def test_a_design_that_was_not_the_one_computed_is_refused(folder: Path) -> None:
    place = folder / "study-input" / "design.yaml"
    place.write_bytes(place.read_bytes().replace(b"41.5 mH", b"40.5 mH"))
    store = PartStore.existing(folder)
    with pytest.raises(
        StoreError, match=r"row 2: the design in .* is not the one that was computed"
    ):
        export_row(store, stored_study(store), 2)
    assert not (folder / "winners").exists()


def test_designs_of_rows_have_the_values_of_the_rows(folder: Path) -> None:
    store = PartStore.existing(folder)
    study = stored_study(store)
    assert replace(study, places=None) == replace(study_of_text(STUDY, "study.yaml"), places=None)
    seen = set()
    for row in range(6):
        design = row_design(study, row_text(store, study, row), f"row {row}")
        values = {value.path: value.si for value in design.values}
        seen.add((values["inverter.switching_frequency"], design.digest))
    assert len(seen) == 6
    assert {frequency for frequency, _ in seen} == {8000.0, 10000.0}


def test_restart_takes_winners_away_but_for_what_was_changed(folder: Path) -> None:
    store = PartStore.existing(folder)
    study = stored_study(store)
    for row in (0, 1):
        export_row(store, study, row, verify=False)
    changed = folder / "winners" / "row-000001" / "abbsyrm.h"
    changed.write_bytes(b"mine")
    PartStore.open(folder, store.header, restart=True, inputs=study_inputs(study)).close()
    left = [path for path in (folder / "winners").rglob("*") if path.is_file()]
    assert left == [changed]


def test_the_file_of_the_front_has_whole_rows(tmp_path: Path) -> None:
    whole = Rows(1050).rows(0, 1050)
    index = np.array([3, 99, 100, 420, 1049])
    with filled(tmp_path / "out") as store:
        data = front_file(store, index)
        assert data == front_file(store, index)
        store.write_beside(FRONT, data)
        with pytest.raises(ValueError, match="1 rows of the front are not there"):
            front_file(store, np.array([3, 5000]))
        assert front_file(store, index[:0])[:4] == b"PAR1"
    table = parquet.read_table(tmp_path / "out" / FRONT)
    assert table["index"].to_pylist() == index.tolist()
    total = table["out.losses.total"].to_numpy()
    assert np.array_equal(total, whole.columns["out.losses.total"][index], equal_nan=True)
    assert table["message"].to_pylist() == [whole.messages[row] or None for row in index]
    assert [bytes(key) for key in whole.keys[index]] == table["key"].to_pylist()
