"""From which speed on a drive on its observer holds at every corner of its box."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import SPEED_ERROR
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.drive_model import (
    OWN,
    RELATIVE,
    DriveCases,
    ObservedDrive,
    drive_cases,
    exact_cases,
)
from dqforge.optimizer.loops.observed_margins import (
    Corner,
    CornerJudgement,
    FailingCorner,
    Failure,
    LimitCycle,
    SpeedRange,
    StepsBorne,
)
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.observers.parts import usual_disturbances
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.sampled_systems import ComplexArray, SampledSystem

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design


# Lowest speed that is tried, over the largest. Observers count their speed as 0.02 of it at least:
# there their step has a kink, where central differences tell the slope of neither side.
LEAST_SHARE = 0.0205

# Least rates at which modes die away at every corner: those that swing over the bandwidth kp/J of
# the speed loop, all of them over the rate ki/kp of its integral. What takes longer does not hold.
SWINGING, CREEPING = 0.1, 0.3
_SPEEDS = 9
# Above the lowest speed that holds further ones are tried up to this multiple of it: what fails
# there may lie between two of the nine, as the step of an observer may change with its speed.
_NEAR, _NEARER = 2.5, 9
_BISECTIONS = 5


@dataclass(frozen=True, slots=True)
class SpeedPi:
    """The speed controller: ``kp`` in N m s/rad, ``ki`` in N m/rad, current samples per sample."""

    kp: float
    ki: float
    ratio: int


def settling(steady: SteadyDrives, speed: SpeedPi, inertia: float) -> FloatArray:
    """How fast the slowest mode dies away, over the least rate that counts as holding, shape (M,).

    Args:
        steady: Drives.
        speed: The speed controller.
        inertia: As the design has it, in kg m^2.
    """
    swings, every = steady.decay(speed.ratio, speed.kp, speed.ki)
    return np.minimum(
        swings * inertia / (SWINGING * speed.kp), every * speed.kp / (CREEPING * speed.ki)
    )


def worst_corner(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    corners: tuple[Corner, ...],
    omega: float,
    limits: tuple[float, float] = (np.inf, np.inf),
) -> FailingCorner:
    """The corner that fails at an electrical speed in rad/s; that with the largest pole where none
    does.

    Args:
        drive: Control and observer.
        machine: As the design has it.
        speed: The speed controller.
        corners: What is tried.
        limits: Phase amplitude in V that the link has, and largest relative error of the speed.
            Corners without the voltage count only where no other one is unstable.
    """
    steady = steady_drives(drive, cases_of(machine, corners, omega))
    radius = steady.radius(speed.ratio, speed.kp, speed.ki)
    rate = settling(steady, speed, machine.inertia or 1.0)
    volts = np.hypot(steady.states[:, 5], steady.states[:, 6])
    error = np.where(steady.found, np.abs(steady.speed_error) / omega, 0.0)
    lacking = steady.found & (volts > limits[0])
    reached, slow = np.where(lacking, 0.0, radius), np.where(lacking, np.inf, rate)
    worst = int(np.argmax(reached))
    why: Failure | None = None
    if reached[worst] >= 1.0:
        why = "unstable"
    elif np.min(slow) < 1.0:
        worst, why = int(np.argmin(slow)), "unstable"
    elif np.max(error) > limits[1]:
        worst, why = int(np.argmax(error)), "speed-error"
    elif np.any(lacking):
        worst, why = int(np.argmax(np.where(lacking, volts, 0.0))), "voltage"
    most = float(np.max(error))
    return FailingCorner(omega, corners[worst], float(radius[worst]), most, why, float(rate[worst]))


def speed_range(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    box: CornerBox,
    top: float,
    *,
    dead_time: bool = False,
    braking: bool = False,
    least: float = 0.0,
) -> SpeedRange:
    """Speeds downwards from ``top`` in rad/s (electrical) at which all corners hold.

    The first that fails below ends the range; both ends are narrowed down to two percent.

    Args:
        drive, machine, speed: As of `worst_corner`.
        box: Whose corners are tried, with its limits of voltage and speed error.
        dead_time: Whether what the dead time costs counts as well.
        braking: Whether the loads drive the shaft.
        least: Electrical speed in rad/s below which nothing is tried, where that lies above
            `LEAST_SHARE` of ``top``.
    """
    corners = box.corners(dead_time=dead_time, braking=braking)
    limits = (box.v_max, box.most_error)

    def found(omega: float) -> FailingCorner:
        return worst_corner(drive, machine, speed, corners, omega, limits)

    below: FailingCorner | None = None
    failed: list[FailingCorner] = []
    held: list[FailingCorner] = []
    for omega in np.geomspace(top, max(LEAST_SHARE * top, least), _SPEEDS).tolist():
        tried = found(omega)
        if tried.why is None:
            held.append(tried)
        elif held:
            below = tried
            break
        else:
            failed.append(tried)
    if not held:
        return SpeedRange(np.nan, np.nan, failed[-1], len(corners), failed[0])
    high, low, above = held[0], held[-1], None
    if failed:
        high, above = _narrowed(found, high, failed[-1])
    if below is not None:
        low, below = _narrowed(found, low, below)
    low, below = _without_gaps(found, low, below, high)
    error = max(each.speed_error for each in (high, low, *held))
    return SpeedRange(low.omega, high.omega, below, len(corners), above, error)


def _narrowed(
    found: Callable[[float], FailingCorner], inside: FailingCorner, outside: FailingCorner
) -> tuple[FailingCorner, FailingCorner]:
    """The end of a range between a speed that holds and one that fails, by bisection."""
    for _ in range(_BISECTIONS):
        middle = found(float(np.sqrt(inside.omega * outside.omega)))
        inside, outside = (middle, outside) if middle.why is None else (inside, middle)
    return inside, outside


def _without_gaps(
    found: Callable[[float], FailingCorner],
    low: FailingCorner,
    below: FailingCorner | None,
    high: FailingCorner,
) -> tuple[FailingCorner, FailingCorner | None]:
    """The lower end of a range with all that fails a little above it left out."""
    above = high
    for omega in np.geomspace(min(_NEAR * low.omega, high.omega), low.omega, _NEARER).tolist()[:-1]:
        tried = found(omega)
        if tried.why is not None:
            return _narrowed(found, above, tried)
        above = tried
    return low, below


def judge_corners(
    drive: ObservedDrive,
    machine: LinearMachine,
    speed: SpeedPi,
    box: CornerBox,
    top: float,
    least: float = 0.0,
) -> CornerJudgement:
    """The range of speeds at which all corners hold, motoring and braking, without and with what
    the dead time costs.

    Args:
        drive, machine, speed, box, top, least: As of `speed_range`.
    """
    exact = speed_range(drive, machine, speed, box, top, least=least)
    braking = speed_range(drive, machine, speed, box, top, braking=True, least=least)
    lossy = None
    if box.lost:
        lossy = speed_range(drive, machine, speed, box, top, dead_time=True, least=least)
    return CornerJudgement(
        box.named,
        box.limits,
        box.loads,
        exact,
        box.lost,
        lossy,
        braking,
        most_error=box.most_error,
        pole_pairs=machine.pole_pairs,
    )


# Steady states of drives on their observer, and how they answer to torque: Newton and differences.
#
# With the speed controller at rest its torque is constant and what it sees is its reference: the
# states x of a current sample and the torque T follow from
#
#     F(x, T) = x,   filtered speed = reference
#
# by Newton's method, from the steady state with exact data; where that does not lead there, along
# the way from exact to wrong data. The derivative of F there is the drive's state space; held over
# the samples of a speed period and closed by the PI it has the poles of the whole.

_STEP = 1e-6


_NEWTON_STEPS = 12


_CLOSE = 1e-8  # largest change in a step, in sizes: rounding alone


_LARGEST_MOVE = 0.5  # in sizes


_STAGES = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class SteadyDrives:
    """Steady states of M drives with n states, and their derivatives per current sample.

    ``states`` (M, n) as in `drive_model.OWN`, behind them those of the estimator; ``torque`` (M,)
    in N m; ``angle_error`` in rad and ``speed_error`` in rad/s (electrical) are estimate minus
    truth, shape (M,); ``found`` (M,) whether there is a steady state within 90 degrees of the
    rotor and the largest torque. ``a`` (M, n, n), ``b`` (M, n) and ``c`` (M, n) lead from the
    torque reference in N m to the filtered mechanical speed in rad/s.
    """

    t_s: float
    states: FloatArray
    torque: FloatArray
    angle_error: FloatArray
    speed_error: FloatArray
    found: NDArray[np.bool_]
    a: FloatArray
    b: FloatArray
    c: FloatArray

    def system(self, case: int) -> SampledSystem:
        """State space of one drive, sampled with the current."""
        a, b, c = self.a[case], self.b[case][:, None], self.c[case][None, :]
        return SampledSystem(a, b, c, np.zeros((1, 1)), self.t_s)

    def closed(self, ratio: int, kp: float, ki: float) -> FloatArray:
        """Transition matrices over ``ratio`` samples with the speed PI, shape (M, n + 1, n + 1).

        ``kp`` in N m s/rad, ``ki`` in N m/rad.
        """
        count, n = self.c.shape
        a = np.broadcast_to(np.eye(n), self.a.shape)
        b = np.zeros_like(self.b)
        for _ in range(ratio):
            a, b = self.a @ a, (self.a @ b[..., None])[..., 0] + self.b
        step = ki * ratio * self.t_s
        whole = np.zeros((count, n + 1, n + 1))
        whole[:, :n, :n] = a - (kp + step) * b[:, :, None] * self.c[:, None, :]
        whole[:, :n, n], whole[:, n, n] = b, 1.0
        whole[:, n, :n] = -step * self.c
        return whole

    def poles(self, ratio: int, kp: float, ki: float) -> ComplexArray:
        """Poles in the z plane of the speed period, largest modulus first, shape (M, n + 1).

        Where there is no steady state they are nan.
        """
        whole = self.closed(ratio, kp, ki)
        finite = np.all(np.isfinite(whole), axis=(1, 2)) & self.found
        whole[~finite] = 0.0
        values = np.linalg.eigvals(whole).astype(np.complex128)
        values[~finite] = np.nan
        order = np.argsort(-np.abs(values), axis=1, kind="stable")
        return np.take_along_axis(values, order, axis=1)

    def decay(self, ratio: int, kp: float, ki: float) -> tuple[FloatArray, FloatArray]:
        """Rates in 1/s at which the slowest of the modes that swing, and of all, dies away, shapes
        (M,): negative where one grows, inf where none swings, -inf where there is no steady state.
        """
        poles = self.poles(ratio, kp, ki)
        with np.errstate(divide="ignore"):
            rate = -np.log(np.abs(poles)) / (ratio * self.t_s)
        rate = np.where(np.isnan(rate), -np.inf, rate)
        swinging = np.abs(np.angle(poles)) >= np.abs(rate) * ratio * self.t_s
        lost = np.isinf(rate) & (rate < 0.0)
        swings = np.min(np.where(swinging | lost, rate, np.inf), axis=1)
        return swings, np.min(rate, axis=1)

    def radius(self, ratio: int, kp: float, ki: float) -> FloatArray:
        """Largest modulus of a pole, shape (M,); inf where there is no steady state."""
        size = np.abs(self.poles(ratio, kp, ki)[:, 0])
        return np.where(np.isfinite(size), size, np.inf)


@dataclass(slots=True, eq=False)
class _Point:
    """States, torques and sizes on the way to a steady state."""

    x: FloatArray
    torque: FloatArray
    size: FloatArray
    torque_size: float

    def taken(self, index: NDArray[np.intp]) -> _Point:
        return _Point(self.x[index], self.torque[index], self.size[index], self.torque_size)


def _gaps(drive: ObservedDrive, cases: DriveCases, point: _Point) -> tuple[FloatArray, FloatArray]:
    """What a step changes, in sizes, shape (M, n + 1): states, and speed against its reference;
    then the derivative of that by states and torque in sizes, shape (M, n + 1, n + 1).
    """
    m, n = point.x.shape
    step = _STEP * np.concatenate([point.size, np.full((m, 1), point.torque_size)], axis=1)
    base = np.concatenate([point.x, point.torque[:, None]], axis=1)
    moved = np.concatenate([base[None], base + np.moveaxis(step[..., None] * np.eye(n + 1), 2, 0)])
    flat = moved.reshape(-1, n + 1)
    after, speeds = drive.step(cases.tiled(n + 2), flat[:, :n], flat[:, n])
    pole_pairs = drive.data.machine.pole_pairs
    change = (after - flat[:, :n]).reshape(n + 2, m, n)
    change[..., -2] = (change[..., -2] + np.pi) % (2.0 * np.pi) - np.pi
    missing = speeds.reshape(n + 2, m) * pole_pairs - cases.omega
    values = np.concatenate(
        [change / point.size, (missing / np.maximum(np.abs(cases.omega), 1.0))[..., None]], axis=2
    )
    return values[0], np.moveaxis((values[1:] - values[0]) / _STEP, 0, -1)


def _solved(
    drive: ObservedDrive, cases: DriveCases, point: _Point
) -> tuple[_Point, NDArray[np.bool_]]:
    """Newton's method on all drives at once, each with a limited move; which have arrived."""
    arrived = np.zeros(len(point.x), dtype=np.bool_)
    point = point.taken(np.arange(len(point.x)))
    for _ in range(_NEWTON_STEPS):
        left = np.flatnonzero(~arrived)
        part = point.taken(left)
        gap, slope = _gaps(drive, cases.taken(left), part)
        finite = np.all(np.isfinite(gap), axis=1) & np.all(np.isfinite(slope), axis=(1, 2))
        gap[~finite], slope[~finite] = 0.0, np.eye(slope.shape[1])
        close = finite & (np.max(np.abs(gap), axis=1) < _CLOSE)
        move = _directions(slope, gap)
        largest = np.maximum(np.max(np.abs(move), axis=1), _LARGEST_MOVE) / _LARGEST_MOVE
        move = np.where((close | ~finite)[:, None], 0.0, move / largest[:, None])
        point.x[left] = part.x + move[:, :-1] * part.size
        point.torque[left] = part.torque + move[:, -1] * point.torque_size
        arrived[left[close]] = True
        if np.all(arrived):
            break
    return point, arrived


def _directions(slope: FloatArray, gap: FloatArray) -> FloatArray:
    """Newton's moves in sizes, shape (M, n + 1); by least squares where the matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(slope, -gap[..., None])[..., 0])
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(slope) @ -gap[..., None])[..., 0])


def steady_drives(drive: ObservedDrive, cases: DriveCases) -> SteadyDrives:
    """Steady states of M drives on their observer.

    Args:
        drive: Control and observer, and what they believe.
        cases: The true machines, at speeds and loads.
    """
    with np.errstate(all="ignore"):  # beyond the range of an observer numbers may grow
        exact, point = _begun(drive, cases)
        found_at, arrived = _solved(drive, cases, point)
        lost = np.flatnonzero(~arrived)
        if len(lost):
            way, held = point.taken(lost), np.ones(len(lost), dtype=np.bool_)
            for share in _STAGES:
                at = exact.taken(lost).towards(cases.taken(lost), share)
                way, held = _solved(drive, at, way)
            found_at.x[lost], found_at.torque[lost] = way.x, way.torque
            arrived[lost] = held
        return _derived(drive, cases, found_at, arrived)


def _begun(drive: ObservedDrive, cases: DriveCases) -> tuple[DriveCases, _Point]:
    """Where Newton starts: speeds and loads with exact data, each once."""
    pairs = np.stack([cases.omega, cases.load], axis=1)
    _, first, place = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    begun = _with_exact_data(drive, cases.omega[first].tobytes(), cases.load[first].tobytes())
    exact = exact_cases(drive.data.machine, cases)
    return exact, begun.taken(np.asarray(place).reshape(-1))


@lru_cache(maxsize=32)
def _with_exact_data(drive: ObservedDrive, omega: bytes, load: bytes) -> _Point:
    """Steady states at speeds and loads, the bytes of arrays of shape (M,).

    The corners of a box ask for the same ones with and without what a dead time costs.
    """
    machine = drive.data.machine
    exact = drive_cases(machine, np.frombuffer(omega), np.frombuffer(load))
    x, size, torque = drive.start(exact)
    torque_size = machine.torque_per_ampere * machine.i_max
    return _solved(drive, exact, _Point(x, torque, size, torque_size))[0]


def _derived(
    drive: ObservedDrive, cases: DriveCases, point: _Point, arrived: NDArray[np.bool_]
) -> SteadyDrives:
    """Central differences around the steady states."""
    m, n = point.x.shape
    step = _STEP * np.concatenate([point.size, np.full((m, 1), point.torque_size)], axis=1)
    base = np.concatenate([point.x, point.torque[:, None]], axis=1)
    moves = np.moveaxis(step[..., None] * np.eye(n + 1), 2, 0)
    flat = np.concatenate([base + moves, base - moves]).reshape(-1, n + 1)
    after, speeds = drive.step(cases.tiled(2 * (n + 1)), flat[:, :n], flat[:, n])
    ends, seen = after.reshape(2, n + 1, m, n), speeds.reshape(2, n + 1, m)
    slope = (ends[0] - ends[1]) / (2.0 * step.T[:, :, None])
    by_speed = (seen[0] - seen[1]) / (2.0 * step.T)
    delta, speed = _estimates(drive, point.x)
    good = arrived & (np.abs(delta) < 0.5 * np.pi) & (np.abs(point.torque) <= drive.data.torque_max)
    return SteadyDrives(
        t_s=drive.data.t_s,
        states=point.x,
        torque=point.torque,
        angle_error=delta,
        speed_error=speed - point.x[:, 2],
        found=good & np.isfinite(delta),
        a=np.moveaxis(slope[:n], 0, -1),
        b=slope[n],
        c=by_speed[:n].T,
    )


def _estimates(drive: ObservedDrive, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angle error in rad and electrical speed in rad/s of the estimates at the sample."""
    i, acted = x[:, 0] + 1j * x[:, 1], x[:, 3] + 1j * x[:, 4]
    _, delta, speed = drive.estimator.step(x[:, OWN:], acted, i)
    return delta, speed


# Corners of the box within which a drive on its observer must hold: tolerances, loads,
# dead time.

LOAD_SHARE = 0.3  # Load of the corners beside none, over the largest torque.


@dataclass(frozen=True, slots=True)
class CornerBox:
    """All corners of a design.

    ``named`` says whether the design names tolerances; else the box is the usual one of the
    observers' conditions. ``limits`` are the least and largest relative errors by name, exact
    values left out; ``loads`` in N m; ``lost`` the voltages in V that the dead time may cost,
    empty where it costs none. ``v_max`` in V is the phase amplitude that the link has,
    ``most_error`` the largest error of the speed that counts as holding, relative.
    """

    named: bool
    limits: dict[str, tuple[float, float]]
    loads: tuple[float, ...]
    lost: tuple[float, ...]
    v_max: float = np.inf
    most_error: float = np.inf

    def corners(self, *, dead_time: bool, braking: bool = False) -> tuple[Corner, ...]:
        """Every combination of the limits with every load, and with the dead time or without;
        ``braking`` with the loads that drive the shaft instead.
        """
        errors = [
            dict(zip(self.limits, values, strict=True)) for values in product(*self.limits.values())
        ]
        lost = self.lost if dead_time else (0.0,)
        loads = tuple(-load for load in self.loads if load) if braking else self.loads
        return tuple(Corner(*parts) for parts in product(errors, loads, lost))


def corner_box(design: Design) -> CornerBox:
    """Corners of `control.tolerances`; where a design names none, of the usual errors of R, L and
    psi.

    Dead time counts as for the observer alone: the whole of it, or what `control.tolerances` says
    that its compensation leaves.
    """
    machine, tolerances = design.machine, design.control.tolerances
    if tolerances is None:
        usual = usual_disturbances(linearised(machine), design.inverter.v_dc, 1.0)
        limits = {name: usual.limits(name) for name in ("r_s", "l_d", "l_q", "psi_pm")}
    else:
        limits = {
            name: tolerances.limits(name)  # type: ignore[arg-type]
            for name in RELATIVE
        }
    choice = CurrentChoice(linearised(machine), design.operation.strategy, design.i_max)
    observer = design.control.observer
    lost = tuple(dict.fromkeys(value for value in lost_voltage(design) if value != 0.0))
    return CornerBox(
        tolerances is not None,
        {name: pair for name, pair in limits.items() if pair != (0.0, 0.0)},
        (0.0, LOAD_SHARE * choice.largest_torque()),
        lost,
        # a weakened field needs less voltage than the currents that are followed here
        np.inf if design.weakening is not None else design.v_max,
        SPEED_ERROR if observer is None else observer.max_speed_error,
    )


# Errors within which a drive on a tracker is judged: the others change what it measures as well,
# which its loop does not know.
TRACKED = ("r_s", "psi_pm", "inertia")


def tracked_box(design: Design) -> CornerBox:
    """Corners of a drive on a tracker: those of `corner_box` in R, psi and J, without dead time."""
    box = corner_box(design)
    limits = {name: pair for name, pair in box.limits.items() if name in TRACKED}
    return replace(box, limits=limits, lost=())


def cases_of(machine: LinearMachine, corners: tuple[Corner, ...], omega: float) -> DriveCases:
    """The drives of all corners at an electrical speed in rad/s, shape (corners,)."""
    names = dict.fromkeys(name for corner in corners for name in corner.errors)

    def column(name: str) -> FloatArray:
        return np.array([corner.errors.get(name, 0.0) for corner in corners])

    return drive_cases(
        machine,
        np.full(len(corners), omega),
        np.array([corner.load for corner in corners]),
        {name: column(name) for name in names},
        np.array([corner.lost for corner in corners]),
    )


# Which steps of load and of speed a drive on its observer bears at every corner of its box.
#
# Around a steady state the drive is linear as long as neither torque nor voltage meets its limit
# and the speed stays where every corner is stable. Per corner, at three speeds of the range, the
# closed loop answers to a unit step of the load with a dip D of the speed and a peak O of the
# torque, to one of the reference with a peak P of the torque and an overshoot S. A load step L
# then needs
#
#     speed - D L >= lowest speed,   T_0 + max(O, 2) L <= T_max,   |v(T_0 + max(O, 2) L)| <= v_max
#
# and a step of the speed has what torque that leaves, (max(O, 2) - 1) L/P.

_SPEED = 2  # column of the electrical speed


_TIMES = 20.0  # of J/kp, for which answers are followed


_MOST_PERIODS = 5000


_LEAST_PEAK = 2.0  # of the torque, over the load step that causes it


_SHARES = (1.0, 0.75, 0.5, 0.35, 0.2, 0.1, 0.05)  # of the largest load, tried one by one


_STEPS_BORNE_BISECTIONS = 20


@dataclass(frozen=True, slots=True)
class _Answers:
    """The worst of all corners: ``dip`` in rad/s (electrical) per N m, ``peak`` in N m per N m,
    ``effort`` in N m s/rad (mechanical), ``overshoot`` over the step, ``idle`` in N m without load.
    """

    dip: float
    peak: float
    effort: float
    overshoot: float
    idle: float


def steps_borne(
    drive: ObservedDrive, machine: LinearMachine, speed: SpeedPi, box: CornerBox, held: SpeedRange
) -> StepsBorne:
    """Steps that the drive bears within a range.

    Args:
        drive, machine, speed, box: As of
            `dqforge.optimizer.control_design.speed_range.speed_range`.
        held: Where every corner holds.
    """
    corners = (*box.corners(dead_time=False), *box.corners(dead_time=False, braking=True))
    cases = [
        cases_of(machine, corners, omega) for omega in np.geomspace(held.low, held.high, 3).tolist()
    ]
    found = [_answers(drive, each, speed) for each in cases]
    dip, peak, effort, overshoot, idle = (
        max(getattr(each, name) for each in found)
        for name in ("dip", "peak", "effort", "overshoot", "idle")
    )
    rise = max(peak, _LEAST_PEAK)
    most = min(max(box.loads), (drive.data.torque_max - idle) / rise)
    for share in _SHARES:
        load = share * most
        low, torque = held.low + dip * load, idle + rise * load
        high = _reached(drive, cases[-1], torque, (held.low, held.high), box.v_max)
        if load > 0.0 and low < high:
            step = machine.pole_pairs * (rise - 1.0) * load / effort
            return StepsBorne(load, low, high, step, overshoot)
    return StepsBorne(0.0, held.low, held.high, 0.0, overshoot)


def _answers(drive: ObservedDrive, cases: DriveCases, speed: SpeedPi) -> _Answers:
    steady = steady_drives(drive, cases)
    whole = steady.closed(speed.ratio, speed.kp, speed.ki)
    by_load, by_speed = _inputs(drive, cases, steady, speed)
    period = speed.ratio * steady.t_s
    least = _TIMES * float(np.max(cases.inertia)) / (speed.kp * period)
    x = np.zeros((*by_load.shape, 2))
    both = np.stack([by_load, by_speed], axis=-1)
    gain = speed.kp + speed.ki * period
    dip = peak = effort = fast = 0.0
    for _ in range(min(_MOST_PERIODS, max(50, math.ceil(least)))):
        torque = x[:, -1] - gain * np.sum(steady.c[:, :, None] * x[:, :-1], axis=1)
        dip = max(dip, float(np.max(np.abs(x[:, _SPEED, 0]))))
        fast = max(fast, float(np.max(x[:, _SPEED, 1])))
        peak = max(peak, float(np.max(np.abs(torque[:, 0]))))
        effort = max(effort, float(np.max(np.abs(torque[:, 1] + gain))))
        x = whole @ x + both
    pole_pairs = drive.data.machine.pole_pairs
    idle = float(np.max(np.abs(steady.torque[cases.load == 0.0]), initial=0.0))
    return _Answers(dip, peak, effort, max(fast / pole_pairs - 1.0, 0.0), idle)


def _inputs(
    drive: ObservedDrive, cases: DriveCases, steady: SteadyDrives, speed: SpeedPi
) -> tuple[FloatArray, FloatArray]:
    """How a unit step of the load, and of the reference (mechanical), enter a speed period,
    shape (M, n + 1).
    """
    step = 1e-4 * drive.data.torque_max
    after = [
        drive.step(replace(cases, load=cases.load + sign * step), steady.states, steady.torque)[0]
        for sign in (1.0, -1.0)
    ]
    own = (after[0] - after[1]) / (2.0 * step)
    load, torque = np.zeros_like(own), np.zeros_like(own)
    for _ in range(speed.ratio):
        load = (steady.a @ load[..., None])[..., 0] + own
        torque = (steady.a @ torque[..., None])[..., 0] + steady.b
    integral = speed.ki * speed.ratio * steady.t_s
    one = np.ones((len(own), 1))
    return (
        np.concatenate([load, 0.0 * one], axis=1),
        np.concatenate([(speed.kp + integral) * torque, integral * one], axis=1),
    )


def _reached(
    drive: ObservedDrive,
    cases: DriveCases,
    torque: float,
    between: tuple[float, float],
    v_max: float,
) -> float:
    """Largest electrical speed in rad/s between two at which every corner has the voltage for a
    torque in N m; 0 where the lower one is too fast.
    """
    i = complex(drive.data.reference(np.array([torque]))[0])

    def enough(omega: float) -> bool:
        psi = cases.psi_pm + cases.l_d * i.real + 1j * cases.l_q * i.imag
        volts = np.abs(cases.r_s * i + 1j * omega * psi) / cases.link
        return bool(np.all(volts <= v_max))

    low, high = between
    if enough(high):
        return high
    if not enough(low):
        return 0.0
    for _ in range(_STEPS_BORNE_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


# How an unstable speed loop on an observer swings in the end.
#
# Its torque becomes a square wave at its limit, the speed a triangle. The fundamental of that
# torque, 4/pi T_max, moves the shaft by T/(J omega): from peak to peak
#
#     8 T_max/(pi J omega_osc),   omega_osc = 0.9 times the frequency of the unstable pole
#
# (the limit slows the swing: simulated drives swing at 0.82 to 0.93 times that frequency).

SLOWING = 0.9  # Frequency of the limit cycle over that of the unstable pole.


def limit_cycle(
    pole: complex, period: float, torque_max: float, inertia: float
) -> LimitCycle | None:
    """Frequency and size of the swing; None of a stable pole, or one that does not swing.

    Args:
        pole: The largest of the closed loop, in the z plane.
        period: Period of the speed controller in s.
        torque_max: Limit of its torque in N m.
        inertia: In kg m^2.
    """
    turning = abs(float(np.angle(pole)))
    if not abs(pole) >= 1.0 or turning < 1e-9:
        return None
    omega = SLOWING * turning / period
    return LimitCycle(omega, 8.0 * torque_max / (np.pi * inertia * omega))
