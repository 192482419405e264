"""A study on a cluster that somebody else started: its own processes, folders, certificates."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import pytest
from study_clusters import TESTS, certificates, cluster, end, free_port
from study_rows import StudyRows
from study_runs import parts_hash, rows_there, run_in
from study_workers import parts_in

from dqforge import __version__
from dqforge.machines.errors import InputError
from dqforge.reports.exploration.contained_rows import EngineSettings, TlsFiles
from dqforge.reports.exploration.local_cluster import EngineStoppedError, SchedulerLostError


@pytest.mark.slow
def test_separate_workers_with_tls_write_the_same_bytes(tmp_path: Path) -> None:
    rows = StudyRows(count=200, batch=10, refused=(3,), raising=(77,))
    quiet = tmp_path / "quiet"
    run_in(quiet, rows, workers=1)
    tls = certificates(tmp_path / "certificates")
    with cluster(tmp_path / "cluster", 2, tls) as there:
        settings = EngineSettings(scheduler=there.address, tls=tls)
        outcome = run_in(tmp_path / "there", rows, settings)
        by_file = EngineSettings(scheduler_file=there.file, tls=tls)
        run_in(tmp_path / "again", rows, by_file)
        with pytest.raises(EngineStoppedError) as refused:
            run_in(tmp_path / "open", rows, EngineSettings(scheduler=there.address))
    assert "scheduler at tls://127.0.0.1:" in str(refused.value)
    assert outcome.counts["crashed"] == 1
    assert parts_hash(tmp_path / "there") == parts_hash(quiet)
    assert parts_hash(tmp_path / "again") == parts_hash(quiet)


@pytest.mark.parametrize("address", ["nonsense", "foo://host:1", "tcp://host", "tcp://host:99999"])
def test_what_is_no_address_is_refused(address: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"--scheduler {address}: .* such as tcp://host:8786"):
        EngineSettings(scheduler=address)
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": address}), encoding="utf-8")
    with pytest.raises(EngineStoppedError, match=f"cannot use the scheduler at {address}: "):
        run_in(tmp_path / "a", StudyRows(), EngineSettings(scheduler_file=file))


@pytest.mark.parametrize(
    "address", ["host:1", "tls://a.b-c:8786", "tcp://[::1]:8786", "tcp://h:1/"]
)
def test_what_may_be_an_address_is_taken(address: str) -> None:
    assert EngineSettings(scheduler=address).elsewhere


def test_certificates_are_asked_for_before_anybody_is_asked(tmp_path: Path) -> None:
    settings = EngineSettings(scheduler=f"tls://127.0.0.1:{free_port()}")
    with pytest.raises(EngineStoppedError, match="requires certificates; write --tls-ca-file"):
        run_in(tmp_path / "a", StudyRows(), settings)


def test_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dqforge.reports.exploration.local_cluster.ANSWERS_WITHIN_S", 0.5)
    address = f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(EngineStoppedError) as stopped:
        run_in(tmp_path / "a", StudyRows(), EngineSettings(scheduler=address))
    assert str(stopped.value) == (
        f"explore: no scheduler answers at {address} within 0.5 s; start one with "
        "'dask scheduler', or leave --scheduler out"
    )
    assert stopped.value.exit_code == 1
    file = tmp_path / "scheduler.json"
    with pytest.raises(EngineStoppedError, match="no scheduler has written its address into"):
        run_in(tmp_path / "a", StudyRows(), EngineSettings(scheduler_file=file))


@pytest.mark.slow
def test_a_worker_that_differs_is_named(tmp_path: Path) -> None:
    other = tmp_path / "other" / "dqforge-0.0.1.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: dqforge\nVersion: 0.0.1\n")
    with cluster(tmp_path / "cluster", 0) as there:
        worker = there.start_worker(PYTHONPATH=f"{other.parent}:{TESTS}")
        settings = EngineSettings(scheduler=there.address)
        with pytest.raises(EngineStoppedError) as stopped:
            run_in(tmp_path / "a", StudyRows(), settings)
        words = str(stopped.value)
        assert words.startswith("explore: worker tcp://127.0.0.1:")
        assert words.endswith(
            f"has dqforge 0.0.1, here is {__version__}; install the same version on all workers"
        )
        end(worker)
        there.start_worker(NPY_DISABLE_CPU_FEATURES="AVX512F AVX512_SKX X86_V4 AVX512_ICL")
        with pytest.raises(EngineStoppedError, match=r"has other CPU features .* or --mixed"):
            run_in(tmp_path / "a", StudyRows(), settings)
        mixed = EngineSettings(scheduler=there.address, mixed=True)
        assert run_in(tmp_path / "a", StudyRows(), mixed).done == 100


@pytest.mark.slow
def test_a_scheduler_that_is_lost_leaves_what_is_done(tmp_path: Path) -> None:
    rows = StudyRows(count=400, batch=10, takes=0.1)
    run_in(tmp_path / "quiet", StudyRows(count=400, batch=10), workers=1)
    folder = tmp_path / "lost"
    with cluster(tmp_path / "first", 2) as there:
        settings = EngineSettings(scheduler=there.address)

        def kill_when_under_way() -> None:
            until = time.monotonic() + 300.0
            while parts_in(folder) < 5 and time.monotonic() < until:
                time.sleep(0.05)
            there.scheduler.kill()

        lost = threading.Thread(target=kill_when_under_way)
        lost.start()
        with pytest.raises(SchedulerLostError) as stopped:
            run_in(folder, rows, settings)
        lost.join()
    kept = rows_there(folder)
    assert 50 <= len(kept) < 400
    assert str(stopped.value) == (
        f"explore: the scheduler was lost after {len(kept):,} of 400 rows; they are kept, run the "
        "same command again"
    )
    with cluster(tmp_path / "second", 2) as there:
        outcome = run_in(folder, rows, EngineSettings(scheduler=there.address))
    assert outcome.computed == 400 - len(kept)
    assert rows_there(folder) == list(range(400))
    assert parts_hash(folder) == parts_hash(tmp_path / "quiet")


def test_a_scheduler_file_that_is_there_is_read(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": address}))
    settings = EngineSettings(scheduler_file=file, tls=TlsFiles("none.pem", "none.pem"))
    with pytest.raises(EngineStoppedError, match=r"cannot read the certificate 'none\.pem'"):
        run_in(tmp_path / "a", StudyRows(), settings)
