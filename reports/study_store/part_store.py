"""An explored folder: its parts written one by one, found again, and read by columns."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.plain_data import PlainData
from dqforge.reports.study_store.part_columns import PartColumns, part_columns
from dqforge.reports.study_store.part_file import KEY, MESSAGE, PartAbout, PartError, part_about
from dqforge.reports.study_store.store_files import (
    BESIDE,
    PARTS,
    StoreError,
    part_files,
    part_name,
    read_whole,
    write_below,
    write_whole,
)
from dqforge.reports.study_store.store_opening import held_study, made_and_locked, make_ready
from dqforge.reports.study_store.study_header import STUDY_JSON, StudyHeader, header_bytes


@dataclass(frozen=True, slots=True)
class Survey:
    """Which parts of a study are there.

    Args:
        finished: Numbers of the parts that count.
        damaged: By number, why a part that is there does not count.
        audited: Largest deviation of the batch path over the finished parts, by output.
    """

    finished: frozenset[int]
    damaged: Mapping[int, str]
    audited: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class PartStore:
    """A folder that holds one study.

    Args:
        folder: As the user named it.
        header: What the study is.
        lock: Descriptor that keeps other runs out; -1 of a folder that is only read.
    """

    folder: Path
    header: StudyHeader
    lock: int = field(default=-1, compare=False)

    @classmethod
    def open(
        cls,
        folder: Path,
        header: StudyHeader,
        *,
        restart: bool = False,
        mixed: bool = False,
        inputs: Mapping[str, bytes] | None = None,
    ) -> Self:
        """Make a folder for a study, or go on with the study that it holds.

        Args:
            folder: Made if missing.
            header: The study that is asked.
            restart: Whether what another study, or this one, left there is taken away first; files
                that no study wrote stay.
            mixed: Whether parts of other versions or another processor may stand beside new ones.
            inputs: Files from which the study can be read again, by name in the folder.

        Raises:
            InputError: The folder cannot be written, holds another study, or another run writes
                there.
        """
        lock = made_and_locked(folder)
        try:
            make_ready(folder, header, restart=restart, mixed=mixed)
            # First what says whose folder this is: a run that ends here can be gone on with.
            write_whole(folder / STUDY_JSON, header_bytes(header))
            for name, content in (inputs or {}).items():
                write_below(folder, name, content)
        except BaseException:
            os.close(lock)
            raise
        return cls(folder, header, lock)

    @classmethod
    def existing(cls, folder: Path) -> Self:
        """A folder to be read; raises `InputError` where it holds no study."""
        found = held_study(folder)
        if found is None:
            raise InputError(
                f"{folder} holds no {STUDY_JSON}; name a folder that 'dqforge explore' wrote"
            )
        return cls(folder, found)

    def survey(self) -> Survey:
        """Look at every part: its seal, its rows, and the study that it is of."""
        finished: set[int] = set()
        damaged: dict[int, str] = {}
        audited: dict[str, float] = {}
        for part, path in part_files(self.folder).items():
            try:
                about = part_about(read_whole(path))
                self._require(part, about)
            except (PartError, OSError) as error:
                damaged[part] = str(error)
                continue
            finished.add(part)
            for name, deviation in about.audited.items():
                audited[name] = max(audited.get(name, 0.0), deviation)
        return Survey(frozenset(finished), damaged, dict(sorted(audited.items())))

    def finished(self) -> frozenset[int]:
        """Numbers of the parts that need not be computed."""
        return self.survey().finished

    def _require(self, part: int, about: PartAbout) -> None:
        """Raise `PartError` where a part is not this one of this study."""
        header = self.header
        if about.digest != header.digest:
            raise PartError("it is of another study")
        if part >= header.parts or about.first != part * header.batch:
            raise PartError("it stands in the place of another part")
        if about.count != header.rows_of(part):
            raise PartError(f"it has {about.count} rows of {header.rows_of(part)}")

    def write(self, part: int, data: bytes) -> None:
        """Keep a part, as `dqforge.reports.study_store.part_file.encode_part` made it.

        Raises:
            StoreError: The disk is full or the folder cannot be written; what is finished stays.
            PartError: The bytes are not those of this part of this study.
        """
        self._require(part, part_about(data))
        write_whole(self.folder / PARTS / part_name(part), data)

    def read(
        self, names: Sequence[str], parts: Collection[int] | None = None
    ) -> Iterator[PartColumns]:
        """Columns of one part after the other, in their order; parts that are not there are left
        out.

        Args:
            names: Columns of the study, ``key`` or ``message``.
            parts: Numbers of the parts, None for all.

        Raises:
            InputError: There is no such column.
            StoreError: A part is damaged.
        """
        known = (*(column.name for column in self.header.columns), KEY, MESSAGE)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise InputError(f"{self.folder} has no column {unknown[0]!r}")
        for part, path in part_files(self.folder, parts).items():
            yield self._columns(part, path, names)

    def _columns(self, part: int, path: Path, names: Sequence[str]) -> PartColumns:
        try:
            found = part_columns(read_whole(path), names, self.header.columns)
            self._require(part, found.about)
        except (PartError, OSError) as error:
            raise StoreError(
                f"{path}: {error}; run the study again, which computes this part anew"
            ) from error
        return found

    def finish(self, outcome: PlainData) -> Self:
        """Put into ``study.json`` what is known at the end."""
        done = replace(self, header=replace(self.header, outcome=outcome))
        write_whole(self.folder / STUDY_JSON, header_bytes(done.header))
        return done

    def write_beside(self, name: str, content: bytes) -> None:
        """Write `FRONT`, `SENSITIVITY` or `REPORT`; raises as `write`."""
        if name not in BESIDE:
            raise ValueError(f"{name} is no file of a study")
        write_whole(self.folder / name, content)

    def close(self) -> None:
        """Let other runs into the folder; once."""
        if self.lock >= 0:
            os.close(self.lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
