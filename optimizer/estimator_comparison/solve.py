"""Every estimator and start-up of a drive over its speeds and loads: who errs least where,
and which pair to flash.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    Question,
    StartCandidate,
)
from dqforge.optimizer.estimator_comparison.closed_loop import closed_loop
from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart
from dqforge.optimizer.estimator_comparison.flashed_pair import (
    AtSpeed,
    FlashedPair,
    chosen_pair,
    estimator_at_speed,
)
from dqforge.optimizer.estimator_comparison.registry import estimators, starts
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.conditions import conditions, loads_at
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT

# Speeds of the comparison over the largest one.
SPEED_SHARES = (0.0, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0)
COMPARED_LOADS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Torques of the comparison over the largest one.

# In the map of who wins: nobody holds there, or the voltage does not reach it.
NOBODY, UNREACHED = -1, -2
_STANDSTILL = 1e-3  # of the largest speed: an error of the speed that is none at standstill
_KEY = re.compile(r"^control\.(observer|start_up)(\.method)?: ")


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorComparison:
    """The comparison.

    Args:
        asked: What was asked of all.
        estimators, starts: The candidates, in the order of the registry.
        winner: Index among the estimators of the one with the least error of those that hold,
            `NOBODY` or `UNREACHED`, shape (S, L).
        pair: What to flash.
        uncounted: Why cycles and bytes were not measured; empty where they were.
    """

    asked: Question
    estimators: tuple[ComparedEstimator, ...]
    starts: tuple[ComparedStart, ...]
    winner: NDArray[np.int64]
    pair: FlashedPair
    uncounted: str = "the cost was not measured"

    def estimator(self, name: str) -> ComparedEstimator:
        """The one of that name."""
        return next(row for row in self.estimators if row.candidate.name == name)


def ask(design: Design) -> Question:
    """What is asked of every candidate.

    Args:
        design: The drive.
    """
    machine = design.machine
    omega_m = design.control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    omega_max = machine.pole_pairs * omega_m
    omega, loads = np.array(SPEED_SHARES) * omega_max, loads_at(design, COMPARED_LOADS)
    volts = [
        np.hypot(*machine.voltage(np.array([load.i_d]), np.array([load.i_q]), omega))
        for load in loads
    ]
    return Question(
        design,
        omega_max,
        omega,
        np.array(COMPARED_LOADS),
        loads,
        np.stack(volts, axis=1) <= design.v_max,
        conditions(design, omega_max),
        _loops(design),
    )


def _loops(design: Design) -> tuple[LoopGains, LoopGains, LoopGains] | None:
    """The loops as with an encoder, None where there is no speed loop to judge."""
    try:
        found = solve_gains(replace(design, control=replace(design.control, observer=None)))
    except NoSolutionError:
        return None
    return None if found.speed is None else (found.i_d, found.i_q, found.speed)


def reason_of(error: Exception) -> str:
    """A refusal without the key that it begins with.

    Args:
        error: An `InputError` or a `NoSolutionError`.
    """
    return _KEY.sub("", str(getattr(error, "message", error)))


def _compared(asked: Question, candidate: Candidate) -> ComparedEstimator:
    refusal = candidate.refusal(asked)
    if refusal:
        return ComparedEstimator(candidate, refusal)
    try:
        figures = candidate.figures(asked)
    except (NoSolutionError, InputError) as error:
        return ComparedEstimator(candidate, reason_of(error))
    permitted = np.maximum(SPEED_LIMIT * asked.omega, _STANDSTILL * asked.omega_max)
    holds = (figures.angle <= ANGLE_LIMIT) & (figures.speed <= permitted[:, None])
    return ComparedEstimator(candidate, "", figures, holds)


def _started(asked: Question, candidate: StartCandidate) -> ComparedStart:
    refusal = candidate.refusal(asked)
    if refusal:
        return ComparedStart(candidate, refusal)
    try:
        return ComparedStart(candidate, "", candidate.figures(asked))
    except (NoSolutionError, InputError) as error:
        return ComparedStart(candidate, reason_of(error))


def winners(asked: Question, rows: Sequence[ComparedEstimator]) -> NDArray[np.int64]:
    """Index of the estimator with the least r.m.s. error of the angle among those that hold.

    Args:
        asked: The question.
        rows: The estimators.
    """
    errors: list[FloatArray] = []
    for row in rows:
        if row.figures is None or row.holds is None or not row.candidate.competes(asked):
            errors.append(np.full(asked.reached.shape, np.inf))
        else:
            errors.append(np.where(row.holds, row.figures.angle, np.inf))
    stacked = np.stack(errors)
    best = np.argmin(stacked, axis=0)
    found = np.where(np.isfinite(np.min(stacked, axis=0)), best, NOBODY)
    return np.where(asked.reached, found, UNREACHED)


@on_design("control")
def compare_estimators(
    design: Design,
    candidates: Sequence[Candidate] | None = None,
    told: Callable[[str], None] | None = None,
) -> EstimatorComparison:
    """Every estimator and start-up.

    Args:
        design: The drive.
        candidates: The estimators to compare; all of them when None.
        told: Called with the name of each before it is asked.

    Raises:
        InputError, NoSolutionError: The design has no loops, or no torque.
    """
    asked = ask(design)
    chosen = estimators() if candidates is None else candidates
    found = []
    for candidate in chosen:
        if told is not None:
            told(candidate.name)
        found.append(_compared(asked, candidate))
    rows = tuple(found)
    at_speed = estimator_at_speed(asked, rows, closed_loop)
    pair = chosen_pair(asked, rows, (), at_speed)
    asked = replace(asked, at_speed=pair.at_speed, from_standstill=pair.from_standstill)
    begun = tuple(_started(asked, candidate) for candidate in starts())
    pair = chosen_pair(asked, rows, begun, at_speed)
    return EstimatorComparison(asked, rows, begun, winners(asked, rows), pair)


def with_success(
    found: EstimatorComparison, starts: Sequence[ComparedStart]
) -> EstimatorComparison:
    """The comparison with start-ups that were tried, and the pair that follows.

    Args:
        found: The comparison.
        starts: Its start-ups, in their order.
    """
    old = found.pair
    at_speed = None if old.at_speed is None else AtSpeed(old.at_speed, old.loop, old.passed)
    pair = chosen_pair(found.asked, found.estimators, starts, at_speed)
    return replace(found, starts=tuple(starts), pair=pair)


def named(only: str) -> tuple[Candidate, ...]:
    """The estimators of a list of names, in the order of the registry.

    Args:
        only: Names with commas in between.

    Raises:
        InputError: There is none of that name.
    """
    every = {candidate.name: candidate for candidate in estimators()}
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in every]
    if unknown or not wanted:
        what = unknown[0] if unknown else "nothing"
        raise InputError(f"--only: no estimator is named {what}; write some of {', '.join(every)}")
    return tuple(candidate for name, candidate in every.items() if name in wanted)
