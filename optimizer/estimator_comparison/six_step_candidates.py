"""Estimators of six-step drives as candidates: by the errors of their commutation."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings, SixStepSettings
from dqforge.machines.names import SIX_STEP_METHODS, ObserverMethodName
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    EstimatorFigures,
    Question,
)
from dqforge.optimizer.six_step.design import SixStepDesign, solve_six_step
from dqforge.optimizer.six_step.errors import commutation_errors

_TITLES = {
    "zero-crossing": "zero crossing of the floating phase's voltage, of a six-step drive",
    "emf-integration": "integral of the floating phase's voltage, of a six-step drive",
}


def six_step_candidates() -> tuple[Candidate, ...]:
    """A candidate per estimator of a six-step drive."""
    return tuple(_candidate(name) for name in SIX_STEP_METHODS)


def _candidate(name: str) -> Candidate:
    title = _TITLES.get(name, name)
    return Candidate(name, title, lambda _: "", lambda asked: _figures(asked, name), six_step=True)


def _solved(asked: Question, name: str) -> SixStepDesign:
    """The drive of the design with blocks in place of its currents."""
    design, control = asked.design, asked.design.control
    observer = control.observer
    if observer is None or observer.method != name:
        observer = ObserverSettings(method=cast(ObserverMethodName, name))
    settings = SixStepSettings() if control.six_step is None else control.six_step
    chosen = replace(control, observer=observer, six_step=settings)
    found = solve_six_step(replace(design, control=chosen))
    assert found is not None
    return found


def _figures(asked: Question, name: str) -> EstimatorFigures:
    found = _solved(asked, name)
    low, high = found.limits.low, found.limits.high
    inside = (asked.omega >= low) & (asked.omega <= high)
    shape = asked.reached.shape
    angle, noise = np.full(shape, np.inf), np.full(shape, np.inf)
    for m, load in enumerate(asked.loads):
        share = float(np.hypot(load.i_d, load.i_q)) / asked.design.i_max
        known = replace(
            found.disturbed, step=share * found.disturbed.step, kappa=share * found.disturbed.kappa
        )
        errors = commutation_errors(
            found.shape, known, asked.omega[inside], by_integral=found.by_integral
        )
        angle[inside, m] = _root(errors.offset, errors.noise, errors.grid, errors.saliency)
        noise[inside, m] = errors.noise
    return EstimatorFigures(
        angle=angle,
        speed=np.where(np.isfinite(angle), 0.0, np.inf),
        noise=noise,
        omega_low=low,
        omega_high=high,
        left=None if found.speed is None else found.speed.crossover,
    )


def _root(*parts: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))
