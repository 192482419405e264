"""The position observer in fixed point, as a record."""

from __future__ import annotations

from typing import Literal

from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FixedObserverFit,
    FixedPositionObserver,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability
from dqforge.reports.fixed_observers.fixed_observer_header import (
    fit_in_words,
    fixed_observer_files,
    fixed_observer_programme,
    plain_fixed_observer,
    plain_observer_evidence,
)
from dqforge.reports.fixed_observers.fixed_observer_reading import fixed_observer_from
from dqforge.reports.plain_data import PlainData

Fits = tuple[FixedObserverFit, ...]


def _fit(fits: Fits, width: int) -> FixedObserverFit | None:
    return next((fit for fit in fits if fit.observer.width == width), None)


def _fixed_kind(width: Literal[16, 32]) -> HeaderKind[Fits, FixedPositionObserver]:
    def files(solution: Solution, fits: Fits) -> dict[str, bytes]:
        fit = _fit(fits, width)
        return {} if fit is None else fixed_observer_files(solution.design, fit)

    def plain(_: Solution, fits: Fits) -> PlainData | None:
        fit = _fit(fits, width)
        return None if fit is None else plain_fixed_observer(fit.observer)

    return HeaderKind(
        name=f"observer_q{width - 1}",
        files=files,
        plain=plain,
        read=lambda own, _: fixed_observer_from(own, width),
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
    headers=(_fixed_kind(16), _fixed_kind(32)),
)
