"""How fast the currents of a phase machine forget, over speeds and tolerances: rows of text, words,
plain data.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.phase_control.design import PhaseLoops
    from dqforge.optimizer.phase_control.judged_box import JudgedLoops, JudgedSpeed
    from dqforge.reports.plain_data import PlainData

JUDGED_TITLE = "Currents over a period of the back-EMF"


_LINE = 88


_WORST = ("worst radius", "at")


def _rpm(speed: JudgedSpeed) -> str:
    return f"{speed.omega_m * 30.0 / math.pi:.5g}"


def _orders(speed: JudgedSpeed) -> str:
    plane, zero = (", ".join(map(str, orders)) for orders in speed.orders)
    parts = [*([plane] if plane else []), *([f"zero sequence {zero}"] if zero else [])]
    return "; ".join(parts) or "none"


def _row(speed: JudgedSpeed) -> tuple[str, ...]:
    still = math.isinf(speed.samples)
    return (
        _rpm(speed),
        "at rest" if still else f"{speed.samples:.4g}",
        f"{speed.nominal:.4f}",
        f"{speed.decay_time * 1e3:.3g}",
        *(() if speed.worst is None else (f"{speed.worst.value:.4f}", speed.worst.at)),
        "as the others" if still else _orders(speed),
        "" if speed.learning_time is None else f"{speed.learning_time * 1e3:.3g}",
    )


def judged_columns(judged: JudgedLoops) -> tuple[str, ...]:
    """Heads of the columns; those of the tolerances where there are any."""
    return (
        "rpm",
        "samples per period",
        "radius per sample",
        "forgotten to 1/e in ms",
        *(_WORST if judged.corners else ()),
        "harmonic integrators",
        "learnt to 1/e in ms",
    )


def judged_rows(judged: JudgedLoops) -> tuple[tuple[str, ...], ...]:
    """One row per speed."""
    return tuple(_row(speed) for speed in judged.speeds)


def judged_notes(phases: PhaseLoops) -> tuple[str, ...]:
    """What was judged, and how many drives were tried."""
    judged, control = phases.judged, phases.control
    assert judged is not None
    what = "radius: largest modulus of a Floquet multiplier per sample, stable below 1"
    notes = [f"frame {control.frame}, feedforward {control.feedforward}; {what}"]
    if judged.corners:
        inside = f" and {judged.inside} points inside" if judged.inside else ""
        notes.append(
            f"{judged.corners} corners{inside} of the tolerances at each speed, l_0 as far as l_d "
            "or l_q, whichever is further"
        )
    if judged.midpoint_time is not None:
        notes.append(f"the midpoint returns to 1/e in {judged.midpoint_time * 1e3:.3g} ms")
    return tuple(notes)


def _largest(judged: JudgedLoops) -> tuple[float, str]:
    """The largest radius and where it is, in words."""
    slow = judged.slowest
    if slow.worst is None:
        return slow.nominal, f"{_rpm(slow)} rpm"
    return slow.worst.value, f"{_rpm(slow)} rpm, {slow.worst.at}"


def judged_words(judged: JudgedLoops) -> str:
    """The slowest of all in a few words."""
    value, where = _largest(judged)
    return f"radius per sample {value:.4f} or less ({where})"


def judged_sentence(judged: JudgedLoops) -> str:
    """The same as a sentence."""
    value, where = _largest(judged)
    return (
        "Over a period of the back-EMF the currents keep at most "
        f"{value:.4f} of a disturbance per sample ({where})."
    )


def judged_lines(judged: JudgedLoops) -> list[str]:
    """The same as lines at the head of a header."""
    return textwrap.wrap(judged_sentence(judged), _LINE)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain_speed(speed: JudgedSpeed) -> PlainData:
    return {
        "omega_m_rad_per_s": speed.omega_m,
        "samples_per_period": _finite(speed.samples),
        "radius": speed.nominal,
        "decay_time_s": _finite(speed.decay_time),
        "worst": None if speed.worst is None else asdict(speed.worst),
        "orders": {"plane": list(speed.orders[0]), "zero": list(speed.orders[1])},
        "learning_time_s": (None if speed.learning_time is None else _finite(speed.learning_time)),
    }


def plain_judged(phases: PhaseLoops) -> PlainData:
    """The judgement as plain data, in SI units; an empty mapping without one."""
    judged = phases.judged
    if judged is None:
        return {}
    return {
        "currents": {
            "frame": phases.control.frame,
            "feedforward": phases.control.feedforward,
            "radius": _largest(judged)[0],
            "corners": judged.corners,
            "inside": judged.inside,
            "midpoint_time_s": (
                None if judged.midpoint_time is None else _finite(judged.midpoint_time)
            ),
            "speeds": [_plain_speed(speed) for speed in judged.speeds],
        }
    }
