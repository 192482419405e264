"""What is said of a speed loop that runs on an observer, for tables, the report,
the header and JSON.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.observed_margins import ObservedLoop, SpeedRange
    from dqforge.reports.plain_data import PlainData


def _hertz(omega: float) -> str:
    return f"{omega / (2.0 * math.pi):.4g} Hz"


def loop_words(gains: LoopGains) -> str:
    """Crossover and phase margin in a few words; with the observer's lag,
    and what the observer leaves.
    """
    crossover, margin = _hertz(gains.crossover), math.degrees(gains.phase_margin)
    found = gains.observed
    if found is None:
        return f"{crossover} crossover, {margin:.0f} deg phase margin"
    if found.stable:
        own = f"{crossover} crossover, {margin:.0f} deg phase margin with the observer's lag"
    else:
        own = f"unstable with the observer's lag ({margin:.0f} deg at {crossover})"
    return own if found.holds else f"{own}; {left_words(gains)}"


def left_words(gains: LoopGains) -> str:
    """Which bandwidth the observer leaves, and what to write; empty without an observer."""
    found = gains.observed
    if found is None:
        return ""
    required = f"{math.degrees(found.required):.3g} deg"
    if found.left is None:
        return (
            f"the observer leaves no speed loop with {required}: no slower one of this method has "
            "them"
        )
    advice = f" ({found.advice})" if found.advice else ""
    return f"the observer leaves {_hertz(found.left)} with {required}{advice}"


def observed_notes(gains: LoopGains | None) -> tuple[str, ...]:
    """Notes below a table of gains; none without an observer."""
    if gains is None or gains.observed is None:
        return ()
    found = gains.observed
    speeds = ", ".join(f"{omega / (2.0 * math.pi):.3g}" for omega in found.omega)
    margins = ", ".join(
        f"{math.degrees(phase):.1f}" if radius < 1.0 else "unstable"
        for phase, radius in zip(found.phase_margin, found.radius, strict=True)
    )
    worst = f"{found.omega[found.worst] / (2.0 * math.pi):.3g} Hz"
    state = "" if found.stable else f"; unstable, largest pole {found.radius[found.worst]:.4g}"
    swinging = () if found.cycle is None else (f"unstable as it is, {found.cycle.words}",)
    return (
        (
            f"the speed loop runs on the {found.observer}: with its lag, at the worst speed "
            f"({worst}){state}"
        ),
        (
            f"phase margin at {speeds} Hz (electrical): {margins} deg; exact parameters, no dead "
            "time, no load"
        ),
        left_words(gains),
        *swinging,
        *corner_notes(found),
    )


def corner_notes(found: ObservedLoop) -> tuple[str, ...]:
    """From which speed on all corners of the tolerances hold; none for a speed observer."""
    corners = found.corners
    if corners is None:
        return ()
    box = "control.tolerances" if corners.named else "the usual tolerances"
    limits = ", ".join(
        f"{name} {100.0 * low:+.3g} to {100.0 * high:+.3g} %"
        for name, (low, high) in corners.limits.items()
    )
    loads = " and ".join(f"{load:.3g}" for load in corners.loads)
    exact = (
        f"corners of {box} ({limits or 'exact data'}; loads of {loads} N m), no dead time: "
        f"{range_words(corners.exact)}"
    )
    told: tuple[str, ...] = (exact,)
    if corners.braking is not None:
        told = (*told, f"braking with as much: {range_words(corners.braking)}")
    if corners.dead_time is None:
        return told
    lost = " or ".join(f"{value:.3g}" for value in corners.lost)
    dead_time = f"an indication: with {lost} V of dead time {range_words(corners.dead_time)}"
    return (*told, dead_time)


def leaving_notes(gains: LoopGains | None) -> tuple[str, ...]:
    """That the simulation stays on the observer below the lowest speed that holds, and the corner
    that fails there; nothing where it does not.
    """
    found = None if gains is None else gains.observed
    corners = None if found is None else found.corners
    if corners is None or corners.leaves is None or not corners.left_unstable:
        return ()
    below = corners.binding.below
    assert below is not None
    words = (
        f"simulation.sensorless.below leaves the drive on its observer down to "
        f"{_hertz(corners.leaves)} (electrical), all corners hold from "
        f"{_hertz(corners.binding.low)} on; below, {below.words}"
    )
    return (words,)


def corner_words(gains: LoopGains | None) -> tuple[str, ...]:
    """Speeds at which all corners are stable, without dead time; none for a speed observer."""
    found = None if gains is None else gains.observed
    if found is None or found.corners is None:
        return ()
    return (range_words(found.corners.exact),)


def range_words(found: SpeedRange) -> str:
    """Where all corners are stable, and what fails below."""
    if not found.any:
        below = (
            "" if found.below is None else f"; at {_hertz(found.below.omega)} {found.below.words}"
        )
        return f"stable at no speed{below}"
    span = f"stable from {_hertz(found.low)} to {_hertz(found.high)} (electrical)"
    return span if found.below is None else f"{span}; below, {found.below.words}"


def margin_words(gains: LoopGains) -> str:
    """Phase margin in degrees, or that there is none."""
    return f"{math.degrees(gains.phase_margin):.1f}" + ("" if gains.stable else " (unstable)")


def plain_observed(gains: LoopGains) -> PlainData:
    """The same as plain data; nothing without an observer."""
    found = gains.observed
    if found is None:
        return {}
    return {
        "observed": {
            "observer": found.observer,
            "omega_rad_per_s": found.omega,
            "crossover_rad_per_s": found.crossover,
            "phase_margin_rad": found.phase_margin,
            "largest_pole": found.radius,
            "worst": found.worst,
            "stable": found.stable,
            "required_phase_margin_rad": found.required,
            "left_rad_per_s": found.left,
            "advice": found.advice,
            "limit_cycle": None
            if found.cycle is None
            else {"omega_rad_per_s": found.cycle.omega, "swing_rad_per_s": found.cycle.swing},
            "stable_advice": found.stable_advice,
            "pll_least_rad_per_s": found.pll_least,
            "corners": _plain_corners(found),
        }
    }


def _plain_corners(found: ObservedLoop) -> PlainData | None:
    corners = found.corners
    if corners is None:
        return None
    return {
        "named": corners.named,
        "limits": {name: list(pair) for name, pair in corners.limits.items()},
        "loads_Nm": list(corners.loads),
        "exact": _plain_range(corners.exact),
        "lost_V": list(corners.lost),
        "dead_time": None if corners.dead_time is None else _plain_range(corners.dead_time),
        "braking": None if corners.braking is None else _plain_range(corners.braking),
        "leaves_rad_per_s": corners.leaves,
        "left_unstable": corners.left_unstable,
    }


def _plain_range(found: SpeedRange) -> PlainData:
    below = found.below
    failing = None
    if below is not None:
        failing = {
            "omega_rad_per_s": below.omega,
            "errors": below.corner.errors,
            "load_Nm": below.corner.load,
            "lost_V": below.corner.lost,
            "largest_pole": below.radius if math.isfinite(below.radius) else None,
        }
    return {
        "corners": found.corners,
        "low_rad_per_s": found.low if found.any else None,
        "high_rad_per_s": found.high if found.any else None,
        "failing_below": failing,
    }
