"""What the loops keep over the tolerances, and their gains in three forms: rows of text,
comment lines, plain data.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.reports.loops.stability_text import plain_stability

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.robustness import LoopRobustness, RobustSet
    from dqforge.reports.plain_data import PlainData

FORM_COLUMNS = (
    "loop",
    "parallel: kp",
    "ki t_s",
    "series: T_i",
    "velocity: q0 = kp + ki t_s",
    "q1 = -kp",
    "anti-windup 1/s",
)


ROBUST_COLUMNS = ("loop", "margin", "worst", "at")


def form_rows(gains: GainSet) -> tuple[tuple[str, ...], ...]:
    """Each loop's gains in parallel, series and velocity form.

    All but the times in the unit of kp.
    """
    return tuple(
        (
            loop.loop,
            f"{loop.kp:.6g}",
            f"{loop.ki_ts:.6g}",
            f"{loop.t_i * 1e3:.5g} ms",
            f"{loop.velocity[0]:.6g}",
            f"{loop.velocity[1]:.6g}",
            f"{loop.anti_windup:.5g}",
        )
        for loop in gains.loops
    )


def _decibel(factor: float) -> str:
    return f"{20.0 * math.log10(factor):.1f} dB" if math.isfinite(factor) else "none"


def _loops(robust: RobustSet) -> list[tuple[str, LoopRobustness]]:
    named = (
        ("i_d", robust.i_d),
        ("i_q", robust.i_q),
        ("i_0", robust.i_0),
        ("speed", robust.speed),
    )
    return [(name, loop) for name, loop in named if loop is not None]


def worst_words(robust: RobustSet) -> str:
    """The least phase margin of all loops over the tolerances, with its loop and corner."""
    name, loop = min(_loops(robust), key=lambda pair: pair[1].phase_margin.value)
    worst = loop.phase_margin
    margin = f"{math.degrees(worst.value):.1f} deg"
    return f"the least phase margin over the tolerances is {margin}: {name} loop at {worst.at}"


def robust_rows(robust: RobustSet) -> tuple[tuple[str, ...], ...]:
    """The worst of each margin with its corner, loop by loop."""
    rows: list[tuple[str, ...]] = []
    for name, loop in _loops(robust):
        texts = (
            (
                "phase margin",
                f"{math.degrees(loop.phase_margin.value):.1f} deg",
                loop.phase_margin.at,
            ),
            ("gain margin", _decibel(loop.gain_margin.value), loop.gain_margin.at),
            ("delay margin", f"{loop.delay_margin.value * 1e6:.3g} us", loop.delay_margin.at),
            ("M_s", f"{loop.max_sensitivity.value:.3f}", loop.max_sensitivity.at),
            ("largest pole", f"{loop.radius.value:.6f}", loop.radius.at),
        )
        rows += [(name if place == 0 else "", *text) for place, text in enumerate(texts)]
    if robust.turning is not None:
        rows.append(
            ("both, turning", "largest pole", f"{robust.turning.value:.6f}", robust.turning.at)
        )
    return tuple(rows)


def limits_text(robust: RobustSet) -> str:
    """The box in words: ``r_s -10 to +30 %, dead_time 0 to +2 us``."""
    parts = []
    for name, low, high in robust.limits:
        scale, unit = (1e6, "us") if name == "dead_time" else (100.0, "%")
        below, above = (f"{scale * side:+.3g}" if side else "0" for side in (low, high))
        parts.append(f"{name} {below} to {above} {unit}")
    return ", ".join(parts)


def robust_notes(robust: RobustSet) -> tuple[str, ...]:
    """The box, how many drives were tried, and whether one inside the box
    was worse than all corners.
    """
    counts = ", ".join(f"{name} {loop.corners} and {loop.samples}" for name, loop in _loops(robust))
    worse = [name for name, loop in _loops(robust) if loop.inside_worse]
    inside = (
        f"a point inside was worse than every corner: {', '.join(worse)}"
        if worse
        else "none inside was worse than a corner"
    )
    box = (f"tolerances: {limits_text(robust)}",) if robust.limits else ()
    return (*box, f"corners and points inside that were checked: {counts}; {inside}")


def robust_lines(gains: GainSet, loop: str) -> list[str]:
    """Comment lines of a header on what a loop keeps over the tolerances; none without them."""
    found = {} if gains.robust is None else dict(_loops(gains.robust))
    if loop not in found:
        return []
    kept = found[loop]
    phase, gain = math.degrees(kept.phase_margin.value), _decibel(kept.gain_margin.value)
    return [
        f"Within the tolerances at least {phase:.1f} deg phase margin and {gain} gain margin,",
        f"M_s at most {kept.max_sensitivity.value:.2f} ({kept.max_sensitivity.at}).",
    ]


def plain_loop_robustness(loop: LoopRobustness) -> PlainData:
    """Worst margins of one loop as plain data, in SI units."""
    units = {
        "phase_margin": "phase_margin_rad",
        "delay_margin": "delay_margin_s",
        "radius": "largest_pole",
    }
    return {units.get(key, key): value for key, value in asdict(loop).items()}


def plain_robustness(robust: RobustSet | None) -> PlainData:
    """Worst margins of every loop as plain data; an empty mapping without tolerances."""
    if robust is None:
        return {}
    plain: PlainData = {"i_d": None, "i_q": None, "speed": None}
    for name, loop in _loops(robust):
        plain[name] = plain_loop_robustness(loop)
    plain["both_turning"] = (
        None if robust.turning is None else {"largest_pole": asdict(robust.turning)}
    )
    plain["stability"] = plain_stability(robust)
    plain["limits"] = {
        "dead_time_s" if name == "dead_time" else name: [low, high]
        for name, low, high in robust.limits
    }
    return {"tolerances": plain}


def robust_text(kept: LoopRobustness) -> str:
    """Least phase margin and largest M_s over the tolerances in a few words."""
    return (
        f"phase margin {math.degrees(kept.phase_margin.value):.1f} deg or more "
        f"({kept.phase_margin.at}), M_s {kept.max_sensitivity.value:.2f} or less"
    )
