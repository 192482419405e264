"""The family of modulators written out one phase value at a time, independent of the package."""

from __future__ import annotations

import math

from dqforge.machines.names import ModulationName

THIRD = 2.0 * math.pi / 3.0
# Degrees by which neighbouring intervals overlap, so that rounding leaves no gap between them.
TINY = 1e-9
CONTINUOUS: tuple[ModulationName, ...] = ("spwm", "thipwm6", "thipwm4", "svpwm")


def phases_at(angle: float) -> list[float]:
    return [math.cos(angle), math.cos(angle - THIRD), math.cos(angle + THIRD)]


def folded(lag: float) -> float:
    """Load angle within -90 and 90 degrees: generating is motoring with the current reversed."""
    return math.remainder(lag, math.pi)


def _rests_from_to(name: str, lag: float) -> list[tuple[float, float]]:
    """Degrees from the positive peak of a phase between which it rests at the positive rail."""
    if name == "gdpwm":
        centre = min(max(math.degrees(folded(lag)), -30.0), 30.0)
        return [(centre - 30.0, centre + 30.0)]
    return {
        "dpwm0": [(-60.0, 0.0)],
        "dpwm1": [(-30.0, 30.0)],
        "dpwm2": [(0.0, 60.0)],
        "dpwm3": [(-60.0, -30.0), (30.0, 60.0)],
        "dpwmmax": [(-60.0, 60.0)],
        "dpwmmin": [],
    }[name]


def rest(name: str, angle: float, lag: float) -> tuple[int, bool] | None:
    """Phase that rests and whether at the positive rail, for the voltage angle `angle`.

    None if all switch.
    """
    if name in CONTINUOUS:
        return None
    v, i = phases_at(angle), phases_at(angle - lag)
    high, low = v.index(max(v)), v.index(min(v))
    if name == "ddt-gdpwm":
        return (high, True) if abs(i[high]) >= abs(i[low]) else (low, False)
    for k in range(3):
        own = math.degrees(math.remainder(angle - k * THIRD, 2.0 * math.pi))
        opposite = math.degrees(math.remainder(angle - k * THIRD + math.pi, 2.0 * math.pi))
        if any(a - TINY <= own <= b + TINY for a, b in _rests_from_to(name, lag)):
            return k, True
        negative = (
            [(-60.0, 60.0)]
            if name == "dpwmmin"
            else []
            if name == "dpwmmax"
            else _rests_from_to(name, lag)
        )
        if any(a - TINY <= opposite <= b + TINY for a, b in negative):
            return k, False
    raise AssertionError((name, angle, lag))


def duties(name: str, amplitude: float, angle: float, lag: float) -> list[float]:
    """Duty cycles without saturation for an amplitude relative to v_dc."""
    v = [amplitude * x for x in phases_at(angle)]
    place = rest(name, angle, lag)
    if place is not None:
        k, upper = place
        v0 = (1.0 if upper else 0.0) - v[k]
    else:
        third = {"thipwm6": 1.0 / 6.0, "thipwm4": 1.0 / 4.0}.get(name, 0.0)
        v0 = 0.5 - third * amplitude * math.cos(3.0 * angle)
        if name == "svpwm":
            v0 -= 0.5 * (max(v) + min(v))
    return [x + v0 for x in v]
