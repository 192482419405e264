"""Trackers of the position as candidates: judged by trials of their own step."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import cast

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.observed_speed_loop import judge_observed
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    EstimatorFigures,
    Question,
)
from dqforge.optimizer.estimator_comparison.capture_range import (
    HALF_TURN,
    LOCKED,
    LOST,
    START_ANGLES,
    CaptureMap,
)
from dqforge.optimizer.estimator_comparison.sensitivity import Slopes
from dqforge.optimizer.estimator_comparison.tracker_trials import SteadyDrives, tracked
from dqforge.optimizer.estimators.registry import TRACKERS
from dqforge.optimizer.estimators.solve import TunedTracker, tune_tracker
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, DEAD_TIME, PARAMETERS, SPEED_LIMIT
from dqforge.optimizer.observers.tuning_numbers import Load

_SETTLING, _COUNTED = 1200, 1000  # samples of a trial

_CAPTURED = 2000  # samples of a start

_SPEEDS = np.array([0.5, 1.0])  # of the starts, over the largest of the tracker

_STARTS = np.array([-1.0, -0.5, 0.0, 0.5])  # errors of the speed at the start, over it

_OF_SALIENCY, _OF_SUM = ("r_s", "l_d", "l_q"), ("psi_pm",)  # what enters either kind

_SIGNALS = ("sum-voltage",)


def tracker_candidates() -> tuple[Candidate, ...]:
    """A candidate per tracker."""
    return tuple(_candidate(name) for name in TRACKERS)


def _candidate(name: str) -> Candidate:
    tracker = TRACKERS[name]
    return Candidate(
        name,
        tracker.title,
        lambda _: "",
        lambda asked: _figures(asked, name),
        from_standstill=tracker.injects,
    )


@dataclass(frozen=True, slots=True)
class _Case:
    """One cause: relative errors of the machine, voltage lost in V, whether noise acts."""

    name: str
    errors: dict[str, float]
    lost: float = 0.0
    noise: bool = False


def _names(tuned: TunedTracker) -> tuple[str, ...]:
    """Parameters that enter a tracker."""
    return _OF_SUM if tuned.tracker.hears else _OF_SALIENCY


def _cases(asked: Question, names: tuple[str, ...]) -> list[_Case]:
    """Exact data, noise, the dead time from least to most, then each parameter to both sides."""
    known = asked.disturbances
    found = [_Case("exact_data", {}), _Case("noise", {}, noise=True)]
    found += [_Case(DEAD_TIME, {}, lost) for lost in (known.lost, known.lost_least)]
    for name in names:
        found += [_Case(name, {name: error}) for error in reversed(known.limits(name))]
    return found


def _drives(
    asked: Question, omega: FloatArray, loads: tuple[Load, ...], cases: list[_Case]
) -> SteadyDrives:
    """Every case at every speed and load, in that order."""
    machine = asked.design.machine
    shape = (len(cases), len(omega), len(loads))
    currents = np.array([complex(load.i_d, load.i_q) for load in loads])
    jet = machine.jet(currents.real, currents.imag)
    inductance = np.stack(
        [np.stack([jet.l_dd, jet.l_dq], axis=-1), np.stack([jet.l_qd, jet.l_qq], axis=-1)], axis=1
    )
    scale = np.array(
        [[1.0 + case.errors.get("l_d", 0.0), 1.0 + case.errors.get("l_q", 0.0)] for case in cases]
    )
    mixed = np.sqrt(scale[:, :, None] * scale[:, None, :])  # keeps it symmetric
    whole = mixed[:, None, None] * inductance[None, None]
    spread = np.broadcast_to(omega[None, :, None], shape)
    volts = np.array(
        [
            np.array(machine.voltage(currents.real, currents.imag, np.full(len(loads), w)))
            for w in omega
        ]
    )
    r_s = np.array([machine.r_s * (1.0 + case.errors.get("r_s", 0.0)) for case in cases])
    every = np.broadcast_to
    return SteadyDrives(
        omega=spread.ravel(),
        current=every(currents, shape).ravel(),
        voltage=every(volts[None, :, 0] + 1j * volts[None, :, 1], shape).ravel(),
        r_s=every(r_s[:, None, None], shape).ravel(),
        inductance=every(whole, (*shape, 2, 2)).reshape(-1, 2, 2),
        lost=every(np.array([case.lost for case in cases])[:, None, None], shape).ravel(),
        noise=every(
            np.array([asked.disturbances.i_noise * case.noise for case in cases])[:, None, None],
            shape,
        ).ravel(),
        i_max=asked.design.i_max,
        **_sum_voltage(asked, cases, shape),
    )


def _sum_voltage(
    asked: Question, cases: list[_Case], shape: tuple[int, ...]
) -> dict[str, FloatArray]:
    """Integral of the sum of the phase voltages and its noise; nothing of a machine of sines."""
    machine = asked.design.phase_machine
    if machine is None:
        return {}
    plain = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    flux = np.sum(plain.flux, axis=0)
    count = flux.size // plain.turns
    turn = flux[:count] - np.mean(flux[:count])
    steps = 0.5 * (turn + np.roll(turn, -1)) * (2.0 * np.pi / count)
    table = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    scale = np.array([1.0 + case.errors.get("psi_pm", 0.0) for case in cases])
    noise = np.sqrt(3.0) * asked.disturbances.v_noise * np.array([case.noise for case in cases])
    ones = np.ones(shape)
    return {
        "sum_flux": (scale[:, None, None] * ones).reshape(-1, 1) * table[None],
        "sum_noise": (noise[:, None, None] * ones).ravel(),
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Means of the errors of angle and speed by case name: pairs to both sides stand one behind
    the other, shape (2 or 1, S, L); and the spread of the angle by noise, which hardly depends on
    the speed and is that of all speeds, shape (S, L).
    """

    angle: dict[str, FloatArray]
    speed: dict[str, FloatArray]
    spread: FloatArray


def _tried(asked: Question, tuned: TunedTracker, omega: FloatArray) -> _Trial:
    cases = _cases(asked, _names(tuned))
    drives = _drives(asked, omega, asked.loads, cases)
    count = len(drives.omega)
    total = np.zeros((3, count))  # angle, its square, speed
    worst = np.zeros(count)
    run = tracked(tuned, drives, np.zeros(count), drives.omega, _SETTLING + _COUNTED)
    with np.errstate(all="ignore"):  # a tracker that loses the angle may run away
        for k, (angle, speed) in enumerate(run):
            if k >= _SETTLING:
                total += np.stack([angle, angle**2, speed - drives.omega])
                worst = np.maximum(worst, np.abs(angle))
        mean = total / _COUNTED
        lost = ~np.isfinite(mean).all(axis=0) | (worst > 0.25 * np.pi)
        angle_mean, speed_mean = (np.where(lost, np.inf, mean[row]) for row in (0, 2))
        spread = np.sqrt(np.maximum(mean[1] - mean[0] ** 2, 0.0))
    shape = (len(cases), len(omega), len(asked.loads))
    rows = [part.reshape(shape) for part in (angle_mean, speed_mean)]
    names = [case.name for case in cases]

    def grouped(values: FloatArray) -> dict[str, FloatArray]:
        return {
            name: values[[k for k, own in enumerate(names) if own == name]]
            for name in dict.fromkeys(names)
        }

    own = names.index("noise")
    noisy = np.sqrt(np.mean(spread.reshape(shape)[own] ** 2, axis=0))
    gone = lost.reshape(shape)[own]
    return _Trial(grouped(rows[0]), grouped(rows[1]), np.where(gone, np.inf, noisy))


def _root(parts: dict[str, FloatArray], noise: FloatArray | None) -> FloatArray:
    """Root of the squares of the error with exact data, of what each cause adds to the worse side,
    and of the noise; inf where any is lost.
    """
    exact = parts["exact_data"][0]
    squares = [exact**2]
    with np.errstate(invalid="ignore"):
        for name, values in parts.items():
            if name not in {"exact_data", "noise"}:
                gap = np.max(np.abs(values - exact), axis=0)
                squares.append(np.where(np.isfinite(gap), gap, np.inf) ** 2)
    if noise is not None:
        squares.append(noise**2)
    return np.asarray(np.sqrt(np.sum(squares, axis=0)))


def _figures(asked: Question, name: str) -> EstimatorFigures:
    own = asked.design.control.observer
    plain = ObserverSettings(method=cast(ObserverMethodName, name))
    settings = own if own is not None and own.method == name else plain
    tuned = tune_tracker(asked.design, settings)
    if set(tuned.tracker.hears) - set(_SIGNALS):
        raise NoSolutionError(
            f"it hears {', '.join(tuned.tracker.hears)} besides, which is not compared here"
        )
    inside = (asked.omega >= tuned.omega_low) & (asked.omega <= tuned.omega_high)
    if not np.any(inside):
        raise NoSolutionError(
            f"it holds from {tuned.omega_low / asked.omega_max:.3g} to "
            f"{tuned.omega_high / asked.omega_max:.3g} of the largest speed, between those compared"
        )
    trial = _tried(asked, tuned, asked.omega[inside])
    shape = asked.reached.shape

    def over(values: FloatArray) -> FloatArray:
        found = np.full(shape, np.inf)
        found[inside] = values
        return found

    figures = EstimatorFigures(
        angle=over(_root(trial.angle, trial.spread)),
        speed=over(_root(trial.speed, None)),
        noise=over(trial.spread),
        omega_low=np.nan,
        omega_high=np.nan,
        left=_left(asked, tuned),
        slopes=_slopes(asked, trial, asked.omega[inside], _names(tuned)),
        capture=_capture(asked, tuned),
        tracker=tuned,
    )
    low, high = _span(asked, figures, tuned)
    return replace(figures, omega_low=low, omega_high=high)


def _span(asked: Question, figures: EstimatorFigures, tuned: TunedTracker) -> tuple[float, float]:
    """Speeds in rad/s from the first to the last of the grid at which it holds at every load that
    is reached; to the tracker's own limit where it holds up to there.
    """
    permitted = np.maximum(SPEED_LIMIT * asked.omega, 1e-3 * asked.omega_max)[:, None]
    good = (figures.angle <= ANGLE_LIMIT) & (figures.speed <= permitted)
    rows = np.all(good | ~asked.reached, axis=1) & np.any(asked.reached, axis=1)
    held = np.flatnonzero(rows)
    if not held.size:
        return float("nan"), float("nan")
    first = int(held[0])
    run = held[: int(np.argmax(np.append(np.diff(held) > 1, True))) + 1]
    last = int(run[-1])
    beyond = last + 1 >= len(asked.omega) or asked.omega[last + 1] > tuned.omega_high
    return float(asked.omega[first]), tuned.omega_high if beyond else float(asked.omega[last])


def _left(asked: Question, tuned: TunedTracker) -> float | None:
    """Crossover in rad/s that is left for the speed loop; None where the tracker states no loop, or
    the drive has no steady state at a speed, such as a machine without magnet at no load.
    """
    if asked.loops is None:
        return None
    loops = asked.loops
    try:
        found = judge_observed(asked.design, loops, None, None, tuned, thorough=False).observed
    except np.linalg.LinAlgError:
        return None
    return None if found is None else found.left


def _slopes(
    asked: Question, trial: _Trial, omega: FloatArray, names: tuple[str, ...]
) -> Slopes | None:
    """Errors of the trials over what caused them, at half the torque, motoring."""
    at = int(np.argmin(np.abs(asked.shares - 0.5)))
    known = asked.disturbances
    sizes = {name: float(np.ptp(known.limits(name))) for name in names}
    sizes[DEAD_TIME] = known.lost - known.lost_least
    exact = {"angle": trial.angle["exact_data"][0], "speed": trial.speed["exact_data"][0]}

    def slope(parts: dict[str, FloatArray], bare: FloatArray) -> dict[str, FloatArray]:
        found = {name: np.zeros(len(omega)) for name in PARAMETERS}
        with np.errstate(all="ignore"):
            for name, size in sizes.items():
                ends = parts[name][:, :, at]
                gap, over = ends[0] - ends[1], size
                if name == DEAD_TIME and size == 0.0:
                    gap, over = ends[0] - bare[:, at], known.lost
                value = gap / over if over else np.full(len(omega), np.nan)
                found[name] = np.where(np.isfinite(value), value, np.nan)
        return found

    return Slopes(omega, slope(trial.angle, exact["angle"]), slope(trial.speed, exact["speed"]))


def _capture(asked: Question, tuned: TunedTracker) -> CaptureMap:
    """Starts that lock, at half and at the whole of the speed that the tracker reaches."""
    at = _SPEEDS * min(tuned.omega_high, asked.omega_max)
    load = asked.loads[int(np.argmin(np.abs(asked.shares - 0.5)))]
    mesh = np.meshgrid(at, _STARTS, START_ANGLES, indexing="ij")
    place = np.searchsorted(at, mesh[0].ravel())
    alone = _drives(asked, at, (load,), [_Case("exact_data", {})])
    arrays = {
        part.name: value[place]
        for part in fields(alone)
        if isinstance(value := getattr(alone, part.name), np.ndarray)
    }
    drives = replace(alone, **arrays)
    last = np.zeros((2, len(place)), dtype=np.int64)
    start = drives.omega * (1.0 + mesh[1].ravel())
    with np.errstate(all="ignore"):
        for k, (angle, speed) in enumerate(
            tracked(tuned, drives, mesh[2].ravel(), start, _CAPTURED)
        ):
            slow = np.abs(speed - drives.omega) <= SPEED_LIMIT * drives.omega
            last[0, ~(slow & (np.abs(angle) <= ANGLE_LIMIT))] = k
            last[1, ~(slow & (np.abs(angle) >= np.pi - ANGLE_LIMIT))] = k
    rest = last < 0.75 * _CAPTURED
    outcome = np.where(rest[0], LOCKED, np.where(rest[1], HALF_TURN, LOST)).astype(np.int8)
    times = np.where(rest[0], (last[0] + 1) * tuned.t_s, np.inf)
    shape = mesh[0].shape
    return CaptureMap(
        at,
        START_ANGLES,
        _STARTS,
        outcome.reshape(shape),
        times.reshape(shape),
        _CAPTURED * tuned.t_s,
    )
