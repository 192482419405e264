"""Output folders: wholly old or wholly new after kills, full disks and second runs;
nothing of others is lost.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from drives import make_design

from dqforge.machines.design.design import Design, DesignFiles
from dqforge.machines.errors import InputError
from dqforge.reports.output import folder as folder_swap
from dqforge.reports.output.folder import (
    COMMAND,
    FIGURES,
    FIRMWARE,
    RUN,
    SIMULATION,
    Manifest,
    Part,
    Written,
    find_manifest,
    from_bytes,
    put_output,
    sha256,
    to_bytes,
    write_output,
)
from dqforge.reports.run_folder import INPUT_DESIGN, MANIFEST

Way = Callable[[pytest.MonkeyPatch], None]


@pytest.fixture(autouse=True)
def unflushed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes are killed here, and disks limited; nobody pulls the plug."""
    monkeypatch.setattr("os.fsync", lambda _: None)


def design(name: str) -> Design:
    given = DesignFiles(f"name: {name}\n".encode(), (("maps/../maps/one.csv", b"1,2\n"),))
    return replace(make_design(), digest=sha256(given.text), given=given)


def contents(name: str, count: int = 3, size: int = 20_000) -> dict[str, bytes]:
    """Files of one run: the names are common to all runs but for one."""
    same = {f"file{k}.h": f"{name} {k}\n".encode() * (size // 8) for k in range(count)}
    return {**same, f"only_{name}.h": name.encode(), "result.json": f'"{name}"'.encode()}


def whole(folder: Path) -> str:
    """Name of the run whose files a folder holds, every one by the hash of the manifest.

    Fails for a mix.
    """
    manifest = find_manifest(folder)
    assert manifest is not None
    for name, digest in manifest.files.items():
        assert sha256((folder / name).read_bytes()) == digest, name
    name = (folder / "result.json").read_text().strip('"')
    expected = {*contents(name), INPUT_DESIGN, "dqforge-input/files/maps/one.csv"}
    assert set(manifest.files) == expected
    assert (folder / INPUT_DESIGN).read_text() == f"name: {name}\n"
    ours = {
        path
        for path in folder_swap.files_below(folder)
        if path.startswith(("file", "only_", "dqforge", "result"))
    }
    assert ours == {*expected, MANIFEST}
    return name


def by_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing stands in the way of the exchange."""


def without_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(first: Path, second: Path) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(folder_swap, "_exchange", refuse)


def at_a_mount_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.path.ismount", lambda _: True)


def without_links(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: object, **named: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)


WAYS = (by_exchange, without_exchange, at_a_mount_point, without_links)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("foreign", ["none", "file", "folder"])
def test_a_second_run_replaces_the_first_and_keeps_what_others_wrote(
    way: Way, foreign: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    way(monkeypatch)
    out = tmp_path / "deep" / "out"
    write_output(out, RUN, contents("one"), design("one"))
    assert whole(out) == "one"
    out.chmod(0o750)
    kept = {"file": "notes.txt", "folder": "src/main.c", "none": ""}[foreign]
    if kept:
        (out / kept).parent.mkdir(exist_ok=True)
        (out / kept).write_text("mine")
    paths = write_output(out, RUN, contents("two"), design("two"))
    assert whole(out) == "two"
    assert paths == [out / name for name in contents("two")]
    assert out.stat().st_mode & 0o777 == 0o750
    if kept:
        assert (out / kept).read_text() == "mine"
        assert (out / kept).stat().st_nlink == 1
    assert list((tmp_path / "deep").iterdir()) == [out]


def test_the_folder_is_exchanged_where_it_can_be(tmp_path: Path) -> None:
    """The folder itself is another one afterwards; where it may not change, it is the same one."""
    out = tmp_path / "out"
    write_output(out, RUN, contents("one"), design("one"))
    before = out.stat().st_ino
    write_output(out, RUN, contents("two"), design("two"))
    assert out.stat().st_ino != before
    (out / "src").mkdir()
    before = out.stat().st_ino
    write_output(out, RUN, contents("one"), design("one"))
    assert out.stat().st_ino == before
    assert whole(out) == "one"


def test_the_working_folder_and_those_above_it_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work" / "below").mkdir(parents=True)
    for place, target in (("work", "."), ("work/below", ".."), ("work/below", "../../work")):
        monkeypatch.chdir(tmp_path / place)
        for name in ("one", "two"):
            write_output(Path(target), RUN, contents(name), design(name))
            assert whole(tmp_path / "work") == name
            assert Path.cwd() == tmp_path / place


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    real = tmp_path / "elsewhere" / "real"
    real.mkdir(parents=True)
    for aim in (real, tmp_path / "elsewhere" / "missing"):
        link = tmp_path / f"to_{aim.name}"
        link.symlink_to(aim)
        for name in ("one", "two"):
            write_output(link, RUN, contents(name), design(name))
            assert link.is_symlink()
            assert whole(aim) == whole(link) == name


def test_what_the_user_changed_or_put_in_the_way_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_output(out, RUN, contents("one"), design("one"))
    (out / "only_one.h").write_text("edited")
    write_output(out, RUN, contents("two"), design("two"))
    assert (out / "only_one.h").read_text() == "edited"
    (out / "only_three.h").mkdir()
    with pytest.raises(
        InputError, match=r"only_three\.h: it is a folder; choose another folder with -o"
    ):
        write_output(out, RUN, contents("three"), design("three"))
    (out / "only_one.h").unlink()
    assert whole(out) == "two"


def test_a_manifest_that_was_made_up_removes_nothing_outside(tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "precious.txt"
    other.write_text("kept")
    out.mkdir()
    (out / MANIFEST).write_bytes(
        to_bytes(Manifest({RUN: Part("x", {"../precious.txt": sha256(b"kept")})}))
    )
    with pytest.raises(ValueError, match="no manifest"):
        from_bytes((out / MANIFEST).read_bytes())
    write_output(out, RUN, contents("one"), design("one"))
    assert other.read_text() == "kept"


def test_samples_go_beside_the_headers_of_the_same_design_only(tmp_path: Path) -> None:
    out = tmp_path / "out"
    samples = {"drive_simulation.npz": b"\0\1"}
    write_output(out, RUN, contents("one"), design("one"))
    write_output(out, SIMULATION, samples, design("one"))
    manifest = find_manifest(out)
    assert manifest is not None
    assert set(manifest.files) >= {*samples, *contents("one"), INPUT_DESIGN}
    assert manifest.parts[RUN].files.keys() >= {*contents("one"), INPUT_DESIGN}
    assert manifest.parts[SIMULATION].files.keys() >= {*samples}
    with pytest.raises(InputError, match="another design"):
        write_output(out, SIMULATION, samples, design("two"))
    write_output(out, RUN, contents("one"), design("one"))
    assert (out / "drive_simulation.npz").exists()
    write_output(out, FIGURES, {"figure.svg": b"<svg/>"})
    assert (out / "drive_simulation.npz").exists()
    written = put_output(out, RUN, contents("two"), design("two"))
    assert written.removed == ("only_one.h",)
    assert set(written.replaced) == {*contents("one")} - {"only_one.h"}
    assert written.kept == ("drive_simulation.npz",)
    assert (out / "drive_simulation.npz").exists()
    assert (out / "figure.svg").exists()
    write_output(tmp_path / "samples", SIMULATION, samples, design("one"))
    write_output(tmp_path / "samples", SIMULATION, samples, design("two"))


def other_design(name: str, prefix: str) -> Design:
    made = design(name)
    return replace(made, name=name, export=replace(made.export, prefix=prefix))


@pytest.mark.parametrize("seed", range(12))
def test_no_command_removes_what_another_design_or_command_made(seed: int, tmp_path: Path) -> None:
    """Commands of two designs, each in two states, in random order into one folder: what is gone or
    has other bytes was named, and was made by the same command of the same design.
    """
    chance = random.Random(seed)
    out = tmp_path / "out"
    maker: dict[str, tuple[str, str]] = {}
    before: dict[str, bytes] = {}
    for step in range(10):
        name, part = chance.choice(["first", "second"]), chance.choice([RUN, SIMULATION, FIRMWARE])
        state = replace(other_design(name, name), digest=f"{name}{chance.randrange(2)}")
        files = {f"{name}.{part}.{chance.randrange(3)}": f"{step}".encode(), "both": b"both"}
        if part == RUN and chance.random() < 0.5:
            files["result.json"] = f"{step}".encode()
        try:
            written = put_output(out, part, files, state)
        except InputError:
            written = Written([])
            files = {}
        after = {
            path: (out / path).read_bytes()
            for path in folder_swap.files_below(out)
            if not path.startswith("dqforge-")
        }
        lost = {path for path in before if path not in after}
        changed = {path for path in before if after.get(path, before[path]) != before[path]}
        assert lost == {*written.removed}
        assert changed <= {*written.replaced}
        assert all(maker[path] == (name, part) for path in lost)
        assert all(maker[path][0] == name for path in changed)
        maker |= dict.fromkeys(files, (name, part)) | {
            path: who for path, who in maker.items() if path == "both"
        }
        before = after


def test_an_export_leaves_what_a_run_of_the_same_design_made(tmp_path: Path) -> None:
    out, run = tmp_path / "out", {"drive.h": b"1", "result.json": b"more", "report.html": b"page"}
    export = {"drive.h": b"1", "result.json": b"less"}
    put_output(out, RUN, run, design("one"), options={COMMAND: "run"})
    done = put_output(out, RUN, export, design("one"), options={COMMAND: "export"})
    assert (done.removed, done.replaced) == ((), ())
    assert {name: (out / name).read_bytes() for name in run} == run
    found = find_manifest(out)
    assert found is not None
    assert found.parts[RUN].options == {COMMAND: "run"}
    done = put_output(out, RUN, export, design("two"), options={COMMAND: "export"})
    assert done.removed == ("report.html",)
    assert done.replaced == ("result.json",)


@pytest.mark.parametrize(
    "place", ["file", "file/out", "file/deep/out", "loop", "/proc/out", "/dev/null"]
)
def test_a_place_that_cannot_be_written_is_one_line(place: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(
        InputError, match=r"cannot write the folder .*; choose another one with -o$"
    ):
        write_output(tmp_path / place, RUN, contents("one"), design("one"))
    assert (tmp_path / "file").read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {"file", "loop"}


def test_a_folder_that_may_not_be_written_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its owner could exchange it by the folder above.

    That is not what taking the right to write meant.
    """
    out = tmp_path / "out"
    write_output(out, RUN, contents("one"), design("one"))
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(InputError, match="Permission denied"):
        write_output(out, RUN, contents("two"), design("two"))
    assert whole(out) == "one"


def in_a_child(task: Callable[[], object]) -> int:
    """Process of a task that ends with 0, or with 1 where it was refused."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            task()
            code = 0
        finally:
            os._exit(code)
    return child


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("limit", [0, 10, 5000])
def test_a_disk_that_is_full_leaves_the_old_folder(
    way: Way, limit: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A limit on the size of files stands for a disk that takes no more bytes from some place
    on.
    """
    way(monkeypatch)
    out = tmp_path / "out"
    write_output(out, RUN, contents("one"), design("one"))
    (out / "notes.txt").write_text("mine")

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        with pytest.raises(InputError, match="cannot write the folder"):
            write_output(out, RUN, contents("two"), design("two"))
        os._exit(7)

    _, status = os.waitpid(in_a_child(limited), 0)
    assert os.waitstatus_to_exitcode(status) == 7
    assert whole(out) == "one"
    assert (out / "notes.txt").read_text() == "mine"
    assert list(tmp_path.iterdir()) == [out]


def kill_at_random(out: Path, count: int, seed: int) -> tuple[int, int]:
    """Kill writers of alternating runs at random moments.

    How many left the old folder, and how many the new one.
    """
    chance = random.Random(seed)
    left = {"old": 0, "new": 0}
    begin = time.perf_counter()
    write_output(out, RUN, contents("zero"), design("zero"))
    (out / "notes.txt").write_text("mine")
    write_output(out, RUN, contents("start"), design("start"))
    longest = (time.perf_counter() - begin) / 2.0
    now = "start"
    for k in range(count):
        new = f"run{k}"
        child = in_a_child(partial(write_output, out, RUN, contents(new), design(new)))
        time.sleep(chance.uniform(0.0, 1.6 * longest))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        found = whole(out)
        assert found in {now, new}
        assert (out / "notes.txt").read_text() == "mine"
        left["new" if found == new else "old"] += 1
        now = found
    write_output(out, RUN, contents("end"), design("end"))
    assert whole(out) == "end"
    assert list(out.parent.iterdir()) == [out]
    return left["old"], left["new"]


@pytest.mark.parametrize("count", [12, pytest.param(300, marks=pytest.mark.slow)])
def test_no_kill_leaves_a_mix(count: int, tmp_path: Path) -> None:
    old, new = kill_at_random(tmp_path / "out", count, seed=count)
    assert old + new == count
    assert count < 100 or min(old, new) > 0  # kills before and after the exchange


@pytest.mark.parametrize("way", [without_exchange, at_a_mount_point])
def test_a_kill_while_files_are_moved_is_seen_and_mended(
    way: Way, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every step of the way that has no exchange: the folder is whole, or says that it is not."""
    way(monkeypatch)
    out = tmp_path / "out"
    moves = len(contents("two")) + 6
    marked = 0
    for most in range(moves):
        write_output(out, RUN, contents("one"), design("one"))

        def stop_after(most: int = most) -> None:
            done = 0
            original = Path.replace

            def counted(self: Path, target: Path) -> Path:
                nonlocal done
                if done == most:
                    os._exit(9)
                done += 1
                return original(self, target)

            monkeypatch.setattr(Path, "replace", counted)
            write_output(out, RUN, contents("two"), design("two"))

        os.waitpid(in_a_child(stop_after), 0)
        if (out / folder_swap.PENDING).exists():
            marked += 1
        else:
            assert whole(out) in {"one", "two"}
        write_output(out, RUN, contents("one"), design("one"))
        assert whole(out) == "one"
    assert marked >= len(contents("two"))


def test_two_runs_at_once_leave_one_of_them(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for turn in range(3):
        names = [f"a{turn}", f"b{turn}", f"c{turn}"]
        children = [
            in_a_child(partial(write_output, out, RUN, contents(name), design(name)))
            for name in names
        ]
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
        assert codes == [0, 0, 0]
        assert whole(out) in names
    assert list(tmp_path.iterdir()) == [out]


def test_what_appears_during_the_exchange_is_carried_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write_output(out, RUN, contents("one"), design("one"))
    (out / "notes.txt").write_text("first")
    original = folder_swap._exchange

    def with_company(first: Path, second: Path) -> None:
        (out / "new.txt").write_text("new")
        (out / "other.txt").write_text("second")
        (out / "other.txt").replace(out / "notes.txt")
        original(first, second)

    monkeypatch.setattr(folder_swap, "_exchange", with_company)
    write_output(out, RUN, contents("two"), design("two"))
    assert whole(out) == "two"
    assert (out / "new.txt").read_text() == "new"
    assert (out / "notes.txt").read_text() == "second"
    assert list(tmp_path.iterdir()) == [out]
