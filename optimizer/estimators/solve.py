"""The tracker that a design asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import TRACKER_NAMES
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.settings import ObserverSettings
    from dqforge.optimizer.estimators.tracker import Tracker, TrackerLoop


@dataclass(frozen=True, slots=True, eq=False)
class TunedTracker:
    """A tracker with its gains for the firmware.

    ``t_s`` is the sampling period in s; it holds from ``omega_low`` to ``omega_high`` in rad/s
    (electrical) of a drive that turns with up to ``omega_max``.
    """

    tracker: Tracker
    gains: Any
    t_s: float
    omega_low: float
    omega_high: float
    omega_max: float

    @property
    def loop(self) -> TrackerLoop | None:
        """Its phase-locked loop, None where it states none."""
        return None if self.tracker.loop is None else self.tracker.loop(self.gains)


def tune_tracker(design: Design, settings: ObserverSettings) -> TunedTracker:
    """A tracker of a design by the settings of one of its estimators.

    Raises:
        InputError: Its control functions are in integers, which no tracker is.
        NoSolutionError: Physics forbids it; the message has the number.
    """
    from dqforge.optimizer.estimators.registry import TRACKERS

    tracker = TRACKERS[settings.method]
    for name in design.export.control:
        if name != "float32":
            raise InputError(
                f"export.control: {name} has no {tracker.name} in integers; write float32, or "
                "another control.observer.method"
            )
    machine, control = design.machine, design.control
    omega_m = machine.omega_m_max if machine.omega_m_max is not None else control.bases.speed
    gains = tracker.design(design, settings)
    low, high = tracker.speeds(design, gains)
    if not high > low:
        raise NoSolutionError(
            f"control.observer: {tracker.name} serves at no speed: it would hold from {low:.4g} to "
            f"{high:.4g} rad/s (electrical)"
        )
    return TunedTracker(tracker, gains, control.t_s, low, high, omega_m * machine.pole_pairs)


def solve_tracker(design: Design) -> TunedTracker | None:
    """The tracker that ``control.observer`` names, None where it names an observer or there is
    none.

    Errors as `tune_tracker`.
    """
    wanted = design.control.observer
    if wanted is None or wanted.method not in TRACKER_NAMES:
        return None
    return tune_tracker(design, wanted)
