"""The C header of the start-up, as text."""

from __future__ import annotations

import math
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.c_code.title import title
from dqforge.reports.observers.tracker_float32_model import EmittedTracker
from dqforge.reports.observers.tracker_header import (
    plain_tracker_gains,
    tracker_files,
)
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.emitted import phase_control_of
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.start_up.members import MEMBERS, settings_of

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.start_up.solve import StartUp

LOW_FILE = "start_observer"  # End of the file name of the estimator from standstill on.

_WORDS = {
    "i-f": "a current that turns, at the angle of the ramp",
    "v-f": "a voltage that turns, at the angle of the ramp",
    "direct": "from the alignment into the observer",
    "saliency": "the rotor found by its saliency",
}

_ALIGNMENT_WORDS = {
    "none": "no alignment",
    "one-step": "alignment in one step",
    "two-step": "alignment in two steps",
    "voltage": "alignment by a voltage",
}


def method_words(found: StartUp) -> str:
    """How the drive starts, in words.

    Args:
        found: The start.
    """
    plan = found.plan
    flying = "; a rotor that turns already is caught" if plan.flying else ""
    return f"{_WORDS[plan.method]} ({plan.method}), {_ALIGNMENT_WORDS[plan.alignment]}{flying}"


def load_words(found: StartUp) -> str:
    """Largest load torques, in words.

    Args:
        found: The start.
    """
    others = ", ".join(f"{name} {torque:.4g} N m" for name, torque in found.largest_loads.items())
    return (
        f"largest load torque {found.largest_load:.4g} N m ({found.plan.load_torque:.4g} N m asked "
        f"for); at the current limit: {others}"
    )


def _preamble(found: StartUp, prefix: str) -> list[str]:
    plan = found.plan
    hertz = plan.hand_over / (2.0 * math.pi)
    return [
        *wrap(f"Start: {method_words(found)}; the observer rules from {hertz:.4g} Hz.", 110),
        *wrap(f"It lifts: {load_words(found)}.", 110),
        "",
        f"Call {prefix}_startup_init() once, then {prefix}_startup_step() at every current sample:",
        "it replaces the speed control and calls the observer. State and fault are members of the",
        "structure, which is yours. All settings can be changed: copy the constant structure.",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def _setting_lines(found: StartUp) -> list[tuple[str, str]]:
    values = settings_of(found.plan)
    return [
        (
            f"{int(values[member.name])}U" if member.whole else float_literal(values[member.name]),
            f"{member.name}{': ' if member.comment else ''}{member.comment}",
        )
        for member in MEMBERS
    ]


def estimator_at_speed(gains: GainSet) -> tuple[str, bool]:
    """Part of C names of the estimator that a drive runs on after its start, and whether it is told
    the sum of the phase voltages.

    Args:
        gains: Of the design.
    """
    if gains.tracker is not None:
        return gains.tracker.tracker.code, bool(gains.tracker.tracker.hears)
    assert gains.position is not None, "a start has an estimator of the position"
    return gains.position.method.code, False


def phase_parts(solution: Solution) -> PlainData | None:
    """What of the control over the angle the start-up must know, None for other control.

    Args:
        solution: The solved design.
    """
    control = phase_control_of(solution)
    if control is None:
        return None
    return {"by_torque": control.frame != "dq", "feedforward": control.feedforward}


def start_up_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_startup.h``.

    Args:
        solution: The solved design.
        found: Its start.
    """
    design, gains = solution.design, solution.gains
    prefix = design.export.prefix
    code, hears = estimator_at_speed(gains)
    references = gains.references
    context: PlainData = {
        **title(design),
        "preamble": _preamble(found, prefix),
        "code": code,
        "hears": hears,
        "phases": phase_parts(solution),
        "low": "" if found.low is None else found.low.tracker.code,
        "members": MEMBERS,
        "settings": _setting_lines(found),
        "dynamic": None
        if references is None
        else {
            "torque_step": references.torque_step
            if math.isfinite(references.torque_step)
            else None,
            "current_step": references.current_step
            if math.isfinite(references.current_step)
            else None,
        },
    }
    return {f"{prefix}_startup.h": render("start_up/startup.h.j2", context).encode("ascii")}


def start_observer_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_start_observer.h``; none without an estimator from standstill.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {} if found.low is None else tracker_files(solution.design, found.low, LOW_FILE)


def every_start_file(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Names and bytes of the headers of a start.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return start_up_files(solution, found) | start_observer_files(solution, found)


def plain_start_up(solution: Solution, found: StartUp) -> PlainData:
    """The settings, and what the state machine is tried with, as plain data of float32 values.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {
        "v_dc": solution.design.inverter.v_dc,
        "settings": {
            name: value if isinstance(value, int) else shortest(np.float32(value))
            for name, value in settings_of(found.plan).items()
        },
    }


def plain_start_observer(found: StartUp) -> PlainData | None:
    """The estimator from standstill on as plain data, None without one.

    Args:
        found: The start.
    """
    low = found.low
    return None if low is None else plain_tracker_gains(EmittedTracker(low.tracker, low.gains))
