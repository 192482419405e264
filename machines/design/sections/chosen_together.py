"""Speed loop and position observer of a design that leaves the spread of the loop open."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import ObserverSettings, SpeedLoopSettings, Tolerances
from dqforge.machines.devices.inverter import Inverter

SPREAD = 4.0  # Spread of a speed loop that counts the lag of its observer: about 60 degrees.

# Share of the speed in the correction of the flux: with the whole dead time, and where what is left
# of it is small.
SPEED_GAIN, SPEED_GAIN_COMPENSATED = 1.0, 0.5
COMPENSATED = 0.1  # Largest share of the dead time that counts as small.


def chosen_together(
    loop: SpeedLoopSettings,
    observer: ObserverSettings,
    inverter: Inverter,
    tolerances: Tolerances | None,
    reading: Reading,
) -> tuple[SpeedLoopSettings, ObserverSettings]:
    """Settings of both, with what is assumed said in the remarks of the reading.

    Args:
        loop, observer: As they were read.
        inverter: With its dead time.
        tolerances: What the compensation of the dead time leaves, None where the design names none.
        reading: Takes the remarks.
    """
    reading.remarks.append(
        f"control.speed_loop.spread is taken as {SPREAD:g}, and the observer's lag as one of the "
        "loop's delays, because the loop runs on a position observer"
    )
    loop = replace(loop, spread=SPREAD, counts_observer=True)
    if observer.method != "flux" or observer.speed_gain is not None or observer.tuning != "named":
        return loop, observer
    small = _compensated(inverter, tolerances)
    gain = SPEED_GAIN_COMPENSATED if small else SPEED_GAIN
    reading.remarks.append(
        f"control.observer.speed_gain is taken as {gain:g}, because the speed loop runs on the "
        f"observer{' and little is left of the dead time' if small else ''}"
    )
    return loop, replace(observer, speed_gain=gain)


def _compensated(inverter: Inverter, tolerances: Tolerances | None) -> bool:
    """Whether the design says that at most a tenth of the dead time is left."""
    if inverter.dead_time == 0.0:
        return True
    if tolerances is None:
        return False
    left = max(abs(value) for value in tolerances.limits("dead_time"))
    return 0.0 < left <= COMPENSATED * inverter.dead_time
