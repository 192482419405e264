"""A study in this process: the same batches, the same bytes, and no cluster to start."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from typing import TYPE_CHECKING

from dqforge.reports.study_engine.contained_rows import contained_rows, counted
from dqforge.reports.study_engine.signals import AskedToStop
from dqforge.reports.study_engine.stopped import StudyInterruptedError, kept
from dqforge.reports.study_store.part_file import encode_part

if TYPE_CHECKING:
    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.reports.study_engine.engine_settings import PartWriter
    from dqforge.reports.study_engine.study_progress import StudyProgress


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
