"""Candidates of the comparison with what was found of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, SixStepSettings, StartUpSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import SIX_STEP_METHODS, ObserverMethodName, StartUpMethodName
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.plants.scenario import ComplexArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.measured_speed_loop import judge_observed
from dqforge.optimizer.estimator_comparison.candidate import (
    HALF_TURN,
    LOCKED,
    LOST,
    START_ANGLES,
    Candidate,
    CaptureMap,
    EstimatorFigures,
    Question,
    Slopes,
    StartCandidate,
    StartFigures,
    control_over,
    observer_candidates,
)
from dqforge.optimizer.estimators import TRACKERS, TunedTracker, tune_tracker
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, DEAD_TIME, PARAMETERS, SPEED_LIMIT
from dqforge.optimizer.observers.parts import Load
from dqforge.optimizer.six_step.design import SixStepDesign, commutation_errors, solve_six_step
from dqforge.optimizer.start_up.plan import StartUpPlan
from dqforge.optimizer.start_up.solve import solve_start_up
from dqforge.optimizer.steps.step_arithmetic import EXACT, Pair


@dataclass(frozen=True, slots=True, eq=False)
class ComparedEstimator:
    """An estimator with what was found; ``refusal`` says why nothing was, empty where it may be.

    Args:
        candidate: What it is.
        refusal: With the number.
        figures: None where it is refused.
        holds: Whether angle and speed stay within the limits, shape (S, L); None likewise.
        cycles, instructions, flash: Of a step of its C on the core of the design: cycles (low,
            high) and instructions in the mean, bytes; None where they were not measured.
    """

    candidate: Candidate
    refusal: str
    figures: EstimatorFigures | None = None
    holds: NDArray[np.bool_] | None = None
    cycles: tuple[float, float] | None = None
    instructions: float | None = None
    flash: int | None = None


@dataclass(frozen=True, slots=True)
class ComparedStart:
    """A start-up with what was found; ``refusal`` says why nothing was."""

    candidate: StartCandidate
    refusal: str
    figures: StartFigures | None = None


# Trackers of the position as candidates: judged by trials of their own step.

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


# Trackers tried on drives that turn steadily: the emitted step in the loop with the machine's
# answer to the voltage that it asks for.
#
# The current of the load is held by its controller. What an injected voltage adds to it is the
# answer of a linear machine, whose inductances are the incremental ones at that load, cross
# saturation included; over a period with a voltage held in stator coordinates it is exact. A dead
# time opposes the whole current phase by phase, so that it distorts the answer most where the
# load's own current is small.

_SOFT = 0.02  # of the current limit: below, a phase takes less than the whole dead time
_PHASES = np.exp(2j * np.pi / 3.0 * np.arange(3))


@dataclass(frozen=True, slots=True, eq=False)
class SteadyDrives:
    """N drives, arrays of shape (N,).

    Args:
        omega: Electrical speed in rad/s.
        current: i_d + j i_q in A.
        voltage: v_d + j v_q in V that holds it, in the middle of a period.
        r_s: In Ohm.
        inductance: Incremental, in H, shape (N, 2, 2).
        lost: Amplitude in V of what the dead time takes from the fundamental.
        noise: Standard deviation of a measured current in A, per axis.
        i_max: Current limit in A.
        sum_flux: Integral of the sum of the phase voltages over the angle of a turn in V s, shape
            (N, K), the first value at 0 and all equally far apart; None where nothing hears it.
        sum_noise: Standard deviation of the measured sum in V, shape (N,); None likewise.
    """

    omega: FloatArray
    current: ComplexArray
    voltage: ComplexArray
    r_s: FloatArray
    inductance: FloatArray
    lost: FloatArray
    noise: FloatArray
    i_max: float
    sum_flux: FloatArray | None = None
    sum_noise: FloatArray | None = None


# A real matrix M of vectors z = x + j y as M z = p z + q conj(z), arrays of shape (N,).
Factors = tuple[ComplexArray, ComplexArray]


def _transition(drives: SteadyDrives, t_s: float) -> tuple[Factors, Factors]:
    """Factors of current and voltage over a period, in the rotor's frame at its beginning for the
    voltage and at its end for the current.
    """
    from scipy.linalg import expm

    count = len(drives.omega)
    inverse = np.linalg.inv(drives.inductance)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])[None] * drives.omega[:, None, None]
    matrix = np.zeros((count, 4, 4))
    resistance = drives.r_s[:, None, None] * np.eye(2)[None]
    matrix[:, :2, :2] = -inverse @ (resistance + turn @ drives.inductance)
    matrix[:, :2, 2:] = inverse
    matrix[:, 2:, 2:] = -turn
    step = expm(matrix * t_s)
    return _factors(step[:, :2, :2]), _factors(step[:, :2, 2:])


def _factors(m: FloatArray) -> Factors:
    straight = m[:, 0, 0] + m[:, 1, 1] + 1j * (m[:, 1, 0] - m[:, 0, 1])
    mirrored = m[:, 0, 0] - m[:, 1, 1] + 1j * (m[:, 1, 0] + m[:, 0, 1])
    halves = 0.5 * np.stack([straight, mirrored]).astype(np.complex128)
    return halves[0], halves[1]


def _applied(factors: Factors, vector: ComplexArray) -> ComplexArray:
    return np.asarray(factors[0] * vector + factors[1] * np.conj(vector))


def _dead(drives: SteadyDrives, current: ComplexArray) -> ComplexArray:
    """Voltage in V that the dead time takes at a current in stator coordinates."""
    phases = (current[:, None] * np.conj(_PHASES)).real / (_SOFT * drives.i_max)
    lost = 0.25 * np.pi * drives.lost[:, None] * np.clip(phases, -1.0, 1.0)
    return np.asarray(2.0 / 3.0 * (lost @ _PHASES))


def _summed(drives: SteadyDrives, theta: FloatArray) -> FloatArray:
    """Integral of the sum voltage at angles in rad by lines between its points, shape (N,)."""
    table = drives.sum_flux
    assert table is not None
    place = np.mod(theta, 2.0 * np.pi) / (2.0 * np.pi) * table.shape[1]
    below = place.astype(np.int64) % table.shape[1]
    rows, part = np.arange(len(theta)), place - np.floor(place)
    return np.asarray(
        (1.0 - part) * table[rows, below] + part * table[rows, (below + 1) % table.shape[1]]
    )


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


def tracked(
    tuned: TunedTracker,
    drives: SteadyDrives,
    angle: FloatArray,
    speed: FloatArray,
    samples: int,
    seed: int = 0,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Error of the angle in rad, wrapped, and electrical speed in rad/s after each sample.

    Args:
        tuned: The tracker.
        drives: What it is tried on.
        angle: Error of its angle at the start in rad, shape (N,).
        speed: Electrical speed in rad/s that it starts with, shape (N,).
        samples: How many.
        seed: Of the noise.
    """
    generator = np.random.default_rng(seed)
    tracker, t_s, count = tuned.tracker, tuned.t_s, len(drives.omega)
    by_current, by_voltage = _transition(drives, t_s)
    dead = bool(np.any(drives.lost))
    half = np.exp(0.5j * drives.omega * t_s)
    answer = np.zeros(count, dtype=np.complex128)  # to what was added, in the rotor's frame
    acting = waiting = np.zeros(count, dtype=np.complex128)
    state: Any = tracker.start(tuned.gains, np.asarray(EXACT.wrap(angle)), speed)
    for k in range(samples):
        theta = np.asarray(EXACT.wrap(drives.omega * t_s * k))
        turn = np.exp(1j * theta)
        whole = (drives.current + answer) * turn
        noise = generator.standard_normal((2, count)) * drives.noise
        # The fundamental that acted over the period before was held at its middle.
        before = drives.voltage * turn * np.conj(half) + acting
        seen = whole + noise[0] + 1j * noise[1]
        heard: tuple[FloatArray, ...] = ()
        if drives.sum_flux is not None and drives.sum_noise is not None:
            earlier = theta - drives.omega * t_s
            mean = (_summed(drives, theta) - _summed(drives, earlier)) / t_s
            heard = (mean + drives.sum_noise * generator.standard_normal(count),)
        state = tracker.step(tuned.gains, state, _pair(before), _pair(seen), heard, EXACT)
        yield np.asarray(EXACT.wrap(np.asarray(state.theta_e) - theta)), np.asarray(state.omega_e)
        acting = waiting
        if tracker.injects:
            waiting = np.asarray(state.added[0] + 1j * state.added[1])
        acted = acting
        if dead:
            acted = acting - _dead(drives, whole) + _dead(drives, drives.current * turn)
        answer = _applied(by_current, answer) + _applied(by_voltage, acted * np.conj(turn))


# The ways to start as candidates: each with the plan of its computed defaults.

_TITLES: dict[str, str] = {
    "i-f": "alignment, then a current that turns",
    "v-f": "alignment, then a voltage that turns",
    "direct": "alignment, then the observer at once",
    "saliency": "the rotor found by its saliency",
}


def start_candidates() -> tuple[StartCandidate, ...]:
    """A candidate per way to start."""
    names = [name for name in get_args(StartUpMethodName) if name in _TITLES]
    return tuple(_start_candidate(name) for name in names)


def _start_candidate(name: StartUpMethodName) -> StartCandidate:
    return StartCandidate(name, _TITLES[name], _refusal, lambda asked: _start_figures(asked, name))


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


def _start_figures(asked: Question, method: StartUpMethodName) -> StartFigures:
    if method == "saliency" and asked.from_standstill is None:
        raise NoSolutionError("no estimator holds at standstill")
    design = started_design(asked, method)
    found = solve_start_up(design)
    assert found is not None
    plan = found.plan
    return StartFigures(found.largest_loads[method], plan.hand_over, planned_time(plan), design)


# Estimators of six-step drives as candidates: by the errors of their commutation.

_SIX_STEP_TITLES = {
    "zero-crossing": "zero crossing of the floating phase's voltage, of a six-step drive",
    "emf-integration": "integral of the floating phase's voltage, of a six-step drive",
    "diode-conduction": "conduction of the floating phase's diode, of a six-step drive",
}


def six_step_candidates() -> tuple[Candidate, ...]:
    """A candidate per estimator of a six-step drive."""
    return tuple(_six_step_candidate(name) for name in SIX_STEP_METHODS)


def _six_step_candidate(name: str) -> Candidate:
    title = _SIX_STEP_TITLES.get(name, name)
    return Candidate(
        name, title, lambda _: "", lambda asked: _six_step_figures(asked, name), six_step=True
    )


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


def _six_step_figures(asked: Question, name: str) -> EstimatorFigures:
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
        angle[inside, m] = _six_step_root(errors.offset, errors.noise, errors.grid, errors.saliency)
        noise[inside, m] = errors.noise
    return EstimatorFigures(
        angle=angle,
        speed=np.where(np.isfinite(angle), 0.0, np.inf),
        noise=noise,
        omega_low=low,
        omega_high=high,
        left=None if found.speed is None else found.speed.crossover,
    )


def _six_step_root(*parts: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))


# All candidates of the comparison; a line per kind, which lists its own.


def estimators() -> tuple[Candidate, ...]:
    """Every estimator of the position, in the order in which they are shown."""
    return (*observer_candidates(), *tracker_candidates(), *six_step_candidates())


def starts() -> tuple[StartCandidate, ...]:
    """Every way to start."""
    return start_candidates()
