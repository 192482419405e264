"""What a trained correction gains on drives that it has not seen, within its box and beyond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.learned_correction.correction_frame import (
    CorrectionFrame,
    inputs_of,
    outside,
)
from dqforge.optimizer.learned_correction.least_squares import least_squares
from dqforge.optimizer.learned_correction.steady_errors import Drives, SteadyErrors, drawn
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.training import Limits, Training, TrainingBox

POINTS = 20_000  # Drives drawn for a training.
TRIED = 8_000  # Drives drawn for its assessment, and as many beyond the box.
LEAST_HELD = 0.2  # Least share of the drives of the box at which the observer has a steady state.
ALONE, REGRESSION = "flux observer alone", "linear regression"

# Corrected once, with the currents still held in the angle that is not corrected.
ANSWERED = "first answer"

# At rest with the correction: the currents are held in the corrected angle.
CORRECTED = "corrected"
_TRAINED, _TRIED, _BEYOND = 1, 2, 3  # seeds
_EDGES = (0.03, 0.06, 0.12, 0.3, 1.0)
_PASSES = 8

# Inputs of -1 to 1, shape (6, M) -> correction in rad, shape (M,).
Corrects = Callable[[FloatArray], FloatArray]


@lru_cache(maxsize=4)
def training_drives(gains: FluxGains, machine: LinearMachine, box: TrainingBox) -> SteadyErrors:
    """The drives that are trained on, each with some share of its error corrected already.

    The correction turns the angle in which the currents are held, and with it what the observer
    sees: what is learned has to be right before it acts, when it has acted, and in between.

    Raises:
        NoSolutionError: The observer holds on hardly any of them.
    """
    drives = drawn(machine, box, gains.path.t_s, POINTS, _TRAINED)
    bare = drives.at_rest(gains)
    share = float(np.mean(bare.held))
    if share < LEAST_HELD:
        raise NoSolutionError(
            f"control.observer: the flux observer has a steady angle on {100.0 * share:.3g} % of "
            "the drives of its tolerance box alone; there is nothing to learn from, narrow "
            "control.tolerances or write method: flux"
        )
    done = np.random.default_rng(_TRAINED).uniform(0.0, 1.0, POINTS)
    found = drives.at_rest(gains, np.where(bare.held, -done * bare.error, 0.0))
    return found.only(found.held & bare.held)


@lru_cache(maxsize=4)
def _fresh(
    gains: FluxGains, machine: LinearMachine, box: TrainingBox, seed: int
) -> tuple[Drives, SteadyErrors]:
    drives = drawn(machine, box, gains.path.t_s, TRIED, seed)
    return drives, drives.at_rest(gains)


def beyond(box: TrainingBox) -> Limits:
    """Relative errors of R above the box that are tried: 30 % of R more."""
    return box.r_s[1], box.r_s[1] + 0.3


def _regression(seen: SteadyErrors, box: TrainingBox) -> FloatArray:
    """Columns of a linear regression, shape (15, M): residual, currents and the size of i_q, by
    one, the logarithm of the speed, and its inverse.
    """
    one = np.ones_like(seen.omega)
    speeds = [one, np.log(seen.omega / box.omega_high), box.omega_low / seen.omega]
    d, q = seen.current.real / box.i_max, seen.current.imag / box.i_max
    values = [one, seen.residual.real / box.i_max, d, q, np.abs(q)]
    return np.stack([speed * value for speed in speeds for value in values])


def _in_the_loop(
    gains: FluxGains, drives: Drives, frame: CorrectionFrame, corrects: Corrects
) -> tuple[FloatArray, Any, Any]:
    """Errors in rad where correction and drive have come to rest together, where there is such a
    rest, and where the correction acts.

    Halfway to each new answer: as the filter of the correction, slowly.
    """
    kappa = np.zeros_like(drives.omega)
    for _ in range(_PASSES):
        seen = drives.at_rest(gains, kappa)
        answer, _ = _answer(frame, corrects, seen)
        kappa = np.where(seen.held, 0.5 * (kappa + answer), kappa)
    seen = drives.at_rest(gains, kappa)
    return seen.error + kappa, seen.held, _answer(frame, corrects, seen)[1]


def _answer(
    frame: CorrectionFrame, corrects: Corrects, seen: SteadyErrors
) -> tuple[FloatArray, Any]:
    """The correction in rad as it is emitted: silent outside its trained ranges; where it acts."""
    x = inputs_of(frame, seen)
    acts = outside(tuple(x)) == 0.0
    return np.where(acts, corrects(x), 0.0), acts


def assessed(
    gains: FluxGains,
    machine: LinearMachine,
    box: TrainingBox,
    frame: CorrectionFrame,
    omega_max: float,
    corrects: Corrects,
    rules: float | None,
    numbers: int,
) -> Training:
    """Errors with and without a correction, on drives drawn anew.

    Args:
        gains: Of the flux observer.
        frame: What the correction is told, and its limit.
        omega_max: Largest electrical speed in rad/s, of which the bands are shares.
        corrects: What was learned.
        rules: Bound of its rules in rad, None where it has none.
        numbers: How many constants were learned.
    """
    trained = training_drives(gains, machine, box)
    linear = least_squares(_regression(trained, box), -trained.error)
    further = replace(box, r_s=beyond(box))
    edges = omega_max * np.stack([_EDGES[:-1], _EDGES[1:]], axis=1)
    found: list[dict[str, Any]] = []
    for where, seed in ((box, _TRIED), (further, _BEYOND)):
        drives, bare = _fresh(gains, machine, where, seed)
        error, held, acts = _in_the_loop(gains, drives, frame, corrects)
        left = {
            ALONE: bare.error,
            REGRESSION: bare.error + np.einsum("i,in->n", linear, _regression(bare, box)),
            ANSWERED: bare.error + _answer(frame, corrects, bare)[0],
            CORRECTED: error,
        }
        found.append(_by_band(bare, edges, left, held & bare.held, acts))
    inner, outer = found
    return Training(
        box,
        edges,
        inner["rms"],
        inner["largest"],
        outer["rms"],
        beyond(box),
        inner["held"],
        inner["acts"],
        outer["acts"],
        frame.limit,
        rules,
        numbers,
        len(trained.error),
    )


def _by_band(
    tried: SteadyErrors, edges: FloatArray, left: dict[str, FloatArray], both: Any, acts: Any
) -> dict[str, Any]:
    """R.m.s. and largest errors in rad per band, and shares of the drives; nought where the
    observer holds on none. ``both`` are the drives that are at rest without and with a correction.
    """
    bands = [(tried.omega >= low) & (tried.omega <= high) for low, high in edges.tolist()]

    def over(function: Callable[[FloatArray], Any], name: str) -> FloatArray:
        held = both if name == CORRECTED else tried.held
        parts = [left[name][band & held] for band in bands]
        return np.array([float(function(part)) if part.size else 0.0 for part in parts])

    def root(part: FloatArray) -> Any:
        return np.sqrt(np.mean(part**2))

    def share(of: Any, among: Any) -> FloatArray:
        counts = [max(1, int(np.count_nonzero(band & among))) for band in bands]
        return np.array(
            [
                np.count_nonzero(band & among & of) / count
                for band, count in zip(bands, counts, strict=True)
            ]
        )

    return {
        "rms": {name: over(root, name) for name in left},
        "largest": {name: over(lambda part: np.max(np.abs(part)), name) for name in left},
        "held": share(tried.held, np.ones_like(tried.held)),
        "acts": share(acts, both),
    }
