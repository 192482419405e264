"""Observers of position and of speed, as records."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Outcome, ReportPart
from dqforge.reports.observers.estimator_header import (
    emitted_estimator,
    estimator_files,
    estimator_from,
    estimator_programme,
    plain_estimator,
)
from dqforge.reports.observers.html import estimator_tables, speed_tables
from dqforge.reports.observers.speed_float32_model import (
    plain_speed_observer,
    speed_observer_from,
)
from dqforge.reports.observers.speed_header import speed_observer_files, speed_observer_programme
from dqforge.reports.pages.chapters import LOOPS

if TYPE_CHECKING:
    from dqforge.optimizer.estimators.solve import TunedTracker
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.reports.pages.html_table import HtmlTable


def _part(tables: list[HtmlTable]) -> list[ReportPart]:
    return [ReportPart(LOOPS, "pages/tables.html.j2", {"tables": tables, "kind": "loops"})]


def _position(outcome: Outcome) -> PositionObserver | TunedTracker | None:
    gains = outcome.solution.loops
    if gains is None:
        return None
    return gains.position if gains.tracker is None else gains.tracker


def _speed(outcome: Outcome) -> ReducedOrderObserver | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.observer


POSITION_OBSERVER: Capability[PositionObserver | TunedTracker] = Capability(
    name="position_observer",
    title="position observer",
    of=_position,
    parts=lambda _, observer: _part(estimator_tables(observer)),
    headers=(
        HeaderKind(
            name="observer",
            files=lambda solution, observer: estimator_files(solution.design, observer),
            plain=lambda _, observer: plain_estimator(emitted_estimator(observer)),
            read=lambda own, _: estimator_from(own),
            programme=estimator_programme,
            vectors=False,
        ),
    ),
)

# Tables of the terminal and JSON of both stand with those of the loops.
SPEED_OBSERVER = Capability(
    name="speed_observer",
    title="speed observer",
    of=_speed,
    parts=lambda solution, observer: _part(speed_tables(observer, solution.observer_errors)),
    headers=(
        HeaderKind(
            name="speed_observer",
            files=lambda solution, observer: speed_observer_files(solution.design, observer),
            plain=lambda solution, observer: plain_speed_observer(
                solution.design.machine, observer
            ),
            read=lambda own, _: speed_observer_from(own),
            programme=speed_observer_programme,
            vectors=False,
        ),
    ),
)
