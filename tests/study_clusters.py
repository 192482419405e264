"""Clusters of dask.distributed as somebody else starts them: own processes, own folders, own
certificates.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from dqforge.reports.exploration.contained_rows import TlsFiles

TESTS = Path(__file__).resolve().parent
OPEN = TlsFiles()


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Cluster:
    """`dask scheduler` and `dask worker` as somebody starts them, each in a folder of its own."""

    def __init__(self, folder: Path, tls: TlsFiles = OPEN) -> None:
        self.folder = folder
        self.port = free_port()
        self.address = f"{'tls' if tls.authority else 'tcp'}://127.0.0.1:{self.port}"
        self.file = folder / "scheduler.json"
        self.tls = []
        if tls.authority:
            self.tls = ["--tls-ca-file", tls.authority, "--tls-cert", tls.certificate]
            self.tls += ["--tls-key", tls.key]
        self.running: list[subprocess.Popen[bytes]] = []
        self.scheduler = self.start_scheduler()

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        self.file.unlink(missing_ok=True)
        words = ["--host", self.address.rpartition(":")[0], "--port", str(self.port)]
        words += ["--scheduler-file", str(self.file), "--no-dashboard"]
        started = self._start(
            "scheduler", words, {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
        )
        until = time.monotonic() + 300.0
        while not self.file.exists():
            assert time.monotonic() < until
            assert started.poll() is None
            time.sleep(0.05)
        return started

    def start_worker(self, **environment: str) -> subprocess.Popen[bytes]:
        words = [self.address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "30"]
        return self._start("worker", words, environment)

    def _start(
        self, kind: str, words: list[str], environment: dict[str, str]
    ) -> subprocess.Popen[bytes]:
        place = self.folder / f"{kind}-{len(self.running)}"
        place.mkdir(parents=True)
        log = (place / "log").open("wb")
        started = subprocess.Popen(
            [sys.executable, "-m", "dask", kind, *words, *self.tls],
            cwd=place,
            env={
                **os.environ,
                "PYTHONPATH": str(TESTS),
                "OPENBLAS_NUM_THREADS": "1",
                **environment,
            },
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        log.close()
        self.running.append(started)
        return started

    def close(self) -> None:
        for each in self.running:
            end(each)


def end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and those that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@contextmanager
def cluster(folder: Path, workers: int, tls: TlsFiles = OPEN) -> Iterator[Cluster]:
    with ExitStack() as stack:
        found = Cluster(folder, tls)
        stack.callback(found.close)
        for _ in range(workers):
            found.start_worker()
        yield found


def certificates(folder: Path) -> TlsFiles:
    """An authority of our own, and a certificate that it signed."""
    folder.mkdir()
    made = [
        "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=authority -keyout ca.key -out ca.pem",
        "req -newkey rsa:2048 -nodes -subj /CN=localhost -keyout own.key -out own.csr",
        "x509 -req -in own.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -out own.pem",
    ]
    for words in made:
        subprocess.run(["openssl", *words.split()], cwd=folder, check=True, capture_output=True)
    return TlsFiles(*(str(folder / name) for name in ("ca.pem", "own.pem", "own.key")))
