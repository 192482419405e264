"""The command on a study of a linear drive, whatever happens to its processes, its disk and its
scheduler: the bytes of an undisturbed run.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from study_clusters import certificates, cluster
from study_commands import Command, Ended, explored, linear_study, strange
from study_runs import rows_there
from study_workers import killing_workers

from dqforge.reports.exploration.contained_rows import TlsFiles

pytestmark = pytest.mark.slow

PARTS = 40


@dataclass(frozen=True)
class Undisturbed:
    """A study of 100,000 rows in one process, and one of 1,000."""

    out: Path
    long: Ended
    short: Ended

    def parts(self, count: int) -> list[bytes]:
        """The first parts."""
        return [path.read_bytes() for path in sorted((self.out / "parts").iterdir())[:count]]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    folder = tmp_path_factory.mktemp("undisturbed")
    ended = [
        explored(written(folder, count), folder / str(count), "--workers", 1)
        for count in (100_000, 1_000)
    ]
    assert [(each.code, each.err) for each in ended] == [(0, ""), (0, "")]
    return Undisturbed(folder / "100000", ended[0], ended[1])


def written(folder: Path, count: int) -> Path:
    """The file of a study."""
    path = folder / f"linear-{count}.yaml"
    path.write_text(linear_study(count), encoding="utf-8")
    return path


def parts_of(out: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted((out / "parts").iterdir())]


class Disk:
    """A disk of its own, that can be as small as asked."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mount("-t", "tmpfs", "-o", "size=64m", "tmpfs")

    def _mount(self, *words: str) -> None:
        subprocess.run(["mount", *words, str(self.folder)], check=True, capture_output=True)

    def leave(self, kilobytes: int) -> None:
        """Leave so much room beside what is there."""
        used = sum(path.stat().st_size for path in self.folder.rglob("*")) // 1000
        self._mount("-o", f"remount,size={used + kilobytes}k")


@contextmanager
def disk(folder: Path) -> Iterator[Disk]:
    folder.mkdir()
    try:
        found = Disk(folder)
    except (subprocess.CalledProcessError, OSError):
        pytest.skip("a disk of its own takes the right to mount one")
    try:
        yield found
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_study_that_is_disturbed_in_every_way_has_the_bytes_of_one_that_is_not(
    undisturbed: Undisturbed, tmp_path: Path
) -> None:
    study, tls = written(tmp_path, PARTS * 1000), certificates(tmp_path / "certificates")
    with disk(tmp_path / "disk") as room:
        out = room.folder / "study"
        for least in (4, 10):
            run = Command(study, out, "--workers", 8)
            with killing_workers(run.out, 2.0, run.process.pid, run.parts()) as killed:
                run.wait_for_parts(least)
                while not killed:
                    assert run.process.poll() is None
                    time.sleep(0.05)
            run.press_ctrl_c()
            ended = run.end()
            assert (ended.code, ended.out) == (130, "")
            assert said(ended, out) == f"interrupted after {kept(out)}; they are kept, run the same"
        full_disk(study, out, room)
        lost_scheduler(study, out, tls)
        run = Command(study, out, "--workers", 8)
        with killing_workers(run.out, 3.0, run.process.pid, run.parts()) as killed:
            ended = run.end()
        assert (ended.code, ended.err) == (0, "")
        assert killed
        assert "ok      40,000" in ended.out
        assert rows_there(out) == list(range(PARTS * 1000))
        assert parts_of(out) == undisturbed.parts(PARTS)
        assert ended.memory < 200.0


def full_disk(study: Path, out: Path, room: Disk) -> None:
    """The disk is full after three parts."""
    before = len(parts_of(out))
    room.leave(1_200)
    ended = explored(study, out, "--workers", 1)
    assert (ended.code, ended.out) == (1, "")
    assert "No space left on device" in ended.err
    assert ended.err.count("\n") == 1
    assert before < len(parts_of(out)) < before + 8
    assert not [*out.rglob("*.new")]
    room.leave(60_000)


def lost_scheduler(study: Path, out: Path, tls: TlsFiles) -> None:
    """The scheduler of a cluster with TLS and separate workers is killed after two parts."""
    with cluster(room_of(out), 2, tls) as there:
        words = ("--scheduler", there.address, "--tls-ca-file", tls.authority)
        keys = ("--tls-cert", tls.certificate, "--tls-key", tls.key)
        run = Command(study, out, *words, *keys)
        run.wait_for_parts(run.parts() + 2)
        there.scheduler.kill()
        ended = run.end()
    assert (ended.code, ended.out) == (1, "")
    text = f"the scheduler was lost after {kept(out)}; they are kept, run the same"
    assert said(ended, out) == text


def room_of(out: Path) -> Path:
    return out.parent.parent / "cluster"


def kept(out: Path) -> str:
    return f"{len(parts_of(out)) * 1000:,} of {PARTS * 1000:,} rows"


def said(ended: Ended, out: Path) -> str:
    """The one line of a command that was stopped, without its beginning and its end."""
    assert ended.err.count("\n") == 1
    assert not [*out.rglob("*.new")]
    return ended.err.removeprefix("dqforge: explore: ").removesuffix(" command again\n")


def test_a_cluster_with_tls_writes_the_bytes_of_one_process(
    undisturbed: Undisturbed, tmp_path: Path
) -> None:
    tls = certificates(tmp_path / "certificates")
    with cluster(tmp_path / "cluster", 2, tls) as there:
        words = ("--scheduler-file", there.file, "--tls-ca-file", tls.authority)
        keys = ("--tls-cert", tls.certificate, "--tls-key", tls.key, "--limit", 11_001)
        ended = explored(written(tmp_path, 100_000), tmp_path / "out", *words, *keys)
    assert (ended.code, ended.err) == (0, "")
    assert parts_of(tmp_path / "out") == undisturbed.parts(12)


def test_memory_of_a_command_that_computes_by_itself_is_flat(undisturbed: Undisturbed) -> None:
    short, long = undisturbed.short.memory, undisturbed.long.memory
    assert long < 300.0
    assert long < short + 30.0


def test_memory_of_workers(tmp_path: Path) -> None:
    notes = tmp_path / "notes"
    notes.mkdir()
    ended = explored(
        written(tmp_path, 12_000), tmp_path / "out", "--workers", 2, **strange(MEMORY=notes)
    )
    assert (ended.code, ended.err) == (0, "")
    found = [int(path.read_text(encoding="utf-8")) / 1e3 for path in notes.iterdir()]
    assert len(found) == 2
    assert max(found) < 300.0
    assert ended.memory < 200.0


def test_a_part_that_is_damaged_is_computed_again(undisturbed: Undisturbed, tmp_path: Path) -> None:
    study, out = written(tmp_path, 5_000), tmp_path / "out"
    assert explored(study, out, "--workers", 1).code == 0
    paths = sorted((out / "parts").iterdir())
    flipped = bytearray(paths[1].read_bytes())
    flipped[len(flipped) // 3] ^= 1
    paths[1].write_bytes(flipped)
    whole = paths[3].read_bytes()
    paths[3].write_bytes(whole[: len(whole) // 2])
    ended = explored(study, out, "--workers", 1)
    assert (ended.code, ended.err) == (0, "")
    assert "computed now: 2,000 rows" in ended.out
    assert parts_of(out) == undisturbed.parts(5)
