"""How far a run of a study is, as the terminal shows it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from dqforge.reports.pages.console import shares, stage

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
