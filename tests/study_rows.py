"""Rows that are quick to compute and behave as badly as asked: what engines of a study are tried
on.
"""

from __future__ import annotations

import hashlib
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dqforge.optimizer.exploration.row_block import STATES, ColumnSpec, RowBlock

COLUMNS = (
    ColumnSpec("in.machine.resistance", "ohm"),
    ColumnSpec("in.inverter.device", "", "choice", ("fuji", "own")),
    ColumnSpec("out.losses.total", "W"),
)


@dataclass(frozen=True)
class StudyRows:
    """Rows whose figures follow from their index alone.

    Args:
        takes: Time of a batch in s.
        refused, raising, killing, hanging, looping: Rows that are refused, raise an error, end
            their process, sleep for ever, or keep the interpreter to themselves for ever.
        seen: Folder in which each batch leaves a mark that it was computed, None for nowhere.
    """

    count: int = 100
    batch: int = 10
    takes: float = 0.0
    refused: tuple[int, ...] = ()
    raising: tuple[int, ...] = ()
    killing: tuple[int, ...] = ()
    hanging: tuple[int, ...] = ()
    looping: tuple[int, ...] = ()
    seen: Path | None = None

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        return COLUMNS

    def rows(self, first: int, end: int) -> RowBlock:
        """Figures whose last digits hang on the size of the batch, as those of real rows do."""
        if self.seen is not None:
            (self.seen / f"{first}-{end}-{os.getpid()}-{time.time_ns()}").touch()
        time.sleep(self.takes)
        self._misbehave(first, end)
        index = np.arange(first, end)
        resistance = 0.01 * (1.0 + np.sin(index))
        total = resistance * 350.0**2 + (end - first) * 2.0**-40
        states = np.where(np.isin(index, self.refused), STATES.index("refused"), 0)
        total = np.where(states == 0, total, np.nan)
        keys = [hashlib.sha256(str(row).encode()).digest()[:16] for row in index]
        return RowBlock(
            first=first,
            columns={
                "in.machine.resistance": resistance,
                "in.inverter.device": (index % 2).astype(np.int32),
                "out.losses.total": total,
            },
            keys=np.frombuffer(b"".join(keys), np.uint8).reshape(-1, 16),
            states=states.astype(np.int8),
            messages=tuple("500 V is above 80 V" if state else "" for state in states),
            audited={"losses.total": 1e-15 * (first + 1)},
        )

    def _misbehave(self, first: int, end: int) -> None:
        inside = range(first, end)
        if any(row in inside for row in self.raising):
            raise ZeroDivisionError("division by zero")
        if any(row in inside for row in self.killing):
            os.kill(os.getpid(), signal.SIGKILL)
        if any(row in inside for row in self.hanging):
            time.sleep(3600.0)
        if any(row in inside for row in self.looping):
            sum(range(10**15))  # one call into compiled code, which keeps the interpreter
