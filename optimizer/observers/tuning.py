"""Tuning of position observers: by the named method, or optimised for the least r.m.s.
error of the angle.
"""

from __future__ import annotations

import math
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.judgement import ObserverJudgement, judge, judge_at
from dqforge.optimizer.observers.parts import (
    LARGEST_TURN,
    Disturbances,
    ObserverTuning,
    require_magnet,
    usual_disturbances,
)
from dqforge.optimizer.observers.pll import FASTEST
from dqforge.optimizer.observers.reduced_order import Training, TrainingBox, usual_training_box

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.settings import ObserverSettings
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observers.parts import ObserverMethod


SHOWN = (0.05, 0.1, 0.25, 0.5, 1.0)  # Shares of the largest speed that tables show.
_SPEEDS = 8
_EVALUATIONS = 100
_UNSTABLE = 10.0
_WIDEST = 100.0
USUAL_LOSS = 0.01  # Share of the dc link that a dead time takes where nothing is known of it.


@dataclass(frozen=True, slots=True, eq=False)
class PositionObserver:
    """A tuned observer: ``gains`` for the firmware, and how good it is on the linear ``machine``.

    ``omega_max`` is the largest electrical speed of the drive in rad/s; ``judgement`` covers the
    whole range of speeds, ``shown`` some shares of ``omega_max`` for tables. ``training`` is what
    one that learns has gained by it.
    """

    machine: LinearMachine
    method: ObserverMethod
    tuning: ObserverTuning
    gains: Any
    t_s: float
    omega_max: float
    disturbances: Disturbances
    judgement: ObserverJudgement
    shown: ObserverJudgement
    training: Training | None = None


def _top(omega_max: float, t_s: float) -> float:
    """Speed in rad/s for which the gains are made: a fifth above the largest one,
    as far as sampling allows.
    """
    return min(1.2 * omega_max, LARGEST_TURN / t_s)


def _cost(
    method: ObserverMethod,
    tuning: ObserverTuning,
    machine: LinearMachine,
    t_s: float,
    disturbances: Disturbances,
    omega: FloatArray,
) -> float:
    """R.m.s. of the total angle error over speeds, in rad.

    Large where the observer is refused or unstable.
    """
    try:
        gains = method.design(machine, tuning, t_s, _top(float(omega[-1]), t_s))
    except NoSolutionError:
        return _UNSTABLE
    total = judge_at(method, gains, t_s, machine, disturbances, omega).total
    return float(
        np.sqrt(np.mean(np.where(np.isfinite(total), np.minimum(total, _UNSTABLE), _UNSTABLE) ** 2))
    )


def optimise(
    method: ObserverMethod,
    first: ObserverTuning,
    machine: LinearMachine,
    t_s: float,
    disturbances: Disturbances,
    omega_max: float,
) -> ObserverTuning:
    """Tuning with the least r.m.s. angle error from 5 % of ``omega_max`` rad/s upwards.

    The keys of the method and the bandwidth of the loop are searched within a factor of 100 of
    ``first`` by the subplex method of nlopt on their logarithms; the result is rounded to three
    digits.

    References:
        T. Rowan, "Functional stability analysis of numerical algorithms", 1990 (subplex).
    """
    import nlopt

    if not method.searched:
        return first
    omega = np.geomspace(0.05 * omega_max, omega_max, _SPEEDS)
    names = method.searched
    centre = np.log([getattr(first, name) for name in names])
    ceiling = {"pll_bandwidth": FASTEST / t_s, "bandwidth": 1.0 / t_s, "speed_gain": 2.0}
    upper = np.minimum(centre + np.log(_WIDEST), np.log([ceiling[name] for name in names]))
    lower = np.minimum(centre - np.log(_WIDEST), upper)

    def tuned(x: FloatArray) -> ObserverTuning:
        return replace(
            first, **{n: float(f"{np.exp(v):.3g}") for n, v in zip(names, x, strict=True)}
        )

    def cost(x: FloatArray, _: FloatArray) -> float:
        return _cost(method, tuned(x), machine, t_s, disturbances, omega)

    search = nlopt.opt(nlopt.LN_SBPLX, len(names))
    search.set_min_objective(cost)
    search.set_lower_bounds(lower)
    search.set_upper_bounds(upper)
    search.set_initial_step(0.7)
    search.set_maxeval(_EVALUATIONS)
    search.set_xtol_abs(2e-3)
    best = tuned(np.asarray(search.optimize(np.clip(centre, lower, upper)), dtype=np.float64))
    return min(
        (best, first), key=lambda tuning: _cost(method, tuning, machine, t_s, disturbances, omega)
    )


def tune_position_observer(
    machine: LinearMachine,
    settings: ObserverSettings,
    t_s: float,
    v_dc: float,
    omega_max: float,
    disturbances: Disturbances | None = None,
    box: TrainingBox | None = None,
) -> PositionObserver:
    """Position observer of a design.

    Args:
        machine: The machine, linear.
        settings: Method and tuning; what they leave open is the method's usual value, or searched
            for (``optimised``).
        t_s: Sampling period in s.
        v_dc: Voltage of the dc link in V (sets the usual noise of the voltage).
        omega_max: Largest electrical speed in rad/s.
        disturbances: Noise, parameter errors and acceleration; None for the usual ones.
        box: What an observer that learns is trained on; None for the usual one.

    Raises:
        InputError, NoSolutionError: The machine has no magnet, its speed is too high for the
            sampling, or the tuning is too fast.
    """
    from dqforge.optimizer.observers.methods.registry import method_named

    method = method_named(settings.method)
    require_magnet(machine)
    if omega_max * t_s > LARGEST_TURN:
        raise NoSolutionError(
            f"control.observer: at the largest speed the rotor turns by {omega_max * t_s:.3g} rad "
            f"(electrical) per sample, at most {LARGEST_TURN:g}; sample at "
            f"{math.ceil(omega_max / LARGEST_TURN)} Hz or more"
        )
    given = {
        name: value
        for name in ("bandwidth", "pll_bandwidth", "damping", "speed_gain")
        if (value := getattr(settings, name)) is not None
    }
    tuning = replace(method.usual(machine, t_s, omega_max), **given)
    known = usual_disturbances(machine, v_dc, omega_max) if disturbances is None else disturbances
    if settings.tuning == "optimised":
        tuning = optimise(method, tuning, machine, t_s, known, omega_max)
    gains = method.design(machine, tuning, t_s, _top(omega_max, t_s))
    training = None
    if method.train is not None:
        if box is None:
            box = usual_training_box(USUAL_LOSS * v_dc, machine.i_max, omega_max)
        gains, training = method.train(gains, machine, settings, box, omega_max)
    judgement = judge(method, gains, t_s, machine, known, omega_max)
    shown = judge_at(method, gains, t_s, machine, known, np.array(SHOWN) * omega_max)
    return PositionObserver(
        machine, method, tuning, gains, t_s, omega_max, known, judgement, shown, training
    )


def retuned(position: PositionObserver, tuning: ObserverTuning) -> PositionObserver:
    """The observer with other numbers, its judgement left as it was.

    Args:
        position: The observer.
        tuning: Its numbers.

    Raises:
        NoSolutionError: They are too fast.
    """
    top = _top(position.omega_max, position.t_s)
    gains = position.method.design(position.machine, tuning, position.t_s, top)
    return replace(position, tuning=tuning, gains=gains)


# What is proven of a design's observer over its speed range.

_LEAST_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class ObserverProof:
    """Result of the search for a common Lyapunov function, exact
    (`dqforge.optimizer.observers.methods.lpv_certificate`) or checked at many points
    (`dqforge.optimizer.observers.step_certificate`).

    Args:
        contraction: Factor by which the norm of a small error shrinks at least in every sample;
            None where none was found.
        omega_low, omega_high: Electrical speeds in rad/s between which the speed may change
            arbitrarily.
        i_q: Largest |i_q| in A, at i_d = 0.
        reason: Why there is none, empty otherwise.
        searched: Whether one was searched for: not where a package for it is missing, and not of a
            method that can have none.
        points: Speeds and currents at which the contraction was checked; nil where it is exact for
            all of them.
        matrix: Of the norm, in the coordinates of
            `dqforge.optimizer.observers.methods.lpv_certificate`; empty where it is not exact.
    """

    contraction: float | None
    omega_low: float
    omega_high: float
    i_q: float
    reason: str = ""
    searched: bool = True
    points: int = 0
    matrix: tuple[tuple[float, ...], ...] = ()


def prove(observer: PositionObserver | None) -> ObserverProof | None:
    """Search a proof from the least speed at which the observer holds to the largest of the drive.

    None without an observer. Where cvxpy or Clarabel is missing, or the method can have no such
    proof, the result says so.
    """
    if observer is None:
        return None
    low, high = observer.judgement.steady_low, observer.omega_max
    if not (np.isfinite(low) and low < high):
        low = _LEAST_SHARE * high
    i_q = observer.disturbances.i_load
    reason = observer.method.unproven
    missing = [name for name in ("cvxpy", "clarabel") if find_spec(name) is None]
    if missing and not reason:
        reason = (
            f"the search needs {' and '.join(missing)}; install with: pip install "
            f"{' '.join(missing)}"
        )
    if reason:
        return ObserverProof(None, low, high, i_q, reason, searched=False)
    try:
        return _searched(observer, low, high, i_q)
    except NoSolutionError as error:
        return ObserverProof(None, low, high, i_q, error.message.removeprefix("no certificate: "))


def _searched(observer: PositionObserver, low: float, high: float, i_q: float) -> ObserverProof:
    """The exact proof of a method that has one, else the checked one."""
    method, gains = observer.method, observer.gains
    if method.certify is not None:
        factor, matrix = method.certify(gains, low, high, i_q)
        return ObserverProof(factor, low, high, i_q, matrix=tuple(map(tuple, matrix.tolist())))
    from dqforge.optimizer.observers.step_certificate import ObserverRange, certify_step

    found = certify_step(
        ObserverRange(method, gains, observer.machine, observer.t_s, low, high, i_q)
    )
    return ObserverProof(found.contraction, found.omega_low, high, i_q, points=found.points)
