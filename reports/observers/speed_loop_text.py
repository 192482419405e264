"""What is said of a speed loop that runs on an observer, for tables, the report,
the header and JSON.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from dqforge.machines.transforms import in_rpm

if TYPE_CHECKING:
    from dqforge.optimizer.estimators import TunedTracker
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.observed_margins import (
        CornerJudgement,
        DeadTimeCycle,
        FailingCorner,
        ObservedLoop,
        SpeedRange,
        StepsBorne,
    )
    from dqforge.optimizer.observers.reduced_order import (
        ErrorsAtLoad,
        ObserverError,
        SpeedErrorSlopes,
    )
    from dqforge.reports.observers.position_text import TextTable
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
    slowed = (
        ()
        if found.slowed is None
        else (
            (
                f"control.speed_loop.spread is raised to {found.slowed:.4g}, with the observer's "
                "lag as a delay, so that the loop holds at every corner of the tolerances"
            ),
        )
    )
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
        *(() if found.relay is None else (found.relay.words,)),
        *slowed,
        *beyond_notes(gains),
        *swinging,
        *corner_notes(found),
    )


def beyond_notes(gains: LoopGains | None) -> tuple[str, ...]:
    """That the largest speed of the design lies beyond the voltage of the link; nothing where it
    does not.
    """
    found = None if gains is None else gains.observed
    if found is None or found.beyond is None:
        return ()
    return (
        (
            f"the largest speed, {_hertz(found.beyond)} (electrical), is beyond the voltage of the "
            f"dc link, which reaches {_hertz(float(found.omega[-1]))} without load: the speed loop "
            "is judged up to there"
        ),
    )


def _plain_relay(found: DeadTimeCycle) -> PlainData:
    return {
        "lost_V": found.lost,
        "resistance_Ohm": found.resistance,
        "current_A": found.current,
        "omega_rad_per_s": found.omega,
        "swing_rad_per_s": found.swing,
        "limited": found.limited,
        "factor": found.factor,
        "advice": found.advice,
    }


def corner_notes(found: ObservedLoop) -> tuple[str, ...]:
    """From which speed on all corners of the tolerances hold; none for a speed observer."""
    corners = found.corners
    if corners is None:
        return ()
    box = "control.tolerances" if corners.named else "the usual tolerances"
    exact = (
        f"corners of {box} ({_limit_words(corners)}), no dead time: {range_words(corners.exact)}"
    )
    told: tuple[str, ...] = (exact,)
    if corners.braking is not None:
        told = (*told, f"braking with as much: {range_words(corners.braking)}")
    if corners.binding.any:
        told = (*told, promise_words(corners))
    if corners.dead_time is None:
        return told
    lost = " or ".join(f"{value:.3g}" for value in corners.lost)
    dead_time = f"an indication: with {lost} V of dead time {range_words(corners.dead_time)}"
    return (*told, dead_time)


_DIGEST = b" * Input file: SHA-256 "


def with_promise(name: str, content: bytes, lines: list[str]) -> bytes:
    """A file of C with comment lines behind the checksum of its input; others as they are.

    Args:
        name, content: Of the file.
        lines: Of `promise_lines`.
    """
    place = content.find(_DIGEST)
    if not lines or place < 0 or not name.endswith((".h", ".c")) or name.endswith("_vectors.h"):
        return content
    end = content.index(b"\n", place) + 1
    told = "".join(f" * {line}\n" for line in lines).encode("ascii")
    return content[:end] + told + content[end:]


def _limit_words(corners: CornerJudgement) -> str:
    """The box: relative errors by name, and loads."""
    limits = ", ".join(
        f"{name} {100.0 * low:+.3g} to {100.0 * high:+.3g} %"
        for name, (low, high) in corners.limits.items()
    )
    loads = " and ".join(f"{load:.3g}" for load in corners.loads)
    return f"{limits or 'exact data'}; loads of {loads} N m"


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
    """Speeds at which all corners hold, without dead time, and the steps that are borne there; none
    for a speed observer.
    """
    found = None if gains is None else gains.observed
    if found is None or found.corners is None:
        return ()
    corners = found.corners
    return (
        range_words(corners.binding),
        *((promise_words(corners),) if corners.binding.any else ()),
    )


def promise_words(corners: CornerJudgement) -> str:
    """Where a drive may run on its observer, and what it bears there; of a range that is there."""
    found, turn = corners.binding, corners.pole_pairs
    parts = [
        (
            f"every corner holds from {_rpm(found.low, turn, up=True)} to "
            f"{_rpm(found.high, turn)}, motoring and braking"
        ),
        f"there the speed is wrong by {_error_text(found.speed_error)} at most",
    ]
    if corners.steps is not None:
        parts += _step_words(corners.steps, turn)
    return "; ".join([*parts, "below, and so of a reversal, nothing is promised"])


def _error_text(error: float) -> str:
    return "0.1 %" if error < 1e-3 else f"{math.ceil(1e3 * error - 1e-9) / 10.0:.4g} %"


def _step_words(steps: StepsBorne, pole_pairs: int) -> list[str]:
    if not steps.load > 0.0:
        return ["no step of the load is promised"]
    return [
        (
            f"steps of the load by up to {_down(steps.load)} N m are borne from "
            f"{_rpm(steps.load_low, pole_pairs, up=True)} to {_rpm(steps.load_high, pole_pairs)}"
        ),
        (
            f"steps of the speed by up to {_rpm(steps.speed, pole_pairs)} where they stay inside "
            f"with {100.0 * steps.overshoot:.2g} % of overshoot"
        ),
    ]


def _down(value: float, *, up: bool = False) -> str:
    """Three digits, rounded to the safe side."""
    if not value > 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    count = math.ceil(value / unit - 1e-9) if up else math.floor(value / unit + 1e-9)
    return f"{count * unit:.4g}"


def _rpm(omega: float, pole_pairs: int, *, up: bool = False) -> str:
    return f"{_down(in_rpm(omega / pole_pairs), up=up)} rpm"


def promise_lines(gains: LoopGains | None) -> list[str]:
    """Comment lines for every file that is flashed; none where no speed loop runs on an observer of
    the position.
    """
    found = None if gains is None else gains.observed
    if found is None or found.corners is None:
        return []
    box = "control.tolerances" if found.corners.named else "the usual tolerances"
    held = found.corners
    words = promise_words(held) if held.binding.any else "holds at no speed"
    if held.dead_time is not None:
        lost, lossy = " or ".join(f"{value:.3g}" for value in held.lost), held.dead_time
        words += f". With {lost} V of dead time, an indication: {_span(lossy, held.pole_pairs)}"
    return textwrap.wrap(
        f"Speed loop on the {found.observer}, corners of {box} ({_limit_words(held)}), no dead "
        f"time: {words}.",
        100,
    )


def _span(found: SpeedRange, pole_pairs: int) -> str:
    if not found.any:
        return "nowhere"
    low = _rpm(found.low, pole_pairs, up=True)
    return f"from {low} to {_rpm(found.high, pole_pairs)}"


def range_words(found: SpeedRange) -> str:
    """Where all corners are stable, and what fails below."""
    if not found.any:
        below = (
            "" if found.below is None else f"; at {_hertz(found.below.omega)} {found.below.words}"
        )
        return f"stable at no speed{below}"
    span = f"stable from {_hertz(found.low)} to {_hertz(found.high)} (electrical)"
    below = "" if found.below is None else f"; below, {found.below.words}"
    above = "" if found.above is None else f"; above, {found.above.words}"
    return f"{span}{below}{above}"


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
            "dead_time_cycle": None if found.relay is None else _plain_relay(found.relay),
            "stable_advice": found.stable_advice,
            "pll_least_rad_per_s": found.pll_least,
            "slowed_to_spread": found.slowed,
            "beyond_rad_per_s": found.beyond,
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
        "binding": _plain_range(corners.binding),
        "most_speed_error": corners.most_error,
        "steps": None if corners.steps is None else _plain_steps(corners.steps),
        "leaves_rad_per_s": corners.leaves,
        "left_unstable": corners.left_unstable,
    }


def _plain_steps(steps: StepsBorne) -> PlainData:
    return {
        "load_Nm": steps.load,
        "load_from_rad_per_s": steps.load_low,
        "load_to_rad_per_s": steps.load_high,
        "speed_rad_per_s": steps.speed,
        "overshoot": steps.overshoot,
    }


def _plain_failing(failing: FailingCorner | None) -> PlainData | None:
    if failing is None:
        return None
    return {
        "omega_rad_per_s": failing.omega,
        "errors": failing.corner.errors,
        "load_Nm": failing.corner.load,
        "lost_V": failing.corner.lost,
        "largest_pole": failing.radius if math.isfinite(failing.radius) else None,
        "speed_error": failing.speed_error,
        "why": failing.why,
    }


def _plain_range(found: SpeedRange) -> PlainData:
    return {
        "corners": found.corners,
        "low_rad_per_s": found.low if found.any else None,
        "high_rad_per_s": found.high if found.any else None,
        "speed_error": found.speed_error if found.any else None,
        "failing_below": _plain_failing(found.below),
        "failing_above": _plain_failing(found.above),
    }


# What is said of a tracker of the position, for tables, the report, the header and JSON.

_SIGNALS = {
    "sum-voltage": "the mean of v_a + v_b + v_c against the star point over it",
    "voltage-a": "the mean of v_a against the star point over it",
    "voltage-b": "that of v_b",
    "voltage-c": "that of v_c",
}


def tuned_text(found: TunedTracker) -> str:
    """By what numbers it is tuned."""
    return found.tracker.in_words(found.gains)


def speed_text(found: TunedTracker) -> str:
    """At what speeds it holds, and what of the drive's own that is."""
    low = "standstill" if found.omega_low == 0.0 else _hertz(found.omega_low)
    return (
        f"from {low} to {_hertz(found.omega_high)} (electrical); the drive turns with up to "
        f"{_hertz(found.omega_max)}"
    )


def heard_text(found: TunedTracker) -> str:
    """What the firmware hands over besides; empty where that is nothing."""
    signals = [_SIGNALS[name] for name in found.tracker.hears]
    return f", the current and {', '.join(signals)}" if signals else " and the current"


def added_text(found: TunedTracker, prefix: str) -> str:
    """What the firmware does with the voltage that it asks for; empty where it asks for none."""
    if not found.tracker.injects:
        return ""
    code = found.tracker.code
    return (
        f"Then copy the member added of {prefix}_{code}_t to that of {prefix}_control_t, whose "
        "duty cycles make it besides their own voltage, and give the control the currents of "
        f"{prefix}_clarke_inverse() of the member current."
    )


def tracker_part(found: TunedTracker) -> TextTable:
    """Tuning and range as a text table."""
    rows = [("tuning", tuned_text(found)), ("speeds", speed_text(found))]
    if found.tracker.hears:
        rows.append(("told besides", ", ".join(found.tracker.hears)))
    return (
        f"Position tracker: {found.tracker.title}",
        ("", "value"),
        tuple(rows),
        (),
    )


def plain_tracker(found: TunedTracker) -> PlainData:
    """Method, gains and range, in SI units."""
    gains: dict[str, Any] = asdict(found.gains)
    return {
        "method": found.tracker.name,
        "t_s": found.t_s,
        "tuning": tuned_text(found),
        "gains": gains,
        "omega_low_rad_per_s": found.omega_low,
        "omega_high_rad_per_s": found.omega_high,
        "omega_max_rad_per_s": found.omega_max,
        "hears": list(found.tracker.hears),
        "injects": found.tracker.injects,
    }


# Errors of the speed observer as plain data.


def plain_observer_errors(
    slopes: SpeedErrorSlopes | None, steady: tuple[ErrorsAtLoad, ...]
) -> PlainData:
    """Errors of the speed observer per unit of their causes and at loads; nothing without one."""
    if slopes is None:
        return {}

    def plain(error: ObserverError) -> PlainData:
        return {"i_q_A": error.i_q, "speed_rad_per_s": error.total, "relative": error.relative}

    at_loads = [
        {
            "omega_m_rad_per_s": found.exact.omega_m,
            "load_Nm": found.torque_load,
            "exact": plain(found.exact),
            "resistance_too_high": plain(found.resistance),
        }
        for found in steady
    ]
    return {
        "observer_errors": {
            "load_rad_per_s_per_Nm": slopes.load,
            "resistance_error": slopes.r_error,
            "resistance_rad_per_s_per_A": slopes.resistance,
            "contraction": slopes.contraction,
            **({"steady": at_loads} if at_loads else {}),
        }
    }
