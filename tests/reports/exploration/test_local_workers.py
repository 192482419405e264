"""A study on processes of this machine: the same bytes, whatever happens to them."""

from __future__ import annotations

import errno
import gc
import json
import logging
import os
import pty
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp

import psutil
import pytest
from study_rows import StudyRows
from study_runs import opened, parts_hash, rows_there, run_in
from study_workers import killing_workers, parts_in, worker_processes

from dqforge.reports.exploration import local_cluster
from dqforge.reports.exploration.contained_rows import EngineSettings, SuspectPart
from dqforge.reports.exploration.local_cluster import quiet
from dqforge.reports.exploration.part_file import StoreError, encode_part
from dqforge.reports.exploration.part_store import PartStore
from dqforge.reports.exploration.run_study import run_study

TESTS = Path(__file__).resolve().parents[2]


def test_two_workers_write_the_bytes_of_one_whatever_a_row_does(tmp_path: Path) -> None:
    rows = StudyRows(count=60, batch=10, refused=(3,), raising=(12,))
    run_in(tmp_path / "here", rows, workers=1)
    outcome = run_in(tmp_path / "two", rows, workers=2)
    assert parts_hash(tmp_path / "two") == parts_hash(tmp_path / "here")
    assert (outcome.workers, outcome.computed) == (2, 60)
    assert worker_processes() == []


def test_no_logger_of_distributed_has_a_word_while_a_study_runs() -> None:
    with quiet():
        import_module("distributed")
        names = [*logging.root.manager.loggerDict]
        ours = [name for name in names if name.split(".")[0] in {"distributed", "tornado"}]
        assert {"distributed.client", "tornado.application"} <= set(ours)
        assert not [name for name in ours if logging.getLogger(name).isEnabledFor(logging.ERROR)]


@pytest.mark.parametrize("closed_after", [pytest.param(2.0, marks=pytest.mark.slow), 0.001])
def test_nothing_talks_on_when_a_study_has_ended(
    closed_after: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Also where the workers take longer to close than is waited for, as on a busy machine."""
    monkeypatch.setattr(local_cluster, "_CLOSED_AFTER_S", closed_after)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = {*threading.enumerate()}
    with caplog_of_distributed() as said:
        run_in(tmp_path / "out", StudyRows(count=20, batch=10), workers=2)
        later = [each.name for each in threading.enumerate() if each not in before]
        gc.collect()
    assert not [name for name in later if name == "IO loop"]
    assert said == []
    assert capfd.readouterr().err == ""
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@contextmanager
def caplog_of_distributed() -> Iterator[list[str]]:
    """What the loggers say, at the level that distributed gives them where it is loaded first."""
    said: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    logger, keep = logging.getLogger("distributed"), Keep()
    level = logger.level
    logger.addHandler(keep)
    logger.setLevel(logging.INFO)
    try:
        yield said
    finally:
        logger.removeHandler(keep)
        logger.setLevel(level)


@pytest.mark.slow
def test_eight_workers_write_the_same_bytes(tmp_path: Path) -> None:
    rows = StudyRows(count=500, batch=10, takes=0.01)
    run_in(tmp_path / "one", rows, workers=1)
    run_in(tmp_path / "eight", rows, workers=8)
    assert parts_hash(tmp_path / "eight") == parts_hash(tmp_path / "one")


def as_halved(rows: StudyRows, part: int, guilty: set[int], message: str) -> bytes:
    """A part with rows that end their process, by the rule of halves."""
    first = part * rows.batch
    suspect = SuspectPart(part, first, first + rows.batch, rows)
    tame = StudyRows(rows.count, rows.batch, refused=rows.refused)
    asked = suspect.began()
    while asked:
        each = asked.pop()
        if any(each.first <= row < each.end for row in guilty):
            asked += suspect.died(each, message)
        else:
            asked += suspect.computed(each, tame.rows(each.first, each.end))
    assert suspect.block is not None
    with opened(Path(mkdtemp()), rows) as store:
        return encode_part(suspect.block, rows.columns, store.header.digest)


@pytest.mark.slow
def test_rows_that_kill_and_hang_are_crashed_and_the_others_done(tmp_path: Path) -> None:
    rows = StudyRows(count=16, batch=4, killing=(5,), looping=(14,), refused=(6,))
    outcome = run_in(tmp_path / "a", rows, workers=2, time_limit=3.0)
    assert rows_there(tmp_path / "a") == list(range(16))
    assert (outcome.counts["crashed"], outcome.counts["refused"], outcome.counts["ok"]) == (
        2,
        1,
        13,
    )
    killed = as_halved(rows, 1, {5}, "ended its process 3 times")
    assert (tmp_path / "a" / "parts" / "part-000001.parquet").read_bytes() == killed
    hung = as_halved(rows, 3, {14}, "took longer than 3 s")
    assert (tmp_path / "a" / "parts" / "part-000003.parquet").read_bytes() == hung


@pytest.mark.slow
def test_workers_that_are_killed_again_and_again_cost_no_row(tmp_path: Path) -> None:
    rows = StudyRows(count=600, batch=10, takes=1.0, refused=(3, 599))
    run_in(tmp_path / "quiet", StudyRows(count=600, batch=10, refused=(3, 599)), workers=1)
    with killing_workers(tmp_path / "killed", 10.0) as killed:
        outcome = run_in(tmp_path / "killed", rows, workers=2)
    assert len(killed) >= 2
    assert outcome.counts["crashed"] == 0
    assert rows_there(tmp_path / "killed") == list(range(600))
    assert parts_hash(tmp_path / "killed") == parts_hash(tmp_path / "quiet")


class FullOnce:
    """A store on a disk that is full at the fourth part."""

    def __init__(self, store: PartStore) -> None:
        self.store = store
        self.header = store.header
        self.finished = store.finished
        self.written = 0

    def write(self, part: int, data: bytes) -> None:
        self.written += 1
        if self.written == 4:
            raise StoreError(f"cannot write part {part}: {os.strerror(errno.ENOSPC)}; make room")
        self.store.write(part, data)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_full_disk_stops_the_run_and_the_next_goes_on(tmp_path: Path, workers: int) -> None:
    rows = StudyRows(count=80, batch=10)
    run_in(tmp_path / "quiet", rows, workers=1)
    with opened(tmp_path / "full", rows) as store, pytest.raises(StoreError, match="No space"):
        run_study(rows, FullOnce(store), EngineSettings(workers=workers))  # type: ignore[arg-type]
    assert len(rows_there(tmp_path / "full")) == 30
    assert worker_processes() == []
    outcome = run_in(tmp_path / "full", rows, workers=1)
    assert outcome.computed == 50
    assert parts_hash(tmp_path / "full") == parts_hash(tmp_path / "quiet")


SLOW = {"count": 400, "batch": 10, "takes": 0.2}


class Terminal:
    """The run of artificial rows in a terminal of its own, whose keys go to all its processes."""

    def __init__(
        self, folder: Path, rows: Mapping[str, object], settings: Mapping[str, object]
    ) -> None:
        words = [sys.executable, "explore_rows.py", str(folder)]
        self.folder = folder
        self.pid, self.screen = pty.fork()
        if self.pid == 0:
            os.chdir(TESTS)
            os.environ["NO_COLOR"] = "1"
            os.execv(sys.executable, [*words, json.dumps(rows), json.dumps(settings)])

    def wait_for_parts(self, count: int) -> None:
        """Wait until so many parts are there."""
        until = time.monotonic() + 300.0
        while parts_in(self.folder) < count:
            assert time.monotonic() < until
            time.sleep(0.05)

    def press_ctrl_c(self) -> None:
        os.write(self.screen, b"\x03")

    def end(self) -> tuple[int, str]:
        """Exit code, and what stood on the screen."""
        shown = b""
        with suppress(OSError):
            while chunk := os.read(self.screen, 4096):
                shown += chunk
        _, status = os.waitpid(self.pid, 0)
        os.close(self.screen)
        return os.waitstatus_to_exitcode(status), shown.decode()


def said(screen: str) -> list[str]:
    """Lines of a screen without the echo of the key."""
    return [line for line in screen.replace("^C", "").splitlines() if line.strip()]


def gone(processes: list[psutil.Process]) -> bool:
    """Whether processes end of themselves; waited for as long as a busy machine may take."""
    return not psutil.wait_procs(processes, timeout=60.0)[1]


@pytest.mark.slow
def test_ctrl_c_twice_in_a_terminal(tmp_path: Path) -> None:
    run_in(tmp_path / "quiet", StudyRows(count=400, batch=10), workers=1)
    folder = tmp_path / "pressed"
    for least in (3, 10):
        terminal = Terminal(folder, SLOW, {"workers": 2})
        terminal.wait_for_parts(least)
        workers = worker_processes(terminal.pid)
        assert len(workers) == 2
        terminal.press_ctrl_c()
        code, screen = terminal.end()
        assert code == 130
        (line,) = said(screen)
        assert line.startswith("dqforge: explore: interrupted after ")
        assert line.endswith(" of 400 rows; they are kept, run the same command again")
        assert gone(workers)
        assert f"after {len(rows_there(folder))} of" in line
    assert run_in(folder, StudyRows(**SLOW), workers=2).done == 400  # type: ignore[arg-type]
    assert rows_there(folder) == list(range(400))
    assert parts_hash(folder) == parts_hash(tmp_path / "quiet")


def is_deaf(process: psutil.Process) -> bool:
    """Whether a process never sees Ctrl-C."""
    lines = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8").splitlines()
    mask = next(int(line.split()[1], 16) for line in lines if line.startswith("SigBlk:"))
    return bool(mask >> (signal.SIGINT - 1) & 1)


@pytest.mark.slow
def test_workers_are_deaf_to_the_terminal_and_those_in_their_place_too(tmp_path: Path) -> None:
    terminal = Terminal(tmp_path / "deaf", SLOW, {"workers": 2})
    terminal.wait_for_parts(2)
    first = worker_processes(terminal.pid)
    assert [is_deaf(worker) for worker in first] == [True, True]
    first[0].kill()
    until, found = time.monotonic() + 300.0, first
    while not [worker for worker in found if worker.pid not in {each.pid for each in first}]:
        assert time.monotonic() < until
        found = worker_processes(terminal.pid)
    assert all(is_deaf(worker) for worker in found if worker.pid != first[0].pid)
    terminal.press_ctrl_c()
    code, screen = terminal.end()
    assert (code, len(said(screen))) == (130, 1)


@pytest.mark.slow
def test_a_second_ctrl_c_ends_at_once_and_breaks_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "pressed"
    terminal = Terminal(folder, SLOW, {"workers": 2})
    terminal.wait_for_parts(2)
    workers = worker_processes(terminal.pid)
    terminal.press_ctrl_c()
    terminal.press_ctrl_c()
    code, screen = terminal.end()
    assert code == 130
    assert len(said(screen)) <= 1
    assert gone(workers)
    run_in(folder, StudyRows(count=400, batch=10), workers=1)
    assert rows_there(folder) == list(range(400))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_the_command(tmp_path: Path, number: signal.Signals) -> None:
    run_in(tmp_path / "quiet", StudyRows(count=400, batch=10), workers=1)
    folder = tmp_path / "killed"
    terminal = Terminal(folder, SLOW, {"workers": 2})
    terminal.wait_for_parts(3)
    workers = worker_processes(terminal.pid)
    assert len(workers) == 2
    os.kill(terminal.pid, number)
    code, screen = terminal.end()
    assert gone(workers)
    if number == signal.SIGTERM:
        assert code == 143
        assert said(screen)[0].startswith("dqforge: explore: interrupted after ")
    run_in(folder, StudyRows(count=400, batch=10), workers=1)
    assert rows_there(folder) == list(range(400))
    assert parts_hash(folder) == parts_hash(tmp_path / "quiet")


@pytest.mark.slow
def test_the_command_in_a_pipe_is_silent(tmp_path: Path) -> None:
    words = [sys.executable, "explore_rows.py", str(tmp_path / "a"), '{"count": 30}']
    run = subprocess.run(
        [*words, '{"workers": 1}'], cwd=TESTS, capture_output=True, text=True, check=True
    )
    assert (run.stdout, run.stderr) == ("", "")
    assert rows_there(tmp_path / "a") == list(range(30))
