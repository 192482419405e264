"""What runs on a worker: the study, sent once, and the rows of a range.

A batch that takes too long ends its own process: the alarm is a thread of C that needs no
interpreter, so that it rings in a loop of compiled code as well, and wherever the worker runs. The
nanny of the worker starts another process, which is given the study by the scheduler.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from distributed import Worker, WorkerPlugin, get_worker

from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import RowBlock, RowSource
from dqforge.reports.study_engine.contained_rows import contained_rows, counted
from dqforge.reports.study_engine.worker_facts import first_difference, worker_facts
from dqforge.reports.study_store.part_file import encode_part

_SETTLED_S = 1.0
_HEARD_S = 0.3


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
            self.source: RowSource = pickle.loads(self.pickled)
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
