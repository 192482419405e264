"""The position observers as candidates: judged by their steady states, tried from wrong starts."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.sections.chosen_together import (
    COMPENSATED,
    SPEED_GAIN,
    SPEED_GAIN_COMPENSATED,
)
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import SPEED_OBSERVER, ObserverMethodName
from dqforge.optimizer.control_design.observed_speed_loop import judge_observed
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    EstimatorFigures,
    Question,
)
from dqforge.optimizer.estimator_comparison.own_observer import capture_of
from dqforge.optimizer.estimator_comparison.sensitivity import SLOPE_SHARES, slopes_of
from dqforge.optimizer.observers.conditions import loads_at, training_box
from dqforge.optimizer.observers.judgement import ObserverJudgement, judge_at
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.tuning import PositionObserver, tune_position_observer

_SLOPE_LOAD = 0.5  # torque over the largest one, motoring


def observer_candidates() -> tuple[Candidate, ...]:
    """A candidate per method, and the speed observer, which cannot do without an encoder."""
    behind_encoder = Candidate(
        SPEED_OBSERVER,
        "reduced-order speed observer",
        lambda _: "it observes the speed alone, in the angle of an encoder",
        _never,
    )
    return (behind_encoder, *(_candidate(name) for name in METHODS))


def _never(_: Question) -> EstimatorFigures:
    raise AssertionError("a candidate that is refused is not asked")


def _candidate(name: str) -> Candidate:
    return Candidate(name, METHODS[name].title, _refusal, lambda asked: _figures(asked, name))


def _refusal(asked: Question) -> str:
    psi_pm = linearised(asked.design.machine).psi_pm
    if psi_pm > 0.0:
        return ""
    return f"psi_pm = {psi_pm:g} Wb: without a magnet there is nothing to see at no current"


def settings_of(asked: Question, name: str) -> ObserverSettings:
    """What a design that asks for an observer has: the design's own where it is this very one, else
    the usual ones, with those that are chosen together with the speed loop.

    Args:
        asked: The question.
        name: Of a method.
    """
    control = asked.design.control
    own, loop = control.observer, control.speed_loop
    if own is not None and own.method == name:
        return own
    plain = ObserverSettings(method=cast(ObserverMethodName, name))
    if name != "flux" or loop is None or loop.method != "symmetrical-optimum":
        return plain
    known, inverter = asked.disturbances, asked.design.inverter
    left = max(abs(known.lost), abs(known.lost_least))
    whole = 4.0 / np.pi * inverter.f_sw * inverter.v_dc * inverter.dead_time
    small = left <= COMPENSATED * whole
    return replace(plain, speed_gain=SPEED_GAIN_COMPENSATED if small else SPEED_GAIN)


def tuned_observer(asked: Question, name: str) -> PositionObserver:
    """The observer of a method, with the design's own settings where it asks for this very one.

    Args:
        asked: The question.
        name: Of a method.
    """
    design = asked.design
    learns = METHODS[name].train is not None
    return tune_position_observer(
        linearised(design.machine),
        settings_of(asked, name),
        design.control.t_s,
        design.inverter.v_dc,
        asked.omega_max,
        asked.disturbances,
        training_box(design, asked.omega_max) if learns else None,
    )


def _figures(asked: Question, name: str) -> EstimatorFigures:
    observer = tuned_observer(asked, name)
    judged = [_judged(asked, observer, m) for m in range(len(asked.loads))]

    def over(values: list[FloatArray], standstill: float) -> FloatArray:
        """Of all speeds and loads: standstill, where an observer sees nothing, then the rest."""
        return np.vstack([np.full(len(judged), standstill), np.stack(values, axis=1)])

    load = loads_at(asked.design, (_SLOPE_LOAD,))[0]
    return EstimatorFigures(
        angle=over([part.steady for part in judged], np.inf),
        speed=over([part.speed_total for part in judged], np.inf),
        noise=over([part.noise for part in judged], np.inf),
        omega_low=observer.judgement.steady_low,
        omega_high=observer.judgement.steady_high,
        left=_left(asked, observer),
        slopes=slopes_of(observer, load, np.array(SLOPE_SHARES) * asked.omega_max),
        capture=capture_of(asked.design, observer),
        observer=observer,
    )


def _judged(asked: Question, observer: PositionObserver, load: int) -> ObserverJudgement:
    """At one load, over the speeds from the first above standstill."""
    alone = replace(asked.disturbances, loads=(asked.loads[load],))
    return judge_at(
        observer.method, observer.gains, observer.t_s, observer.machine, alone, asked.omega[1:]
    )


def _left(asked: Question, observer: PositionObserver) -> float | None:
    """Crossover in rad/s that is left for the speed loop."""
    if asked.loops is None:
        return None
    loops = asked.loops
    found = judge_observed(asked.design, loops, None, observer, thorough=False).observed
    return None if found is None else found.left
