"""Processes of this machine as workers, for one run of a study."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from dqforge.reports.operating_system import system
from dqforge.reports.study_engine.signals import deaf_to_the_terminal
from dqforge.reports.study_engine.stopped import EngineStoppedError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

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
    "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
    # Whose rows end a process is found out here, with fewer deaths than Dask would take.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.worker.profile.enabled": False,
    "distributed.diagnostics.nvml": False,
    "distributed.comm.timeouts.connect": "10s",
    # A process that starts again is not lost, however long that takes on a busy machine.
    "distributed.deploy.lost-worker-timeout": "1h",
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
    with quiet(), dask.config.set(_SETTINGS):
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
    with suppress(Exception):
        client.close(timeout=_CLOSED_AFTER_S)


def _end(cluster: LocalCluster) -> None:
    """End the processes at once: nothing that they still hold is wanted, and a thread that computes
    cannot be asked to stop.
    """
    for nanny in [*cluster.workers.values()]:
        nanny.close_gracefully()  # it starts no process in the place of this one
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, _AT_ONCE)
    with suppress(Exception):
        cluster.close(timeout=_CLOSED_AFTER_S)
