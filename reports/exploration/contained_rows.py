"""Rows that are computed whatever one of them does: an error inside a row stays in that row, a
part whose process dies is searched for the row to blame, and a run says how far it is.
"""

from __future__ import annotations

import re
import time
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from statistics import median
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    KEY_BYTES,
    STATES,
    ColumnSpec,
    KnownRows,
    RowBlock,
    RowSource,
)
from dqforge.reports.exploration.part_store import PartStore
from dqforge.reports.pages.answer import shares, stage

Column = FloatArray | NDArray[np.int32]


def contained_rows(source: RowSource, first: int, end: int) -> RowBlock:
    """Rows ``first`` to ``end`` - 1 of ``source``.

    A range that ends in an error is halved, down to the row that is to blame, which becomes
    `crashed`. The halves follow from the range alone, so that every engine gets the same bytes.
    Warnings are those of the command line: numerical trouble is an error, the rest is silent.
    Memory that runs out is not the row's fault, and is raised.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", RuntimeWarning)
        return _contained(source, first, end)


def _contained(source: RowSource, first: int, end: int) -> RowBlock:
    try:
        return source.rows(first, end)
    except MemoryError:
        raise
    except Exception as error:  # whatever a row does, the others are computed
        if end - first == 1:
            return crashed_row(source, first, _in_words(error))
    middle = halfway(first, end)
    return joined((_contained(source, first, middle), _contained(source, middle, end)))


def _in_words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def halfway(first: int, end: int) -> int:
    """Where a range of rows is halved: by its ends alone."""
    return first + (end - first) // 2


def crashed_row(source: RowSource, index: int, message: str) -> RowBlock:
    """The row ``index`` that could not be computed: what went into it, no outputs, and why.

    A source that cannot tell inputs and key without computing the row has none of them; the key is
    then of zeros, which no design has.
    """
    inputs, keys = _known(source, index)
    given = {INPUT_COLUMN + name: values for name, values in inputs.items()}
    return RowBlock(
        first=index,
        columns={each.name: given.get(each.name, _nothing(each)) for each in source.columns},
        keys=keys,
        states=np.array([STATES.index("crashed")], np.int8),
        messages=(message,),
    )


def _known(source: RowSource, index: int) -> tuple[Mapping[str, Column], NDArray[np.uint8]]:
    """Inputs and key of one row."""
    nothing = np.zeros((1, KEY_BYTES), np.uint8)
    if not isinstance(source, KnownRows):
        return {}, nothing
    try:
        return source.inputs(index, index + 1), source.keys(index, index + 1)
    except Exception:  # the row may have crashed on just that
        return {}, nothing


def _nothing(column: ColumnSpec) -> Column:
    return np.full(1, np.nan) if column.kind == "number" else np.full(1, -1, np.int32)


def joined(blocks: Sequence[RowBlock]) -> RowBlock:
    """Blocks that follow upon each other as one."""
    if len(blocks) == 1:
        return blocks[0]
    names = blocks[0].columns
    audited: dict[str, float] = {}
    for block in blocks:
        for name, deviation in block.audited.items():
            audited[name] = max(deviation, audited.get(name, 0.0))
    return RowBlock(
        first=blocks[0].first,
        columns={name: np.concatenate([block.columns[name] for block in blocks]) for name in names},
        keys=np.concatenate([block.keys for block in blocks]),
        states=np.concatenate([block.states for block in blocks]),
        messages=tuple(message for block in blocks for message in block.messages),
        audited=audited,
    )


def counted(block: RowBlock) -> Mapping[str, int]:
    """Rows of a block by how they ended."""
    return Counter(STATES[state] for state in block.states)


# A part of a study whose process died: which of its rows is to blame.
#
# Ranges are halved until single rows are left. What a part holds in the end follows from the rows
# that kill and from nothing else: a range in which no row is found to blame is computed once more
# as a whole, since it was a neighbour, or somebody from outside, that ended its process.

# Deaths at which a single row, or a range without a row to blame, is given up; at the last one
# nothing else was running.
DEATHS = 3


@dataclass(slots=True, eq=False)
class SuspectRange:
    """A range of rows on its way to a block."""

    first: int
    end: int
    parent: SuspectRange | None = None
    halves: tuple[SuspectRange, ...] = ()
    block: RowBlock | None = None
    crashed: bool = False
    deaths: int = 0

    @property
    def alone(self) -> bool:
        """Whether it is to run with nothing else under way: a verdict hangs on it."""
        return self.deaths == DEATHS - 1 and (self.single or bool(self.halves))

    @property
    def single(self) -> bool:
        """Whether it is one row."""
        return self.end - self.first == 1


@dataclass(slots=True)
class SuspectPart:
    """Rows ``first`` to ``end`` - 1 of ``source``, which ended their process.

    Each step hands back the ranges that are to be run next.
    """

    part: int
    first: int
    end: int
    source: RowSource
    root: SuspectRange = field(init=False)

    def __post_init__(self) -> None:
        self.root = SuspectRange(self.first, self.end)

    @property
    def block(self) -> RowBlock | None:
        """All rows, once they are there."""
        return self.root.block

    def began(self) -> list[SuspectRange]:
        """What is run first: the part as a whole has died before."""
        return self.died(self.root, "")

    def computed(self, found: SuspectRange, block: RowBlock) -> list[SuspectRange]:
        """A range was computed."""
        found.block = block
        return self._settled(found)

    def died(self, found: SuspectRange, message: str) -> list[SuspectRange]:
        """A range ended its process; ``message`` says how, should it be the row's fault."""
        found.deaths += 1
        if (found.single or found.halves) and found.deaths < DEATHS:
            return [found]
        if found.single:
            found.block, found.crashed = crashed_row(self.source, found.first, message), True
            return self._settled(found)
        if found.halves:  # clean in pieces, dead as a whole: the pieces are what there is
            found.block = _of_halves(found)
            return self._settled(found)
        middle = halfway(found.first, found.end)
        found.halves = (
            SuspectRange(found.first, middle, found),
            SuspectRange(middle, found.end, found),
        )
        return list(found.halves)

    def _settled(self, found: SuspectRange) -> list[SuspectRange]:
        """A range has its block; the range that it is a half of may have one now, too."""
        above = found.parent
        if above is None or any(half.block is None for half in above.halves):
            return []
        if not any(half.crashed for half in above.halves):
            return [above]
        above.block, above.crashed = _of_halves(above), True
        return self._settled(above)


def _of_halves(found: SuspectRange) -> RowBlock:
    return joined([half.block for half in found.halves if half.block is not None])


# How far a run of a study is, as the terminal shows it.

_WELL = ("ok", "limit")
_REFRESH_S = 0.2


@dataclass(slots=True)
class StudyProgress:
    """Rows by how they ended.

    Args:
        count: Rows of the study.
        kept: Rows that an earlier run has left.
        states: Rows of this run.
    """

    count: int
    kept: int
    states: Counter[str] = field(default_factory=Counter)
    began: float = field(default_factory=time.monotonic)
    shown: float = 0.0

    @property
    def done(self) -> int:
        """Rows that are kept."""
        return self.kept + self.states.total()

    @property
    def seconds(self) -> float:
        """Time since the first row was asked for."""
        return time.monotonic() - self.began

    def starts(self) -> None:
        """The first row is asked for: what came before does not count for the rate."""
        self.began = time.monotonic()

    def finished(self, states: Mapping[str, int]) -> None:
        """A part is written."""
        self.states.update(states)
        now = time.monotonic()
        if now - self.shown >= _REFRESH_S or self.done == self.count:
            self.shown = now
            self._show()

    def waits(self, text: str) -> None:
        """Say what the run waits for."""
        stage(text)

    def _show(self) -> None:
        computed = self.states.total()
        failed = computed - sum(self.states[state] for state in _WELL)
        rate = computed / max(self.seconds, 1e-9)
        failures = f", {failed:,} failed" if failed else ""
        stage(f"{self.done:,} of {self.count:,} rows, {rate:,.0f}/s{failures}")
        move = shares()
        if move is not None:
            move(computed / max(self.count - self.kept, 1))


# How long a batch may take before its process is ended: from what batches have taken so far.

_FIRST_S = 900.0
_LEAST_S = 60.0
_LEAST_OF_A_PIECE_S = 10.0
_USUAL_BATCHES = 30.0
_LONGEST_BATCHES = 5.0
_ENOUGH = 3


@dataclass(slots=True)
class TimeLimits:
    """Limits in s.

    Args:
        given: By the user, for every batch; None to learn it.
        rows: Rows of a whole part.
        taken: What whole parts have taken.
    """

    given: float | None
    rows: int
    taken: list[float] = field(default_factory=list)

    def of(self, count: int) -> float:
        """Limit of ``count`` rows: 30 usual batches and 5 of the longest, at least a minute, for a
        piece of a part its share and at least 10 s.
        """
        if self.given is not None:
            return self.given
        if len(self.taken) < _ENOUGH:
            return _FIRST_S
        usual = max(_USUAL_BATCHES * median(self.taken), _LONGEST_BATCHES * max(self.taken))
        if count >= self.rows:
            return max(_LEAST_S, usual)
        return max(_LEAST_OF_A_PIECE_S, usual * count / self.rows)

    def in_words(self) -> str:
        """The limit in a message: one that was learned differs from run to run, and messages do
        not.
        """
        return "30 usual batches" if self.given is None else f"{self.given:g} s"


# On what a study is run, as the command asks for it.

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
