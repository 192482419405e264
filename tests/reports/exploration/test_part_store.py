"""The folder of a study: resumed by part, refused for another study, and whole whatever happens."""

from __future__ import annotations

import errno
import hashlib
import itertools
import os
import resource
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from study_blocks import COLUMNS, Rows, filled, grid_study, header, keys_of, part, study

from dqforge.machines.errors import InputError
from dqforge.reports.exploration.part_file import PartError, StoreError, part_name, write_whole
from dqforge.reports.exploration.part_store import (
    PartStore,
    header_bytes,
    header_from,
    study_from,
    study_header,
    study_inputs,
)

TOTAL = "out.losses.total"


def digest_of(folder: Path) -> str:
    """SHA-256 over all parts of a folder."""
    whole = hashlib.sha256()
    for path in sorted((folder / "parts").iterdir()):
        whole.update(path.name.encode() + path.read_bytes())
    return whole.hexdigest()


def refusal(folder: Path, **changed: Any) -> str:
    with pytest.raises(InputError) as caught:
        PartStore.open(folder, replace(header(), **changed))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_parts_are_found_again_and_read(tmp_path: Path) -> None:
    with filled(tmp_path / "out") as store:
        assert store.finished() == frozenset(range(11))
        assert store.survey().audited == {"losses.total": pytest.approx(1.001e-12)}
    again = PartStore.existing(tmp_path / "out")
    assert header_bytes(again.header) == header_bytes(header())
    found = list(again.read([TOTAL, "key"]))
    assert [one.first for one in found] == list(range(0, 1050, 100))
    assert [one.count for one in found] == [100] * 10 + [50]
    wanted = Rows(1050).rows(0, 1050)
    total = np.concatenate([one.columns[TOTAL] for one in found])
    assert np.array_equal(total, wanted.columns[TOTAL], equal_nan=True)
    assert np.array_equal(np.concatenate([one.keys for one in found]), keys_of(np.arange(1050)))
    assert [one.first for one in again.read([TOTAL], [3, 7])] == [300, 700]
    with pytest.raises(InputError, match=r"has no column 'out\.loses'"):
        list(again.read(["out.loses"]))


def test_a_stopped_study_computes_what_is_missing_and_ends_in_the_same_bytes(
    tmp_path: Path,
) -> None:
    filled(tmp_path / "whole").close()
    folder = tmp_path / "stopped"
    with PartStore.open(folder, header()) as store:
        for number in (4, 0, 7):
            store.write(number, part(header(), number))
    with PartStore.open(folder, header()) as store:
        assert store.finished() == {0, 4, 7}
        for number in set(range(11)) - store.finished():
            store.write(number, part(header(), number))
    assert digest_of(folder) == digest_of(tmp_path / "whole")


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bits_and_halves_are_found_and_computed_again(tmp_path: Path, seed: int) -> None:
    filled(tmp_path / "out").close()
    before = digest_of(tmp_path / "out")
    numbers = np.random.default_rng(seed).integers(0, 1 << 30, 40)
    path = tmp_path / "out" / "parts" / part_name(5)
    content = path.read_bytes()
    store = PartStore.existing(tmp_path / "out")
    spots = [int(number) % (8 * len(content)) for number in numbers]
    footer = 8 * (len(content) - 2000)
    spots += [footer + int(number) % 16000 for number in numbers]
    for spot in spots:
        changed = bytearray(content)
        changed[spot // 8] ^= 1 << spot % 8
        path.write_bytes(changed)
        assert store.finished() == frozenset(range(11)) - {5}, spot
    path.write_bytes(content[: len(content) // 2])
    assert store.survey().damaged == {5: "it is truncated, or not a part"}
    with pytest.raises(StoreError, match=r"part-000005\.parquet: it is truncated"):
        list(store.read([TOTAL]))
    filled(tmp_path / "out").close()
    assert digest_of(tmp_path / "out") == before


def test_a_part_in_the_place_of_another_or_of_another_study_does_not_count(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    parts = tmp_path / "out" / "parts"
    (parts / part_name(2)).write_bytes((parts / part_name(3)).read_bytes())
    (parts / part_name(4)).write_bytes(part(header(seed=2), 4))
    (parts / part_name(10)).write_bytes((parts / part_name(9)).read_bytes())
    (parts / part_name(11)).write_bytes((parts / part_name(9)).read_bytes())
    (parts / part_name(6)).unlink()
    survey = PartStore.existing(tmp_path / "out").survey()
    assert survey.finished == {0, 1, 3, 5, 7, 8, 9}
    assert survey.damaged == {
        2: "it is in the place of another part",
        4: "it is of another study",
        10: "it is in the place of another part",
        11: "it is in the place of another part",
    }


def test_bytes_of_another_part_are_not_kept(tmp_path: Path) -> None:
    with filled(tmp_path / "out") as store:
        for data in (part(header(), 2), part(header(seed=3), 3), part(header(), 3)[:-1]):
            with pytest.raises(PartError):
                store.write(3, data)
        assert store.finished() == frozenset(range(11))


def test_a_longer_study_keeps_its_first_parts(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    longer = header(2000)
    with PartStore.open(tmp_path / "out", longer) as store:
        assert store.finished() == frozenset(range(10))  # the eleventh was half a part
    filled(tmp_path / "out", longer).close()
    filled(tmp_path / "at once", longer).close()
    assert digest_of(tmp_path / "out") == digest_of(tmp_path / "at once")
    assert refusal(tmp_path / "out").endswith(
        "holds another study (1 of 6 keys differ: draw.count); take another -o, or --restart"
    )


def test_a_drawn_grid_that_is_drawn_longer_is_another_study() -> None:
    """Its rows move: each point of the grid has draw.count of them."""
    drawn = [
        replace(grid_study(8000.0, 9000.0), draw=study(count).draw, goals=()) for count in (10, 20)
    ]
    one, other = (
        study_header(each, Rows(each.draw.count * 2)) for each in drawn if each.draw is not None
    )
    assert one.digest != other.digest


def test_what_is_picked_afterwards_is_no_other_study(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    asked = replace(study(name="Another title"), goals=())
    other = study_header(asked, Rows(1050))
    with PartStore.open(tmp_path / "out", other) as store:
        assert store.finished() == frozenset(range(11))
    assert PartStore.existing(tmp_path / "out").header.name == "Another title"


def test_another_study_is_refused_and_its_keys_are_named(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    before = digest_of(tmp_path / "out")
    asked = replace(study(seed=4), sets=(("inverter.v_dc", "500 V"),))
    other = study_header(asked, Rows(1050))
    with pytest.raises(InputError) as caught:
        PartStore.open(tmp_path / "out", other)
    assert str(caught.value) == (
        f"{tmp_path / 'out'} holds another study (2 of 6 keys differ: draw.seed, "
        "set.inverter.v_dc); take another -o, or --restart"
    )
    assert "its columns differ" in refusal(tmp_path / "out", columns=COLUMNS[:-1])
    assert digest_of(tmp_path / "out") == before


def test_other_versions_and_processors_are_refused_or_mixed(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    own = header()
    newer = dict(own.computed_with) | {"dqforge": "9.0"}
    assert "was begun with dqforge 0.1.0, this is 9.0" in refusal(
        tmp_path / "out", computed_with=newer
    )
    other = replace(own, computed_with=dict(own.computed_with) | {"numpy": "1.0"})
    assert "was begun with numpy" in refusal(tmp_path / "out", computed_with=other.computed_with)
    poorer = own.cpu_features[1:]
    assert f"another processor ({own.cpu_features[0]} only there)" in refusal(
        tmp_path / "out", cpu_features=poorer
    )
    assert "parquet-cpp" in refusal(tmp_path / "out", created_by="parquet-cpp-arrow version 0")
    with PartStore.open(tmp_path / "out", replace(other, cpu_features=poorer), mixed=True) as store:
        assert store.finished() == frozenset(range(11))


def test_restart_takes_away_what_a_study_wrote_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with filled(folder) as store:
        store.write_beside("front.parquet", b"front")
        store.write_beside("report.html", b"report")
        with pytest.raises(ValueError, match="not a file of a study"):
            store.write_beside("notes.txt", b"")
    kept = {
        "notes.txt": b"mine",
        "parts/part-000001.parquet.bak": b"mine",
        "parts/part-1.parquet": b"mine",
        "parts/.hidden": b"mine",
        "study-input/mine.csv": b"mine",
    }
    for name, content in kept.items():
        (folder / name).write_bytes(content)
    (folder / "parts" / "part-000777.parquet").mkdir()
    (tmp_path / "far.parquet").write_bytes(b"mine")
    (folder / "parts" / "part-000888.parquet").symlink_to(tmp_path / "far.parquet")
    with PartStore.open(folder, header(seed=9), restart=True) as store:
        assert store.finished() == frozenset()
    left = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    assert left == {*kept, "study.json", "parts/part-000888.parquet"}
    assert all((folder / name).read_bytes() == content for name, content in kept.items())
    assert (tmp_path / "far.parquet").read_bytes() == b"mine"


def test_folders_that_no_study_wrote_are_left_alone(tmp_path: Path) -> None:
    for name in ("report.html", "study-input", "dqforge-manifest.json"):
        folder = tmp_path / name.partition(".")[0]
        folder.mkdir()
        (folder / name).write_bytes(b"mine")
        for restart in (False, True):
            with pytest.raises(InputError, match=f"holds {name}, which no study wrote"):
                PartStore.open(folder, header(), restart=restart)
        assert (folder / name).read_bytes() == b"mine"
    orphans = tmp_path / "orphans"
    filled(orphans).close()
    (orphans / "study.json").unlink()
    with pytest.raises(InputError, match=r"holds parts without their study\.json"):
        PartStore.open(orphans, header(), restart=True)
    assert len(list((orphans / "parts").iterdir())) == 11
    with pytest.raises(InputError, match=r"holds no study\.json; name a folder that"):
        PartStore.existing(orphans)


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"not json", b"[" * 100_000, b"\xff"])
def test_a_study_json_of_others_is_not_written_over(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "study.json").write_bytes(content)
    for restart in (False, True):
        with pytest.raises(InputError, match=r"study\.json is not what dqforge wrote") as caught:
            PartStore.open(tmp_path, header(), restart=restart)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "study.json").read_bytes() == content


def test_a_changed_study_json_is_found(tmp_path: Path) -> None:
    filled(tmp_path).close()
    path = tmp_path / "study.json"
    path.write_bytes(path.read_bytes().replace(b'"draw.seed": 1', b'"draw.seed": 2'))
    with pytest.raises(InputError, match="it was changed since it was written"):
        PartStore.existing(tmp_path)


def test_places_that_are_no_folders(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        assert "cannot write the folder" in refusal(place)
    (tmp_path / "linked").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "linked" / "parts").symlink_to(tmp_path / "elsewhere")
    assert "parts is a link; take another -o" in refusal(tmp_path / "linked")
    (tmp_path / "json").mkdir()
    (tmp_path / "json" / "study.json").symlink_to(tmp_path / "file")
    assert "study.json cannot be read" in refusal(tmp_path / "json")
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / "study.json")
    assert "study.json cannot be read" in refusal(tmp_path / "pipe")


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    assert refusal(tmp_path / "out") == (
        f"cannot write the folder {tmp_path / 'out'}: Permission denied; take another -o"
    )


def test_links_in_the_folder_are_not_written_through(tmp_path: Path) -> None:
    folder, far = tmp_path / "out", tmp_path / "far"
    with PartStore.open(folder, header()) as store:
        far.write_bytes(b"mine")
        (folder / "parts" / part_name(0)).symlink_to(far)
        with pytest.raises(StoreError, match="it is a link"):
            store.write(0, part(header(), 0))
    (tmp_path / "elsewhere").mkdir()
    (folder / "study-input").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="a link leads out of"):
        PartStore.open(folder, header(), inputs={"study-input/design.yaml": b""})
    assert far.read_bytes() == b"mine"
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_linked_folder_serves(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with filled(tmp_path / "link") as store:
        assert len(store.finished()) == 11


def test_a_full_disk_leaves_one_line_and_what_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with PartStore.open(tmp_path / "out", header()) as store:
        store.write(0, part(header(), 0))
        second = part(header(), 1)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(StoreError) as caught:
                store.write(1, second)
        path = tmp_path / "out" / "parts" / part_name(1)
        assert str(caught.value) == (
            f"cannot write {path}: No space left on device; make room and run the same command "
            "again, finished parts are kept"
        )
        assert caught.value.exit_code == 1
        assert store.finished() == {0}
        assert len(list(path.parent.iterdir())) == 1
        store.write(1, part(header(), 1))
        assert store.finished() == {0, 1}


def test_a_limit_on_the_size_of_files(tmp_path: Path) -> None:
    """The system refuses in the midst of a write."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    target = tmp_path / "file"
    target.write_bytes(b"old")
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(StoreError, match="cannot write"):
            write_whole(target, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert target.read_bytes() == b"old"


def test_leftovers_of_a_kill_go_at_the_next_start(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    parts = tmp_path / "out" / "parts"
    (parts / ".part-000003.parquet.new").write_bytes(b"half")
    (tmp_path / "out" / ".study.json.new").write_bytes(b"half")
    (tmp_path / "out" / ".mine.txt.new").write_bytes(b"mine")
    filled(tmp_path / "out").close()
    assert not list(parts.glob(".*"))
    assert [path.name for path in (tmp_path / "out").glob(".*")] == [".mine.txt.new"]


def test_a_kill_between_write_and_rename_leaves_a_study(tmp_path: Path) -> None:
    filled(tmp_path / "whole").close()
    data = {number: part(header(), number) for number in range(4)}
    for kill in range(1, 10):
        folder = tmp_path / f"out{kill}"
        child = os.fork()
        if child == 0:
            _write_until(folder, data, kill)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
        filled(folder).close()
        assert digest_of(folder) == digest_of(tmp_path / "whole")
        assert not list(folder.rglob(".*"))


def _write_until(folder: Path, data: dict[int, bytes], kill: int) -> NoReturn:
    """Write parts, and die at a number of flushes."""
    real, count = os.fsync, itertools.count(1)

    def fsync(handle: int) -> None:
        if next(count) == kill:
            os.kill(os.getpid(), signal.SIGKILL)
        real(handle)

    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", fsync)
            store = PartStore.open(folder, header(), inputs={"study-input/design.yaml": b""})
            for number, content in data.items():
                store.write(number, content)
    finally:
        os._exit(1)


def test_two_runs_in_one_folder(tmp_path: Path) -> None:
    with PartStore.open(tmp_path / "out", header()):
        assert "is being written by another run" in refusal(tmp_path / "out")
        PartStore.existing(tmp_path / "out")
    PartStore.open(tmp_path / "out", header()).close()


def test_what_is_known_at_the_end_stands_in_the_file(tmp_path: Path) -> None:
    with filled(tmp_path / "out") as store:
        done = store.finish({"rows": {"ok": 3}, "audited": {"losses.total": 1e-15}})
    assert PartStore.existing(tmp_path / "out").header == done.header
    assert done.header.digest == header().digest
    content = (tmp_path / "out" / "study.json").read_bytes()
    assert header_bytes(header_from(content)) == content


def test_a_study_is_read_again_from_its_folder(tmp_path: Path) -> None:
    whole = replace(study(), named=(("maps/a.csv", b"1,2"),), header_files=(("h.h", b"h"),))
    found = study_header(whole, Rows(100))
    PartStore.open(tmp_path, found, inputs=study_inputs(whole)).close()
    plain = PartStore.existing(tmp_path).header.study
    contents = {name: (tmp_path / name).read_bytes() for name in study_inputs(whole)}
    assert study_from(plain, contents) == whole
    listed = grid_study(8000.0, -0.0)
    grid = replace(listed, axes=tuple(replace(axis, spacing="log") for axis in listed.axes))
    there = study_header(grid, Rows(2))
    assert study_from(header_from(header_bytes(there)).study, study_inputs(grid)) == grid
