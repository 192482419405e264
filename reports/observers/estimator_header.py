"""The C header ``<prefix>_observer.h`` of an observer or a tracker of the position: one of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dqforge.optimizer.estimators.registry import TRACKERS
from dqforge.optimizer.estimators.solve import TunedTracker
from dqforge.reports.observers.position_header import (
    EmittedObserver,
    observer_files,
    observer_from,
    observer_programme,
    plain_observer,
)
from dqforge.reports.observers.tracker_float32_model import EmittedTracker
from dqforge.reports.observers.tracker_header import (
    plain_tracker_gains,
    tracker_files,
    tracker_from,
    tracker_programme,
)

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.plain_data import PlainData


def emitted_estimator(
    found: PositionObserver | TunedTracker,
) -> EmittedObserver | EmittedTracker:
    """What reaches the firmware."""
    if isinstance(found, TunedTracker):
        return EmittedTracker(found.tracker, found.gains)
    return EmittedObserver(found.method, found.gains)


def estimator_files(design: Design, found: PositionObserver | TunedTracker) -> dict[str, bytes]:
    """Name and bytes of the header."""
    if isinstance(found, TunedTracker):
        return tracker_files(design, found)
    return observer_files(design, found)


def plain_estimator(found: EmittedObserver | EmittedTracker) -> PlainData:
    """Method and gains as plain data."""
    if isinstance(found, EmittedTracker):
        return plain_tracker_gains(found)
    return plain_observer(found)


def estimator_from(plain: Mapping[str, Any]) -> EmittedObserver | EmittedTracker:
    """Read it back; errors as `observer_from`."""
    return tracker_from(plain) if plain.get("method") in TRACKERS else observer_from(plain)


def estimator_programme(found: EmittedObserver | EmittedTracker) -> Programme:
    """The harness, with what the model answers."""
    if isinstance(found, EmittedTracker):
        return tracker_programme(found)
    return observer_programme(found)
