"""Runs the parts of a study that are not there yet, on the engine that suits them."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING
from uuid import uuid4

from dqforge.reports.operating_system.system import processors
from dqforge.reports.study_engine.contained_rows import StudyProgress, TimeLimits
from dqforge.reports.study_engine.engine_settings import EngineSettings, StudyOutcome, study_outcome
from dqforge.reports.study_engine.local_cluster import AskedToStop, asked_to_stop, run_here

if TYPE_CHECKING:
    from distributed import Client

    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.reports.study_store.part_store import PartStore

    Compute = Callable[[RowSource, Sequence[int]], None]
    """Computes and writes parts of a study, given its rows and the numbers of the parts."""

_FEWEST_BATCHES = 3
_FEWEST_ROWS = 2000
# Parts of so many rows are cheap by the row: a few of them are not worth a cluster.
_QUICK_ROWS = 500


def run_study(
    source: RowSource,
    store: PartStore,
    settings: EngineSettings,
    only: Sequence[int] | None = None,
) -> StudyOutcome:
    """Compute what a store lacks of a study.

    Args:
        source: The rows.
        store: Where parts go; those that it has stay.
        settings: On what they are computed.
        only: Numbers of the parts that are wanted, None for all.

    Raises:
        EngineStoppedError: The run could not go on; what is done is kept.
    """
    run, missing = opened_run(store, settings, only)
    if missing:
        with computing(run, source.batch, len(missing)) as compute:
            compute(source, missing)
    return run.outcome()


def opened_run(
    store: PartStore, settings: EngineSettings, only: Sequence[int] | None
) -> tuple[StudyRun, tuple[int, ...]]:
    """A run, and the numbers of the parts that are wanted and not there; arguments as of
    `run_study`.
    """
    there = store.finished()
    wanted = range(store.header.parts) if only is None else only
    missing = tuple(part for part in wanted if part not in there)
    return StudyRun(store, settings, _progress(store, there)), missing


def _progress(store: PartStore, there: frozenset[int]) -> StudyProgress:
    kept = sum(store.header.rows_of(part) for part in there)
    return StudyProgress(store.header.count, kept)


@dataclass(slots=True)
class StudyRun:
    """A run: where its parts go, on what they are computed, how far it is, and the number of
    ``workers``, 0 for this process.
    """

    store: PartStore
    settings: EngineSettings
    progress: StudyProgress
    workers: int = 0

    def outcome(self) -> StudyOutcome:
        """What is there at its end."""
        return study_outcome(
            self.store,
            computed=self.progress.states.total(),
            seconds=self.progress.seconds,
            workers=self.workers,
        )


@contextmanager
def computing(
    run: StudyRun, batch: int, parts: int, *, at_once: int | None = None
) -> Iterator[Compute]:
    """What computes parts, for as long as the block lasts: the same workers for all that is asked.

    Args:
        run: The run.
        batch: Rows of a part.
        parts: Number of parts that will be asked for, about.
        at_once: Number of parts that are asked for together, None for all of them.
    """
    settings = run.settings
    most = parts if at_once is None else min(parts, at_once)
    with asked_to_stop() as asked:
        if settings.elsewhere:
            from dqforge.reports.study_engine.local_cluster import existing_workers

            waits = run.progress.waits
            with existing_workers(settings, waits, lambda: bool(asked)) as client:
                yield _on_workers(run, client, asked)
        elif (count := local_processes(batch, parts, settings.workers, most)) > 1:
            from dqforge.reports.study_engine.local_cluster import local_workers

            run.progress.waits(f"starting {count} workers")
            with local_workers(count) as client:
                yield _on_workers(run, client, asked)
        else:
            yield _here(run, asked)


def local_processes(batch: int, parts: int, asked: int | None, most: int | None = None) -> int:
    """Processes that missing parts are worth; 1 stands for this one.

    Starting a cluster takes one or two seconds. A number that was asked for is taken at its word: a
    row may end its process, and then it had better not be this one. Otherwise no more than ``most``
    are of use, the number of parts that are asked for together; None for all of them.
    """
    if asked is not None:
        return asked
    few = parts < _FEWEST_BATCHES or (batch >= _QUICK_ROWS and parts * batch <= _FEWEST_ROWS)
    return 1 if few else min(processors(), parts if most is None else most)


def _here(run: StudyRun, asked: AskedToStop) -> Compute:
    run.progress.starts()

    def compute(source: RowSource, parts: Sequence[int]) -> None:
        run_here(source, run.store.header.digest, run.store, parts, run.progress, asked)

    return compute


def _on_workers(run: StudyRun, client: Client, asked: AskedToStop) -> Compute:
    """Each source is sent to the workers once, and forgotten by them in the end."""
    from dqforge.reports.study_engine.cluster_run import ClusterRun, StudyOnWorker
    from dqforge.reports.study_engine.local_cluster import compared_facts

    digest, settings = run.store.header.digest, run.settings
    facts = compared_facts(mixed=settings.mixed)
    run.workers = len(client.nthreads()) or 1
    run.progress.starts()

    def compute(source: RowSource, parts: Sequence[int]) -> None:
        name = f"dqforge-{uuid4().hex}"
        client.register_plugin(StudyOnWorker(pickle.dumps(source), digest, facts), name=name)
        limits = TimeLimits(settings.time_limit, source.batch)
        under_way = ClusterRun(
            client,
            name,
            source,
            digest,
            run.store,
            deque(parts),
            run.progress,
            asked,
            limits,
            run.workers,
        )
        try:
            under_way.run()
        finally:
            under_way.leave()
            with suppress(Exception):
                client.unregister_worker_plugin(name)

    return compute
