"""What was made of the studies used last: made once for each, and kept while it is in use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from dqforge.machines.exploration.study import Study

_Made = TypeVar("_Made")
_MOST = 4


class Recent(Generic[_Made]):
    """Things made of studies, known by the study itself and not by what it says."""

    def __init__(self, make: Callable[[Study], _Made]) -> None:
        self._make = make
        self._kept: list[tuple[Study, _Made]] = []

    def of(self, study: Study) -> _Made:
        """What is made of a study; of the last few it is there already."""
        for known, made in self._kept:
            if known is study:
                return made
        made = self._make(study)
        self._kept.append((study, made))
        del self._kept[:-_MOST]
        return made
