"""What is said of a speed loop that runs on an observer, for tables, the report,
the header and JSON.
"""

from __future__ import annotations

import math

from dqforge.optimizer.loops.loop_gains import LoopGains
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
    )


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
        }
    }
