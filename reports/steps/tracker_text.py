"""A tracker of the position in C, from its step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dqforge.optimizer.observers.parts import FirmwareStep
from dqforge.reports.steps.observer_text import step_text
from dqforge.reports.steps.record_text import sentence

if TYPE_CHECKING:
    from dqforge.machines.transforms import Reals
    from dqforge.optimizer.estimators import Signal, Tracker
    from dqforge.optimizer.observers.parts import ObserverState
    from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair

_NAMES: dict[Signal, str] = {
    "sum-voltage": "u",
    "voltage-a": "v_a",
    "voltage-b": "v_b",
    "voltage-c": "v_c",
}


def tracker_text(tracker: Tracker, gains: Any, prefix: str, macro: str) -> str:
    """What stands in a header behind the types that control and observers share.

    Args:
        tracker: With ``members``; the C says of its functions what their docstrings begin with.
        gains: Its gains.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    assert tracker.members is not None

    def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
        return tracker.start(gains, theta_e, omega_e)

    def step(
        own: Any, state: ObserverState, v: Pair, i: Pair, o: Arithmetic, *heard: Reals
    ) -> ObserverState:
        return tracker.step(own, state, v, i, heard, o)

    emitted = FirmwareStep(
        tracker.code,
        tracker.gains,
        start,
        step,
        tracker.members,
        sentence(tracker.start),
        sentence(tracker.step),
        tuple(_NAMES[signal] for signal in tracker.hears),
    )
    return step_text(emitted, gains, prefix, macro)
