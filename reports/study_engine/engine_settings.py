"""On what a study is run, as the command asks for it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.reports.study_store.part_store import PartStore

_ADDRESS = re.compile(r"(?:(?:tcp|tls|ws|wss|ucx)://)?[^\s/:]+|(?:(?:tcp|tls)://)?\[[0-9a-f:.%]+\]")
_MOST_PORT = 65535


def is_address(text: str) -> bool:
    """Whether a text may be the address of a scheduler: a host and a port, after a protocol.

    A client of Dask that is given another one is left half made, and complains when it is deleted.

    Args:
        text: Such as ``tcp://host:8786``.
    """
    host, _, port = text.rstrip("/").rpartition(":")
    number = int(port) if re.fullmatch(r"\d{1,5}", port) else 0
    return _ADDRESS.fullmatch(host) is not None and 1 <= number <= _MOST_PORT


class PartWriter(Protocol):
    """Where parts go."""

    def write(self, part: int, data: bytes) -> None:
        """Keep the bytes of a part."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Certificates in PEM format; empty texts leave them to Dask's own settings."""

    authority: str = ""
    certificate: str = ""
    key: str = ""


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """On what a study is run.

    Args:
        workers: Processes of this machine, None for as many as it has processors.
        scheduler: Address of a cluster that there is, empty for none.
        scheduler_file: File in which the scheduler wrote its address, None for none.
        tls: For a cluster that asks for it.
        mixed: Whether workers may have other CPU features.
        time_limit: Of a batch in s, None to learn it.
    """

    workers: int | None = None
    scheduler: str = ""
    scheduler_file: Path | None = None
    tls: TlsFiles = TlsFiles()
    mixed: bool = False
    time_limit: float | None = None

    def __post_init__(self) -> None:
        """Refuse an address that none can be; raises `InputError`."""
        if self.scheduler and not is_address(self.scheduler):
            raise InputError(
                f"--scheduler {self.scheduler}: expected an address such as tcp://host:8786"
            )

    @property
    def elsewhere(self) -> bool:
        """Whether a cluster that there is does the work."""
        return bool(self.scheduler) or self.scheduler_file is not None


# What a run of a study leads to, counted over the parts that are there.

FAILED = ("no-solution", "refused", "crashed")


@dataclass(frozen=True, slots=True)
class FailedRows:
    """Rows that ended in the same state: how many, and the first of them with its message."""

    state: str
    count: int
    first: int
    message: str


@dataclass(frozen=True, slots=True)
class StudyOutcome:
    """A study after a run.

    Args:
        rows: Rows of the study.
        counts: Rows by state, in the order of `STATES`; rows that are not computed are in none.
        failures: By state, those that gave no numbers.
        audited: Largest relative deviation of the batch path from the single path, by output.
        computed: Rows that this run computed; the others were there.
        seconds: What it took; it stands in no file.
        workers: Processes that computed, 0 for the command's own.
    """

    rows: int
    counts: Mapping[str, int]
    failures: tuple[FailedRows, ...]
    audited: Mapping[str, float]
    computed: int
    seconds: float
    workers: int

    @property
    def done(self) -> int:
        """Rows that are there."""
        return sum(self.counts.values())

    @property
    def succeeded(self) -> bool:
        """Whether any row has its numbers."""
        return self.counts["ok"] + self.counts["limit"] > 0


def study_outcome(store: PartStore, *, computed: int, seconds: float, workers: int) -> StudyOutcome:
    """Look through the parts of a store; ``computed``, ``seconds`` and ``workers`` of the run."""
    counts = np.zeros(len(STATES), dtype=np.int64)
    first: dict[str, tuple[int, str]] = {}
    for part in store.read(["message"]):
        counts += np.bincount(part.states, minlength=len(STATES))
        for state in FAILED:
            own = np.flatnonzero(part.states == STATES.index(state))
            if own.size:
                first.setdefault(state, (part.first + int(own[0]), part.messages[own[0]]))
    by_state: dict[str, int] = dict(zip(STATES, counts.tolist(), strict=True))
    failures = [
        FailedRows(state, by_state[state], *first[state]) for state in FAILED if state in first
    ]
    return StudyOutcome(
        rows=store.header.count,
        counts=by_state,
        failures=tuple(failures),
        audited=store.survey().audited,
        computed=computed,
        seconds=seconds,
        workers=workers,
    )
