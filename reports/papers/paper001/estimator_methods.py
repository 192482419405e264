"""Chapter 7 of paper 001: every method with what the thesis says of it, and what is found of it on
its bench.
"""

from __future__ import annotations

from math import degrees

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    EstimatorFigures,
    Question,
)
from dqforge.optimizer.estimator_comparison.registry import estimators
from dqforge.optimizer.estimator_comparison.solve import ask, reason_of

SHARES = (0.1, 0.5)  # Of the largest speed, at which angle errors are shown.

# What errors are shown of, and for how much of each: a tenth of a parameter, a volt that the dead
# time takes; at half the speed and half the torque.
CAUSES = {"r_s": 0.1, "l_q": 0.1, "psi_pm": 0.1, "dead_time": 1.0}


@dataclass(frozen=True, slots=True)
class Stated:
    """A method of the chapter: where it stands, its name here (empty: none), what is said of it."""

    section: str
    name: str
    says: str


METHODS = (
    Stated("7.2.1.1", "extended-emf", "poor near standstill; voltage and parameters needed"),
    Stated("7.2.1 (2)", "zero-crossing", "not for a sinusoidal EMF; filters delay; no start"),
    Stated("7.2.1 (3)", "emf-integration", "not for a sinusoidal EMF; poor at low speed"),
    Stated("7.2.1 (4)", "", "conduction of the freewheeling diodes; named only"),
    Stated("7.2.2", "open-loop-flux", "better than the EMF at low speed; the integral drifts"),
    Stated("7.2.2", "flux", "the same in a closed loop"),
    Stated("7.2.3", "third-harmonic", "looked for in this motor and found absent"),
    Stated("7.2.4.1", "inductance-mapping", "precise table needed; saturation moves it"),
    Stated("7.2.4.2", "injection", "independent of parameters, at low speed; L_q/L_d high"),
    Stated("7.2.4.2", "inform", "disturbed by the EMF; pulses both ways remove it"),
    Stated("7.2.5", "ekf", "covariances by search; no error of a parameter is made good"),
    Stated("7.2.6", "matsui-voltage", "ordinary current sensors suffice"),
    Stated("7.2.6", "matsui-current", "said to need no voltage: dead time does not matter much"),
    Stated("7.2.7", "reduced-order", "exact without, wrong with errors of parameters; used in 8.5"),
    Stated("7.2.8", "neuro-fuzzy", "no model needed; robust, tolerant of defects"),
    Stated("7.2.8", "neural", "no parameters needed; not transparent"),
)


@dataclass(frozen=True, slots=True)
class MethodFound:
    """A method on the bench.

    ``refusal`` says why it is none for the bench, empty where it may be; then speeds in Hz
    (electrical) between which it holds at every load, nan for none; ``angle_deg`` the r.m.s. of all
    steady errors and noise at `SHARES` at the worst load (inf: lost), ``noise_deg`` at half the
    speed, and ``slopes_deg`` by cause the steady error for what `CAUSES` says of it (nan:
    not known).
    """

    stated: Stated
    refusal: str
    low_hz: float = float("nan")
    high_hz: float = float("nan")
    angle_deg: tuple[float, ...] = ()
    noise_deg: float = float("nan")
    slopes_deg: tuple[float, ...] = ()


def _slopes(figures: EstimatorFigures, asked: Question) -> tuple[float, ...]:
    slopes = figures.slopes
    if slopes is None:
        return tuple(float("nan") for _ in CAUSES)
    at = int(np.argmin(np.abs(slopes.omega / asked.omega_max - SHARES[-1])))
    return tuple(degrees(size * float(slopes.angle[cause][at])) for cause, size in CAUSES.items())


def _found(stated: Stated, candidate: Candidate | None, asked: Question) -> MethodFound:
    if candidate is None:
        return MethodFound(stated, "not made here")
    refusal = candidate.refusal(asked)
    if refusal:
        return MethodFound(stated, refusal)
    try:
        figures = candidate.figures(asked)
    except (NoSolutionError, InputError) as error:
        return MethodFound(stated, reason_of(error))
    at = [int(np.argmin(np.abs(asked.omega / asked.omega_max - share))) for share in SHARES]
    worst = [np.max(np.where(asked.reached[s], figures.angle[s], 0.0)) for s in at]
    noise = np.max(np.where(asked.reached[at[-1]], figures.noise[at[-1]], 0.0))
    return MethodFound(
        stated,
        "",
        figures.omega_low / (2.0 * np.pi),
        min(figures.omega_high, asked.omega_max) / (2.0 * np.pi),
        tuple(degrees(float(value)) for value in worst),
        degrees(float(noise)),
        _slopes(figures, asked),
    )


def methods_found(design_name: str) -> tuple[MethodFound, ...]:
    """Every method of the chapter on a drive of the library.

    Args:
        design_name: Of the bench.
    """
    asked = ask(catalogue.load(design_name))
    known = {candidate.name: candidate for candidate in estimators()}
    return tuple(_found(stated, known.get(stated.name), asked) for stated in METHODS)
