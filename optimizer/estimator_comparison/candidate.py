"""What stands in the comparison: an estimator or a start-up with what is asked of it.

A candidate is a record of functions. Each says by a reason with its number why physics forbids it,
or what it does at the speeds and loads of a question. A further kind of estimator is a further
function that lists candidates, in `dqforge.optimizer.estimator_comparison.compared`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.sections.observer import (
    COMPENSATED,
    SPEED_GAIN,
    SPEED_GAIN_COMPENSATED,
    SPREAD,
)
from dqforge.machines.design.settings import ControlSettings, ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.machine_budget import COPPER_COEFFICIENT
from dqforge.machines.names import SPEED_OBSERVER, ObserverMethodName, StartUpMethodName
from dqforge.machines.plants.scenario import Plants, plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.measured_speed_loop import judge_observed
from dqforge.optimizer.estimators import TunedTracker
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.conditions import loads_at, lost_voltage, training_box
from dqforge.optimizer.observers.judgement import (
    ANGLE_LIMIT,
    DEAD_TIME,
    PARAMETERS,
    SPEED_LIMIT,
    judge_loads,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import Disturbances, Load, ObserverMethod, steady_observer
from dqforge.optimizer.observers.tuning import SHOWN, PositionObserver, tune_position_observer
from dqforge.optimizer.steps.step_arithmetic import EXACT


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What every candidate is asked.

    Args:
        design: The drive.
        omega_max: Its largest electrical speed in rad/s.
        omega: Electrical speeds in rad/s, ascending from standstill, shape (S,).
        shares: Torques over the largest one, ascending from braking, shape (L,).
        loads: The loads there.
        reached: Whether the drive's voltage reaches a speed at a load, shape (S, L).
        disturbances: What an estimator has to live with: noise, tolerances, dead time.
        loops: Both current loops and the speed loop as tuned for an encoder; None without a speed
            loop.
        at_speed, from_standstill: Names of the chosen estimators, of which start-ups are asked;
            None where there is none.
        steady: Whether steady errors are all that is asked, without starts and what is left for a
            speed loop.
    """

    design: Design
    omega_max: float
    omega: FloatArray
    shares: FloatArray
    loads: tuple[Load, ...]
    reached: NDArray[np.bool_]
    disturbances: Disturbances
    loops: tuple[LoopGains, LoopGains, LoopGains] | None
    at_speed: str | None = None
    from_standstill: str | None = None
    steady: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives at one load.

    Args:
        omega: Electrical speeds in rad/s, shape (S,).
        angle: By cause the angle error in rad per relative change of the machine's parameter, and
            per V of lost voltage for the dead time, shape (S,); nan where the angle is lost.
        speed: The same of the speed error in rad/s.
    """

    omega: FloatArray
    angle: dict[str, FloatArray]
    speed: dict[str, FloatArray]


# What became of a start: never at rest, at the rotor, or half a turn off.
LOST, LOCKED, HALF_TURN = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class CaptureMap:
    """What becomes of starts.

    Args:
        omega: Electrical speeds in rad/s, shape (S,).
        angles: Errors of the angle at the start in rad, estimate minus truth, shape (A,).
        speeds: Errors of the speed at the start, over the speed, shape (V,).
        outcome: `LOST`, `LOCKED` or `HALF_TURN`, shape (S, V, A).
        lock_time: Time in s after which the errors stay within the limits, shape (S, V, A); inf of
            starts that do not lock.
        duration: Length of a run in s.
    """

    omega: FloatArray
    angles: FloatArray
    speeds: FloatArray
    outcome: NDArray[np.int8]
    lock_time: FloatArray
    duration: float

    @property
    def share(self) -> FloatArray:
        """Share of the starts that lock, over the speeds, shape (S,).

        The angle of -180 degrees, which is that of 180, does not count twice.
        """
        return np.asarray(np.mean(self.outcome[:, :, 1:] == LOCKED, axis=(1, 2)))

    def angle_range(self, start_speed: float = 0.0) -> FloatArray:
        """Largest error of the angle to both sides in rad from which every start locks, shape
        (S, 2); nan where not even the true angle does.

        Args:
            start_speed: One of ``speeds``.
        """
        row = int(np.argmin(np.abs(self.speeds - start_speed)))
        middle = int(np.argmin(np.abs(self.angles)))
        locked = self.outcome[:, row] == LOCKED
        found = np.full((len(self.omega), 2), np.nan)
        for k, line in enumerate(locked):
            if line[middle]:
                below, above = np.flatnonzero(~line[:middle]), np.flatnonzero(~line[middle:])
                low = int(below[-1]) + 1 if below.size else 0
                high = middle + int(above[0]) - 1 if above.size else len(line) - 1
                found[k] = self.angles[low], self.angles[high]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorFigures:
    """What an estimator does.

    Args:
        angle: R.m.s. of all steady errors of the angle and of its noise in rad, inf where it is
            lost, shape (S, L).
        speed: R.m.s. of the steady errors of the electrical speed in rad/s, shape (S, L).
        noise: Standard deviation of the angle in rad, shape (S, L).
        omega_low, omega_high: Electrical speeds in rad/s between which it holds at every load; nan
            where it never does.
        left: Crossover in rad/s that it leaves for the speed loop, None where it leaves none or
            where that is not known.
        slopes: Errors per unit of their causes, None where they are not known.
        capture: Starts from which it locks, None where none were tried.
        observer: The tuned observer, None of candidates of other kinds.
        tracker: The tuned tracker likewise.
    """

    angle: FloatArray
    speed: FloatArray
    noise: FloatArray
    omega_low: float
    omega_high: float
    left: float | None = None
    slopes: Slopes | None = None
    capture: CaptureMap | None = None
    observer: PositionObserver | None = None
    tracker: TunedTracker | None = None


@dataclass(frozen=True, slots=True)
class Candidate:
    """An estimator.

    Args:
        name: The word of ``control.observer.method``.
        title: In words.
        refusal: question -> why physics or the design forbids it, with the number; empty where it
            may be.
        figures: question -> what it does; may raise `NoSolutionError` or `InputError`, whose
            message is then the reason why it cannot be.
        from_standstill: Whether it works at standstill, so that a drive may start on it.
        six_step: Whether it makes the drive a six-step drive, whose currents are others: it wins
            and is flashed in such a design alone, where the others are not.
    """

    name: str
    title: str
    refusal: Callable[[Question], str]
    figures: Callable[[Question], EstimatorFigures]
    from_standstill: bool = False
    six_step: bool = False

    def competes(self, asked: Question) -> bool:
        """Whether it can be flashed in the drive of the question."""
        return self.six_step == (asked.design.control.six_step is not None)


@dataclass(frozen=True, slots=True)
class TriedStarts:
    """Starts that were tried against a load.

    Args:
        load: Friction over the torque of the current limit.
        count, succeeded: How many, and how many of them succeeded.
        interval: Within which the true share lies with 95 %.
        failures: How often each failure, by its name.
    """

    load: float
    count: int
    succeeded: int
    interval: tuple[float, float]
    failures: Mapping[str, int]

    @property
    def rate(self) -> float:
        """The share that succeeded."""
        return self.succeeded / self.count


@dataclass(frozen=True, slots=True, eq=False)
class StartFigures:
    """What a start-up does.

    Args:
        largest_load: Largest load torque in N m that it starts against.
        hand_over: Electrical speed in rad/s at which it hands over.
        duration: Time in s to the hand-over by plan.
        design: The design with the chosen estimators and this start; None where it is not known.
        tried: Starts over the box of the design, by load; none where none were tried.
        untried: Why they could not be tried; empty where they could, or were not asked for.
    """

    largest_load: float
    hand_over: float
    duration: float
    design: Design | None = None
    tried: tuple[TriedStarts, ...] = ()
    untried: str = ""

    @property
    def success(self) -> float | None:
        """Least share of starts that succeed, over the loads; None where none were tried."""
        return min((part.rate for part in self.tried), default=None)


@dataclass(frozen=True, slots=True)
class StartCandidate:
    """A way to start.

    Args:
        method: The word of ``control.start_up.method``.
        title: In words.
        refusal, figures: As of `Candidate`; success is tried elsewhere, by the emitted C.
    """

    method: StartUpMethodName
    title: str
    refusal: Callable[[Question], str]
    figures: Callable[[Question], StartFigures]

    @property
    def name(self) -> str:
        """Its word."""
        return self.method


# The position observers as candidates: judged by their steady states, tried from wrong starts.

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
    raise AssertionError("a rejected candidate is not evaluated")


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
    whole = inverter.lost_per_dead_time * inverter.dead_time
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
    known = replace(asked.disturbances, loads=asked.loads)
    judged, _ = judge_loads(
        observer.method, observer.gains, observer.t_s, observer.machine, known, asked.omega[1:]
    )

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
        left=None if asked.steady else _left(asked, observer),
        slopes=slopes_of(observer, load, np.array(SLOPE_SHARES) * asked.omega_max),
        capture=None if asked.steady else capture_of(asked.design, observer),
        observer=observer,
    )


def _left(asked: Question, observer: PositionObserver) -> float | None:
    """Crossover in rad/s that is left for the speed loop."""
    if asked.loops is None:
        return None
    loops = asked.loops
    found = judge_observed(asked.design, loops, None, observer, thorough=False).observed
    return None if found is None else found.left


# What an estimator errs by per unit of each cause: derivatives of the steady errors by R, L_d,
# L_q, psi and the voltage that a dead time takes.

CAUSES = (*PARAMETERS, DEAD_TIME)
SLOPE_SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)  # Speeds over the largest one at which they are given.
_STEP = 1e-3  # of a parameter; of the voltage R i for the dead time


def slopes_of(observer: PositionObserver, load: Load, omega: FloatArray) -> Slopes:
    """Derivatives of the steady errors by central differences.

    Args:
        observer: The observer.
        load: Currents, and the machine there.
        omega: Electrical speeds in rad/s, shape (S,).
    """
    count, cases = len(omega), len(CAUSES)
    exact = np.array([observer.machine.r_s, load.l_d, load.l_q, load.psi_pm])
    current = complex(load.i_d, load.i_q)
    volt = observer.machine.r_s * abs(current)
    rows = np.repeat(exact[None, :], 2 * cases, axis=0)
    lost = np.zeros(2 * cases)
    for k, cause in enumerate(CAUSES):
        for row, sign in ((2 * k, 1.0), (2 * k + 1, -1.0)):
            if cause == DEAD_TIME:
                lost[row] = sign * _STEP * volt
            else:
                rows[row, k] *= 1.0 + sign * _STEP
    found = steady_observer(
        observer.method,
        observer.gains,
        observer.t_s,
        Plants(*np.repeat(rows, count, axis=0).T),
        np.full(2 * cases * count, current),
        np.tile(omega, 2 * cases),
        0.0,
        np.repeat(lost, count),
    )
    holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)

    def slopes(error: FloatArray) -> dict[str, FloatArray]:
        values = np.where(holds, error, np.nan).reshape(cases, 2, count)
        size = {DEAD_TIME: 2.0 * _STEP * volt}
        return {
            cause: (values[k, 0] - values[k, 1]) / size.get(cause, 2.0 * _STEP)
            for k, cause in enumerate(CAUSES)
        }

    return Slopes(omega, slopes(found.theta_error), slopes(found.omega_error))


# The speed loop over an observer, both judged as one: as `tune` would in a design that asks for
# this observer.


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """The loop.

    Args:
        margin, crossover: Phase margin in rad and crossover in rad/s at the worst speed.
        holds: Whether it is stable with the margin that the design asks for.
        low: Least electrical speed in rad/s from which every corner of the tolerances is stable,
            dead time apart; nan where there is none.
    """

    margin: float
    crossover: float
    holds: bool
    low: float

    @property
    def robust(self) -> bool:
        """Whether it has its margin, and there is a speed at which every corner is stable."""
        return self.holds and math.isfinite(self.low)


def control_over(asked: Question, name: str) -> ControlSettings:
    """Control of the design with another observer, as in a design that leaves open what is chosen
    together: a speed loop by the symmetrical optimum counts the lag of the observer.

    Args:
        asked: The question.
        name: Of the observer.
    """
    control = asked.design.control
    loop, own = control.speed_loop, control.observer
    other = own is None or own.method != name
    if other and loop is not None and loop.method == "symmetrical-optimum":
        loop = replace(loop, spread=SPREAD, counts_observer=True)
    return replace(control, observer=settings_of(asked, name), speed_loop=loop)


def closed_loop(asked: Question, name: str) -> ClosedLoop | None:
    """The speed loop over an observer; None without a speed loop, or where it has none.

    Args:
        asked: The question.
        name: Of the observer.
    """
    design = asked.design
    if design.control.speed_loop is None or asked.loops is None or name not in METHODS:
        return None
    chosen = replace(control_over(asked, name), start_up=None, six_step=None)
    try:
        speed = solve_gains(replace(design, control=chosen)).speed
    except (InputError, NoSolutionError):
        return None
    found = None if speed is None else speed.observed
    if speed is None or found is None:
        return None
    low = float("nan") if found.corners is None else found.corners.binding.low
    return ClosedLoop(speed.phase_margin, speed.crossover, found.holds, low)


# From which wrong starts a position observer locks: angle and speed of its start off by so much,
# on the exact machine at a constant speed.
#
# Every cell of the map is a run of the emitted step, all of them at once. Currents and voltages
# are those of the steady drive, so that what a run shows is the observer's own way to the truth,
# as after a hand-over or a flying start.

CAPTURE_SHARES = (0.1, 0.25, 0.5, 1.0)  # Speeds of the map over the largest one.

# Errors of the angle at the start in rad, estimate minus truth.
START_ANGLES = np.radians(np.arange(-180.0, 181.0, 15.0))

# Errors of the speed at the start over the speed: -1 starts from rest, -2 the wrong way round.
START_SPEEDS = np.array([-2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0])

_TIME_CONSTANTS = 15.0
_SHORTEST, _LONGEST = 400, 4000  # samples
_WATCHED = 0.25  # share of a run, its end, that decides


def _samples(
    method: ObserverMethod, gains: Any, t_s: float, machine: LinearMachine, starts: _Starts
) -> int:
    """How many samples the slowest pole wants, within what a map may take."""
    speeds = np.unique(starts.omega)
    current = np.full(len(speeds), starts.current)
    found = steady_observer(method, gains, t_s, plants(machine, count=len(speeds)), current, speeds)
    radius = np.abs(found.poles[:, 0])
    slow = radius[found.found & (radius < 1.0)]
    if not slow.size:
        return _LONGEST
    wanted = -_TIME_CONSTANTS / np.log(min(float(np.max(slow)), 1.0 - 1e-9))
    return int(np.clip(np.ceil(wanted), _SHORTEST, _LONGEST))


@dataclass(frozen=True, slots=True, eq=False)
class _Starts:
    """N starts: electrical speed in rad/s, errors of angle and speed; one current in A."""

    omega: FloatArray
    angle: FloatArray
    speed: FloatArray
    current: complex


def _last_outside(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    machine: LinearMachine,
    starts: _Starts,
    samples: int,
) -> NDArray[np.int64]:
    """Index of the last sample at which each start was outside the limits around the rotor, and
    around half a turn from it, shape (2, N).
    """
    omega = starts.omega
    voltage = steady_voltage(
        plants(machine, count=len(omega)), np.full(len(omega), starts.current), omega, t_s
    )
    state = method.start(np.asarray(EXACT.wrap(starts.angle)), omega * (1.0 + starts.speed))
    last = np.zeros((2, len(omega)), dtype=np.int64)
    with np.errstate(all="ignore"):  # a start that is lost may run away
        for k in range(samples):
            theta = EXACT.wrap(omega * t_s * k)
            turn = np.exp(1j * theta)
            v, i = voltage * turn, starts.current * turn
            state = method.step(gains, state, (v.real, v.imag), (i.real, i.imag), EXACT)
            error = EXACT.wrap(np.asarray(state.theta_e) - theta)
            slow = np.abs(state.omega_e - omega) <= SPEED_LIMIT * np.abs(omega)
            near = np.abs(error)
            last[0, ~(slow & (near <= ANGLE_LIMIT))] = k
            last[1, ~(slow & (near >= np.pi - ANGLE_LIMIT))] = k
    return last


def capture_map(
    observer: PositionObserver,
    i_dq: complex,
    omega: FloatArray | None = None,
    angles: FloatArray = START_ANGLES,
    speeds: FloatArray = START_SPEEDS,
) -> CaptureMap:
    """Which starts lock.

    Args:
        observer: The observer, on its own machine.
        i_dq: Current i_d + j i_q of the drive in A.
        omega: Electrical speeds in rad/s, positive, shape (S,); None for shares of the largest one.
        angles, speeds: Errors at the start, as in `CaptureMap`.
    """
    method, gains, t_s, machine = observer.method, observer.gains, observer.t_s, observer.machine
    at = np.array(CAPTURE_SHARES) * observer.omega_max if omega is None else omega
    mesh = np.meshgrid(at, speeds, angles, indexing="ij")
    starts = _Starts(mesh[0].ravel(), mesh[2].ravel(), mesh[1].ravel(), i_dq)
    samples = _samples(method, gains, t_s, machine, starts)
    last = _last_outside(method, gains, t_s, machine, starts, samples)
    rest = last < (1.0 - _WATCHED) * samples
    outcome = np.where(rest[0], LOCKED, np.where(rest[1], HALF_TURN, LOST)).astype(np.int8)
    times = np.where(rest[0], (last[0] + 1) * t_s, np.inf)
    shape = mesh[0].shape
    return CaptureMap(
        at, angles, speeds, outcome.reshape(shape), times.reshape(shape), samples * t_s
    )


# Steady errors of a position observer on the machine as it becomes in operation: its copper and
# its magnets warmer than the constants of the firmware.
#
# R grows with the temperature of the copper and psi falls with that of the magnets, both at once
# and each by its own coefficient; the magnets are taken to warm up half as much as the winding.
# Where the design gives operating temperatures, the firmware's constants hold there, and the
# machine that has just been switched on is the one that differs: it is shown beside the warmer
# ones.

LOAD_SHARES = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Torques over the largest one at which errors are shown.

# Relative change of the magnet flux linkage per K where the design gives none: NdFeB.
MAGNET_COEFFICIENT = -0.11e-2
_RISES = (0.0, 40.0, 80.0)
_MAGNET_SHARE = 0.5  # of the rise of the winding
_REFERENCE = 20.0  # degC of constants without a temperature


@dataclass(frozen=True, slots=True)
class WarmState:
    """Rises in K above the temperatures at which the firmware's constants hold, and what they make.

    ``r_s`` and ``psi_pm`` are relative changes of resistance and magnet flux linkage.
    """

    winding: float
    magnet: float
    r_s: float
    psi_pm: float


@dataclass(frozen=True, slots=True, eq=False)
class WarmErrors:
    """Steady errors of an observer, estimate minus truth, inf where the angle is lost.

    Args:
        states: T states of the machine, by rising temperature.
        shares: Torques over the largest one, shape (L,).
        omega: Electrical speeds in rad/s, shape (S,).
        angle, speed: In rad and rad/s by temperature alone, shape (T, L, S).
        angle_with_dead_time, speed_with_dead_time: The same with the dead time that the design
            leaves besides.
    """

    states: tuple[WarmState, ...]
    shares: FloatArray
    omega: FloatArray
    angle: FloatArray
    speed: FloatArray
    angle_with_dead_time: FloatArray
    speed_with_dead_time: FloatArray

    @property
    def shown(self) -> tuple[int, ...]:
        """Indices of the states that a table shows: the cold one where there is one, and the
        hottest.
        """
        cold = (0,) if self.states[0].winding < 0.0 or self.states[0].magnet < 0.0 else ()
        return (*cold, len(self.states) - 1)


def _given(design: Design, key: str, default: float) -> float:
    """A value of the section machine.temperature in SI units (degC), or its default."""
    path = f"machine.temperature.{key}"
    return next((value.si for value in design.values if value.path == path), default)


def warm_states(design: Design) -> tuple[WarmState, ...]:
    """States of the machine from the constants of the firmware up, and the cold one where these
    hold at operating temperatures.
    """
    reference = _given(design, "winding_reference", _REFERENCE)
    winding = _given(design, "winding", reference)
    cold_magnet = _given(design, "magnet_reference", _REFERENCE)
    magnet = _given(design, "magnet", cold_magnet)
    copper = _given(design, "copper_coefficient", COPPER_COEFFICIENT)
    remanence = _given(design, "magnet_coefficient", MAGNET_COEFFICIENT)
    rises = [(rise, _MAGNET_SHARE * rise) for rise in _RISES]
    if (winding, magnet) != (reference, cold_magnet):
        rises.insert(0, (reference - winding, cold_magnet - magnet))
    scale = 1.0 + copper * (winding - reference), 1.0 + remanence * (magnet - cold_magnet)
    # Adding zero turns -0 into 0.
    return tuple(
        WarmState(w, m, copper * w / scale[0] + 0.0, remanence * m / scale[1] + 0.0)
        for w, m in rises
    )


def _plants(design: Design, loads: tuple[Load, ...], states: tuple[WarmState, ...]) -> FloatArray:
    """Rows (R, L_d, L_q, psi) of the true machines, shape (T, L, 4)."""
    linear = linearised(design.machine)
    rows = [
        [
            # Of a saturated machine the magnets' share alone follows their temperature.
            (
                linear.r_s * (1.0 + state.r_s),
                load.l_d,
                load.l_q,
                load.psi_pm + state.psi_pm * linear.psi_pm,
            )
            for load in loads
        ]
        for state in states
    ]
    return np.array(rows)


def warm_errors(
    design: Design, observer: PositionObserver, omega: FloatArray | None = None
) -> WarmErrors:
    """Steady errors over temperature, load and speed.

    Args:
        design: The drive.
        observer: Its position observer.
        omega: Electrical speeds in rad/s, positive, shape (S,); None for those of the tables.
    """
    speeds = np.array(SHOWN) * observer.omega_max if omega is None else omega
    states, loads = warm_states(design), loads_at(design, LOAD_SHARES)
    rows = _plants(design, loads, states)
    shape = (len(states), len(loads), len(speeds))
    spread = np.broadcast_to(rows[:, :, None, :], (*shape, 4)).reshape(-1, 4)
    current = np.array([complex(load.i_d, load.i_q) for load in loads])
    currents = np.broadcast_to(current[None, :, None], shape).ravel()
    every = np.broadcast_to(speeds, shape).ravel()

    def errors(lost: float) -> tuple[FloatArray, FloatArray]:
        found = steady_observer(
            observer.method,
            observer.gains,
            observer.t_s,
            Plants(*spread.T),
            currents,
            every,
            0.0,
            lost,
        )
        holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)
        angle, speed = (
            np.where(holds, part, np.inf).reshape(shape)
            for part in (found.theta_error, found.omega_error)
        )
        return angle, speed

    plain, dead = errors(0.0), errors(lost_voltage(design)[1])
    return WarmErrors(states, np.array(LOAD_SHARES), speeds, *plain, *dead)


# What is computed of a design's position observer when it is tuned: warm machines and starts.

_LOAD = 0.5  # torque of the capture map over the largest one


@dataclass(frozen=True, slots=True, eq=False)
class ObserverEvidence:
    """Steady errors on warm machines, and the starts from which the observer locks."""

    warm: WarmErrors
    capture: CaptureMap


def capture_of(design: Design, observer: PositionObserver) -> CaptureMap:
    """Starts from which an observer locks at half the largest torque.

    Args:
        design: The drive.
        observer: The observer.
    """
    load = loads_at(design, (_LOAD,))[0]
    return capture_map(observer, complex(load.i_d, load.i_q))


def observer_evidence(design: Design, observer: PositionObserver | None) -> ObserverEvidence | None:
    """Both of the design's own observer, None where it has none.

    Args:
        design: The drive.
        observer: As `solve_gains` tuned it.
    """
    if observer is None:
        return None
    return ObserverEvidence(warm_errors(design, observer), capture_of(design, observer))
