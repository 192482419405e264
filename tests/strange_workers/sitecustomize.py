"""Loaded by every Python that has this folder in PYTHONPATH: worker processes of studies then
behave as the environment asks.

STUDY_KILLING and STUDY_HANGING name a row that ends its process, or never ends. STUDY_MEMORY names
a folder into which each worker writes its largest memory at the end of every batch, in kB.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.exploration.row_block import RowBlock
    from dqforge.optimizer.exploration.study_plan import StudyPlan


def largest_memory() -> int:
    """Largest memory that this process has had since it began, in kB."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def misbehave(inside: range) -> None:
    """Do what the environment asks of these rows."""
    if int(os.environ.get("STUDY_KILLING", "-1")) in inside:
        os.kill(os.getpid(), signal.SIGKILL)
    if int(os.environ.get("STUDY_HANGING", "-1")) in inside:
        time.sleep(3600.0)


def _make_strange() -> None:
    from dqforge.optimizer.exploration.study_plan import StudyPlan

    tame = StudyPlan.rows

    def rows(plan: StudyPlan, first: int, end: int) -> RowBlock:
        misbehave(range(first, end))
        block = tame(plan, first, end)
        if folder := os.environ.get("STUDY_MEMORY"):
            Path(folder, str(os.getpid())).write_text(str(largest_memory()), encoding="utf-8")
        return block

    type.__setattr__(StudyPlan, "rows", rows)


if any("spawn_main" in word for word in sys.orig_argv) and "STUDY_STRANGE" in os.environ:
    _make_strange()
