"""The ways to start as candidates: each with the plan of its computed defaults."""

from __future__ import annotations

from dataclasses import replace
from typing import cast, get_args

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, StartUpSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName, StartUpMethodName
from dqforge.optimizer.estimator_comparison.candidate import (
    Question,
    StartCandidate,
    StartFigures,
)
from dqforge.optimizer.estimator_comparison.closed_loop import control_over
from dqforge.optimizer.start_up.plan import StartUpPlan
from dqforge.optimizer.start_up.solve import solve_start_up

_TITLES: dict[str, str] = {
    "i-f": "alignment, then a current that turns",
    "v-f": "alignment, then a voltage that turns",
    "direct": "alignment, then the observer at once",
    "saliency": "the rotor found by its saliency",
}


def start_candidates() -> tuple[StartCandidate, ...]:
    """A candidate per way to start."""
    names = [name for name in get_args(StartUpMethodName) if name in _TITLES]
    return tuple(_candidate(name) for name in names)


def _candidate(name: StartUpMethodName) -> StartCandidate:
    return StartCandidate(name, _TITLES[name], _refusal, lambda asked: _figures(asked, name))


def _refusal(asked: Question) -> str:
    """What every start needs."""
    design = asked.design
    psi_pm = linearised(design.machine).psi_pm
    if not psi_pm > 0.0:
        return f"psi_pm = {psi_pm:g} Wb: a start needs a magnet"
    if design.phase_machine is not None:
        return "starts of machines of model: waveform are not compared"
    if design.machine.inertia is None:
        return "machine.inertia is not known"
    if design.control.speed_loop is None:
        return "there is no control.speed_loop"
    return "" if asked.at_speed is not None else "no estimator holds at speed"


def started_design(
    asked: Question, method: StartUpMethodName, hand_over: float | None = None
) -> Design:
    """The design with the chosen estimators and a start.

    Args:
        asked: The question, with the chosen estimators.
        method: How it starts.
        hand_over: Electrical speed in rad/s of the hand-over; None for the computed one.
    """
    design, control = asked.design, asked.design.control
    own = control.start_up
    settings = own if own is not None and own.method == method else StartUpSettings(method=method)
    if hand_over is not None:
        settings = replace(settings, hand_over=hand_over / design.machine.pole_pairs)
    if method == "saliency" and settings.observer is None:
        settings = replace(settings, observer=_settings(asked.from_standstill))
    assert asked.at_speed is not None
    chosen = replace(control_over(asked, asked.at_speed), start_up=settings)
    return replace(design, control=chosen, export=replace(design.export, control=("float32",)))


def _settings(name: str | None) -> ObserverSettings | None:
    return None if name is None else ObserverSettings(method=cast(ObserverMethodName, name))


def planned_time(plan: StartUpPlan) -> float:
    """Time in s from standstill to the hand-over by plan.

    Args:
        plan: Of the start.
    """
    aligned = 0.0 if plan.alignment == "none" else plan.align_time
    if plan.method in {"i-f", "v-f"}:
        return aligned + plan.ramp_rise + plan.hand_over / plan.ramp_acceleration
    found = plan.search_time + 2.0 * plan.polarity_time if plan.method == "saliency" else 0.0
    return aligned + found + plan.hand_over / plan.run_acceleration


def _figures(asked: Question, method: StartUpMethodName) -> StartFigures:
    if method == "saliency" and asked.from_standstill is None:
        raise NoSolutionError("no estimator holds at standstill")
    design = started_design(asked, method)
    found = solve_start_up(design)
    assert found is not None
    plan = found.plan
    return StartFigures(found.largest_loads[method], plan.hand_over, planned_time(plan), design)
