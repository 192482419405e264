"""The position observer in fixed point, as a record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FixedObserverFit,
    FixedPositionObserver,
)
from dqforge.reports.c_code.header_kind import HeaderKind, integer_kinds
from dqforge.reports.capability import Capability
from dqforge.reports.fixed_observers.fixed_observer_header import (
    fit_in_words,
    fixed_observer_files,
    fixed_observer_programme,
    plain_fixed_observer,
    plain_observer_evidence,
)
from dqforge.reports.fixed_observers.fixed_observer_reading import fixed_observer_from

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution

Fits = tuple[FixedObserverFit, ...]


_KINDS: tuple[HeaderKind[Fits, FixedPositionObserver], ...] = integer_kinds(
    "observer",
    width_of=lambda fit: fit.observer.width,
    files=lambda solution, fit: fixed_observer_files(solution.design, fit),
    plain=lambda fit: plain_fixed_observer(fit.observer),
    read=lambda own, width, _: fixed_observer_from(own, width),
    programme=fixed_observer_programme,
)


def _summary(_: Solution, fits: Fits) -> list[tuple[str, str]]:
    return [("observer in integers", "; ".join(fit_in_words(fit) for fit in fits))]


FIXED_OBSERVER = Capability(
    name="observer_fixed",
    title="position observer in fixed point",
    of=lambda outcome: outcome.solution.fixed_observers or None,
    plain=lambda _, fits: {fit.observer.format: plain_observer_evidence(fit) for fit in fits},
    always=False,
    summary=_summary,
    headers=_KINDS,
)
