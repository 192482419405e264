"""Processes of this machine as workers, for one run of a study."""

from __future__ import annotations

import ctypes
import hashlib
import json
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

import dqforge
from dqforge.machines.errors import DqforgeError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.reports.exploration.contained_rows import (
    EngineSettings,
    TlsFiles,
    contained_rows,
    counted,
    is_address,
)
from dqforge.reports.exploration.part_file import encode_part
from dqforge.reports.exploration.part_store import cpu_features, versions
from dqforge.reports.operating_system import system

if TYPE_CHECKING:
    from distributed import Client, LocalCluster, Security

    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.reports.exploration.contained_rows import PartWriter, StudyProgress


_KEEP = str(2**28)
WORKER_ENVIRONMENT = {
    # Dask has the allocator give every temporary array back at once, and fault it in again for the
    # next one: rows take four times as long.
    "MALLOC_TRIM_THRESHOLD_": _KEEP,
    "MALLOC_MMAP_THRESHOLD_": _KEEP,
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "DASK_LOGGING__DISTRIBUTED": "critical",
}
_SETTINGS: dict[str, Any] = {
    # Whose rows end a process is found out here, with fewer deaths than Dask would take.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.worker.profile.enabled": False,
    "distributed.diagnostics.nvml": False,
    "distributed.comm.timeouts.connect": "10s",
    # A process that starts again is not lost, however long that takes on a busy machine.
    "distributed.deploy.lost-worker-timeout": "1h",
}


def _settings(held: Path) -> dict[str, Any]:
    """Those of Dask, with a folder for what processes leave behind that are ended at once.

    It is gone before Dask removes what is its own there, which is not told.
    """
    logging.getLogger("distributed.diskutils").setLevel(logging.CRITICAL)
    spawned = WORKER_ENVIRONMENT | {"TMPDIR": str(held), "TEMP": str(held), "TMP": str(held)}
    return _SETTINGS | {
        "temporary-directory": str(held),
        "distributed.nanny.pre-spawn-environ": spawned,
    }


# Loggers that distributed gives a level of their own, beside those that stand for all.
_LOUD = (
    "distributed",
    "distributed.client",
    "distributed.gc",
    "tornado",
    "tornado.application",
    "asyncio",
)
# Ends a process without asking it; Windows ends it by either.
_CLOSED_AFTER_S = 2.0
_AT_ONCE = getattr(signal, "SIGKILL", signal.SIGTERM)


@contextmanager
def quiet() -> Iterator[None]:
    """What goes wrong is told in one line, by the one who knows what it means for the study.

    The settings hold for processes that are started within the block, too.
    """
    import dask

    # Workers that are started set up their logging by this; here it has been set up.
    words = {"logging": dict.fromkeys(_LOUD, "critical")}
    loggers = [logging.getLogger(name) for name in _LOUD]
    before = [logger.level for logger in loggers]
    with dask.config.set(words):
        import distributed  # noqa: F401

        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        try:
            yield
        finally:
            for logger, level in zip(loggers, before, strict=True):
                logger.setLevel(level)


@contextmanager
def _without_words_on_leaks() -> Iterator[None]:
    """Have the tracker, started within the block, clear away what a command that ends at once has
    left, and not warn of it: the terminal then belongs to the next command.
    """
    name, ours = "PYTHONWARNINGS", "ignore:resource_tracker:UserWarning"
    before = os.environ.get(name)
    os.environ[name] = ours if not before else f"{before},{ours}"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _ended(workers: int, error: Exception) -> EngineStoppedError:
    return EngineStoppedError(
        f"one of {workers} processes ended while it started or answered ({type(error).__name__}); "
        "what is finished stays: give the command again, or fewer --workers"
    )


@contextmanager
def local_workers(workers: int) -> Iterator[Client]:
    """``workers`` processes of one thread each, gone after the block whatever they are at."""
    import dask

    # The thread that starts the tracker of multiprocessing hears Ctrl-C afterwards whatever its
    # mask was, and so would all that it starts: it is started before anybody is deaf.
    # Windows has no such tracker.
    with _without_words_on_leaks():
        if not system.WINDOWS:
            resource_tracker.ensure_running()
    with scratch_folder() as held, quiet(), dask.config.set(_settings(held)):
        from distributed import Client, LocalCluster
        from distributed.comm.core import CommClosedError

        with deaf_to_the_terminal():
            try:
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    silence_logs=logging.CRITICAL,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                )
            except (RuntimeError, OSError, TimeoutError) as error:
                raise EngineStoppedError(
                    f"{workers} processes could not be started: {error}; try fewer --workers"
                ) from error
            try:
                client = Client(cluster, set_as_default=False, timeout=10)
            except BaseException as error:
                _end(cluster)
                if isinstance(error, (OSError, TimeoutError)):
                    raise _ended(workers, error) from error
                raise
        try:
            yield client
        except CommClosedError as error:
            # What is written to disk raises other errors; this one is of a connection.
            raise _ended(workers, error) from error
        finally:
            _end(cluster)
            close_client(client)


def replace_lost(client: Client) -> None:
    """Start workers in the place of those that are gone for good: the nanny of a process that ends
    while it starts gives up. Nothing happens on a cluster of somebody else.
    """
    from distributed.core import Status

    cluster = client.cluster
    if cluster is None:
        return
    count = len(cluster.worker_spec)
    gone = [name for name, nanny in cluster.workers.items() if nanny.status in _gone(Status)]
    for name in gone:
        cluster.worker_spec.pop(name, None)
    if gone:
        cluster.scale(count)


def _gone(status: Any) -> tuple[Any, ...]:
    return status.closed, status.failed


def close_client(client: Client) -> None:
    """Leave a cluster, also one that answers no more."""
    _close(client)


def _close(one: Client | LocalCluster) -> None:
    """Close, and end the thread that talks: on a busy machine it is at it for longer, and would
    tell of lost connections as soon as `quiet` is over, or of itself when it is deleted.
    """
    with suppress(Exception):
        one.close(timeout=_CLOSED_AFTER_S)
    with suppress(Exception):
        one._loop_runner.stop()
    one.status = type(one.status)("closed")


def _end(cluster: LocalCluster) -> None:
    """End the processes at once: nothing that they still hold is wanted, and a thread that computes
    cannot be asked to stop.
    """
    for nanny in [*cluster.workers.values()]:
        nanny.close_gracefully()  # it starts no process in the place of this one
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, _AT_ONCE)
    _close(cluster)


# A cluster that somebody else started: found, and held to the versions of this process.

ANSWERS_WITHIN_S = 10.0
FIRST_WORKER_WITHIN_S = 120.0
_ASK_EVERY_S = 0.2


@contextmanager
def existing_workers(
    settings: EngineSettings, waits: Callable[[str], None], asked: Callable[[], bool]
) -> Iterator[Client]:
    """The cluster at the address, with at least one worker, all of them fit.

    Args:
        waits: Told what is waited for.
        asked: Whether somebody asked to stop, which ends the waiting.

    Raises:
        EngineStoppedError: Nobody answers, there is no worker, or one differs.
    """
    with quiet():
        client = _connected(settings)
        try:
            _wait_for_a_worker(client, waits, asked)
            require_fit(client, mixed=settings.mixed)
            yield client
        finally:
            close_client(client)


def _connected(settings: EngineSettings) -> Client:
    from distributed import Client

    address = settings.scheduler or _address_in(settings.scheduler_file or Path())
    if not is_address(address):
        raise EngineStoppedError(f"cannot use the scheduler at {address}: no address with a port")
    security = _security(settings.tls)
    if address.startswith("tls://") and not _has_certificates(security):
        raise EngineStoppedError(
            f"the scheduler at {address} requires certificates; write --tls-ca-file, --tls-cert "
            "and --tls-key"
        )
    try:
        with deaf_to_the_terminal():
            return Client(
                address,
                security=security,
                timeout=ANSWERS_WITHIN_S,
                set_as_default=False,
                name="dqforge",
            )
    except (OSError, TimeoutError) as error:
        raise EngineStoppedError(
            f"no scheduler answers at {address} within {ANSWERS_WITHIN_S:g} s; start one with "
            f"'dask scheduler', or leave {_flag(settings)} out"
        ) from error
    except (ValueError, TypeError, RuntimeError) as error:
        text = " ".join(str(error).split())
        raise EngineStoppedError(f"cannot use the scheduler at {address}: {text}") from error


def _flag(settings: EngineSettings) -> str:
    return "--scheduler" if settings.scheduler else "--scheduler-file"


def _address_in(path: Path) -> str:
    """The address that a scheduler wrote; it may be about to."""
    until = time.monotonic() + ANSWERS_WITHIN_S
    while True:
        try:
            address = json.loads(path.read_text(encoding="utf-8"))["address"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            if time.monotonic() < until and not isinstance(error, IsADirectoryError):
                time.sleep(_ASK_EVERY_S)
                continue
            raise EngineStoppedError(
                f"no scheduler has written its address into {path} within {ANSWERS_WITHIN_S:g} s; "
                f"start one with 'dask scheduler --scheduler-file {path}'"
            ) from error
        return str(address)


def _has_certificates(security: Security | None) -> bool:
    """Whether the command or the settings of Dask name certificates. Without any, a client of Dask
    is left half made, and complains when it is deleted.
    """
    from distributed import Security

    found = Security() if security is None else security
    return found.get_connection_args("client").get("ssl_context") is not None


def _security(tls: TlsFiles) -> Security | None:
    """Certificates that the command names; None leaves it to Dask's settings."""
    from distributed import Security

    if tls == TlsFiles():
        return None
    missing = [path for path in (tls.authority, tls.certificate, tls.key) if not _readable(path)]
    if missing:
        raise EngineStoppedError(
            f"cannot read the certificate {missing[0]!r}; name PEM files by --tls-ca-file, "
            "--tls-cert and --tls-key"
        )
    return Security(
        tls_ca_file=tls.authority,
        tls_client_cert=tls.certificate,
        tls_client_key=tls.key or None,
        require_encryption=True,
    )


def _readable(path: str) -> bool:
    return not path or Path(path).is_file()


def _wait_for_a_worker(
    client: Client, waits: Callable[[str], None], asked: Callable[[], bool]
) -> None:
    until = time.monotonic() + FIRST_WORKER_WITHIN_S
    waits("waiting for a worker")
    while not client.nthreads() and not asked():
        if time.monotonic() > until:
            raise EngineStoppedError(
                f"no worker has joined the scheduler within {FIRST_WORKER_WITHIN_S:g} s; start "
                "some with 'dask worker', one thread each"
            )
        time.sleep(_ASK_EVERY_S)


def require_fit(client: Client, *, mixed: bool) -> None:
    """Raise `EngineStoppedError` with the first worker that would not write the same bytes.

    Versions are asked of Dask first, since a worker without dqforge cannot be asked by it.
    """
    here = compared_facts(mixed=mixed)
    libraries = [name for name in COMPARED if name != "python"]
    found = cast("Mapping[str, Any]", client.get_versions(packages=libraries))
    for address, about in sorted(found["workers"].items()):
        packages = {**about["packages"], "python": _minor(about["packages"]["python"])}
        _refuse(address, first_difference(packages, {name: here[name] for name in COMPARED}))
    facts: Mapping[str, Any] = client.run(worker_facts, on_error="return")
    for address, there in sorted(facts.items()):
        if isinstance(there, BaseException):
            _refuse(address, f"cannot load dqforge: {there}")
        _refuse(address, first_difference(there, here))


def compared_facts(*, mixed: bool) -> dict[str, str]:
    """What workers must share: facts of this process, without CPU features where they may be
    ``mixed``.
    """
    facts = worker_facts()
    if mixed:
        facts.pop(CPU)
        facts.pop("processor")
    return facts


def _minor(python: str) -> str:
    return ".".join(python.split(".")[:2])


def _refuse(address: str, difference: str) -> None:
    if not difference:
        return
    advice = (
        "use machines of one kind, or --mixed, with which identical bytes are not guaranteed"
        if CPU in difference
        else "install the same version on all workers"
    )
    raise EngineStoppedError(f"worker {address} {difference}; {advice}")


# Ctrl-C while a study runs: the first one ends it in order, the second one at once.

_SHOW_CURSOR = "\x1b[?25h"


@dataclass(slots=True)
class AskedToStop:
    """What has been asked of this process.

    Args:
        number: The signal that came first, 0 for none.
        wake: Called as it comes, to end a wait.
        at_once: Whether the signal interrupts what is under way: nothing of it is worth waiting
            for.
    """

    number: int = 0
    wake: Callable[[], None] = lambda: None
    at_once: bool = False

    def __bool__(self) -> bool:
        return self.number > 0

    def take(self, number: int, _: FrameType | None) -> None:
        """The handler of the signal."""
        if self.number:
            _leave(number)
        self.number = number
        self.wake()
        if self.at_once:
            raise KeyboardInterrupt


def _leave(number: int) -> None:
    """End this process as it is: files are written under another name first, workers end with the
    process that started them.
    """
    with suppress(OSError, ValueError):
        if sys.stderr.isatty():
            os.write(sys.stderr.fileno(), _SHOW_CURSOR.encode())
    os._exit(128 + number)


@contextmanager
def asked_to_stop() -> Iterator[AskedToStop]:
    """Take Ctrl-C and the request to end while the block runs; elsewhere than in the main thread
    signals go their usual way.
    """
    asked = AskedToStop()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number, old in before.items():
            if old is not signal.SIG_IGN:
                signal.signal(number, asked.take)
        yield asked
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def deaf_to_the_terminal() -> Iterator[None]:
    """Threads and processes that are started within the block never see Ctrl-C: it goes to every
    process of a terminal, and only this one knows what to do with it.

    A mask is inherited by threads and by what they start, so that it holds for a worker from its
    first instruction on, and for those that take the place of others later.
    """
    if system.WINDOWS:
        with _without_ctrl_c():
            yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Windows hands down to a process whether the one that starts it ignores Ctrl-C; what takes the
    place of a worker later, outside the block, hears it.
    """
    console = getattr(ctypes, "windll").kernel32  # noqa: B009 - there alone
    console.SetConsoleCtrlHandler(None, True)
    try:
        yield
    finally:
        console.SetConsoleCtrlHandler(None, False)


# What a worker must share with the process that asks, for the same bytes: versions, the sources of
# dqforge, and the instruction sets that numpy uses.

CPU = "CPU features"
SOURCES = "sources"
# Versions that are compared before anything of dqforge is asked of a worker.
COMPARED = ("dqforge", "python", "numpy", "scipy", "pyarrow", "cloudpickle")


@cache
def source_hash() -> str:
    """SHA-256 of the modules of dqforge: one version may stand for several states of a checkout."""
    root = Path(dqforge.__file__).parent
    folders = [root / name for name in ("machines", "optimizer", "reports")]
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def worker_facts() -> dict[str, str]:
    """Facts of this process by name."""
    features = " ".join(cpu_features())
    pickler = {"cloudpickle": metadata.version("cloudpickle")}
    return versions() | pickler | {SOURCES: source_hash(), CPU: features}


def first_difference(there: Mapping[str, str], here: Mapping[str, str]) -> str:
    """What a worker has that differs from ``here``, in words; empty where nothing does.

    Args:
        there: Facts, or versions alone, of the worker.
        here: What is compared, of this process.
    """
    for name, value in here.items():
        other = there.get(name) or "none"
        if other == value:
            continue
        if name == CPU:
            return f"has other CPU features ({_features_apart(other, value)})"
        if name == SOURCES:
            return f"has other sources of dqforge {here['dqforge']}"
        return f"has {name} {other}, here is {value}"
    return ""


def _features_apart(there: str, here: str) -> str:
    ours, theirs = set(here.split()), set(there.split())
    texts = [
        f"{sorted(names)[0]}{f' and {len(names) - 1} more' * (len(names) > 1)} only {where}"
        for names, where in ((ours - theirs, "here"), (theirs - ours, "there"))
        if names
    ]
    return ", ".join(texts)


# A study in this process: the same batches, the same bytes, and no cluster to start.


def run_here(
    source: RowSource,
    digest: str,
    writer: PartWriter,
    parts: Iterable[int],
    progress: StudyProgress,
    asked: AskedToStop,
) -> None:
    """Compute and write ``parts`` one after the other.

    Raises:
        StudyInterruptedError: Somebody asked to stop; the part that was under way is left out.
    """
    try:
        for part in parts:
            first = part * source.batch
            asked.at_once = True
            block = contained_rows(source, first, min(first + source.batch, source.count))
            data = encode_part(block, source.columns, digest)
            asked.at_once = False  # a part that is there is written
            writer.write(part, data)
            progress.finished(counted(block))
            if asked:
                break
    except KeyboardInterrupt:
        asked.number = asked.number or signal.SIGINT
    finally:
        asked.at_once = False
    if asked:
        raise StudyInterruptedError(asked.number, kept(progress.done, progress.count))


# How a run of a study ends before its end: one line, and a folder that the next run goes on
# with.


class EngineStoppedError(DqforgeError):
    """The run could not go on; the line says why, and what is kept."""

    def __init__(self, message: str) -> None:
        super().__init__(f"explore: {message}")


class SchedulerLostError(EngineStoppedError):
    """The scheduler answers no more."""


class StudyInterruptedError(EngineStoppedError):
    """Somebody pressed Ctrl-C, or the process was asked to end.

    Args:
        number: The signal; the exit code follows from it as a shell's does, 130 for Ctrl-C.
    """

    def __init__(self, number: int, kept: str) -> None:
        super().__init__(f"interrupted after {kept}")
        self.exit_code = 128 + number


def kept(done: int, count: int) -> str:
    """How much of a study is done, and that it goes on from there."""
    return f"{done:,} of {count:,} rows; they are kept, run the same command again"
