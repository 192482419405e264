"""Runs the parts of a study that are not there yet, on the engine that suits them: in one process,
on workers, a search a generation at a time.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, cast
from uuid import uuid4

import numpy as np
from distributed import KilledWorker, Worker, WorkerPlugin, get_worker

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, STATES, RowBlock
from dqforge.optimizer.exploration.row_block import RowSource as row_block_RowSource
from dqforge.reports.exploration.contained_rows import (
    DEATHS,
    EngineSettings,
    PartWriter,
    StudyOutcome,
    StudyProgress,
    SuspectPart,
    SuspectRange,
    TimeLimits,
    contained_rows,
    counted,
    study_outcome,
)
from dqforge.reports.exploration.local_cluster import (
    AskedToStop,
    EngineStoppedError,
    SchedulerLostError,
    StudyInterruptedError,
    asked_to_stop,
    first_difference,
    kept,
    replace_lost,
    run_here,
    worker_facts,
)
from dqforge.reports.exploration.part_file import PartColumns, encode_part
from dqforge.reports.exploration.part_store import PartStore as part_store_PartStore
from dqforge.reports.operating_system.system import processors
from dqforge.reports.pages.answer import stage

if TYPE_CHECKING:
    from dask.typing import Key
    from distributed import Client as distributed_Client
    from distributed import Future

    from dqforge.optimizer.exploration.study_search import GenerationRows, SearchedStudy, SearchRows


if TYPE_CHECKING:
    from distributed import Client

    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.reports.exploration.part_store import PartStore

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
            from dqforge.reports.exploration.local_cluster import existing_workers

            waits = run.progress.waits
            with existing_workers(settings, waits, lambda: bool(asked)) as client:
                yield _on_workers(run, client, asked)
        elif (count := local_processes(batch, parts, settings.workers, most)) > 1:
            from dqforge.reports.exploration.local_cluster import local_workers

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
    from dqforge.reports.exploration.local_cluster import compared_facts

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


# Runs the parts of a study with a search: all parts of one generation are in before the next one
# is asked for.
#
# Which generations are finished is told by the stored parts alone. A run that goes on tells the
# search their outcomes again, and computes what is missing.

_CRASHED = STATES.index("crashed")


def run_search(
    searched: SearchedStudy,
    store: part_store_PartStore,
    settings: EngineSettings,
    only: Sequence[int] | None = None,
) -> StudyOutcome:
    """Compute what a store lacks of a study with a search.

    Args:
        searched: The study.
        store: Where parts go; those that it has stay.
        settings: On what they are computed.
        only: Numbers of the parts that are wanted, from 0 on; None for all.

    Raises:
        InputError: What is stored is not what this search comes to.
        EngineStoppedError: The run could not go on; what is done is kept.
    """
    run, missing = opened_run(store, settings, only)
    if not missing:
        return run.outcome()
    each = searched.parts_of_generation
    way = SearchedWay(searched, store, searched.begun())
    stage("finding the way of the search so far")
    way.go_to(min(missing) // each)
    with computing(run, searched.batch, len(missing), at_once=each) as compute:
        for number in range(way.number, max(missing) // each + 1):
            way.go_to(number)
            lacking = [part for part in way.parts if part in missing]
            if lacking:
                compute(way.rows, lacking)
    return run.outcome()


@dataclass(slots=True, eq=False)
class SearchedWay:
    """How far a search is along the generations that a store holds.

    Args:
        searched: The study.
        store: Its parts.
        search: Told all generations before that of ``number``.
    """

    searched: SearchedStudy
    store: part_store_PartStore
    search: SearchRows

    @property
    def number(self) -> int:
        """Of the generation that is asked for now."""
        return self.search.generation

    @property
    def parts(self) -> range:
        """Numbers of its parts."""
        each = self.searched.parts_of_generation
        return range(self.number * each, (self.number + 1) * each)

    @property
    def rows(self) -> GenerationRows:
        """Its rows."""
        return self.searched.generation(self.number, self.search.ask())

    def go_to(self, number: int) -> None:
        """Tell the search what the store holds of the generations before ``number``.

        Raises:
            InputError: Their rows are others than this search asks for.
        """
        while self.number < number:
            rows, judged = self.rows, self.searched.judged_columns
            inputs = [spec.name for spec in rows.columns if spec.name.startswith(INPUT_COLUMN)]
            stored = list(self.store.read([*judged, *inputs], self.parts))
            if sum(part.count for part in stored) != rows.size:
                raise ValueError(f"generation {self.number} is not finished")
            self._require(rows, stored)
            columns = {
                name: np.concatenate([part.columns[name] for part in stored]) for name in judged
            }
            states = np.concatenate([part.states for part in stored])
            self.search.tell(self.searched.outcomes(columns, states))

    def _require(self, rows: GenerationRows, stored: Sequence[PartColumns]) -> None:
        """Raise where rows were computed from other inputs; those of crashed rows are not known."""
        for part in stored:
            known = part.states != _CRASHED
            for name, values in rows.inputs(part.first, part.first + part.count).items():
                if not np.array_equal(part.columns[INPUT_COLUMN + name][known], values[known]):
                    raise InputError(
                        f"{self.store.folder}: {name} of generation {self.number} is not what the "
                        "search expects here; take another -o, or --restart"
                    )


# A study on workers: a window of batches under way, each written as it comes, and what dies with
# its process found out.
#
# The batches are the parts of the study, whatever the number of workers. A part whose process died
# is asked for once more; at the second death its rows are found out one half after the other, once
# all other parts are done and with no more under way than there are workers.

_WAIT_S = 0.5
_LOOK_EVERY_S = 2.0
_WITHOUT_WORKERS_S = 120.0
_DEATHS_WITHOUT_A_RESULT = 60


@dataclass(frozen=True, slots=True)
class Flight:
    """Rows that are under way: a whole part, or a range of a suspect one."""

    part: int
    first: int
    end: int
    limit: float
    suspect: tuple[SuspectPart, SuspectRange] | None = None


@dataclass(frozen=True, slots=True)
class Computed:
    """What a worker hands back.

    Args:
        data: Bytes of the part, empty where only some of its rows were asked for.
        block: Those rows, None where the whole part was asked for.
        states: Rows by how they ended.
        seconds: How long the rows took.
    """

    data: bytes
    block: RowBlock | None
    states: Mapping[str, int]
    seconds: float


@dataclass(frozen=True, slots=True)
class Landing:
    """What became of a flight: what was computed, or the error instead."""

    future: Future[Computed]
    computed: Computed | None
    error: BaseException | None


@dataclass(slots=True, eq=False)
class ClusterRun:
    """One run.

    Args:
        client: Of the cluster.
        plugin: Name of the plugin that holds the study on the workers.
        digest: Of the study.
        parts: Numbers of the parts to compute.
        workers: Workers as last counted.
    """

    client: distributed_Client
    plugin: str
    source: row_block_RowSource
    digest: str
    writer: PartWriter
    parts: deque[int]
    progress: StudyProgress
    asked: AskedToStop
    limits: TimeLimits
    workers: int
    started: int = field(init=False)
    deaths: Counter[int] = field(default_factory=Counter)
    pieces: deque[tuple[SuspectPart, SuspectRange]] = field(default_factory=deque)
    flying: dict[Key, tuple[Flight, Future[Computed]]] = field(default_factory=dict)
    landed: SimpleQueue[Landing | None] = field(default_factory=SimpleQueue)
    looked: float = field(default_factory=time.monotonic)
    worked: float = field(default_factory=time.monotonic)
    began: dict[tuple[int, int], float] = field(default_factory=dict)
    computed_any: bool = False

    def __post_init__(self) -> None:
        self.started = self.workers

    def run(self) -> None:
        """Compute and write all parts.

        Raises:
            EngineStoppedError: The scheduler or all workers are lost, or somebody asked to stop;
                what had come is written.
        """
        self.asked.wake = self._wake
        self.client.subscribe_topic(self.plugin, self._hear)
        try:
            while self.parts or self.pieces or self.flying:
                self._fill()
                self._take()
                if self.asked:
                    kept_now = self._write_what_has_come()
                    raise StudyInterruptedError(self.asked.number, kept_now)
                if time.monotonic() - self.looked > _LOOK_EVERY_S:
                    self._look()
        finally:
            self.asked.wake = _nothing

    def leave(self) -> None:
        """Ask for nothing any more."""
        futures = [future for _, future in self.flying.values()]
        with suppress(Exception):
            self.client.unsubscribe_topic(self.plugin)
            self.client.cancel(futures)

    def _hear(self, event: tuple[float, tuple[int, int]]) -> None:
        """A worker says that rows begin on which a verdict hangs: they may have waited for it."""
        first, end = event[1]
        self.began[first, end] = time.monotonic()

    def _wake(self) -> None:
        self.landed.put(None)

    def _fill(self) -> None:
        """Ask for rows until the window is full."""
        while not self._alone_flies():
            if self.parts and len(self.flying) < 2 * self.workers:
                part = self.parts.popleft()
                first = part * self.source.batch
                self._send(part, first, min(first + self.source.batch, self.source.count))
            elif not self.parts and self.pieces and self._room_for(self.pieces[0][1]):
                suspect, rows = self.pieces.popleft()
                self._send(suspect.part, rows.first, rows.end, (suspect, rows))
            else:
                return

    def _room_for(self, rows: SuspectRange) -> bool:
        return not self.flying if rows.alone else len(self.flying) < self.workers

    def _alone_flies(self) -> bool:
        return any(
            flight.suspect is not None and flight.suspect[1].alone
            for flight, _ in self.flying.values()
        )

    def _send(
        self,
        part: int,
        first: int,
        end: int,
        suspect: tuple[SuspectPart, SuspectRange] | None = None,
    ) -> None:
        limit = self.limits.of(end - first)
        whole = suspect is None
        future = self.client.submit(
            compute_rows,
            self.plugin,
            first,
            end,
            limit,
            whole,
            suspect is not None and suspect[1].alone,
            pure=False,
            retries=0,
        )
        flight = Flight(part, first, end, limit, suspect)
        self.flying[future.key] = flight, future
        future.add_done_callback(self._fetch)

    def _fetch(self, future: Future[Computed]) -> None:
        """Bring a result here; runs in a thread of the client."""
        try:
            self.landed.put(Landing(future, future.result(), None))
        except BaseException as error:
            self.landed.put(Landing(future, None, error))

    def _take(self) -> None:
        """Wait for a landing, not for long, and act upon it."""
        try:
            landing = self.landed.get(timeout=_WAIT_S)
        except Empty:
            return
        if landing is None or landing.future.key not in self.flying:
            return
        flight, _ = self.flying.pop(landing.future.key)
        if landing.computed is not None:
            self._arrived(flight, landing.computed)
        elif landing.error is not None:
            self._failed(flight, landing.error)

    def _arrived(self, flight: Flight, computed: Computed) -> None:
        self.computed_any = True
        if flight.suspect is not None and computed.block is not None:
            suspect, rows = flight.suspect
            self._go_on_with(suspect, suspect.computed(rows, computed.block))
            return
        self.limits.taken.append(computed.seconds)
        self._write(flight.part, computed.data, computed.states)

    def _go_on_with(self, suspect: SuspectPart, rows: Sequence[SuspectRange]) -> None:
        self.pieces.extend((suspect, each) for each in rows)
        block = suspect.block
        if block is not None:
            data = encode_part(block, self.source.columns, self.digest)
            self._write(suspect.part, data, counted(block))

    def _write(self, part: int, data: bytes, states: Mapping[str, int]) -> None:
        self.writer.write(part, data)
        self.progress.finished(states)

    def _failed(self, flight: Flight, error: BaseException) -> None:
        if isinstance(error, KilledWorker | OSError | MemoryError):
            self._died(flight, error)
        elif isinstance(error, UnfitWorkerError):
            raise EngineStoppedError(str(error)) from error
        elif isinstance(error, CancelledError):
            raise self._lost() from error
        else:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise EngineStoppedError(f"a worker failed: {text}") from error

    def _died(self, flight: Flight, error: BaseException) -> None:
        """A flight ended its process, or was on its way to one that ended."""
        self.deaths[flight.part] += 1
        if not self.computed_any and self.deaths.total() >= _DEATHS_WITHOUT_A_RESULT:
            raise EngineStoppedError(
                f"none of {self.deaths.total()} batches came back: each ended its process"
            ) from error
        if flight.suspect is not None:
            suspect, rows = flight.suspect
            self._go_on_with(suspect, suspect.died(rows, self._verdict(flight, error)))
        elif self.deaths[flight.part] == 1:
            self.parts.append(flight.part)
        else:
            suspect = SuspectPart(flight.part, flight.first, flight.end, self.source)
            self._go_on_with(suspect, suspect.began())

    def _verdict(self, flight: Flight, error: BaseException) -> str:
        """What the message of a row says that is given up; the same in every run."""
        if isinstance(error, MemoryError):
            return "ran out of memory"
        began = self.began.get((flight.first, flight.end))
        if began is not None and time.monotonic() - began >= flight.limit:
            return f"took longer than {self.limits.in_words()}"
        return f"ended its process {DEATHS} times"

    def _look(self) -> None:
        """Count the workers that there are; see that others take the place of lost ones."""
        self.looked = now = time.monotonic()
        try:
            there = len(self.client.nthreads())
        except Exception as error:
            raise self._lost() from error
        if there < self.started:
            replace_lost(self.client)
        if there:
            self.workers, self.worked = there, now
        elif now - self.worked > _WITHOUT_WORKERS_S:
            rows = self._write_what_has_come()
            raise EngineStoppedError(
                f"no worker has been left for {_WITHOUT_WORKERS_S:g} s, after {rows}"
            )

    def _lost(self) -> SchedulerLostError:
        return SchedulerLostError(f"the scheduler was lost after {self._write_what_has_come()}")

    def _write_what_has_come(self) -> str:
        """Write the parts that are in hand and wait for none; how much of the study is kept."""
        with suppress(Empty):
            while True:
                landing = self.landed.get_nowait()
                if landing is None or landing.computed is None:
                    continue
                flight, _ = self.flying.pop(landing.future.key)
                if flight.suspect is None:
                    self._write(flight.part, landing.computed.data, landing.computed.states)
        return kept(self.progress.done, self.progress.count)


def _nothing() -> None:
    """Nobody waits."""


# What runs on a worker: the study, sent once, and the rows of a range.
#
# A batch that takes too long ends its own process: the alarm is a thread of C that needs no
# interpreter, so that it rings in a loop of compiled code as well, and wherever the worker runs.
# The nanny of the worker starts another process, which is given the study by the scheduler.

_SETTLED_S = 1.0
_HEARD_S = 0.3


class UnfitWorkerError(Exception):
    """A worker cannot compute rows of the study; the text says which, and why."""


class StudyOnWorker(WorkerPlugin):
    """The study on a worker, there before its first batch and again after each restart.

    Args:
        pickled: A `RowSource`.
        digest: Of the study, for the parts.
        facts: What each worker must be like (`worker_facts`); one that comes later is held to it,
            too.
    """

    def __init__(self, pickled: bytes, digest: str, facts: Mapping[str, str]) -> None:
        self.pickled = pickled
        self.digest = digest
        self.facts = dict(facts)

    def setup(self, worker: Worker) -> None:
        """Read the study, with all the modules that it needs.

        What goes wrong is told by the first batch: a ``worker`` that cannot start would only
        vanish.
        """
        self.turn = threading.Lock()
        # A nanny gives up on a process that ends before it has said that it is there.
        self.ready = time.monotonic() + (0.0 if worker.status.name == "running" else _SETTLED_S)
        self.unfit = self._read(worker.address)

    def _read(self, address: str) -> str:
        """Why the study cannot be computed here; empty where it can."""
        difference = first_difference(worker_facts(), self.facts)
        if difference:
            return f"worker {address} {difference}"
        try:
            self.source: row_block_RowSource = pickle.loads(self.pickled)
        except Exception as error:  # whatever it is, the study cannot be read
            return f"worker {address} cannot read the study: {type(error).__name__}: {error}"
        return ""


def compute_rows(
    name: str, first: int, end: int, limit: float, whole: bool, told: bool
) -> Computed:
    """Rows ``first`` to ``end`` - 1 of the study that the plugin ``name`` holds.

    Args:
        limit: Time in s after which this process ends.
        whole: Whether they are a part, which is encoded here.
        told: Whether those who listen to ``name`` are told that the rows begin now.
    """
    study = cast("StudyOnWorker", get_worker().plugins[name])
    if study.unfit:
        raise UnfitWorkerError(study.unfit)
    with study.turn:
        time.sleep(max(0.0, study.ready - time.monotonic()))
        if told:
            get_worker().log_event(name, [first, end])
            time.sleep(_HEARD_S)
        return _timed(study, first, end, limit, whole)


def _timed(study: StudyOnWorker, first: int, end: int, limit: float, whole: bool) -> Computed:
    with ending_after(limit):
        began = time.perf_counter()
        block = contained_rows(study.source, first, end)
        data = encode_part(block, study.source.columns, study.digest) if whole else b""
        took = time.perf_counter() - began
    return Computed(data, None if whole else block, counted(block), took)


@contextmanager
def ending_after(limit: float) -> Iterator[None]:
    """End this process where the block takes longer than ``limit`` s."""
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        faulthandler.dump_traceback_later(limit, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
