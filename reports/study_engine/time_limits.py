"""How long a batch may take before its process is ended: from what batches have taken so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median

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
