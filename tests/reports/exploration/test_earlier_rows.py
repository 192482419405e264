"""Rows of earlier studies, found by their keys."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_blocks import COLUMNS, Rows, filled, header, keys_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_block import STATES, ColumnSpec, RowBlock
from dqforge.reports.exploration import summary_files as earlier_rows
from dqforge.reports.exploration.part_file import encode_part, part_name
from dqforge.reports.exploration.part_store import PartStore
from dqforge.reports.exploration.summary_files import EarlierRows


@pytest.fixture(params=["memory", "files"])
def where(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "files":
        monkeypatch.setattr(earlier_rows, "_IN_MEMORY", 0)
    return str(request.param)


def test_rows_are_found_by_their_keys_wherever_they_stand_now(tmp_path: Path, where: str) -> None:
    filled(tmp_path / "old").close()
    order = np.random.default_rng(1).permutation(1400)[:1000]
    with closing(EarlierRows.of([tmp_path / "old"], COLUMNS)) as earlier:
        assert (len(earlier), earlier.folder is not None) == (1050, where == "files")
        found = earlier.outputs(keys_of(order), COLUMNS)
    assert np.array_equal(found.found, order < 1050)
    whole = Rows(1400).rows(0, 1400)
    for column in COLUMNS[2:]:
        wanted = np.where(order < 1050, whole.columns[column.name][order], np.nan)
        assert np.array_equal(found.columns[column.name], wanted, equal_nan=True)
    assert np.array_equal(found.states, np.where(order < 1050, whole.states[order], -1))
    assert found.messages == tuple(whole.messages[k] if k < 1050 else "" for k in order)


def test_nothing_is_found_in_an_empty_folder(tmp_path: Path, where: str) -> None:
    PartStore.open(tmp_path / "old", header()).close()
    with closing(EarlierRows.of([tmp_path / "old"], COLUMNS)) as earlier:
        assert not earlier.outputs(keys_of(np.arange(9)), COLUMNS).found.any()
    with closing(EarlierRows.of([], COLUMNS)) as none:
        assert len(none) == 0


def test_keys_that_share_their_first_half(tmp_path: Path, where: str) -> None:
    keys = keys_of(np.arange(100))
    keys[:, :8] = 7
    block = replace(Rows(100).rows(0, 100), keys=keys)
    with PartStore.open(tmp_path / "old", header(100)) as store:
        store.write(0, encode_part(block, COLUMNS, store.header.digest))
    stranger = keys[:1].copy()
    stranger[0, 15] ^= 1
    with closing(EarlierRows.of([tmp_path / "old"], COLUMNS)) as earlier:
        assert np.array_equal(earlier.find(keys)[:, 1], np.arange(100))
        assert earlier.find(stranger).tolist() == [[-1, -1]]


def test_crashed_rows_rows_without_key_and_damaged_parts_are_computed(tmp_path: Path) -> None:
    filled(tmp_path / "old").close()
    path = tmp_path / "old" / "parts" / part_name(2)
    path.write_bytes(path.read_bytes()[:-1])
    crashed = np.full(100, STATES.index("crashed"), np.int8)
    nameless = np.zeros((100, 16), np.uint8)
    with PartStore.open(tmp_path / "old", header()) as store:
        rows = Rows(1050)
        block = replace(rows.rows(0, 100), states=crashed)
        store.write(0, encode_part(block, COLUMNS, store.header.digest))
        block = replace(rows.rows(100, 200), keys=nameless)
        store.write(1, encode_part(block, COLUMNS, store.header.digest))
    earlier = EarlierRows.of([tmp_path / "old"], COLUMNS)
    found = earlier.outputs(keys_of(np.arange(1050)), COLUMNS).found
    assert np.array_equal(found, np.arange(1050) >= 300)
    assert not earlier.outputs(nameless, COLUMNS).found.any()


def test_the_first_folder_counts_and_words_are_those_of_now(tmp_path: Path) -> None:
    keys = keys_of(np.arange(3))
    for name, words, total in (("one", ("a", "c"), 1.0), ("two", ("a", "b", "c"), 2.0)):
        specs = (ColumnSpec("out.word", "", "choice", words), ColumnSpec("out.losses.total", "W"))
        places = np.array([words.index("a"), words.index("c"), -1], np.int32)
        columns = {"out.word": places, "out.losses.total": np.full(3, total)}
        block = RowBlock(0, columns, keys, np.zeros(3, np.int8), ("",) * 3)
        with PartStore.open(tmp_path / name, replace(header(3), columns=specs)) as store:
            store.write(0, encode_part(block, specs, store.header.digest))
    asked = (
        ColumnSpec("out.losses.total", "W"),
        ColumnSpec("out.word", "", "choice", ("a", "aa", "c")),
    )
    found = EarlierRows.of([tmp_path / "one", tmp_path / "two"], asked).outputs(keys, asked)
    assert found.columns["out.losses.total"].tolist() == [1.0, 1.0, 1.0]
    assert found.columns["out.word"].tolist() == [0, 2, -1]


def test_folders_without_an_output_are_refused(tmp_path: Path) -> None:
    filled(tmp_path / "old").close()
    more = (*COLUMNS, ColumnSpec("out.reference.torque_max", "N m"))
    with pytest.raises(InputError) as caught:
        EarlierRows.of([tmp_path / "old"], more)
    assert str(caught.value) == (
        f"--reuse {tmp_path / 'old'}: it has no output reference.torque_max; omit the folder"
    )
    with pytest.raises(InputError, match=r"holds no study\.json"):
        EarlierRows.of([tmp_path], COLUMNS)
